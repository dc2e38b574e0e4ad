/* Tiles of a store on the device: see resident.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/choose/resident.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "codec/splat/payload.h"
#include "core/pool.h"
#include "lod/store/store.h"

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
    out->model.sh_halves = true;
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

/* Memory of a thread while it decodes a tile; the next tile gets it again. */
struct resident_bench {
    atomic_flag taken;
    struct payload payload;
    float *size_log; /* [room] */
    uint32_t *place; /* [room] */
    size_t room;
    float **block; /* [n_blocks] */
    size_t n_blocks;
};

/* Tiles on their way into a model, some at a time. */
struct resident_batch {
    struct resident *r;
    struct render_model *to;
    struct render_piece *piece; /* blocks of these tiles */
    uint32_t tile[RESIDENT_BATCH];
    size_t first[RESIDENT_BATCH + 1]; /* piece of each tile */
    size_t n;
    struct buf payload[RESIDENT_BATCH];
    struct resident_bench bench[RESIDENT_BATCH];
};

/* blocks: of all tiles that will be added. Large, so on the heap; resident_batch_free it. */
static enum err_code resident_batch_make(struct resident *r, struct render_model *to, size_t blocks,
                                         struct resident_batch **out, struct err *e)
{
    struct resident_batch *b = *out = mem_array(1, sizeof *b);
    if (b)
        b->piece = mem_array(blocks + 1, sizeof *b->piece);
    if (!b || !b->piece)
        return err_set(e, ERR_MEM, "out of memory for %zu blocks of Gaussians", blocks);
    b->r = r;
    b->to = to;
    for (size_t i = 0; i < RESIDENT_BATCH; i++)
        atomic_flag_clear(&b->bench[i].taken);
    return ERR_OK;
}

static void resident_batch_free(struct resident_batch *b)
{
    for (size_t i = 0; b && i < RESIDENT_BATCH; i++) {
        buf_free(&b->payload[i]);
        payload_free(&b->bench[i].payload);
        mem_free(b->bench[i].size_log);
        mem_free(b->bench[i].place);
        mem_free(b->bench[i].block);
    }
    if (b)
        mem_free(b->piece);
    mem_free(b);
}

/* There are as many as tiles in work, so one is free. Few threads use the first few. */
static struct resident_bench *resident_bench_take(struct resident_batch *b)
{
    for (size_t i = 0;; i = (i + 1) % RESIDENT_BATCH)
        if (!atomic_flag_test_and_set(&b->bench[i].taken))
            return &b->bench[i];
}

/* Where the rows of an unpacked tile go: its blocks, and the order of rows in them. */
static enum err_code resident_bench_lay(struct resident_bench *k, const struct render_piece *piece,
                                        struct err *e)
{
    const size_t n = k->payload.n, blocks = block_count(n);
    if (n > k->room || !k->size_log) {
        mem_free(k->size_log);
        mem_free(k->place);
        mem_free(k->block);
        k->size_log = mem_uninit(n, sizeof *k->size_log);
        k->place = mem_uninit(n, sizeof *k->place);
        k->block = mem_array(blocks + 1, sizeof *k->block);
        k->room = n;
    }
    if (!k->size_log || !k->place || !k->block) {
        k->room = 0;
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", n);
    }
    payload_sizes(&k->payload, k->size_log);
    block_places(k->size_log, n, k->place);
    for (size_t i = 0; i < blocks; i++)
        k->block[i] = piece[i].groups;
    return ERR_OK;
}

/* Rows of block i of a tile of n. */
static size_t resident_rows(size_t n, size_t i)
{
    const size_t left = n - i * BLOCK_ROWS;
    return left < BLOCK_ROWS ? left : BLOCK_ROWS;
}

/* Takes away a share of the opacity of a block. */
static void resident_faint(const struct resident_tile *t, float *groups, uint32_t planes, size_t n)
{
    const double share = 1.0 - (double)t->missing;
    for (size_t i = 0; i < n; i++) {
        float *logit = groups + layout_at(i, planes) + LAYOUT_PLANE_OPACITY * LAYOUT_LANES;
        double o = share / (1.0 + exp(-(double)*logit));
        *logit = (float)log(o / (1.0 - o));
    }
}

/* What is left to do once the rows are in their blocks. */
static enum err_code resident_finish(struct resident_tile *t, const struct render_model *m,
                                     float *const *block, size_t n, struct err *e)
{
    struct block *box = t->block ? NULL : mem_array(block_count(n) + 1, sizeof *box);
    if (!t->block && !box)
        return err_set(e, ERR_MEM, "out of memory for a tile of %zu Gaussians", n);
    for (size_t i = 0; i < block_count(n); i++) {
        const size_t rows = resident_rows(n, i);
        if (box)
            block_measure(block[i], m->planes, rows, m->origin_enu_m, &box[i]);
        if (t->missing > 0.0f)
            resident_faint(t, block[i], m->planes, rows);
        render_piece_end(block[i], m->planes, rows);
    }
    t->block = box ? box : t->block;
    return ERR_OK;
}

static enum err_code resident_decode(void *user, size_t i, struct err *e)
{
    struct resident_batch *b = user;
    const struct store *s = b->r->store;
    const struct store_tile *t = resident_index(b->r, b->tile[i]);
    const struct render_model *m = b->to;
    struct resident_bench *k = resident_bench_take(b);
    enum err_code rc = store_unpack(s, t, &b->payload[i], &k->payload, e);
    /* Without appearance nothing would say what embeddings mean: they are left out. */
    if (!rc && (k->payload.sh_degree != m->sh_degree ||
                (m->embed_len && k->payload.embed_len != m->embed_len)))
        rc = err_set(e, ERR_FORMAT,
                     "tile %u/%u/%u: other harmonics or embeddings than the store's others",
                     t->key.z, t->key.x, t->key.y);
    if (!rc)
        rc = resident_bench_lay(k, b->piece + b->first[i], e);
    if (!rc) {
        struct payload_target to = {.block = k->block,
                                    .place = k->place,
                                    .block_rows = BLOCK_ROWS,
                                    .sh_halves = m->sh_halves,
                                    .embed_len = m->embed_len};
        memcpy(to.origin_enu_m, m->origin_enu_m, sizeof to.origin_enu_m);
        if (payload_place(&k->payload, &to, e))
            rc = store_name_tile(s, t, e);
    }
    if (!rc)
        rc = resident_finish(&b->r->tile[b->tile[i]], m, k->block, k->payload.n, e);
    atomic_flag_clear(&k->taken);
    return rc;
}

/* Those that were added. On success the batch is empty. */
static enum err_code resident_load(struct resident_batch *b, struct err *e)
{
    struct resident *r = b->r;
    struct render_placing placing;
    enum err_code rc = b->n ? render_go(r->render, e) : ERR_OK;
    for (size_t i = 0; !rc && i < b->n; i++)
        rc = store_read(r->store, resident_index(r, b->tile[i])->key, &b->payload[i], e);
    if (rc || !b->n)
        return rc;
    rc = render_place_open(r->render, b->to, b->piece, b->first[b->n], &placing, e);
    if (!rc) {
        rc = pool_for(b->n, 0, resident_decode, b, e);
        rc = render_place_close(r->render, b->to, &placing, rc, e);
    }
    b->n = rc ? b->n : 0;
    return rc;
}

/* Adds a tile, whose blocks go to pages (NULL: they follow each other, from that group on), and
 * loads the batch if it is full. */
static enum err_code resident_add(struct resident_batch *b, uint32_t tile, const uint32_t *page,
                                  size_t group, struct err *e)
{
    const size_t n = resident_index(b->r, tile)->count, first = b->first[b->n];
    for (size_t i = 0; i < block_count(n); i++)
        b->piece[first + i] = (struct render_piece){
            .n_groups = render_piece_groups(resident_rows(n, i)),
            .at = (uint32_t)(page ? (size_t)page[i] * BLOCK_GROUPS : group + i * BLOCK_GROUPS)};
    b->tile[b->n++] = tile;
    b->first[b->n] = first + block_count(n);
    return b->n == RESIDENT_BATCH ? resident_load(b, e) : ERR_OK;
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

/* There are free pages enough. */
static enum err_code resident_enter(struct resident *r, struct resident_tile *t, struct err *e)
{
    size_t blocks = block_count(resident_index(r, (uint32_t)(t - r->tile))->count);
    t->page = mem_array(blocks + 1, sizeof *t->page);
    if (!t->page)
        return err_set(e, ERR_MEM, "out of memory for %zu blocks", blocks);
    for (size_t i = 0; i < blocks; i++) {
        t->page[i] = r->free_page[--r->n_free];
        r->top = t->page[i] < r->top ? r->top : t->page[i] + 1;
    }
    return ERR_OK;
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
    r->n_pages = r->n_free = r->top = r->n_list = 0;
    r->list_valid = false;
}

/* As resident_open left it. */
static void resident_empty(struct render_model *m)
{
    struct render_model kept = {
        .sh_degree = m->sh_degree, .sh_halves = m->sh_halves, .embed_len = m->embed_len};
    memcpy(kept.origin_enu_m, m->origin_enu_m, sizeof kept.origin_enu_m);
    render_model_free(m);
    *m = kept;
}

void resident_shrink(struct resident *r)
{
    resident_forget_pages(r);
    resident_empty(&r->model);
    resident_empty(&r->flat);
}

static bool resident_resize(uint32_t **p, size_t n_old, size_t n_new)
{
    uint32_t *q = mem_resize(*p, n_old, n_new, sizeof *q);
    *p = q ? q : *p;
    return q;
}

/* At least so many pages; what they hold stays. */
static enum err_code resident_grow(struct resident *r, size_t pages, struct err *e)
{
    const size_t was = r->n_pages;
    enum err_code rc =
        render_model_reserve(r->render, &r->model, pages * BLOCK_GROUPS, r->top * BLOCK_GROUPS, e);
    if (rc)
        return rc;
    const size_t now = render_model_capacity(&r->model) / BLOCK_GROUPS;
    if (!resident_resize(&r->free_page, was, now) ||
        !resident_resize(&r->list, was * BLOCK_GROUPS, now * BLOCK_GROUPS) ||
        !resident_resize(&r->next, was * BLOCK_GROUPS, now * BLOCK_GROUPS))
        return err_set(e, ERR_MEM, "out of memory for %zu blocks of Gaussians", pages);
    r->n_pages = now;
    for (size_t i = now; i-- > was;)
        r->free_page[r->n_free++] = (uint32_t)i;
    return ERR_OK;
}

static int resident_use_compare(const void *a, const void *b)
{
    const struct resident_tile *const *x = a;
    const struct resident_tile *const *y = b;
    return (*x)->used < (*y)->used ? -1 : (*x)->used > (*y)->used;
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

/* Room for a picture of so many pages, `missing` of which are not there. Nothing leaves as long as
 * the limit allows more pages. They double, because all that is there is copied. */
static enum err_code resident_reserve(struct resident *r, size_t pages, size_t missing,
                                      uint64_t since, struct err *e)
{
    const size_t page_bytes = (size_t)render_model_planes(&r->model) * BLOCK_ROWS * sizeof(float);
    const size_t limit = r->limit_bytes / page_bytes;
    struct err why;
    if (missing <= r->n_free && r->n_pages > 0)
        return ERR_OK;
    size_t want = r->n_pages - r->n_free + missing;
    want = want > 2 * r->n_pages ? want : 2 * r->n_pages;
    want = want < limit ? want : limit;
    want = want > pages ? want : pages;
    if (want > r->n_pages && r->n_pages > 0 && resident_grow(r, want, &why)) {
        /* No room for the old pages beside the new ones: all tiles are loaded again. */
        resident_forget_pages(r);
        resident_empty(&r->model);
        missing = want = pages;
    }
    enum err_code rc = want > r->n_pages || !r->n_pages ? resident_grow(r, want, e) : ERR_OK;
    if (!rc)
        resident_make_room(r, missing, since);
    return rc;
}

static enum err_code resident_bring(struct resident *r, const uint32_t *picked, size_t n,
                                    struct err *e)
{
    struct resident_batch *b = NULL;
    size_t pages = 0, missing = 0;
    uint64_t since = r->clock;
    for (size_t i = 0; i < n; i++) {
        const size_t here = block_count(resident_index(r, picked[i])->count);
        pages += here;
        missing += r->tile[picked[i]].page ? 0 : here;
        r->tile[picked[i]].used = ++r->clock;
    }
    enum err_code rc = resident_reserve(r, pages, missing, since, e);
    if (rc || missing == 0)
        return rc;
    rc = resident_batch_make(r, &r->model, pages, &b, e);
    for (size_t i = 0; !rc && i < n; i++) {
        struct resident_tile *t = &r->tile[picked[i]];
        if (t->page)
            continue;
        rc = resident_enter(r, t, e);
        if (!rc)
            rc = resident_add(b, picked[i], t->page, 0, e);
    }
    if (!rc)
        rc = resident_load(b, e);
    for (size_t i = 0; rc && b && i < b->n; i++) /* of all or of none */
        resident_leave(r, &r->tile[b->tile[i]]);
    resident_batch_free(b);
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
            const size_t here = resident_rows(rows, b);
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
    struct resident_batch *b = NULL;
    size_t groups = 0, blocks = 0, at = 0;
    for (size_t i = 0; i < n; i++) {
        groups += render_piece_groups(resident_index(r, picked[i])->count);
        blocks += block_count(resident_index(r, picked[i])->count);
    }
    enum err_code rc = render_model_reserve(r->render, &r->flat, groups, 0, e);
    if (!rc)
        rc = resident_batch_make(r, &r->flat, blocks, &b, e);
    for (size_t i = 0; !rc && i < n; i++) {
        rc = resident_add(b, picked[i], NULL, at, e);
        at += render_piece_groups(resident_index(r, picked[i])->count);
    }
    if (!rc)
        rc = resident_load(b, e);
    if (!rc)
        rc = render_model_list(r->render, NULL, groups, &r->flat, e);
    resident_batch_free(b);
    return rc;
}
