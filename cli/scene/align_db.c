/* COLMAP's database: see align_db.h. Tables and the pair's number are those of
 * https://colmap.github.io/database.html.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/scene/align_db.h"

#include <sqlite3.h>
#include <stdio.h>
#include <string.h>

enum { DB_WAIT_MS = 2000 };
static const int64_t pair_base = 2147483647;

static sqlite3 *db_open(const char *path)
{
    sqlite3 *db = NULL;
    if (!file_exists(path) ||
        sqlite3_open_v2(path, &db, SQLITE_OPEN_READWRITE, NULL) != SQLITE_OK) {
        sqlite3_close(db);
        return NULL;
    }
    sqlite3_busy_timeout(db, DB_WAIT_MS);
    return db;
}

uint64_t align_db_count(const char *path, const char *table)
{
    char sql[100];
    sqlite3 *db = db_open(path);
    sqlite3_stmt *q = NULL;
    uint64_t n = 0;
    snprintf(sql, sizeof sql, "SELECT count(*) FROM %.60s", table);
    if (db && sqlite3_prepare_v2(db, sql, -1, &q, NULL) == SQLITE_OK &&
        sqlite3_step(q) == SQLITE_ROW)
        n = (uint64_t)sqlite3_column_int64(q, 0);
    sqlite3_finalize(q);
    sqlite3_close(db);
    return n;
}

long long align_db_camera(const char *path, const struct align_plan *plan, size_t group)
{
    sqlite3 *db = db_open(path);
    sqlite3_stmt *q = NULL;
    long long camera = -1;
    bool good = db && sqlite3_prepare_v2(db, "SELECT camera_id, name FROM images", -1, &q, NULL) ==
                          SQLITE_OK;
    while (good && camera < 0 && sqlite3_step(q) == SQLITE_ROW) {
        const char *name = (const char *)sqlite3_column_text(q, 1);
        size_t i = name ? align_plan_find(plan, name) : SIZE_MAX;
        if (i != SIZE_MAX && plan->photos[i].group == group)
            camera = sqlite3_column_int64(q, 0);
    }
    sqlite3_finalize(q);
    sqlite3_close(db);
    return camera;
}

double align_db_focal(const char *path, uint32_t camera)
{
    sqlite3 *db = db_open(path);
    sqlite3_stmt *q = NULL;
    double px = 0; /* the first parameter of all of COLMAP's models */
    if (db && sqlite3_prepare_v2(db, "SELECT params FROM cameras WHERE camera_id = ?1", -1, &q,
                                 NULL) == SQLITE_OK) {
        sqlite3_bind_int64(q, 1, camera);
        if (sqlite3_step(q) == SQLITE_ROW && sqlite3_column_bytes(q, 0) >= (int)sizeof px)
            memcpy(&px, sqlite3_column_blob(q, 0), sizeof px);
    }
    sqlite3_finalize(q);
    sqlite3_close(db);
    return px > 0 ? px : 0;
}

static uint32_t db_root(uint32_t *parent, uint32_t i)
{
    while (parent[i] != i)
        i = parent[i] = parent[parent[i]];
    return i;
}

/* Ids of images are COLMAP's: index in the plan by id, at most `cap`. */
static bool db_images(sqlite3 *db, const struct align_plan *plan, struct align_seen *seen,
                      uint32_t *by_id, size_t cap)
{
    sqlite3_stmt *q = NULL;
    bool good = sqlite3_prepare_v2(db,
                                   "SELECT images.image_id, name, coalesce(rows, 0) FROM images "
                                   "LEFT JOIN keypoints ON images.image_id = keypoints.image_id",
                                   -1, &q, NULL) == SQLITE_OK;
    while (good && sqlite3_step(q) == SQLITE_ROW) {
        int64_t id = sqlite3_column_int64(q, 0);
        const char *name = (const char *)sqlite3_column_text(q, 1);
        size_t i = name ? align_plan_find(plan, name) : SIZE_MAX;
        if (i == SIZE_MAX || id < 0 || (uint64_t)id >= cap)
            continue;
        by_id[id] = (uint32_t)i;
        seen[i].features = (uint32_t)sqlite3_column_int64(q, 2);
    }
    sqlite3_finalize(q);
    return good;
}

static bool db_pairs(sqlite3 *db, uint32_t inliers, struct align_seen *seen, const uint32_t *by_id,
                     size_t cap, uint32_t *parent)
{
    sqlite3_stmt *q = NULL;
    bool good = sqlite3_prepare_v2(db, "SELECT pair_id FROM two_view_geometries WHERE rows >= ?1",
                                   -1, &q, NULL) == SQLITE_OK;
    if (good)
        sqlite3_bind_int64(q, 1, inliers);
    while (good && sqlite3_step(q) == SQLITE_ROW) {
        int64_t pair = sqlite3_column_int64(q, 0), b = pair % pair_base, a = (pair - b) / pair_base;
        if (a < 0 || b < 0 || (uint64_t)a >= cap || (uint64_t)b >= cap || by_id[a] == UINT32_MAX ||
            by_id[b] == UINT32_MAX)
            continue;
        seen[by_id[a]].matches++;
        seen[by_id[b]].matches++;
        parent[db_root(parent, by_id[a])] = db_root(parent, by_id[b]);
    }
    sqlite3_finalize(q);
    return good;
}

enum err_code align_db_seen(const char *path, const struct align_plan *plan, uint32_t inliers,
                            struct align_seen *seen, size_t *largest, struct err *e)
{
    size_t cap = 2 * plan->n + 1000;
    uint32_t *by_id = mem_array(cap, sizeof *by_id), *parent = mem_array(plan->n, sizeof *parent),
             *count = mem_array(plan->n, sizeof *count);
    sqlite3 *db = db_open(path);
    enum err_code rc = by_id && parent && count ? ERR_OK : ERR_MEM;
    *largest = 0;
    if (rc) {
        err_set(e, rc, "align: out of memory");
    } else {
        memset(by_id, 0xff, cap * sizeof *by_id);
        for (size_t i = 0; i < plan->n; i++)
            parent[i] = (uint32_t)i;
        if (!db || !db_images(db, plan, seen, by_id, cap) ||
            !db_pairs(db, inliers, seen, by_id, cap, parent))
            rc = err_set(e, ERR_IO, "%s: no database of COLMAP: %s", path,
                         db ? sqlite3_errmsg(db) : "it cannot be opened");
    }
    for (size_t i = 0; !rc && i < plan->n; i++) {
        seen[i].part = db_root(parent, (uint32_t)i);
        size_t n = ++count[seen[i].part];
        *largest = n > *largest ? n : *largest;
    }
    sqlite3_close(db);
    mem_free(by_id);
    mem_free(parent);
    mem_free(count);
    return rc;
}

/* ---- a copy without some ---- */

/* Runs a statement; ?1 and ?2, where it has them, are numbers. */
static bool db_do(sqlite3 *db, const char *sql, int64_t a, int64_t b)
{
    sqlite3_stmt *q = NULL;
    bool good = sqlite3_prepare_v2(db, sql, -1, &q, NULL) == SQLITE_OK;
    if (good && sqlite3_bind_parameter_count(q) > 0)
        sqlite3_bind_int64(q, 1, a);
    if (good && sqlite3_bind_parameter_count(q) > 1)
        sqlite3_bind_int64(q, 2, b);
    good = good && sqlite3_step(q) == SQLITE_DONE;
    sqlite3_finalize(q);
    return good;
}

/* Is it a table of this database? Stand-ins for COLMAP may lack some. */
static bool db_has(sqlite3 *db, const char *table)
{
    return sqlite3_table_column_metadata(db, NULL, table, NULL, NULL, NULL, NULL, NULL, NULL) ==
           SQLITE_OK;
}

static bool db_remove(sqlite3 *db, int64_t image)
{
    static const char *const by_image[] = {"keypoints", "descriptors"}, *const by_pair[] = {
                                                                            "matches",
                                                                            "two_view_geometries"};
    char sql[160];
    bool good = true;
    for (size_t k = 0; k < sizeof by_image / sizeof *by_image; k++) {
        snprintf(sql, sizeof sql, "DELETE FROM %s WHERE image_id = ?1", by_image[k]);
        good = good && (!db_has(db, by_image[k]) || db_do(db, sql, image, 0));
    }
    for (size_t k = 0; k < sizeof by_pair / sizeof *by_pair; k++) {
        snprintf(sql, sizeof sql, "DELETE FROM %s WHERE pair_id / ?2 = ?1 OR pair_id %% ?2 = ?1",
                 by_pair[k]);
        good = good && (!db_has(db, by_pair[k]) || db_do(db, sql, image, pair_base));
    }
    return good;
}

static bool db_remove_all(sqlite3 *db, const struct align_plan *plan, const bool *of)
{
    sqlite3_stmt *q = NULL;
    bool good =
        sqlite3_prepare_v2(db, "SELECT image_id, name FROM images", -1, &q, NULL) == SQLITE_OK;
    while (good && sqlite3_step(q) == SQLITE_ROW) {
        const char *name = (const char *)sqlite3_column_text(q, 1);
        size_t i = name ? align_plan_find(plan, name) : SIZE_MAX;
        if (i != SIZE_MAX && of[i])
            good = db_remove(db, sqlite3_column_int64(q, 0));
    }
    sqlite3_finalize(q);
    return good;
}

enum err_code align_db_without(const char *path, const char *to, const struct align_plan *plan,
                               const bool *of, struct err *e)
{
    char part[FILE_PATH_MAX];
    enum err_code rc = file_begin(to, part, e);
    if (rc)
        return rc;
    file_sweep(to);
    file_abort(part);
    sqlite3 *db = db_open(path), *copy = NULL;
    char *sql = sqlite3_mprintf("VACUUM INTO %Q", part);
    bool good = db && sql && db_do(db, sql, 0, 0) && (copy = db_open(part)) &&
                db_do(copy, "BEGIN", 0, 0) && db_remove_all(copy, plan, of) &&
                db_do(copy, "COMMIT", 0, 0);
    if (!good)
        rc = err_set(e, ERR_IO, "%s: cannot be made: %s", to,
                     copy ? sqlite3_errmsg(copy)
                     : db ? sqlite3_errmsg(db)
                          : "COLMAP's database cannot be opened");
    sqlite3_free(sql);
    sqlite3_close(copy);
    sqlite3_close(db);
    if (!rc)
        return file_commit(part, to, e);
    file_abort(part);
    return rc;
}
