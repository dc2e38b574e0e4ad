/* Tiles of a store in memory and on the device: see resident.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/resident.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/pool.h"
#include "lod/store.h"

enum { RESIDENT_BATCH = 16 /* payloads in memory at once while decoding */ };

static const struct store_tile *resident_index(const struct resident *r, uint32_t tile)
{
    size_t n;
    return &store_tiles(r->store, &n)[tile];
}

enum err_code resident_open(struct store *s, struct render *r, uint32_t embed_len,
                            size_t limit_bytes, struct resident *out, struct err *e)
{
    const struct store_tile *tiles = store_tiles(s, &out->n_tiles);
    out->store = s;
    out->render = r;
    out->limit_bytes = limit_bytes;
    out->model.sh_degree = store_info(s)->sh_degree;
    out->model.embed_len = embed_len;
    if (out->n_tiles > 0) {
        const struct store_shape first = store_shape(s, &tiles[0]);
        memcpy(out->model.origin_enu_m, first.center_enu_m, sizeof out->model.origin_enu_m);
    }
    out->flat = out->model;
    out->tile = mem_array(out->n_tiles, sizeof *out->tile);
    out->scratch = mem_array(out->n_tiles, sizeof *out->scratch);
    return out->tile && out->scratch
               ? ERR_OK
               : err_set(e, ERR_MEM, "out of memory for %zu tiles", out->n_tiles);
}

void resident_close(struct resident *r)
{
    render_model_free(&r->model);
    render_model_free(&r->flat);
    for (size_t i = 0; r->tile && i < r->n_tiles; i++) {
        mem_free(r->tile[i].packed);
        mem_free(r->tile[i].block);
        mem_free(r->tile[i].page);
    }
    mem_free(r->tile);
    mem_free(r->scratch);
    mem_free(r->free_page);
    mem_free(r->list);
    mem_free(r->next);
    *r = (struct resident){0};
}

/* ---- decoding ---- */

struct resident_batch {
    struct resident *r;
    uint32_t tile[RESIDENT_BATCH];
    struct buf payload[RESIDENT_BATCH];
    size_t n;
};

/* Block by block, in their order: what is sorted stays in the processor's cache. */
static enum err_code resident_pack(const struct resident *r, const struct gauss *g,
                                   const uint32_t *order, struct resident_tile *to, struct err *e)
{
    const size_t group = (size_t)LAYOUT_LANES * layout_planes(g->sh_degree, g->embed_len),
                 floats = render_piece_groups(g->n) * group;
    struct gauss part;
    enum err_code rc = gauss_uninit(&part, BLOCK_ROWS, g->sh_degree, g->embed_len, e);
    if (rc)
        return rc;
    if (!to->block)
        to->block = mem_array(block_count(g->n) + 1, sizeof *to->block);
    to->packed = mem_uninit(floats + 1, sizeof(float));
    if (!to->block || !to->packed)
        rc = err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g->n);
    memcpy(part.origin_enu_m, g->origin_enu_m, sizeof part.origin_enu_m);
    part.antialiased = g->antialiased;
    for (size_t b = 0; !rc && b < block_count(g->n); b++) {
        const size_t from = b * BLOCK_ROWS, n = g->n - from < BLOCK_ROWS ? g->n - from : BLOCK_ROWS;
        part.n = 0;
        rc = gauss_append(&part, g, order + from, n, e);
        if (rc)
            break;
        block_measure(&part, &to->block[b]);
        render_piece_pack(&part, r->model.origin_enu_m, to->packed + b * BLOCK_GROUPS * group);
    }
    gauss_free(&part);
    to->bytes = floats * sizeof(float) + sizeof *to;
    return rc;
}

static enum err_code resident_decode(void *user, size_t i, struct err *e)
{
    struct resident_batch *b = user;
    const struct store_tile *t = resident_index(b->r, b->tile[i]);
    const struct render_model *m = &b->r->model;
    struct gauss g = {0};
    uint32_t *order = NULL;
    enum err_code rc = store_decode(b->r->store, t, &b->payload[i], &g, e);
    if (rc)
        return rc;
    if (!m->embed_len)
        g.embed_len = 0; /* nothing would say what they mean */
    if (g.sh_degree != m->sh_degree || g.embed_len != m->embed_len)
        rc = err_set(e, ERR_FORMAT,
                     "tile %u/%u/%u: other harmonics or embeddings than the store's others",
                     t->key.z, t->key.x, t->key.y);
    if (!rc && !(order = mem_uninit(g.n, sizeof *order)))
        rc = err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", g.n);
    if (!rc)
        rc = block_order(&g, order, e);
    if (!rc)
        rc = resident_pack(b->r, &g, order, &b->r->tile[b->tile[i]], e);
    mem_free(order);
    gauss_free(&g);
    return rc;
}

static enum err_code resident_load_batch(struct resident_batch *b, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < b->n; i++)
        rc = store_read(b->r->store, resident_index(b->r, b->tile[i])->key, &b->payload[i], e);
    if (!rc)
        rc = pool_for(b->n, 0, resident_decode, b, e);
    for (size_t i = 0; i < b->n; i++) {
        struct resident_tile *t = &b->r->tile[b->tile[i]];
        buf_free(&b->payload[i]);
        if (rc) { /* of all or of none */
            mem_free(t->packed);
            t->packed = NULL;
            t->bytes = 0;
        }
        b->r->bytes += t->bytes;
    }
    b->n = 0;
    return rc;
}

/* Those of the tiles that are neither in memory nor, unless `all`, on the device. */
static enum err_code resident_load(struct resident *r, const uint32_t *picked, size_t n, bool all,
                                   struct err *e)
{
    struct resident_batch b = {.r = r};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        const struct resident_tile *t = &r->tile[picked[i]];
        if (t->packed || (t->page && !all))
            continue;
        b.tile[b.n++] = picked[i];
        if (b.n == RESIDENT_BATCH)
            rc = render_go(r->render, e);
        if (!rc && b.n == RESIDENT_BATCH)
            rc = resident_load_batch(&b, e);
    }
    return !rc && b.n ? resident_load_batch(&b, e) : rc;
}

static int resident_use_compare(const void *a, const void *b)
{
    const struct resident_tile *const *x = a;
    const struct resident_tile *const *y = b;
    return (*x)->used < (*y)->used ? -1 : (*x)->used > (*y)->used;
}

/* Least recently used out until the limit is kept. */
static void resident_evict(struct resident *r)
{
    size_t n = 0;
    if (r->bytes <= r->limit_bytes)
        return;
    for (size_t i = 0; i < r->n_tiles; i++)
        if (r->tile[i].packed)
            r->scratch[n++] = &r->tile[i];
    qsort(r->scratch, n, sizeof(struct resident_tile *), resident_use_compare);
    for (size_t i = 0; i < n && r->bytes > r->limit_bytes; i++) {
        struct resident_tile *t = r->scratch[i];
        r->bytes -= t->bytes;
        t->bytes = 0;
        mem_free(t->packed);
        t->packed = NULL;
    }
}

/* ---- pages ---- */

static void resident_leave(struct resident *r, struct resident_tile *t)
{
    size_t blocks = block_count(resident_index(r, (uint32_t)(t - r->tile))->count);
    for (size_t i = blocks; i-- > 0;)
        r->free_page[r->n_free++] = t->page[i];
    mem_free(t->page);
    t->page = NULL;
}

void resident_weigh(struct resident *r, uint32_t tile, float share)
{
    struct resident_tile *t = &r->tile[tile];
    if (t->missing == 1.0f - share)
        return;
    t->missing = 1.0f - share;
    if (t->page)
        resident_leave(r, t);
}

/* A copy of what is packed of a tile, with its share of opacity. Caller frees; NULL: no memory. */
static float *resident_faint(const struct resident *r, const struct resident_tile *t, size_t rows)
{
    size_t floats = (size_t)render_piece_groups(rows) * r->model.planes * LAYOUT_LANES;
    double share = 1.0 - (double)t->missing;
    float *out = mem_array(floats + 1, sizeof *out);
    if (!out)
        return NULL;
    memcpy(out, t->packed, floats * sizeof *out);
    for (size_t i = 0; i < rows; i++) {
        size_t group = i / LAYOUT_LANES * r->model.planes;
        float *logit = &out[(group + LAYOUT_PLANE_OPACITY) * LAYOUT_LANES + i % LAYOUT_LANES];
        double o = share / (1.0 + exp(-(double)*logit));
        *logit = (float)log(o / (1.0 - o));
    }
    return out;
}

static void resident_forget_pages(struct resident *r)
{
    for (size_t i = 0; i < r->n_tiles; i++) {
        mem_free(r->tile[i].page);
        r->tile[i].page = NULL;
    }
    mem_free(r->free_page);
    mem_free(r->list);
    mem_free(r->next);
    r->free_page = r->list = r->next = NULL;
    r->n_pages = r->n_free = r->n_list = 0;
    r->list_valid = false;
}

/* At least so many pages; when there were fewer nothing is on the device any more. */
static enum err_code resident_reserve(struct resident *r, size_t pages, struct err *e)
{
    bool kept;
    enum err_code rc = render_model_reserve(r->render, &r->model, pages * BLOCK_GROUPS, &kept, e);
    if (!rc && kept)
        return ERR_OK;
    resident_forget_pages(r);
    r->n_pages = render_model_capacity(&r->model) / BLOCK_GROUPS;
    r->free_page = mem_array(r->n_pages, sizeof *r->free_page);
    r->list = mem_array(r->n_pages * BLOCK_GROUPS, sizeof *r->list);
    r->next = mem_array(r->n_pages * BLOCK_GROUPS, sizeof *r->next);
    if (!rc && !(r->free_page && r->list && r->next)) {
        r->n_pages = 0;
        render_model_free(&r->model);
        rc = err_set(e, ERR_MEM, "out of memory for %zu blocks of Gaussians", pages);
    }
    for (size_t i = r->n_pages; !rc && i-- > 0;)
        r->free_page[r->n_free++] = (uint32_t)i;
    return rc;
}

/* As resident_open left it. */
static void resident_empty(struct render_model *m)
{
    struct render_model kept = {.sh_degree = m->sh_degree, .embed_len = m->embed_len};
    memcpy(kept.origin_enu_m, m->origin_enu_m, sizeof kept.origin_enu_m);
    render_model_free(m);
    *m = kept;
}

void resident_shrink(struct resident *r)
{
    const size_t limit = r->limit_bytes;
    r->limit_bytes = 0;
    resident_evict(r);
    r->limit_bytes = limit;
    resident_forget_pages(r);
    resident_empty(&r->model);
    resident_empty(&r->flat);
}

/* Free pages enough, at the cost of tiles used last before `since`. */
static void resident_make_room(struct resident *r, size_t pages, uint64_t since)
{
    size_t n = 0;
    if (r->n_free >= pages)
        return;
    for (size_t i = 0; i < r->n_tiles; i++)
        if (r->tile[i].page && r->tile[i].used <= since)
            r->scratch[n++] = &r->tile[i];
    qsort(r->scratch, n, sizeof(struct resident_tile *), resident_use_compare);
    for (size_t i = 0; i < n && r->n_free < pages; i++)
        resident_leave(r, r->scratch[i]);
}

/* Copy what is not on the device yet; `pages` of it, which are free. */
static enum err_code resident_place(struct resident *r, const uint32_t *picked, size_t n,
                                    size_t pages, struct err *e)
{
    size_t block_floats = (size_t)r->model.planes * LAYOUT_LANES * BLOCK_GROUPS, n_pieces = 0;
    struct render_piece *piece = mem_array(pages + 1, sizeof *piece);
    float **faint = mem_array(n + 1, sizeof *faint);
    enum err_code rc =
        piece && faint ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu blocks", pages);
    for (size_t i = 0; !rc && i < n; i++) {
        struct resident_tile *t = &r->tile[picked[i]];
        size_t rows = resident_index(r, picked[i])->count, blocks = block_count(rows);
        if (t->page)
            continue;
        faint[i] = t->missing > 0.0f ? resident_faint(r, t, rows) : NULL;
        if ((t->missing > 0.0f && !faint[i]) ||
            !(t->page = mem_array(blocks + 1, sizeof *t->page))) {
            rc = err_set(e, ERR_MEM, "out of memory for %zu blocks", blocks);
            break;
        }
        for (size_t b = 0; b < blocks; b++) {
            uint32_t groups = render_piece_groups(rows - b * BLOCK_ROWS);
            t->page[b] = r->free_page[--r->n_free];
            piece[n_pieces++] = (struct render_piece){
                (faint[i] ? faint[i] : t->packed) + b * block_floats,
                groups < BLOCK_GROUPS ? groups : BLOCK_GROUPS, t->page[b] * BLOCK_GROUPS};
        }
        t->used = 0; /* until its blocks are there */
    }
    if (!rc)
        rc = render_model_place(r->render, piece, n_pieces, &r->model, e);
    for (size_t i = 0; i < n; i++) {
        struct resident_tile *t = &r->tile[picked[i]];
        if (rc && t->page && t->used == 0)
            resident_leave(r, t);
        t->used = ++r->clock;
    }
    for (size_t i = 0; faint && i < n; i++)
        mem_free(faint[i]);
    mem_free(faint);
    mem_free(piece);
    return rc;
}

static enum err_code resident_bring(struct resident *r, const uint32_t *picked, size_t n,
                                    struct err *e)
{
    size_t pages = 0, missing = 0;
    uint64_t since = r->clock;
    for (size_t i = 0; i < n; i++) {
        pages += block_count(resident_index(r, picked[i])->count);
        r->tile[picked[i]].used = ++r->clock;
    }
    enum err_code rc = resident_reserve(r, pages, e);
    if (!rc)
        rc = resident_load(r, picked, n, false, e);
    for (size_t i = 0; !rc && i < n; i++)
        missing += r->tile[picked[i]].page ? 0 : block_count(resident_index(r, picked[i])->count);
    if (rc || missing == 0)
        return rc;
    resident_make_room(r, missing, since);
    rc = resident_place(r, picked, n, missing, e);
    resident_evict(r);
    return rc;
}

enum err_code resident_show(struct resident *r, const uint32_t *picked, size_t n,
                            const struct frustum *f, uint64_t *n_gaussians, struct err *e)
{
    size_t n_list = 0;
    *n_gaussians = 0;
    enum err_code rc = resident_bring(r, picked, n, e);
    for (size_t i = 0; !rc && i < n; i++) {
        const struct resident_tile *t = &r->tile[picked[i]];
        size_t rows = resident_index(r, picked[i])->count;
        for (size_t b = 0; b * BLOCK_ROWS < rows; b++) {
            const struct block *x = &t->block[b];
            size_t left = rows - b * BLOCK_ROWS, here = left < BLOCK_ROWS ? left : BLOCK_ROWS;
            if (f && !frustum_sees(f, x->min_enu_m, x->max_enu_m, x->sigma_max_m))
                continue;
            *n_gaussians += here;
            for (uint32_t k = 0; k < render_piece_groups(here); k++)
                r->next[n_list++] = t->page[b] * BLOCK_GROUPS + k;
        }
    }
    bool same = r->list_valid && n_list == r->n_list &&
                (n_list == 0 || !memcmp(r->list, r->next, n_list * sizeof *r->list));
    if (rc || same)
        return rc;
    rc = render_model_list(r->render, r->next, n_list, &r->model, e);
    uint32_t *was = r->list;
    r->list = r->next;
    r->next = was;
    r->n_list = n_list;
    r->list_valid = !rc;
    return rc;
}

enum err_code resident_flat(struct resident *r, const uint32_t *picked, size_t n, struct err *e)
{
    size_t groups = 0;
    bool kept;
    struct render_piece *piece = mem_array(n + 1, sizeof *piece);
    enum err_code rc = piece ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    for (size_t i = 0; i < n; i++)
        r->tile[picked[i]].used = ++r->clock;
    if (!rc)
        rc = resident_load(r, picked, n, true, e);
    for (size_t i = 0; !rc && i < n; i++) {
        uint32_t here = render_piece_groups(resident_index(r, picked[i])->count);
        piece[i] = (struct render_piece){r->tile[picked[i]].packed, here, (uint32_t)groups};
        groups += here;
    }
    if (!rc)
        rc = render_model_reserve(r->render, &r->flat, groups, &kept, e);
    if (!rc)
        rc = render_model_place(r->render, piece, n, &r->flat, e);
    if (!rc)
        rc = render_model_list(r->render, NULL, groups, &r->flat, e);
    mem_free(piece);
    resident_evict(r);
    return rc;
}
