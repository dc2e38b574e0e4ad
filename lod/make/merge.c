/* Merges two stores.
 *
 * A tile that both stores have is made of the Gaussians of both. Other tiles are copied byte by
 * byte: from the first store, and from the second if it has the same frame. Below a tile of both,
 * only one store may have finer tiles. The rows of the other are then copied down into them,
 * because they would vanish when the tile is replaced. If one store begins at a finer zoom, its
 * missing overviews are made first, so that the coarsest tiles show both.
 *
 * Both frames are east-north-up about their own origins. One is converted to the other by the
 * rotation and shift of their ECEF matrices. Spherical harmonics are rotated by one orthogonal
 * matrix a band. It follows from the values of the basis in seven directions, before and after the
 * rotation.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/splat/appearance.h"
#include "core/splat/camera.h"
#include "lod/make/edit.h"
#include "lod/make/merge.h"
#include "lod/make/pyramid_fit.h"
#include "lod/make/pyramid_plan.h"
#include "lod/store/bake.h"
#include "lod/store/locate.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

#define MERGE_PI 3.14159265358979323846

struct merge {
    struct store *a, *b;
    bool moved;              /* the frames differ */
    double rot[9], shift[3]; /* b's ENU to a's */
    double turn[4][49];      /* by band, [2l + 1][2l + 1] */
    struct edit d;
};

/* ---- frames ---- */

static void merge_frame(struct merge *m, const double ea[16], const double eb[16])
{
    for (size_t r = 0; r < 3; r++) {
        m->shift[r] = 0.0;
        for (size_t k = 0; k < 3; k++)
            m->shift[r] += ea[4 * r + k] * (eb[12 + k] - ea[12 + k]);
        for (size_t c = 0; c < 3; c++) {
            m->rot[3 * r + c] = 0.0;
            for (size_t k = 0; k < 3; k++)
                m->rot[3 * r + c] += ea[4 * r + k] * eb[4 * c + k];
        }
    }
}

/* Basis functions of band l, up to a factor a band, which a rotation does not see; order and signs
 * of 3D Gaussian splatting (Kerbl 2023). */
static void merge_basis(size_t l, const double d[3], double out[7])
{
    double x = d[0], y = d[1], z = d[2], xx = x * x, yy = y * y, zz = z * z;
    if (l == 1) {
        const double v[3] = {-y, z, -x};
        memcpy(out, v, sizeof v);
    } else if (l == 2) {
        const double v[5] = {x * y, -y * z, (2 * zz - xx - yy) / (2 * sqrt(3)), -x * z,
                             (xx - yy) / 2};
        memcpy(out, v, sizeof v);
    } else if (l == 3) {
        const double v[7] = {
            -sqrt(2.5) / 2 * y * (3 * xx - yy),      sqrt(15) * x * y * z,
            -sqrt(1.5) / 2 * y * (4 * zz - xx - yy), 0.5 * z * (2 * zz - 3 * xx - 3 * yy),
            -sqrt(1.5) / 2 * x * (4 * zz - xx - yy), sqrt(15) / 2 * z * (xx - yy),
            -sqrt(2.5) / 2 * x * (xx - 3 * yy)};
        memcpy(out, v, sizeof v);
    }
}

/* Solve Y D = Z for D, all n x n, by elimination with pivots; y and z are spoilt. */
static void merge_solve(size_t n, double y[49], double z[49], double out[49])
{
    for (size_t c = 0; c < n; c++) {
        size_t best = c;
        for (size_t r = c + 1; r < n; r++)
            best = fabs(y[n * r + c]) > fabs(y[n * best + c]) ? r : best;
        for (size_t k = 0; k < n; k++) {
            double t = y[n * c + k], u = z[n * c + k];
            y[n * c + k] = y[n * best + k];
            z[n * c + k] = z[n * best + k];
            y[n * best + k] = t;
            z[n * best + k] = u;
        }
        for (size_t r = 0; r < n; r++) {
            double f = r == c ? 0.0 : y[n * r + c] / y[n * c + c];
            for (size_t k = 0; f != 0.0 && k < n; k++) {
                y[n * r + k] -= f * y[n * c + k];
                z[n * r + k] -= f * z[n * c + k];
            }
        }
    }
    for (size_t r = 0; r < n; r++)
        for (size_t k = 0; k < n; k++)
            out[n * r + k] = z[n * r + k] / y[n * r + r];
}

/* A function with coefficients c, turned, has D c: its value in direction d is the old one's in the
 * direction that is turned into d. */
static void merge_turns(struct merge *m)
{
    for (size_t l = 1; l <= 3; l++) {
        size_t n = 2 * l + 1;
        double y[49], z[49];
        for (size_t i = 0; i < n; i++) { /* along a spiral (Vogel 1979), on half of the
                                          sphere: the other is its mirror and tells nothing new */
            double h = ((double)i + 0.5) / (double)n, r = sqrt(1.0 - h * h);
            double a = (double)i * MERGE_PI * (3.0 - sqrt(5.0)) + 0.3;
            const double d[3] = {r * cos(a), r * sin(a), h};
            double back[3];
            for (size_t k = 0; k < 3; k++)
                back[k] = m->rot[k] * d[0] + m->rot[3 + k] * d[1] + m->rot[6 + k] * d[2];
            merge_basis(l, d, y + n * i);
            merge_basis(l, back, z + n * i);
        }
        merge_solve(n, y, z, m->turn[l]);
    }
}

static void merge_turn_sh(const struct merge *m, struct gauss *g)
{
    size_t stride = 3 * gauss_sh_count(g->sh_degree);
    for (size_t i = 0; i < g->n; i++)
        for (size_t l = 1; l <= g->sh_degree; l++) {
            float *sh = g->sh + stride * i + 3 * l * l;
            size_t n = 2 * l + 1;
            double old[21];
            for (size_t k = 0; k < 3 * n; k++)
                old[k] = (double)sh[k];
            for (size_t r = 0; r < n; r++)
                for (size_t c = 0; c < 3; c++) {
                    double sum = 0.0;
                    for (size_t k = 0; k < n; k++)
                        sum += m->turn[l][n * r + k] * old[3 * k + c];
                    sh[3 * r + c] = (float)sum;
                }
        }
}

/* Rows of b into the frame of a. */
static void merge_move(const struct merge *m, struct gauss *g)
{
    double turn[4], at[3];
    if (!m->moved)
        return;
    camera_rot_to_quat(m->rot, turn);
    for (size_t r = 0; r < 3; r++) {
        at[r] = m->shift[r];
        for (size_t k = 0; k < 3; k++)
            at[r] += m->rot[3 * r + k] * g->origin_enu_m[k];
    }
    memcpy(g->origin_enu_m, at, sizeof at);
    for (size_t i = 0; i < g->n; i++) {
        float *p = g->mean_m + 3 * i, *q = g->quat_wxyz + 4 * i;
        const double old[3] = {(double)p[0], (double)p[1], (double)p[2]};
        const double w = (double)q[0], x = (double)q[1], y = (double)q[2], z = (double)q[3];
        for (size_t r = 0; r < 3; r++)
            p[r] = (float)(m->rot[3 * r] * old[0] + m->rot[3 * r + 1] * old[1] +
                           m->rot[3 * r + 2] * old[2]);
        q[0] = (float)(turn[0] * w - turn[1] * x - turn[2] * y - turn[3] * z);
        q[1] = (float)(turn[0] * x + turn[1] * w + turn[2] * z - turn[3] * y);
        q[2] = (float)(turn[0] * y - turn[1] * z + turn[2] * w + turn[3] * x);
        q[3] = (float)(turn[0] * z + turn[1] * y - turn[2] * x + turn[3] * w);
    }
    merge_turn_sh(m, g);
}

static enum err_code merge_read(const struct merge *m, bool from_b, struct key k, struct gauss *out,
                                struct err *e)
{
    enum err_code rc = store_read_gauss(from_b ? m->b : m->a, k, out, e);
    if (!rc && from_b)
        merge_move(m, out);
    return rc;
}

/* ---- tiles ---- */

static bool merge_has_below(const struct store *s, struct key k)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n), *at = store_find(s, k);
    return at && !tree_leaf(store_tree(s), (size_t)(at - t));
}

/* Append a store's tile to the edit of its key, opening the edit with the first's. */
static enum err_code merge_add(struct merge *m, struct key k, uint8_t level, const struct gauss *g,
                               struct err *e)
{
    struct edit_tile *x = edit_find(&m->d, k);
    enum err_code rc = ERR_OK;
    const struct store_tile *have = store_find(m->a, k);
    if (!x) {
        rc = edit_touch(&m->d, k, level, &x, e);
        if (!rc && have) {
            struct gauss first;
            rc = merge_read(m, false, k, &first, e);
            if (!rc)
                rc = edit_keep(&m->d, x, &first, NULL, first.n, e);
            gauss_free(&first);
            x->level = have->level;
        }
    }
    return rc ? rc : edit_add(&m->d, x, &(struct edit_part){.g = g, .n = g->n}, 1, e);
}

/* Rows of g, of which nothing finer exists, go down with the tiles of `s` below k. */
static enum err_code merge_carry(struct merge *m, const struct store *s, bool s_is_b, struct key k,
                                 uint8_t level, const struct gauss *g, struct err *e)
{
    enum err_code rc = ERR_OK;
    if (!merge_has_below(s, k) || k.z == KEY_ZOOM_MAX)
        return ERR_OK;
    for (uint32_t q = 0; !rc && q < 4; q++) {
        struct key down = {(uint8_t)(k.z + 1), 2 * k.x + (q & 1), 2 * k.y + (q >> 1)};
        struct gauss some = {0};
        rc = gauss_alloc(&some, g->n, g->sh_degree, g->embed_len, e);
        memcpy(some.origin_enu_m, g->origin_enu_m, sizeof some.origin_enu_m);
        for (uint32_t i = 0; !rc && i < g->n; i++) {
            struct key at;
            rc = edit_key(&m->d, g, i, down.z, &at, e);
            if (!rc && key_compare(at, down) == 0)
                rc = gauss_append(&some, g, &i, 1, e);
        }
        const struct store_tile *theirs = store_find(s, down);
        if (!rc && some.n > 0 && s_is_b && theirs && !edit_find(&m->d, down)) {
            struct gauss b; /* the tile of b goes first */
            rc = merge_read(m, true, down, &b, e);
            if (!rc)
                rc = merge_add(m, down, theirs->level, &b, e);
            gauss_free(&b);
        }
        if (!rc && some.n > 0)
            rc = merge_add(m, down, level, &some, e);
        if (!rc && some.n > 0)
            rc = merge_carry(m, s, s_is_b, down, level, &some, e);
        gauss_free(&some);
    }
    return rc;
}

/* One tile of b: left to be copied, moved, or joined with a's. */
static enum err_code merge_tile(struct merge *m, const struct store_tile *t, struct err *e)
{
    bool both = store_find(m->a, t->key);
    struct gauss b = {0}, a = {0};
    if (!both && !m->moved)
        return ERR_OK;
    enum err_code rc = merge_read(m, true, t->key, &b, e);
    if (!rc)
        rc = merge_add(m, t->key, t->level, &b, e);
    bool deep_a = merge_has_below(m->a, t->key), deep_b = merge_has_below(m->b, t->key);
    if (!rc && both && deep_a && !deep_b)
        rc = merge_carry(m, m->a, false, t->key, t->level, &b, e);
    if (!rc && both && deep_b && !deep_a) {
        rc = merge_read(m, false, t->key, &a, e);
        if (!rc)
            rc = merge_carry(m, m->b, true, t->key, store_find(m->a, t->key)->level, &a, e);
    }
    gauss_free(&a);
    gauss_free(&b);
    return rc;
}

/* What a tile will hold: its edit, or the store that has it. */
static enum err_code merge_now(struct merge *m, struct key k, struct gauss *out, struct err *e)
{
    const struct edit_tile *x = edit_find(&m->d, k);
    *out = (struct gauss){0};
    if (!x)
        return merge_read(m, !store_find(m->a, k), k, out, e);
    enum err_code rc = gauss_alloc(out, x->g.n, x->g.sh_degree, x->g.embed_len, e);
    memcpy(out->origin_enu_m, x->g.origin_enu_m, sizeof out->origin_enu_m);
    return rc ? rc : gauss_append(out, &x->g, NULL, x->g.n, e);
}

static enum err_code merge_raise_from(struct merge *m, const struct store *s, uint8_t z,
                                      struct err *e)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        struct key k = t[i].key;
        struct gauss g = {0}, less = {0};
        if (k.z != store_info(s)->zoom_min)
            continue;
        rc = merge_now(m, k, &g, e);
        while (!rc && k.z > z) {
            rc = pyramid_thin(&m->d.locate, &g, k, &less, e);
            gauss_free(&g);
            g = less;
            less = (struct gauss){0};
            k = key_parent(k);
            const struct store_tile *b = store_find(m->b, k);
            if (!rc && b && !edit_find(&m->d, k) && !store_find(m->a, k)) {
                struct gauss theirs;
                rc = merge_read(m, true, k, &theirs, e);
                if (!rc)
                    rc = merge_add(m, k, b->level, &theirs, e);
                gauss_free(&theirs);
            }
            if (!rc)
                rc = merge_add(m, k, 0, &g, e);
        }
        gauss_free(&g);
    }
    return rc;
}

static int merge_key_compare(const void *a, const void *b)
{
    return key_compare(*(const struct key *)a, *(const struct key *)b);
}

static int merge_code_compare(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

/* The tiles at zoom z of both stores and all edits, sorted, each once; room for all there are. */
static size_t merge_list(const struct merge *m, uint8_t z, struct key *out)
{
    size_t n = 0, once = 0, n_tiles;
    for (size_t i = 0; i < m->d.n; i++)
        if (m->d.tile[i].key.z == z)
            out[n++] = m->d.tile[i].key;
    for (int s = 0; s < 2; s++) {
        const struct store_tile *t = store_tiles(s ? m->b : m->a, &n_tiles);
        for (size_t i = 0; i < n_tiles; i++)
            if (t[i].key.z == z)
                out[n++] = t[i].key;
    }
    if (n)
        qsort(out, n, sizeof *out, merge_key_compare);
    for (size_t i = 0; i < n; i++)
        if (!once || key_compare(out[once - 1], out[i]) != 0)
            out[once++] = out[i];
    return once;
}

/* One zoom of overviews above z, of what both show there; *top: there is none to be made. */
static enum err_code merge_raise_once(struct merge *m, uint8_t z, bool *top, struct err *e)
{
    size_t na, nb;
    store_tiles(m->a, &na);
    store_tiles(m->b, &nb);
    struct key *key = mem_array(na + nb + m->d.n, sizeof *key);
    uint64_t *code = mem_array(na + nb + m->d.n, sizeof *code);
    enum err_code rc =
        key && code ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu tiles", na + nb);
    size_t n = rc ? 0 : merge_list(m, z, key);
    for (size_t i = 0; i < n; i++)
        code[i] = locate_code(key[i]);
    if (n)
        qsort(code, n, sizeof *code, merge_code_compare);
    *top = pyramid_is_top(code, n, z);
    for (size_t i = 0; !rc && !*top && i < n; i++) {
        struct gauss g, less = {0};
        rc = merge_now(m, key[i], &g, e);
        if (!rc)
            rc = pyramid_thin(&m->d.locate, &g, key[i], &less, e);
        if (!rc)
            rc = merge_add(m, key_parent(key[i]), 0, &less, e);
        gauss_free(&g);
        gauss_free(&less);
    }
    mem_free(key);
    mem_free(code);
    return rc;
}

/* Overviews of the store that begins at a finer zoom, up to where the other begins; then of both,
 * as a pyramid of all would have them. */
static enum err_code merge_raise(struct merge *m, struct err *e)
{
    uint8_t za = store_info(m->a)->zoom_min, zb = store_info(m->b)->zoom_min;
    uint8_t z = za < zb ? za : zb;
    enum err_code rc = za == zb ? ERR_OK : merge_raise_from(m, za > zb ? m->a : m->b, z, e);
    for (bool top = false; !rc; z--) {
        rc = merge_raise_once(m, z, &top, e);
        if (top)
            break;
    }
    return rc;
}

/* ---- all of it ---- */

/* Put the parts of `more`, with "; " between them, behind those of `all` that lack them; false when
 * all of it fits. */
static bool merge_attribution(char *all, size_t room, const char *more)
{
    while (*more) {
        size_t n = strcspn(more, ";"), have = strlen(all);
        bool known = n == 0;
        for (const char *p = all; !known && *p;) {
            size_t len = strcspn(p, ";");
            known = len == n && !memcmp(p, more, n);
            p += len + strspn(p + len, "; ");
        }
        if (!known) {
            if (have + 2 + n >= room)
                return true;
            snprintf(all + have, room - have, "%s%.*s", have ? "; " : "", (int)n, more);
        }
        more += n + strspn(more + n, "; ");
    }
    return false;
}

static enum err_code merge_open(struct merge *m, const char *path_a, const char *path_b,
                                struct err *e)
{
    enum err_code rc = store_open(path_a, &m->a, e);
    if (!rc)
        rc = store_open(path_b, &m->b, e);
    if (rc)
        return rc;
    const struct store_meta *a = store_info(m->a), *b = store_info(m->b);
    if (!strcmp(a->revision, b->revision))
        return err_set(e, ERR_ARG,
                       "%s and %s are the same tiles (revision %s): every Gaussian would be twice "
                       "in the result",
                       path_a, path_b, a->revision);
    if (a->embed_len != b->embed_len || a->antialiased != b->antialiased)
        return err_set(e, ERR_DATA,
                       "%s and %s do not fit: appearance embeddings of %u and %u, anti-aliasing %d "
                       "and %d; train and tile both with the same options",
                       path_a, path_b, a->embed_len, b->embed_len, a->antialiased, b->antialiased);
    const struct appearance *model = NULL;
    if (a->embed_len > 0)
        rc = bake_of(m->b, &model, e);
    if (rc)
        return rc;
    if (a->embed_len > 0 && bake_fits(m->a, model, e))
        return err_add(
            e,
            "%s: its embeddings mean nothing to another model; give each store one appearance "
            "(citysplat export -o FILE.ply --appearance PHOTO, citysplat import FILE.ply) "
            "and merge those",
            path_b);
    if (a->zoom_max != b->zoom_max)
        log_warn("merge",
                 "the finest zooms differ: %u and %u; tile with the same --tile-edge-m for "
                 "levels that change at the same distance",
                 a->zoom_max, b->zoom_max);
    m->d.meta = *a;
    if (m->d.meta.sh_degree < b->sh_degree)
        m->d.meta.sh_degree = b->sh_degree;
    m->d.meta.lossless = a->lossless && b->lossless;
    for (size_t l = 0; l < STORE_LEVEL_MAX; l++) {
        const double larger_m = fmax(a->pixel_m[l], b->pixel_m[l]);
        m->d.meta.pixel_m[l] = fmin(a->pixel_m[l], b->pixel_m[l]) > 0.0 ? larger_m : 0.0;
    }
    m->d.max_per_tile = PYRAMID_PER_TILE_MAX;
    if (model && (rc = bake_join(m->a, model, &m->d.appearance, e)))
        return rc;
    if (!heights_same(a->heights, b->heights)) {
        log_warn("merge",
                 "heights count from '%s' and from '%s': those of both together are of 'unknown'",
                 heights_name(a->heights), heights_name(b->heights));
        snprintf(m->d.meta.heights, sizeof m->d.meta.heights, "unknown");
    }
    if (merge_attribution(m->d.meta.attribution, sizeof m->d.meta.attribution, b->attribution))
        return err_set(e, ERR_DATA,
                       "the attributions of %s and %s have more than %zu bytes together; tile one "
                       "with a shorter --attribution",
                       path_a, path_b, sizeof m->d.meta.attribution - 1);
    return locate_open(&a->origin, &m->d.locate, e);
}

static enum err_code merge_compare_frames(struct merge *m, struct merge_report *report,
                                          struct err *e)
{
    const struct geo_origin *a = &store_info(m->a)->origin, *b = &store_info(m->b)->origin;
    double ea[16], eb[16];
    m->moved = a->lon_deg != b->lon_deg || a->lat_deg != b->lat_deg || a->h_m != b->h_m;
    enum err_code rc = geo_enu_to_ecef(a, ea, e);
    if (!rc)
        rc = geo_enu_to_ecef(b, eb, e);
    if (rc)
        return rc;
    merge_frame(m, ea, eb);
    merge_turns(m);
    double cosine = (m->rot[0] + m->rot[4] + m->rot[8] - 1.0) / 2.0;
    report->turn_deg = acos(fmax(-1.0, fmin(1.0, cosine))) * 180.0 / MERGE_PI;
    return ERR_OK;
}

enum err_code merge_build(const char *path_a, const char *path_b, const char *name,
                          const char *out_path, struct merge_report *report, struct err *e)
{
    struct merge m = {0};
    struct merge_report none;
    report = report ? report : &none;
    *report = (struct merge_report){0};
    enum err_code rc = merge_open(&m, path_a, path_b, e);
    if (!rc && name) {
        if (strlen(name) >= sizeof m.d.meta.name)
            rc = err_set(e, ERR_ARG, "name of a tile store: at most %zu bytes",
                         sizeof m.d.meta.name - 1);
        else
            memcpy(m.d.meta.name, name, strlen(name) + 1);
    }
    if (!rc)
        rc = merge_compare_frames(&m, report, e);
    size_t n = 0;
    const struct store_tile *t = rc ? NULL : store_tiles(m.b, &n);
    for (size_t i = 0; !rc && i < n; i++)
        rc = merge_tile(&m, &t[i], e);
    if (!rc)
        rc = merge_raise(&m, e);
    if (!rc)
        rc = edit_write(&m.d, m.a, m.b, out_path, &report->n_copied, &report->n_written, e);
    edit_free(&m.d);
    store_close(&m.a);
    store_close(&m.b);
    if (!rc && !(rc = store_open(out_path, &m.a, e))) {
        memcpy(report->revision, store_info(m.a)->revision, sizeof report->revision);
        store_close(&m.a);
    }
    return rc;
}
