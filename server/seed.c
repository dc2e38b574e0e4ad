/* Prefetch lists. For an area, coarse levels come first, then tiles with more Gaussians. For a
 * camera on a path, the tiles that it needs first come first. Of those for one moment, a tile comes
 * after the tiles above it, because clients show a coarse tile until finer ones arrive; then near
 * ones before far ones.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/seed.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lod/crop.h"
#include "lod/pick.h"
#include "lod/store.h"
#include "lod/tree.h"
#include "server/encode.h"
#include "server/link.h"
#include "server/result_id.h"
#include "server/target_query.h"

enum { SEED_ROW = 256 }; /* bytes of a line without its query, from above */

struct seed_row {
    const struct store_tile *tile;
    double at_s, far; /* of a course: when it is needed, and how far away it is then, squared */
};
struct seed {
    const struct dataset *d;
    const struct target *t;
    const struct crop_node *left; /* of each tile; NULL: all of it */
    struct seed_row *row;
    size_t n;
    bool *taken; /* [n_tiles] */
};

/* Coarse levels first, since every view needs them; within a level, tiles that hold more. */
static int seed_by_importance(const void *pa, const void *pb)
{
    const struct seed_row *ra = pa, *rb = pb;
    const struct store_tile *a = ra->tile, *b = rb->tile;
    if (ra->at_s != rb->at_s)
        return ra->at_s < rb->at_s ? -1 : 1;
    if (a->key.z != b->key.z)
        return a->key.z < b->key.z ? -1 : 1;
    if (ra->far != rb->far)
        return ra->far < rb->far ? -1 : 1;
    if (a->count != b->count)
        return a->count > b->count ? -1 : 1;
    return key_compare(a->key, b->key);
}

static bool seed_in_bbox(struct key k, const int32_t bbox_e7[4])
{
    double west, south, east, north;
    key_bounds(k, &west, &south, &east, &north);
    return west * 1e7 < bbox_e7[2] && east * 1e7 > bbox_e7[0] && south * 1e7 < bbox_e7[3] &&
           north * 1e7 > bbox_e7[1];
}

static void seed_take(struct seed *s, size_t tile, double at_s, double far)
{
    const struct store_tile *x = &s->d->tiles[tile];
    if (s->taken[tile] || (s->left && !s->left[tile].count) || x->key.z < s->t->z_min ||
        x->key.z > s->t->z_max || (s->t->has_bbox && !seed_in_bbox(x->key, s->t->bbox_e7)))
        return;
    s->taken[tile] = true;
    s->row[s->n++] = (struct seed_row){x, at_s, far};
}

static double seed_far(const struct seed *s, uint32_t tile, const double eye[3])
{
    const struct store_shape x = store_shape(s->d->index, &s->d->tiles[tile]);
    double d[3];
    for (int k = 0; k < 3; k++)
        d[k] = x.center_enu_m[k] - eye[k];
    return d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
}

/* What one camera needs, with all that is above it. */
static enum err_code seed_take_view(struct seed *s, const struct camera *cam, double error_px,
                                    double at_s, uint32_t *pick, struct err *e)
{
    const struct pick_options o = {.error_px = error_px / STORE_PX_PER_SIGMA};
    const struct tree *tree = store_tree(s->d->index);
    double eye[3];
    size_t n = 0;
    camera_center(cam, eye);
    enum err_code rc = pick_tiles(s->d->index, cam, &o, pick, &n, e);
    for (size_t i = 0; !rc && i < n; i++)
        for (uint32_t v = pick[i]; v != TREE_NONE; v = tree_node(tree, v).parent)
            if (tree_node(tree, v).tile != TREE_NONE)
                seed_take(s, v, at_s, seed_far(s, v, eye));
    return rc;
}

static enum err_code seed_take_course(struct seed *s, const struct course *c, struct err *e)
{
    struct camera *cam = mem_array(COURSE_CAMERAS_MAX, sizeof *cam);
    uint32_t *pick = mem_array(s->d->n_tiles, sizeof *pick);
    double at_s[COURSE_CAMERAS_MAX];
    size_t n = 0;
    enum err_code rc = cam && pick ? course_cameras(c, &s->d->meta.origin, cam, at_s, &n, e)
                                   : err_set(e, ERR_MEM, "seed list: out of memory");
    for (size_t i = 0; !rc && i < n; i++)
        rc = seed_take_view(s, &cam[i], c->error_px, at_s[i], pick, e);
    mem_free(pick);
    mem_free(cam);
    return rc;
}

/* list: what addresses are relative to. */
static void seed_write_row(const struct seed *s, const struct seed_row *row,
                           const struct link *list, const char *query, struct form form,
                           const struct appearance_choice *a, bool course, struct buf *out)
{
    struct link at = *list;
    char etag[BODY_ETAG_SIZE];
    const struct crop_node *left = s->left ? &s->left[row->tile - s->d->tiles] : NULL;
    const uint32_t count = left ? left->count : row->tile->count;
    struct hash128 id = result_id_tile(s->d, row->tile, form, a);
    if (left && left->across)
        result_id_clip(&id, &s->t->clip);
    body_etag(id, etag);
    etag[strlen(etag) - 1] = 0; /* without its quotes, which JSON would have to escape */
    at.key = &row->tile->key;
    at.ext = format_ext(s->t->form.format);
    buf_printf(out, "{\"url\":\"");
    link_tile(&at, out);
    buf_printf(out, "%s\",\"etag\":\"\\\"%s\\\"\",\"gaussians\":%u,\"bytes\":%llu", query, etag + 1,
               count, (unsigned long long)encode_bytes(&s->d->meta, form, count));
    if (course)
        buf_printf(out, ",\"at_s\":%.2f", row->at_s);
    buf_printf(out, "}\n");
}

static void seed_write_page(const struct seed *s, const struct course *c, struct form form,
                            const struct appearance_choice *a, struct buf *out)
{
    char query[TARGET_QUERY_MAX];
    const struct link list =
        link_to(s->t->rev[0] ? LINK_REVISION : LINK_DATASET, NULL, s->d, s->d->edition);
    size_t first = s->t->after < s->n ? s->t->after : s->n;
    size_t end = s->n - first < s->t->limit ? s->n : first + s->t->limit;
    target_query_tiles(s->t, query);
    for (size_t i = first; i < end; i++)
        seed_write_row(s, &s->row[i], &list, query, form, a, c, out);
    if (end < s->n) {
        buf_printf(out, "{\"next\":\"");
        link_seed(&list, out);
        target_query_seed(s->t, c ? c->path : NULL, (uint32_t)end, out);
        buf_printf(out, "\"}\n");
    }
}

enum err_code seed_write(const struct dataset *d, const struct target *t, const struct course *c,
                         const struct crop_node *left, struct form form,
                         const struct appearance_choice *a, struct buf *out, struct err *e)
{
    struct seed s = {.d = d, .t = t, .left = left};
    enum err_code rc = ERR_OK;
    s.row = mem_array(d->n_tiles, sizeof *s.row);
    s.taken = mem_array(d->n_tiles, sizeof *s.taken);
    if (!s.row || !s.taken)
        rc = err_set(e, ERR_MEM, "seed list: out of memory");
    else if (c)
        rc = seed_take_course(&s, c, e);
    else
        for (size_t i = 0; i < d->n_tiles; i++)
            seed_take(&s, i, 0, 0);
    if (!rc) {
        qsort(s.row, s.n, sizeof *s.row, seed_by_importance);
        seed_write_page(&s, c, form, a, out);
    }
    mem_free(s.row);
    mem_free(s.taken);
    return rc ? rc : buf_check(out, e);
}

size_t seed_room(const struct dataset *d, const struct target *t, const struct course *c)
{
    char query[TARGET_QUERY_MAX];
    size_t n = d->n_tiles < t->limit ? d->n_tiles : t->limit;
    target_query_tiles(t, query);
    return n * (SEED_ROW + strlen(query)) + 1024 + strlen(query) + (c ? strlen(c->path) : 0);
}
