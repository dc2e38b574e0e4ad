/* The work of jobs: from a tile in the store to bytes in a format, on a worker thread with a store
 * handle of its own. The result enters the cache before the job ends, so whoever asks next finds
 * the job or the bytes. Axes: .glb, .spz and .drc are in glTF axes about the tile's centre (the
 * tileset's transforms put it in place); .ply keeps east-north-up and says its origin in comments.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct hash128 encode_tile_id(const struct dataset *d, const struct store_tile *t, enum format f)
{
    struct { /* no padding */
        struct hash128 payload, salt;
        uint32_t z, x, y, format;
    } name = {t->hash, d->salt, t->key.z, t->key.x, t->key.y, (uint32_t)f};
    return hash_bytes(&name, sizeof(name));
}

enum err_code encode_tile(struct store *s, struct key key, enum format format, struct buf *out,
                          struct err *e)
{
    const struct store_meta *meta = store_info(s);
    const char *copyright = meta->attribution[0] ? meta->attribution : NULL;
    const struct ply_info info = {.has_origin = true, .origin = meta->origin};
    struct gauss g = {0};
    struct quant q = {0};
    char name[48];
    enum err_code rc = store_read_gauss(s, key, &g, e);
    if (rc == ERR_OK && format != FORMAT_PLY)
        frame_enu_to_gltf(&g);
    if (rc == ERR_OK && format != FORMAT_PLY && format != FORMAT_GLB_PLAIN)
        rc = quant_from_gauss(&g, meta->sh_degree, &q, e);
    if (rc != ERR_OK)
        goto out;
    switch (format) {
    case FORMAT_GLB:
        rc = glb_encode_spz(&q, copyright, out, e);
        break;
    case FORMAT_SPZ:
        rc = spz_encode(&q, 3, out, e);
        break;
    case FORMAT_DRC:
        snprintf(name, sizeof(name), "%u/%u/%u", key.z, key.x, key.y);
        rc = draco_encode(&q, name, out, e);
        break;
    case FORMAT_PLY:
        rc = ply_encode(&g, &info, out, e);
        break;
    case FORMAT_GLB_PLAIN:
        rc = glb_encode_plain(&g, copyright, out, e);
        break;
    default:
        rc = err_set(e, ERR_INTERNAL, "encode_tile: %s is not a tile format", target_ext(format));
    }
out:
    quant_free(&q);
    gauss_free(&g);
    return rc;
}

/* ---- prefetch list ------------------------------------------------------------------------------ */

/* Coarse levels first, since every view needs them; within a level, tiles that hold more. */
static int by_importance(const void *pa, const void *pb)
{
    const struct store_tile *a = *(const struct store_tile *const *)pa;
    const struct store_tile *b = *(const struct store_tile *const *)pb;
    if (a->key.z != b->key.z)
        return a->key.z < b->key.z ? -1 : 1;
    if (a->count != b->count)
        return a->count > b->count ? -1 : 1;
    return key_compare(a->key, b->key);
}

static bool in_bbox(struct key k, const int32_t bbox_e7[4])
{
    double west, south, east, north;
    key_bounds(k, &west, &south, &east, &north);
    return west * 1e7 < bbox_e7[2] && east * 1e7 > bbox_e7[0] && south * 1e7 < bbox_e7[3] &&
           north * 1e7 > bbox_e7[1];
}

enum err_code encode_seed(const struct dataset *d, const struct target *t, struct buf *out,
                          struct err *e)
{
    const struct store_tile **pick = mem_array(d->n_tiles, sizeof(*pick));
    size_t n = 0;
    if (!pick)
        return err_set(e, ERR_MEM, "seed list: out of memory");
    for (size_t i = 0; i < d->n_tiles; i++) {
        struct key k = d->tiles[i].key;
        if (k.z >= t->z_min && k.z <= t->z_max && (!t->has_bbox || in_bbox(k, t->bbox_e7)))
            pick[n++] = &d->tiles[i];
    }
    qsort(pick, n, sizeof(*pick), by_importance);
    for (size_t i = 0; i < n; i++) {
        char etag[BODY_ETAG_SIZE];
        body_etag(encode_tile_id(d, pick[i], t->format), etag);
        etag[strlen(etag) - 1] = 0; /* without its quotes, which JSON would have to escape */
        buf_printf(out,
                   "{\"url\":\"r/%s/t/%u/%u/%u.%s\",\"etag\":\"\\\"%s\\\"\",\"gaussians\":%u}\n",
                   d->meta.revision, pick[i]->key.z, pick[i]->key.x, pick[i]->key.y,
                   target_ext(t->format), etag + 1, pick[i]->count);
    }
    mem_free(pick);
    return buf_check(out, e);
}

/* ---- jobs --------------------------------------------------------------------------------------- */

static enum err_code make_tile(const struct work *w, struct buf *out, struct err *e)
{
    struct store *s = dataset_borrow(w->ds);
    if (!s)
        return err_set(e, ERR_INTERNAL, "dataset %s: fewer store handles than workers",
                       w->ds->path);
    enum err_code rc = encode_tile(s, w->key, w->format, out, e);
    dataset_return(w->ds, s);
    return rc;
}

enum err_code encode_run(void *user, const struct job *j, void *work, size_t worker,
                         struct body **out, struct err *e)
{
    struct services *s = user;
    const struct work *w = work;
    struct buf b = {0};
    char etag[BODY_ETAG_SIZE];
    (void)worker;
    if (w->keep && (*out = cache_get(s->cache, w->id)))
        return ERR_OK; /* made between the look into the cache and the question for a job */
    enum err_code rc = w->kind == WORK_VIEW   ? picture_make(s->picture, j, w, &b, e)
                       : w->kind == WORK_SEED ? encode_seed(w->ds, &w->seed, &b, e)
                                              : make_tile(w, &b, e);
    if (rc == ERR_OK)
        rc = buf_check(&b, e);
    if (rc == ERR_OK) {
        body_etag(w->id, etag);
        *out = body_take(&b, etag);
        if (!*out)
            rc = err_set(e, ERR_MEM, "out of memory for the encoded bytes");
    }
    if (rc == ERR_OK && w->keep)
        cache_put(s->cache, w->id, *out);
    if (rc != ERR_OK && rc != ERR_CANCEL) {
        atomic_fetch_add(&s->metrics.store_errors, w->kind == WORK_TILE);
        log_error("serve", "job failed ds=%s %s %u/%u/%u.%s: %s", w->ds->meta.name,
                  w->kind == WORK_VIEW ? "view" : "tile", w->key.z, w->key.x, w->key.y,
                  target_ext(w->format), e->msg);
    }
    buf_free(&b);
    return rc;
}

void encode_drop(void *services, void *work)
{
    struct work *w = work;
    (void)services;
    dataset_drop(&w->ds);
    mem_free(w);
}
