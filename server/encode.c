/* The work of jobs: from a tile in the store to bytes in a format, on a worker thread with a store
 * handle of its own. The result enters the cache before the job ends, so whoever asks next finds
 * the job or the bytes. Axes: .glb, .spz and .drc are in glTF axes about the tile's centre (the
 * tileset's transforms put it in place); .ply keeps east-north-up and says its origin in comments.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/axes.h"
#include "codec/draco.h"
#include "codec/glb.h"
#include "codec/ply.h"
#include "codec/quant.h"
#include "codec/spz.h"
#include "server/server.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static bool is_quantised(enum format f)
{
    return f == FORMAT_GLB || f == FORMAT_SPZ || f == FORMAT_DRC;
}

struct form encode_form(const struct server_config *cfg, const struct store_meta *meta,
                        const struct form *asked)
{
    struct form f = {.format = asked->format};
    if (is_quantised(f.format)) {
        f.preset = asked->preset < QUANT_PRESETS ? asked->preset : (uint8_t)cfg->preset;
        f.sh_degree =
            asked->sh_degree < meta->sh_degree ? asked->sh_degree : (uint8_t)meta->sh_degree;
    }
    return f;
}

struct hash128 encode_tile_id(const struct dataset *d, const struct store_tile *t, struct form f,
                              const struct look *look)
{
    struct { /* no padding */
        struct hash128 payload, salt;
        uint32_t z, x, y, form;
    } name = {t->hash,  d->salt,  t->key.z,
              t->key.x, t->key.y, (uint32_t)f.format << 16 | (uint32_t)f.preset << 8 | f.sh_degree};
    struct hash128 id = hash_bytes(&name, sizeof(name));
    look_mix(&id, look);
    return id;
}

/* g (changed) to bytes of a form. */
static enum err_code encode_gauss(struct gauss *g, const struct store_meta *meta, struct key key,
                                  struct form form, struct buf *out, struct err *e)
{
    const enum format format = form.format;
    const char *copyright = meta->attribution[0] ? meta->attribution : NULL;
    const struct ply_info info = {.has_origin = true, .origin = meta->origin};
    struct quant q = {0};
    char name[48];
    enum err_code rc = ERR_OK;
    if (format != FORMAT_PLY)
        axes_enu_to_gltf(g);
    if (is_quantised(format))
        rc = quant_from_gauss(g, form.sh_degree, quant_preset_grid((enum quant_preset)form.preset),
                              &q, e);
    if (rc != ERR_OK)
        return rc;
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
        rc = ply_encode(g, &info, out, e);
        break;
    case FORMAT_GLB_PLAIN:
        rc = glb_encode_plain(g, copyright, out, e);
        break;
    default:
        rc = err_set(e, ERR_INTERNAL, "encode: %s is not a tile format", target_ext(format));
    }
    quant_free(&q);
    return rc;
}

enum err_code encode_tile(struct store *s, struct key key, struct form form,
                          const struct look *look, struct buf *out, struct err *e)
{
    struct gauss g = {0};
    enum err_code rc = bake_read(s, key, look->set ? look->image : NULL, &g, e);
    if (rc == ERR_OK)
        rc = encode_gauss(&g, store_info(s), key, form, out, e);
    gauss_free(&g);
    return rc;
}

static enum err_code make_sample(const struct store_meta *meta, struct gauss *g, struct err *e)
{
    const size_t n = 300, k = 3 * gauss_sh_count(meta->sh_degree);
    enum err_code rc = gauss_alloc(g, n, meta->sh_degree, meta->embed_len, e);
    if (rc != ERR_OK)
        return rc;
    g->n = n;
    g->antialiased = meta->antialiased;
    for (size_t i = 0; i < n; i++) {
        for (size_t a = 0; a < 3; a++) {
            g->mean_m[3 * i + a] = (float)(100 * rng_unit(1, a, i) - 50);
            g->scale_log[3 * i + a] = (float)(3 * rng_unit(1, 3 + a, i) - 5);
        }
        for (size_t a = 0; a < 4; a++)
            g->quat_wxyz[4 * i + a] = (float)rng_normal(1, 6 + a, i);
        for (size_t a = 0; a < k; a++)
            g->sh[k * i + a] = (float)(0.3 * rng_normal(1, 10 + a, i));
        for (size_t a = 0; a < meta->embed_len; a++)
            g->embed[meta->embed_len * i + a] = (float)rng_normal(1, 100 + a, i);
        g->opacity_logit[i] = (float)rng_normal(1, 200, i);
    }
    return ERR_OK;
}

enum err_code encode_fingerprint(const struct store_meta *meta, struct hash128 *out, struct err *e)
{
    struct buf all = {0};
    enum err_code rc = ERR_OK;
    const int n_forms = (FORMAT_GLB_PLAIN + 1) * QUANT_PRESETS;
    for (int f = 0; f < n_forms && rc == ERR_OK; f++) {
        struct gauss g = {0};
        struct buf one = {0};
        const struct form form = {(enum format)(f / QUANT_PRESETS), (uint8_t)(f % QUANT_PRESETS),
                                  (uint8_t)meta->sh_degree};
        if (form.preset && !is_quantised(form.format))
            continue;
        rc = make_sample(meta, &g, e);
        if (rc == ERR_OK)
            rc = encode_gauss(&g, meta, (struct key){0}, form, &one, e);
        buf_add(&all, one.data, one.size);
        buf_free(&one);
        gauss_free(&g);
    }
    buf_printf(&all, "%s", CITYSPLAT_VERSION);
    if (rc == ERR_OK)
        rc = buf_check(&all, e);
    if (rc == ERR_OK)
        *out = hash_bytes(all.data, all.size);
    buf_free(&all);
    return rc;
}

/* ---- prefetch list ---- */

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

enum err_code encode_seed(const struct dataset *d, const struct target *t, struct form form,
                          const struct look *look, struct buf *out, struct err *e)
{
    char query[LOOK_QUERY_MAX];
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
    look_query(t, query);
    for (size_t i = 0; i < n; i++) {
        char etag[BODY_ETAG_SIZE];
        body_etag(encode_tile_id(d, pick[i], form, look), etag);
        etag[strlen(etag) - 1] = 0; /* without its quotes, which JSON would have to escape */
        buf_printf(out,
                   "{\"url\":\"r/%s/t/%u/%u/%u.%s%s\",\"etag\":\"\\\"%s\\\"\",\"gaussians\":%u}\n",
                   d->meta.revision, pick[i]->key.z, pick[i]->key.x, pick[i]->key.y,
                   target_ext(t->form.format), query, etag + 1, pick[i]->count);
    }
    mem_free(pick);
    return buf_check(out, e);
}

/* ---- jobs ---- */

static enum err_code make_tile(const struct work *w, struct buf *out, struct err *e)
{
    struct store *s = dataset_borrow(w->ds);
    if (!s)
        return err_set(e, ERR_INTERNAL, "dataset %s: fewer store handles than workers",
                       w->ds->path);
    enum err_code rc = encode_tile(s, w->key, w->form, &w->look, out, e);
    dataset_return(w->ds, s);
    return rc;
}

/* A tileset whose tiles are all asked for with the same query. */
static enum err_code make_tileset(const struct work *w, struct buf *out, struct err *e)
{
    char query[LOOK_QUERY_MAX], uri[LOOK_QUERY_MAX + 64];
    look_query(&w->target, query);
    if (w->target.route == ROUTE_TILESET)
        snprintf(uri, sizeof(uri), "t/{z}/{x}/{y}.glb%s", query);
    else
        snprintf(uri, sizeof(uri), "r/%s/t/{z}/{x}/{y}.glb%s", w->ds->meta.revision, query);
    return tileset_write(w->ds->index, uri, out, e);
}

static enum err_code make_bytes(struct services *s, const struct job *j, const struct work *w,
                                struct buf *out, struct err *e)
{
    switch (w->kind) {
    case WORK_VIEW:
        return picture_make(s->picture, j, w, out, e);
    case WORK_SEED:
        return encode_seed(w->ds, &w->target, w->form, &w->look, out, e);
    case WORK_TILESET:
        return make_tileset(w, out, e);
    default:
        return make_tile(w, out, e);
    }
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
    enum err_code rc = make_bytes(s, j, w, &b, e);
    if (rc == ERR_OK)
        rc = buf_check(&b, e);
    if (rc == ERR_OK) {
        body_etag(w->id, etag);
        *out = body_take(&b, etag);
        if (!*out)
            rc = err_set(e, ERR_MEM, "out of memory for the encoded bytes");
    }
    if (rc == ERR_OK && w->kind == WORK_TILESET)
        body_compress(*out);
    if (rc == ERR_OK && w->keep)
        cache_put(s->cache, w->id, *out);
    if (rc != ERR_OK && rc != ERR_CANCEL) {
        atomic_fetch_add(&s->metrics.store_errors, w->kind == WORK_TILE);
        log_error("serve", "job failed ds=%s %s %u/%u/%u.%s: %s", w->ds->meta.name,
                  w->kind == WORK_VIEW ? "view" : "tile", w->key.z, w->key.x, w->key.y,
                  target_ext(w->form.format), e->msg);
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
