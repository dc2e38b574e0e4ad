/* Encodes a tile of Gaussians. .glb, .spz and .drc are in glTF axes about the tile's centre (the
 * tileset's transforms put it in place). .sog is in the axes of PlayCanvas' tools, half a turn
 * about x from those. .ply, compressed or not, stays in east-north-up, with its origin in comments.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/encode.h"

#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "codec/splat/axes.h"
#include "codec/splat/draco.h"
#include "codec/splat/glb.h"
#include "codec/splat/part.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/spz.h"
#include "core/splat/gauss.h"
#include "lod/export/lowpass.h"
#include "lod/store/bake.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

enum {
    ENCODE_EMBED_BITS = 3
}; /* left out at most where the client computes colours from embeddings */

static bool encode_is_quantised(enum format f)
{
    return f == FORMAT_GLB || f == FORMAT_GLB_LOWPASS || f == FORMAT_SPZ || f == FORMAT_DRC;
}

struct form encode_form(const struct server_config *cfg, const struct store_meta *meta,
                        const struct form *asked)
{
    struct form f = {.format = asked->format};
    if (f.format == FORMAT_DRC)
        f.part = asked->part;
    if (encode_is_quantised(f.format))
        f.preset = asked->preset < QUANT_PRESETS ? asked->preset : (uint8_t)cfg->preset;
    if (encode_is_quantised(f.format) || f.format == FORMAT_SOG || f.format == FORMAT_PLY_PACKED)
        f.sh_degree =
            asked->sh_degree < meta->sh_degree ? asked->sh_degree : (uint8_t)meta->sh_degree;
    return f;
}

struct form encode_form_of(enum format f)
{
    return (struct form){.format = f, .preset = QUANT_PRESETS, .sh_degree = FORM_UNSAID};
}

struct form encode_draft(void)
{
    return (struct form){.format = FORMAT_DRC, .preset = QUANT_PREVIEW, .sh_degree = 0};
}

/* g (changed) to bytes of a form. pixel_m: of the low-pass form. */
static enum err_code encode_gauss(struct gauss *g, const struct store_meta *meta, struct key key,
                                  struct form form, double pixel_m, struct buf *out, struct err *e)
{
    const enum format format = form.format;
    const char *copyright = meta->attribution[0] ? meta->attribution : NULL;
    const struct ply_info info = {.has_origin = true, .origin = meta->origin};
    struct quant_grid grid = *quant_preset_grid((enum quant_preset)form.preset);
    struct quant q = {0};
    char name[48];
    enum err_code rc = ERR_OK;
    if (form.trained && grid.embed > ENCODE_EMBED_BITS)
        grid.embed = ENCODE_EMBED_BITS;
    if (format == FORMAT_GLB_LOWPASS)
        lowpass_gauss(g, pixel_m);
    if (format != FORMAT_PLY && format != FORMAT_PLY_PACKED)
        axes_enu_to_gltf(g);
    if (encode_is_quantised(format))
        rc = quant_from_gauss(g, form.sh_degree, &grid, &q, e);
    if (!rc && form.part) {
        struct quant part;
        rc = part_take(&q, form.part, &part, e);
        quant_free(&q);
        q = part;
    }
    if (rc)
        return rc;
    switch (format) {
    case FORMAT_GLB:
    case FORMAT_GLB_LOWPASS:
        rc = glb_encode_spz(&q, copyright, out, e);
        break;
    case FORMAT_SPZ:
        rc = spz_encode(&q, 3, out, e);
        break;
    case FORMAT_DRC:
        snprintf(name, sizeof name, "%u/%u/%u", key.z, key.x, key.y);
        rc = draco_encode(&q, name, out, e);
        break;
    case FORMAT_PLY:
        rc = ply_encode(g, &info, out, e);
        break;
    case FORMAT_PLY_PACKED:
        rc = ply_packed_encode(g, form.sh_degree, &info, out, e);
        break;
    case FORMAT_GLB_PLAIN:
        rc = glb_encode_plain(g, copyright, out, e);
        break;
    case FORMAT_SOG:
        rc = sog_encode(g, form.sh_degree, out, e);
        break;
    default:
        rc = err_set(e, ERR_INTERNAL, "encode: %s is not a tile format", format_ext(format));
    }
    quant_free(&q);
    return rc;
}

static double encode_pixel_m(const struct store *s, struct key key)
{
    const struct store_tile *tile = store_find(s, key);
    size_t n;
    return tile ? lowpass_pixel_m(store_tree(s), (uint32_t)(tile - store_tiles(s, &n))) : 0.0;
}

enum err_code encode_tile(struct store *s, struct key key, struct form form, const float *image,
                          const struct clip *clip, struct buf *out, struct err *e)
{
    struct gauss g = {0};
    enum err_code rc =
        form.trained ? store_read_gauss(s, key, &g, e) : bake_read(s, key, image, &g, e);
    if (!rc && clip)
        rc = clip_rows(clip, &store_info(s)->origin, &g, e);
    if (!rc && clip && !g.n)
        rc = err_set(e, ERR_NOENT, "no Gaussians of this tile lie within clip");
    if (!rc)
        rc = encode_gauss(&g, store_info(s), key, form, encode_pixel_m(s, key), out, e);
    gauss_free(&g);
    return rc;
}

enum err_code encode_city(struct store *s, struct form form, const float *image,
                          const struct clip *clip, struct buf *out, struct err *e)
{
    struct gauss g = {0}, sorted = {0};
    const bool sorts = form.format == FORMAT_SOG || form.format == FORMAT_PLY_PACKED;
    enum err_code rc = bake_read_cut(s, store_info(s)->zoom_max, image, NULL, &g, e);
    if (!rc && clip)
        rc = clip_rows(clip, &store_info(s)->origin, &g, e);
    if (!rc && !g.n)
        rc = err_set(e, ERR_NOENT, "no Gaussians of this city lie within clip");
    if (!rc && sorts) /* in a texture, neighbours should be so in space */
        rc = gauss_sorted(&g, &sorted, e);
    if (!rc)
        rc = encode_gauss(sorts ? &sorted : &g, store_info(s), (struct key){0}, form, 0.0, out, e);
    gauss_free(&sorted);
    gauss_free(&g);
    return rc;
}

uint64_t encode_city_count(const struct store *s)
{
    const struct tree *tree = store_tree(s);
    uint64_t count = 0;
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    for (size_t i = 0; i < n; i++)
        count += tree_leaf(tree, i) ? t[i].count : 0;
    return count;
}

uint64_t encode_bytes(const struct store_meta *meta, struct form form, uint32_t count)
{
    /* Bytes a Gaussian, SH 0 to 3, as the tables of docs/formats.md have them; of .drc, and what
     * .spz (and .glb around it) takes more, mostly for positions. */
    static const double drc[QUANT_PRESETS][4] = {[QUANT_SPZ] = {9.5, 10.3, 11.5, 13.3},
                                                 [QUANT_PREVIEW] = {5.2, 5.4, 5.9, 6.6},
                                                 [QUANT_BALANCED] = {8.2, 8.4, 9.1, 9.3},
                                                 [QUANT_NEAR_LOSSLESS] = {11, 12.6, 15, 18}},
                        spz[QUANT_PRESETS] = {[QUANT_SPZ] = 4,
                                              [QUANT_PREVIEW] = 2.9,
                                              [QUANT_BALANCED] = 4.4,
                                              [QUANT_NEAR_LOSSLESS] = 6.4},
                        embedding[QUANT_PRESETS] = {[QUANT_SPZ] = 12.6,
                                                    [QUANT_PREVIEW] = 3.4,
                                                    [QUANT_BALANCED] = 5,
                                                    [QUANT_NEAR_LOSSLESS] = 8.7},
                        sog[4] = {12.5, 14.6, 15.3, 16.3};
    const uint32_t sh = form.sh_degree <= 3 ? form.sh_degree : 3, all = meta->sh_degree;
    const unsigned preset = form.preset < QUANT_PRESETS ? form.preset : (unsigned)QUANT_BALANCED;
    double each = 0, head = 1200;
    switch (form.format) {
    case FORMAT_GLB:
    case FORMAT_GLB_LOWPASS:
    case FORMAT_SPZ:
        each = drc[preset][sh] + spz[preset];
        break;
    case FORMAT_DRC:
        each = drc[preset][sh] + (form.trained ? embedding[preset] * meta->embed_len / 16 : 0);
        break;
    case FORMAT_SOG:
        each = sog[sh];
        break;
    case FORMAT_PLY:
        each = 4.0 * (double)(14 + 3 * gauss_sh_count(all));
        break;
    case FORMAT_PLY_PACKED: /* and ranges of each 256 */
        each = 16 + 3 * (double)(gauss_sh_count(sh) - 1) + 72.0 / 256;
        break;
    default: /* plain.glb: place, rotation, scale, opacity, colour for those who show points */
        each = 4.0 * (double)(15 + 3 * gauss_sh_count(all));
    }
    return (uint64_t)(head + each * count);
}

uint64_t encode_city_bytes(const struct store *s, enum format f)
{
    const struct store_meta *m = store_info(s);
    struct form form = encode_form_of(f);
    form.sh_degree = (uint8_t)m->sh_degree;
    return encode_bytes(m, form, (uint32_t)encode_city_count(s));
}

static enum err_code encode_make_sample(const struct store_meta *meta, struct gauss *g,
                                        struct err *e)
{
    const size_t n = 300, k = 3 * gauss_sh_count(meta->sh_degree);
    enum err_code rc = gauss_alloc(g, n, meta->sh_degree, meta->embed_len, e);
    if (rc)
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

/* Of the encoder alone: it takes 20 ms, and a thousand stores ask for the same. */
static enum err_code encode_sample_hash(const struct store_meta *meta, struct hash128 *out,
                                        struct err *e)
{
    struct buf all = {0};
    enum err_code rc = ERR_OK;
    const int n_forms = (FORMAT_SOG + 1) * QUANT_PRESETS;
    const int n_passes = meta->embed_len ? 2 : 1; /* baked, as trained */
    for (int k = 0; k < n_passes * n_forms && !rc; k++) {
        const int f = k % n_forms;
        struct gauss g = {0};
        struct buf one = {0};
        const struct form form = {(enum format)(f / QUANT_PRESETS), (uint8_t)(f % QUANT_PRESETS),
                                  (uint8_t)meta->sh_degree, 0, k >= n_forms};
        if (form.preset && !encode_is_quantised(form.format))
            continue;
        rc = encode_make_sample(meta, &g, e);
        if (!rc)
            rc = encode_gauss(&g, meta, (struct key){0}, form, 0.1, &one, e);
        buf_add(&all, one.data, one.size);
        buf_free(&one);
        gauss_free(&g);
    }
    buf_printf(&all, "%s", CITYSPLAT_VERSION);
    if (!rc)
        rc = buf_check(&all, e);
    if (!rc)
        *out = hash_bytes(all.data, all.size);
    buf_free(&all);
    return rc;
}

enum err_code encode_fingerprint(const struct store_meta *meta, struct hash128 *out, struct err *e)
{
    enum { KNOWN = 8 };
    static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
    static struct {
        struct store_meta of; /* what makes another sample: degree, embedding, anti-aliasing */
        struct hash128 hash;
    } known[KNOWN]; /* by lock */
    static size_t n;
    const struct store_meta of = {.sh_degree = meta->sh_degree,
                                  .embed_len = meta->embed_len,
                                  .antialiased = meta->antialiased};
    struct {
        struct hash128 sample, attribution;
        struct geo_origin origin;
    } all = {.attribution = hash_bytes(meta->attribution, strlen(meta->attribution)),
             .origin = meta->origin};
    enum err_code rc = ERR_OK;
    size_t i = 0;
    pthread_mutex_lock(&lock);
    while (i < n &&
           (known[i].of.sh_degree != of.sh_degree || known[i].of.embed_len != of.embed_len ||
            known[i].of.antialiased != of.antialiased))
        i++;
    if (i < n)
        all.sample = known[i].hash;
    else
        rc = encode_sample_hash(&of, &all.sample, e);
    if (!rc && i == n && n < KNOWN) {
        known[n].of = of;
        known[n++].hash = all.sample;
    }
    pthread_mutex_unlock(&lock);
    if (!rc)
        *out = hash_bytes(&all, sizeof all);
    return rc;
}
