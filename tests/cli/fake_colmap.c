/* A stand-in for COLMAP 3.8 that takes its commands and options, keeps its database and writes its
 * models, without looking at a pixel. The model is the truth that `citysplat synth` wrote. What it
 * shall do wrong comes by the environment:
 *
 *   FAKE_TRUTH   COLMAP model with the true names of photographs
 *   FAKE_LOG     every call is appended to it, one a line
 *   FAKE_HANG    this command does half of its work and hangs; the file FAKE_LOG.hangs tells so
 *   FAKE_FAIL    this command fails
 *   FAKE_ALONE   photographs with this in their name or folder match none
 *   FAKE_BLANK   photographs with this in their name have 12 features
 *   FAKE_LOOSE   photographs with this in their name see three points, if they have fewer than
 *                2,000 features
 *   FAKE_SPLIT   photographs with this in their name become a model of their own
 *   FAKE_FOCAL   cameras begin with a focal length of 1 px, and models have half of their points
 *                unless it is bounded; "always" in it: even then
 *   FAKE_NEW     it has what COLMAP 3.12 has: GPS as prior, other names of options; "global" in it:
 *                a global mapper too
 *
 * Options that COLMAP 3.8 does not have are refused, as it does. Under the name glomap it has that
 * program's command and options.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "codec/scene/colmap.h"

enum {
    FAKE_NAMES = 1000,
    FAKE_FEATURES = 1500,
    FAKE_BLANK_FEATURES = 12,
    FAKE_INLIERS = 90,
    FAKE_ENOUGH = 2000,
    FAKE_FEW_POINTS = 3
};

static int fake_argc;
static char **fake_argv;

static void die(const char *what, const char *which)
{
    fprintf(stderr, "ERROR: %s: %s\n", what, which);
    exit(1);
}

static const char *option(const char *name)
{
    for (int i = 2; i + 1 < fake_argc; i += 2)
        if (!strcmp(fake_argv[i], name))
            return fake_argv[i + 1];
    return NULL;
}

static const char *needed(const char *name)
{
    const char *value = option(name);
    if (!value)
        die("option is missing", name);
    return value;
}

static bool is_set(const char *variable, const char *text)
{
    const char *value = getenv(variable);
    return value && *value && strstr(text, value);
}

static void log_call(void)
{
    const char *path = getenv("FAKE_LOG");
    FILE *f = path ? fopen(path, "a") : NULL;
    for (int i = 1; f && i < fake_argc; i++)
        fprintf(f, "%s%s", fake_argv[i], i + 1 < fake_argc ? " " : "\n");
    if (f)
        fclose(f);
}

static void hang(void)
{
    char path[4096];
    const char *log = getenv("FAKE_LOG");
    FILE *f = NULL;
    if (log && (size_t)snprintf(path, sizeof path, "%s.hangs", log) < sizeof path)
        f = fopen(path, "w");
    if (f) {
        fprintf(f, "%ld\n", (long)getpid());
        fclose(f);
    }
    for (;;)
        pause();
}

static bool is_new(void)
{
    const char *value = getenv("FAKE_NEW");
    return value && *value;
}

static void check_options(const char *const *known)
{
    for (int i = 2; i + 1 < fake_argc; i += 2) {
        const char *const *k = known;
        while (*k && strcmp(*k, fake_argv[i]) != 0)
            k++;
        if (!*k)
            die("unrecognised option", fake_argv[i]);
    }
}

/* ---- database ---- */

static sqlite3 *open_db(void)
{
    static const char *const tables =
        "PRAGMA synchronous = OFF;" /* it is killed, but the machine lives on */
        "CREATE TABLE IF NOT EXISTS cameras (camera_id INTEGER PRIMARY KEY, model INTEGER,"
        " params BLOB);"
        "CREATE TABLE IF NOT EXISTS images (image_id INTEGER PRIMARY KEY, name TEXT UNIQUE, "
        "camera_id INTEGER);"
        "CREATE TABLE IF NOT EXISTS keypoints (image_id INTEGER PRIMARY KEY, rows INTEGER);"
        "CREATE TABLE IF NOT EXISTS two_view_geometries (pair_id INTEGER PRIMARY KEY, rows "
        "INTEGER)";
    sqlite3 *db = NULL;
    if (sqlite3_open(needed("--database_path"), &db) != SQLITE_OK ||
        sqlite3_exec(db, tables, NULL, NULL, NULL) != SQLITE_OK)
        die("database", sqlite3_errmsg(db));
    sqlite3_busy_timeout(db, 5000);
    return db;
}

/* The first column of the first row; -1: there is none. */
static long long ask(sqlite3 *db, const char *sql, const char *text)
{
    sqlite3_stmt *q = NULL;
    long long out = -1;
    if (sqlite3_prepare_v2(db, sql, -1, &q, NULL) != SQLITE_OK)
        die(sql, sqlite3_errmsg(db));
    if (text)
        sqlite3_bind_text(q, 1, text, -1, SQLITE_STATIC);
    if (sqlite3_step(q) == SQLITE_ROW)
        out = sqlite3_column_int64(q, 0);
    sqlite3_finalize(q);
    return out;
}

static void insert(sqlite3 *db, const char *sql, long long a, long long b, const char *text)
{
    sqlite3_stmt *q = NULL;
    if (sqlite3_prepare_v2(db, sql, -1, &q, NULL) != SQLITE_OK)
        die(sql, sqlite3_errmsg(db));
    sqlite3_bind_int64(q, 1, a);
    sqlite3_bind_int64(q, 2, b);
    if (text)
        sqlite3_bind_text(q, 3, text, -1, SQLITE_STATIC);
    if (sqlite3_step(q) != SQLITE_DONE)
        die(sql, sqlite3_errmsg(db));
    sqlite3_finalize(q);
}

/* Lines of a file, without their ends. */
static size_t lines(const char *path, char (*out)[256])
{
    size_t n = 0;
    FILE *f = fopen(path, "r");
    if (!f)
        die("cannot open", path);
    while (n < FAKE_NAMES && fgets(out[n], 256, f)) {
        out[n][strcspn(out[n], "\r\n")] = '\0';
        n += out[n][0] != '\0';
    }
    fclose(f);
    return n;
}

/* The photograph that a link of the image folder leads to. */
static void true_name(const char *folder, const char *link, char out[4096])
{
    char path[4096];
    if ((size_t)snprintf(path, sizeof path, "%s/%s", folder, link) >= sizeof path ||
        !realpath(path, out))
        die("no such photograph", link);
}

/* Folder and name of a photograph: what leads there means nothing. */
static const char *tail(const char *path)
{
    const char *at = path + strlen(path);
    for (int slashes = 0; at > path; at--)
        if (at[-1] == '/' && ++slashes == 2)
            break;
    return at;
}

/* ---- commands ---- */

static int extract(void)
{
    static const char *const known[] = {"--database_path",
                                        "--image_path",
                                        "--image_list_path",
                                        "--ImageReader.single_camera",
                                        "--ImageReader.camera_model",
                                        "--ImageReader.existing_camera_id",
                                        "--SiftExtraction.max_num_features",
                                        "--SiftExtraction.use_gpu",
                                        "--SiftExtraction.max_image_size",
                                        "--SiftExtraction.num_threads",
                                        NULL};
    static const char *const known_new[] = {"--database_path",
                                            "--image_path",
                                            "--image_list_path",
                                            "--ImageReader.single_camera",
                                            "--ImageReader.camera_model",
                                            "--ImageReader.existing_camera_id",
                                            "--SiftExtraction.max_num_features",
                                            "--FeatureExtraction.use_gpu",
                                            "--FeatureExtraction.max_image_size",
                                            "--FeatureExtraction.num_threads",
                                            NULL};
    static char names[FAKE_NAMES][256];
    check_options(is_new() ? known_new : known);
    sqlite3 *db = open_db();
    const char *folder = needed("--image_path"),
               *given = option("--ImageReader.existing_camera_id");
    long long camera = given ? atoll(given) : -1;
    size_t n = lines(needed("--image_list_path"), names);
    for (size_t i = 0; i < n; i++) {
        char path[4096];
        if (is_set("FAKE_HANG", "feature_extractor") && i >= n / 2)
            hang();
        true_name(folder, names[i], path);
        long long id = ask(db, "SELECT image_id FROM images WHERE name = ?1", names[i]);
        if (id >= 0 && ask(db,
                           "SELECT image_id FROM images JOIN keypoints USING (image_id) WHERE "
                           "name = ?1",
                           names[i]) >= 0)
            continue;
        if (camera < 0) {
            camera = 1 + ask(db, "SELECT coalesce(max(camera_id), 0) FROM cameras", NULL);
            insert(db,
                   getenv("FAKE_FOCAL") ? "INSERT INTO cameras VALUES (?1, ?2, x'000000000000f03f')"
                                        : "INSERT INTO cameras VALUES (?1, ?2, NULL)",
                   camera, 4, NULL);
        }
        if (id < 0) {
            id = 1 + ask(db, "SELECT coalesce(max(image_id), 0) FROM images", NULL);
            insert(db, "INSERT INTO images VALUES (?1, ?3, ?2)", id, camera, names[i]);
        }
        insert(db, "INSERT INTO keypoints VALUES (?1, ?2)", id,
               is_set("FAKE_BLANK", tail(path)) ? FAKE_BLANK_FEATURES
               : is_set("FAKE_LOOSE", tail(path))
                   ? atoll(needed("--SiftExtraction.max_num_features"))
                   : FAKE_FEATURES,
               NULL);
    }
    sqlite3_close(db);
    return 0;
}

/* Does the photograph match others, and in which of two parts? */
static int part(const char *whole)
{
    const char *path = tail(whole);
    const char *blank = getenv("FAKE_BLANK"), *alone = getenv("FAKE_ALONE"),
               *split = getenv("FAKE_SPLIT");
    if ((blank && *blank && strstr(path, blank)) || (alone && *alone && strstr(path, alone)))
        return -1;
    return split && *split && strstr(path, split) ? 1 : 0;
}

static int match(void)
{
    static const char *const known[] = {
        "--database_path",        "--match_list_path",          "--match_type",
        "--SiftMatching.use_gpu", "--SiftMatching.num_threads", NULL};
    static const char *const known_new[] = {"--database_path",
                                            "--match_list_path",
                                            "--match_type",
                                            "--FeatureMatching.use_gpu",
                                            "--FeatureMatching.num_threads",
                                            NULL};
    static char pairs[FAKE_NAMES][256];
    char folder[4096];
    check_options(is_new() ? known_new : known);
    sqlite3 *db = open_db();
    /* The list lies beside the links. */
    snprintf(folder, sizeof folder, "%s", needed("--match_list_path"));
    *strrchr(folder, '/') = '\0';
    strncat(folder, "/.photos", sizeof folder - strlen(folder) - 1);
    size_t n = lines(needed("--match_list_path"), pairs);
    for (size_t i = 0; i < n; i++) {
        char path[2][4096], *second = strchr(pairs[i], ' ');
        if (is_set("FAKE_HANG", "matches_importer") && i >= n / 2)
            hang();
        if (!second)
            die("not a pair", pairs[i]);
        *second++ = '\0';
        long long a = ask(db, "SELECT image_id FROM images WHERE name = ?1", pairs[i]),
                  b = ask(db, "SELECT image_id FROM images WHERE name = ?1", second);
        if (a < 0 || b < 0)
            die("no such image", a < 0 ? pairs[i] : second);
        true_name(folder, pairs[i], path[0]);
        true_name(folder, second, path[1]);
        bool good = part(path[0]) >= 0 && part(path[0]) == part(path[1]);
        insert(db, "INSERT OR IGNORE INTO two_view_geometries VALUES (?1, ?2)",
               2147483647LL * (a < b ? a : b) + (a < b ? b : a), good ? FAKE_INLIERS : 0, NULL);
    }
    sqlite3_close(db);
    return 0;
}

/* Of the truth, photographs that are in the database and of this part; names become links. */
static size_t cut(struct colmap_model *m, sqlite3 *db, const char *folder, int want)
{
    uint32_t *to = mem_array(m->n_images + 1, sizeof *to);
    size_t n = 0, points = 0, tracks = 0;
    for (size_t i = 0; i < m->n_images; i++) {
        char name[256] = "", path[4096];
        to[i] = UINT32_MAX;
        sqlite3_stmt *q = NULL;
        if (sqlite3_prepare_v2(db, "SELECT name FROM images", -1, &q, NULL) != SQLITE_OK)
            die("images", sqlite3_errmsg(db));
        while (!name[0] && sqlite3_step(q) == SQLITE_ROW) {
            const char *link = (const char *)sqlite3_column_text(q, 0);
            true_name(folder, link, path);
            const char *slash = strrchr(path, '/');
            if (!strcmp(slash + 1, m->images[i].name) && part(path) == want)
                snprintf(name, sizeof name, "%s", link);
        }
        sqlite3_finalize(q);
        if (!name[0])
            continue;
        printf("Registering image #%u (%zu)\n", m->images[i].id, n + 1);
        if (is_set("FAKE_LOOSE", tail(path)) &&
            ask(db, "SELECT rows FROM keypoints JOIN images USING (image_id) WHERE name = ?1",
                name) < FAKE_ENOUGH)
            m->images[i].n_obs = FAKE_FEW_POINTS;
        m->images[n] = m->images[i];
        m->images[n].name = arena_text(&m->arena, name);
        to[i] = (uint32_t)n++;
    }
    for (size_t p = 0; p < m->n_points; p++) {
        struct colmap_point x = m->points[p];
        size_t from = tracks;
        for (size_t t = 0; t < x.n_track; t++) {
            struct colmap_track_element el = m->tracks[x.track + t];
            if (to[el.image] == UINT32_MAX || el.obs >= m->images[to[el.image]].n_obs)
                continue;
            el.image = to[el.image];
            m->images[el.image].obs[el.obs].point = (int64_t)points;
            m->tracks[tracks++] = el;
        }
        if (tracks == from)
            continue;
        x.track = from;
        x.n_track = tracks - from;
        m->points[points++] = x;
    }
    m->n_images = n;
    m->n_points = points;
    m->n_tracks = tracks;
    mem_free(to);
    return n;
}

/* Leaves half of the points, as a model has whose focal length is wrong. */
static void halve(struct colmap_model *m)
{
    const char *wrong = getenv("FAKE_FOCAL");
    if (!wrong || (option("--Mapper.max_focal_length_ratio") && !strstr(wrong, "always")))
        return;
    m->n_points /= 2;
    m->n_tracks = m->points[m->n_points].track;
    for (size_t i = 0; i < m->n_images; i++)
        for (size_t k = 0; k < m->images[i].n_obs; k++)
            if (m->images[i].obs[k].point >= (int64_t)m->n_points)
                m->images[i].obs[k].point = -1;
}

static int map(const char *const *known)
{
    size_t models = 0;
    check_options(known);
    sqlite3 *db = open_db();
    const char *truth = getenv("FAKE_TRUTH");
    for (int want = 1; want >= 0; want--) { /* the largest comes last: order means nothing */
        struct colmap_model m = {0};
        struct err e = {0};
        char dir[4096];
        if (colmap_read(truth ? truth : "", &m, &e))
            die("FAKE_TRUTH", e.msg);
        size_t n = cut(&m, db, needed("--image_path"), want);
        halve(&m);
        if (is_set("FAKE_HANG", "mapper"))
            hang();
        if (n >= 3) {
            if ((size_t)snprintf(dir, sizeof dir, "%s/%zu", needed("--output_path"), models++) >=
                    sizeof dir ||
                colmap_write_bin(dir, &m, &e))
                die("model", e.msg);
        }
        colmap_free(&m);
    }
    sqlite3_close(db);
    if (!models)
        die("failed to create sparse model", "no good initial pair");
    return 0;
}

static int help(void)
{
    printf("COLMAP %s -- Structure-from-Motion and Multi-View Stereo\n", is_new() ? "3.12" : "3.8");
    printf("  --%s.use_gpu arg (=1)\n", is_new() ? "FeatureExtraction" : "SiftExtraction");
    if (is_new())
        printf("  pose_prior_mapper\n");
    if (is_set("FAKE_NEW", "global"))
        printf("  global_mapper\n");
    return 0;
}

static bool is_glomap(void)
{
    const char *slash = strrchr(fake_argv[0], '/');
    return !strcmp(slash ? slash + 1 : fake_argv[0], "glomap");
}

#define MAP_OPTIONS                                                                                \
    "--database_path", "--image_path", "--output_path", "--Mapper.num_threads",                    \
        "--Mapper.min_model_size", "--Mapper.min_focal_length_ratio",                              \
        "--Mapper.max_focal_length_ratio"
static const char *const map_options[] = {MAP_OPTIONS, NULL};
static const char *const prior_options[] = {MAP_OPTIONS,
                                            "--overwrite_priors_covariance",
                                            "--use_robust_loss_on_prior_position",
                                            "--prior_position_std_x",
                                            "--prior_position_std_y",
                                            "--prior_position_std_z",
                                            NULL};
static const char *const global_options[] = {"--database_path", "--image_path", "--output_path",
                                             NULL};

int main(int argc, char **argv)
{
    const char *command = argc > 1 ? argv[1] : "help";
    fake_argc = argc;
    fake_argv = argv;
    setvbuf(stdout, NULL, _IOLBF, 0);
    if (!strcmp(command, "help") || (argc > 2 && !strcmp(argv[2], "-h")))
        return help();
    log_call();
    if (is_set("FAKE_FAIL", command))
        die("out of luck", command);
    if (is_glomap())
        return strcmp(command, "mapper") != 0 ? 1 : map(global_options);
    if (!strcmp(command, "feature_extractor"))
        return extract();
    if (!strcmp(command, "matches_importer"))
        return match();
    if (!strcmp(command, "mapper"))
        return map(map_options);
    if (is_new() && !strcmp(command, "pose_prior_mapper"))
        return map(prior_options);
    if (is_set("FAKE_NEW", "global") && !strcmp(command, "global_mapper"))
        return map(global_options);
    die("command not recognised", command);
    return 1;
}
