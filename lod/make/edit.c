/* Edits of a pyramid: see edit.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/make/edit.h"

#include <math.h>
#include <string.h>

#include "codec/container/seen.h"
#include "lod/make/pyramid_fit.h"
#include "lod/make/simplify.h"
#include "lod/store/bake.h"
#include "lod/store/key.h"

void edit_free(struct edit *d)
{
    for (size_t i = 0; i < d->n; i++)
        gauss_free(&d->tile[i].g);
    mem_free(d->tile);
    buf_free(&d->appearance);
    d->tile = NULL;
    d->n = d->cap = 0;
}

/* First edit that is not before k: they are kept sorted. */
static size_t edit_lower(const struct edit *d, struct key k)
{
    size_t lo = 0, hi = d->n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (key_compare(d->tile[mid].key, k) < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

struct edit_tile *edit_find(const struct edit *d, struct key k)
{
    size_t i = edit_lower(d, k);
    return i < d->n && key_compare(d->tile[i].key, k) == 0 ? &d->tile[i] : NULL;
}

enum err_code edit_touch(struct edit *d, struct key k, uint8_t level, struct edit_tile **out,
                         struct err *e)
{
    *out = edit_find(d, k);
    if (*out)
        return ERR_OK;
    struct edit_tile *p = mem_room(d->tile, d->n, &d->cap, 64, sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", d->n + 1);
    d->tile = p;
    size_t at = edit_lower(d, k);
    memmove(d->tile + at + 1, d->tile + at, (d->n - at) * sizeof *d->tile);
    d->n++;
    d->tile[at] = (struct edit_tile){.key = k, .level = level};
    *out = &d->tile[at];
    return ERR_OK;
}

static enum err_code edit_open(struct edit *d, struct edit_tile *t, size_t n,
                               const double center[3], struct err *e)
{
    enum err_code rc = gauss_alloc(&t->g, n, d->meta.sh_degree, d->meta.embed_len, e);
    memcpy(t->g.origin_enu_m, center, sizeof t->g.origin_enu_m);
    t->g.antialiased = d->meta.antialiased;
    return rc;
}

enum err_code edit_keep(struct edit *d, struct edit_tile *t, const struct gauss *g,
                        const uint32_t *index, size_t n, struct err *e)
{
    if (n == 0)
        return ERR_OK;
    enum err_code rc = edit_open(d, t, n, g->origin_enu_m, e);
    return rc ? rc : gauss_append(&t->g, g, index, n, e);
}

/* Coordinates along axis k of what a tile has and gets. */
static size_t edit_coordinates(const struct edit_tile *t, const struct edit_part *part,
                               size_t n_parts, size_t k, double *out)
{
    size_t n = 0;
    for (size_t i = 0; i < t->g.n; i++)
        out[n++] = (double)t->g.mean_m[3 * i + k] + t->g.origin_enu_m[k];
    for (size_t p = 0; p < n_parts; p++)
        for (size_t i = 0; i < part[p].n; i++) {
            size_t row = part[p].index ? part[p].index[i] : i;
            out[n++] = (double)part[p].g->mean_m[3 * row + k] + part[p].g->origin_enu_m[k];
        }
    return n;
}

/* The centre for all rows together. */
static enum err_code edit_center(const struct edit *d, const struct edit_tile *t,
                                 const struct edit_part *part, size_t n_parts, size_t n,
                                 double center[3], struct err *e)
{
    bool far = t->g.n == 0;
    double reach = pyramid_reach_m(d->meta.origin.lat_deg, t->key.z);
    double *at = mem_array(n, sizeof *at);
    if (!at)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", n);
    for (size_t k = 0; k < 3; k++) {
        edit_coordinates(t, part, n_parts, k, at);
        for (size_t i = 0; !far && i < n; i++)
            far = !(fabs(at[i] - t->g.origin_enu_m[k]) <= reach);
    }
    memcpy(center, t->g.origin_enu_m, 3 * sizeof *center);
    for (size_t k = 0; far && k < 3; k++) {
        edit_coordinates(t, part, n_parts, k, at);
        center[k] = pyramid_center_axis(d->meta.lossless, reach, at, n);
    }
    mem_free(at);
    return ERR_OK;
}

enum err_code edit_add(struct edit *d, struct edit_tile *t, const struct edit_part *part,
                       size_t n_parts, struct err *e)
{
    double center[3];
    size_t n = t->g.n;
    for (size_t p = 0; p < n_parts; p++)
        n += part[p].n;
    if (n == t->g.n)
        return ERR_OK;
    enum err_code rc = edit_center(d, t, part, n_parts, n, center, e);
    if (!rc && t->g.cap == 0)
        rc = edit_open(d, t, n, center, e);
    if (!rc) {
        gauss_recenter(&t->g, center);
        rc = gauss_reserve(&t->g, n, e);
    }
    for (size_t p = 0; !rc && p < n_parts; p++)
        rc = gauss_append(&t->g, part[p].g, part[p].index, part[p].n, e);
    t->settled = false;
    return rc;
}

enum err_code edit_key(const struct edit *d, const struct gauss *g, size_t i, uint8_t z,
                       struct key *out, struct err *e)
{
    double enu[3];
    struct key k;
    for (size_t a = 0; a < 3; a++)
        enu[a] = (double)g->mean_m[3 * i + a] + g->origin_enu_m[a];
    enum err_code rc = locate_key(&d->locate, enu, &k, e);
    if (!rc)
        *out = (struct key){.z = z, .x = k.x >> (KEY_ZOOM_MAX - z), .y = k.y >> (KEY_ZOOM_MAX - z)};
    return rc;
}

/* ---- writing ---- */

enum err_code edit_settle(struct edit *d, struct edit_tile *t, struct err *e)
{
    struct gauss *g = &t->g;
    if (t->settled || g->n == 0)
        return ERR_OK;
    d->n_far += pyramid_fit(g, pyramid_reach_m(d->meta.origin.lat_deg, t->key.z));
    enum err_code rc = gauss_sort(g, e);
    if (!rc && d->max_per_tile && g->n > d->max_per_tile && !t->whole) {
        struct gauss less;
        rc = simplify_gauss(g, d->max_per_tile, &less, e);
        gauss_free(g);
        if (!rc)
            *g = less;
    }
    t->settled = !rc;
    return rc;
}

static enum err_code edit_copy(struct store *from, struct store *to, const struct store_tile *t,
                               struct err *e)
{
    struct buf payload = {0};
    struct store_entry copy = {*t, store_shape(from, t)};
    enum err_code rc = store_read(from, t->key, &payload, e);
    if (!rc)
        rc = store_add(to, &copy, &payload, e);
    buf_free(&payload);
    return rc;
}

static enum err_code edit_copy_tiles(const struct edit *d, struct store *from,
                                     const struct store *before, struct store *to, size_t *n_copied,
                                     struct err *e)
{
    size_t n;
    const struct store_tile *t = store_tiles(from, &n);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        if (edit_find(d, t[i].key) || (before && store_find(before, t[i].key)))
            continue;
        rc = signals_stopping() ? err_set(e, ERR_CANCEL, "stopped") : edit_copy(from, to, &t[i], e);
        *n_copied += 1;
    }
    return rc;
}

/* other: the second store, NULL when there is one only. The footprint of one of two is not that of
 * both, and what one was clipped to is not either. */
static enum err_code edit_copy_blobs(const struct edit *d, struct store *from, struct store *before,
                                     const struct store *other, struct store *to, struct err *e)
{
    struct arena a = {0};
    struct buf b = {0};
    char **names = NULL;
    size_t n = 0;
    enum err_code rc = store_list_blobs(from, &a, &names, &n, e);
    for (size_t i = 0; !rc && i < n; i++) {
        if (before && !store_get_blob(before, names[i], &b, NULL))
            continue;
        if (other && (!strcmp(names[i], STORE_FOOTPRINT) || !strcmp(names[i], STORE_CLIP) ||
                      !strcmp(names[i], SEEN_BLOB)))
            continue;
        rc = store_get_blob(from, names[i], &b, e);
        if (!rc && !strcmp(names[i], BAKE_BLOB) && d->appearance.size)
            rc = store_put_blob(to, names[i], d->appearance.data, d->appearance.size, e);
        else if (!rc)
            rc = store_put_blob(to, names[i], b.data, b.size, e);
    }
    buf_free(&b);
    arena_free(&a);
    return rc;
}

enum err_code edit_write(struct edit *d, struct store *a, struct store *b, const char *out_path,
                         size_t *n_copied, size_t *n_written, struct err *e)
{
    struct store *to = NULL;
    size_t none[2] = {0};
    n_copied = n_copied ? n_copied : &none[0];
    n_written = n_written ? n_written : &none[1];
    struct store_meta meta = d->meta;
    meta.created[0] = '\0';
    enum err_code rc = store_create(out_path, &meta, &to, e);
    for (size_t i = 0; !rc && i < d->n; i++) {
        struct edit_tile *x = &d->tile[i];
        struct store_entry t = {.tile = {.key = x->key, .level = x->level}};
        rc = edit_settle(d, x, e);
        if (!rc && x->g.n > 0) {
            rc = store_put(to, &t, &x->g, e);
            *n_written += 1;
        }
    }
    if (!rc)
        rc = edit_copy_tiles(d, a, NULL, to, n_copied, e);
    if (!rc && b)
        rc = edit_copy_tiles(d, b, a, to, n_copied, e);
    if (!rc)
        rc = edit_copy_blobs(d, a, NULL, b, to, e);
    if (!rc && b)
        rc = edit_copy_blobs(d, b, a, b, to, e);
    if (!rc)
        rc = store_commit(&to, e);
    store_close(&to);
    return rc;
}
