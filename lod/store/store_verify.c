/* Verification of a tile store: pages, rows, payloads, blobs, and that there are all of them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>

#include "core/base.h"
#include "core/splat/gauss.h"
#include "lod/store/store_db.h"

/* Keep the first error, log and count all. */
static void store_note(struct err *first, const struct err *e, size_t *n_bad)
{
    log_error("store", "%s", e->msg);
    if (first->code == ERR_OK)
        *first = *e;
    *n_bad += 1;
}

static void store_verify_pages(struct store *s, struct err *first, size_t *n_bad)
{
    sqlite3_stmt *q = NULL;
    struct err e = {0};
    int code = sqlite3_prepare_v2(s->db, "PRAGMA integrity_check(16)", -1, &q, NULL);
    while (code == SQLITE_OK || code == SQLITE_ROW) {
        code = sqlite3_step(q);
        const char *text = code == SQLITE_ROW ? (const char *)sqlite3_column_text(q, 0) : NULL;
        if (text && strcmp(text, "ok")) {
            err_set(&e, ERR_FORMAT, "%s: %s", s->path, text);
            store_note(first, &e, n_bad);
        }
    }
    if (code != SQLITE_DONE) {
        store_db_fail(s, code, "integrity check", &e);
        store_note(first, &e, n_bad);
    }
    sqlite3_finalize(q);
}

static void store_verify_tiles(struct store *s, struct err *first, size_t *n_bad)
{
    struct progress p;
    progress_start(&p, "verify tiles", s->index.n);
    for (size_t i = 0; i < s->index.n && first->code != ERR_BUSY; i++) {
        const struct store_tile *t = &s->index.tiles[i];
        struct gauss g = {0};
        struct err e = {0};
        if (!store_read_gauss(s, t->key, &g, &e) && (g.n != t->count || gauss_count_bad(&g, NULL)))
            err_set(&e, ERR_FORMAT,
                    "%s: tile %u/%u/%u: %zu Gaussians (%zu of them unusable), the index says %u",
                    s->path, t->key.z, t->key.x, t->key.y, g.n, gauss_count_bad(&g, NULL),
                    t->count);
        if (e.code != ERR_OK)
            store_note(first, &e, n_bad);
        gauss_free(&g);
        progress_step(&p, i + 1, NULL);
    }
    progress_end(&p, NULL);
}

/* What is whole by itself may be less than was written: tiles and blobs that are gone, another
 * origin. */
static enum err_code store_verify_all(const struct store *s, struct err *e)
{
    char revision[STORE_REVISION];
    const struct store_meta *m = &s->meta;
    const size_t n = s->index.n;
    const int64_t said = store_db_tiles(s);
    if (said && said != (int64_t)n)
        return err_set(e, ERR_FORMAT, "%s: %zu tiles, but meta says that there are %lld", s->path,
                       n, (long long)said);
    const uint8_t low = n ? s->index.tiles[0].key.z : 0, high = n ? s->index.tiles[n - 1].key.z : 0;
    if (n && (low != m->zoom_min || high != m->zoom_max))
        return err_set(e, ERR_FORMAT, "%s: tiles of zooms %u to %u, but meta says %u to %u",
                       s->path, low, high, m->zoom_min, m->zoom_max);
    enum err_code rc = store_revision(s, revision, e);
    if (!rc && strcmp(revision, m->revision))
        rc = err_set(e, ERR_FORMAT,
                     "%s: revision %s, but that of its content is %s: it was changed after it was "
                     "written",
                     s->path, m->revision, revision);
    return rc;
}

enum err_code store_verify(struct store *s, size_t *n_bad_out, struct err *e)
{
    struct arena a = {0};
    struct err first = {0}, one = {0};
    struct buf b = {0};
    size_t n_bad = 0, n_rows_bad = 0, n_blobs = 0;
    char **names = NULL;
    store_verify_pages(s, &first, &n_bad);
    enum err_code rc = store_check_rows(s, &n_rows_bad, &one);
    if (!rc && n_rows_bad)
        err_set(&one, ERR_FORMAT, "%s: %zu index rows are damaged", s->path, n_rows_bad);
    if (one.code != ERR_OK)
        store_note(&first, &one, &n_bad);
    store_verify_tiles(s, &first, &n_bad);
    one = (struct err){0};
    if (store_list_blobs(s, &a, &names, &n_blobs, &one))
        store_note(&first, &one, &n_bad);
    for (size_t i = 0; i < n_blobs; i++)
        if (store_get_blob(s, names[i], &b, &one))
            store_note(&first, &one, &n_bad);
    one = (struct err){0};
    if (!n_bad && store_verify_all(s, &one)) /* any other damage would change these, too */
        store_note(&first, &one, &n_bad);
    buf_free(&b);
    arena_free(&a);
    if (n_bad_out)
        *n_bad_out = n_bad;
    return first.code ? err_set(e, first.code, "%s", first.msg) : ERR_OK;
}
