/* Reading SOG, versions 1 and 2: see sog.c for the layout of the latter. Version 1 has no code
 * books: values lie evenly between "mins" and "maxs", and opacity is a logit. Every texture's size
 * is checked against the number of Gaussians before it is decoded.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/sog.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/archive.h"
#include "codec/image/webp.h"
#include "codec/limits.h"
#include "codec/splat/cluster.h"
#include "codec/splat/sog_layout.h"

enum { SOG_META_MOST = 1 << 20, SOG_EDGE_SPARE_PX = 1 << 16, SOG_CHANNELS = 4 };

struct sog_reader {
    struct archive_reader *zip; /* NULL: files of a folder */
    const char *dir;
    bool first; /* version 1: values lie evenly between a least and a largest one */
    json_t *meta;
    size_t n;
    uint32_t sh_degree;
    struct gauss *g;
};

struct sog_texture {
    uint8_t *px;
    uint32_t width_px, height_px;
};

/* The bytes of a file beside meta.json. */
static enum err_code sog_file(const struct sog_reader *r, const char *name, size_t most,
                              struct buf *out, struct err *e)
{
    char path[FILE_PATH_MAX];
    if (r->zip)
        return archive_get(r->zip, name, most, out, e);
    if (strchr(name, '/') || !strcmp(name, ".."))
        return err_set(e, ERR_FORMAT, "a name with a folder");
    enum err_code rc = file_join(path, r->dir, name, e);
    return rc ? rc : file_read(path, most, out, e);
}

/* Texels of a texture for n values: it may be wider or higher than they need. */
static size_t sog_most_px(size_t n)
{
    return 4 * n + SOG_EDGE_SPARE_PX;
}

/* The k-th file of a member of meta.json; `least` to `most_px` texels. */
static enum err_code sog_load(struct sog_reader *r, const char *key, size_t k, size_t least,
                              size_t most_px, struct sog_texture *out, struct err *e)
{
    const json_t *files = json_object_get(json_object_get(r->meta, key), "files");
    const char *name = json_string_value(json_array_get(files, k));
    struct buf b = {0};
    if (!name)
        return err_set(e, ERR_FORMAT, "sog: %s has no file %zu", key, k);
    enum err_code rc = sog_file(r, name, 8 * most_px, &b, e);
    if (!rc)
        rc = webp_decode(b.data, b.size, most_px, &out->px, &out->width_px, &out->height_px, e);
    if (!rc && (size_t)out->width_px * out->height_px < least)
        rc = err_set(e, ERR_FORMAT, "%u x %u px: too few for %zu", out->width_px, out->height_px,
                     least);
    if (rc) {
        err_add(e, "sog: %s", name);
        mem_free(out->px);
        out->px = NULL;
    }
    buf_free(&b);
    return rc;
}

/* One number, as version 1 has it for harmonics, is the value of all. */
static enum err_code sog_numbers(const struct sog_reader *r, const char *key, const char *member,
                                 size_t n, float *out, struct err *e)
{
    const json_t *list = json_object_get(json_object_get(r->meta, key), member);
    const bool one = json_is_number(list);
    const size_t there = one ? 1 : json_array_size(list);
    if (!there || there > n)
        return err_set(e, ERR_FORMAT, "sog: %s.%s: %zu numbers: 1 to %zu are expected", key, member,
                       there, n);
    for (size_t i = 0; i < n; i++) {
        const json_t *v = one ? list : json_array_get(list, i < there ? i : there - 1);
        const float x = (float)json_number_value(v);
        if (!json_is_number(v) || !isfinite(x))
            return err_set(e, ERR_FORMAT, "sog: %s.%s[%zu] is no number", key, member, i);
        out[i] = x;
    }
    return ERR_OK;
}

/* What a byte of channel c means: book[c * CLUSTER_BOOK + byte]. Version 2 has one list for all. */
static enum err_code sog_book_read(const struct sog_reader *r, const char *key, size_t channels,
                                   float *book, struct err *e)
{
    float lo[SOG_CHANNELS], hi[SOG_CHANNELS];
    enum err_code rc = r->first ? sog_numbers(r, key, "mins", channels, lo, e)
                                : sog_numbers(r, key, "codebook", CLUSTER_BOOK, book, e);
    if (!rc && r->first)
        rc = sog_numbers(r, key, "maxs", channels, hi, e);
    for (size_t i = 0; !rc && i < channels * CLUSTER_BOOK; i++) {
        const size_t c = i / CLUSTER_BOOK;
        const float t = (float)(i % CLUSTER_BOOK) / (CLUSTER_BOOK - 1);
        book[i] = r->first ? lo[c] + t * (hi[c] - lo[c]) : book[i % CLUSTER_BOOK];
    }
    return rc;
}

/* The first texture that is there says that the count is no lie: only then there is room for
 * rows. */
static enum err_code sog_get_means(struct sog_reader *r, struct err *e)
{
    struct sog_texture low = {0}, high = {0};
    float lo[3], hi[3];
    enum err_code rc = sog_numbers(r, "means", "mins", 3, lo, e);
    if (!rc)
        rc = sog_numbers(r, "means", "maxs", 3, hi, e);
    if (!rc)
        rc = sog_load(r, "means", 0, r->n, sog_most_px(r->n), &low, e);
    if (!rc)
        rc = sog_load(r, "means", 1, r->n, sog_most_px(r->n), &high, e);
    if (!rc)
        rc = gauss_alloc(r->g, r->n, r->sh_degree, 0, e);
    for (size_t i = 0; !rc && i < 3 * r->n; i++) {
        const size_t c = i % 3, at = 4 * (i / 3) + c;
        double t = (low.px[at] | high.px[at] << 8) / (double)SOG_MEAN_STEPS;
        double v = (double)lo[c] + t * ((double)hi[c] - (double)lo[c]);
        r->g->mean_m[i] = sog_flip[c] * (float)copysign(expm1(fabs(v)), v);
    }
    mem_free(low.px);
    mem_free(high.px);
    return rc;
}

static enum err_code sog_get_quats(struct sog_reader *r, struct err *e)
{
    struct sog_texture t = {0};
    enum err_code rc = sog_load(r, "quats", 0, r->n, sog_most_px(r->n), &t, e);
    for (size_t i = 0; !rc && i < r->n; i++) {
        const uint8_t *texel = t.px + 4 * i;
        const int largest = texel[3] - SOG_QUAT_TAG;
        float *q = r->g->quat_wxyz + 4 * i, sum = 0;
        if (largest < 0) {
            rc = err_set(e, ERR_FORMAT, "sog: quats: row %zu: %u is no component", i, texel[3]);
            break;
        }
        for (int c = 0; c < 4; c++)
            if (c != largest) {
                float v = ((float)*texel++ / 255 - 0.5f) * (float)M_SQRT2;
                q[c] = sog_flip_quat[c] * v;
                sum += v * v;
            }
        q[largest] = sog_flip_quat[largest] * sqrtf(sum < 1 ? 1 - sum : 0);
    }
    mem_free(t.px);
    return rc;
}

static enum err_code sog_get_scales(struct sog_reader *r, struct err *e)
{
    struct sog_texture t = {0};
    float book[3 * CLUSTER_BOOK];
    enum err_code rc = sog_book_read(r, "scales", 3, book, e);
    if (!rc)
        rc = sog_load(r, "scales", 0, r->n, sog_most_px(r->n), &t, e);
    for (size_t i = 0; !rc && i < 3 * r->n; i++)
        r->g->scale_log[i] = book[i % 3 * CLUSTER_BOOK + t.px[4 * (i / 3) + i % 3]];
    mem_free(t.px);
    return rc;
}

static enum err_code sog_get_color(struct sog_reader *r, struct err *e)
{
    const size_t k = 3 * gauss_sh_count(r->g->sh_degree);
    struct sog_texture t = {0};
    float book[SOG_CHANNELS * CLUSTER_BOOK];
    enum err_code rc = sog_book_read(r, "sh0", SOG_CHANNELS, book, e);
    if (!rc)
        rc = sog_load(r, "sh0", 0, r->n, sog_most_px(r->n), &t, e);
    for (size_t i = 0; !rc && i < r->n; i++) {
        float a = (float)t.px[4 * i + 3];
        a = a < 0.25f ? 0.25f : a > 254.75f ? 254.75f : a; /* finite logits */
        r->g->opacity_logit[i] =
            r->first ? book[3 * CLUSTER_BOOK + t.px[4 * i + 3]] : logf(a / (255 - a));
        for (size_t c = 0; c < 3; c++)
            r->g->sh[k * i + c] = book[c * CLUSTER_BOOK + t.px[4 * i + c]];
    }
    mem_free(t.px);
    return rc;
}

static enum err_code sog_get_harmonics(struct sog_reader *r, size_t n_palette, struct err *e)
{
    const size_t coefs = gauss_sh_count(r->g->sh_degree) - 1, k = 3 * (coefs + 1);
    const size_t rows = (n_palette + SOG_PALETTE_COLUMNS - 1) / SOG_PALETTE_COLUMNS;
    const size_t texels = rows * SOG_PALETTE_COLUMNS * coefs;
    struct sog_texture palette = {0}, label = {0};
    float book[CLUSTER_BOOK];
    enum err_code rc = sog_book_read(r, "shN", 1, book, e);
    if (!rc)
        rc = sog_load(r, "shN", 0, texels, sog_most_px(texels), &palette, e);
    if (!rc && palette.width_px != SOG_PALETTE_COLUMNS * coefs)
        rc = err_set(e, ERR_FORMAT, "sog: shN: the palette is %u px wide, not %zu",
                     palette.width_px, SOG_PALETTE_COLUMNS * coefs);
    if (!rc)
        rc = sog_load(r, "shN", 1, r->n, sog_most_px(r->n), &label, e);
    for (size_t i = 0; !rc && i < r->n; i++) {
        const size_t row = label.px[4 * i] | (size_t)label.px[4 * i + 1] << 8;
        if (row >= n_palette) {
            rc = err_set(e, ERR_FORMAT, "sog: shN: row %zu: label %zu of %zu", i, row, n_palette);
            break;
        }
        for (size_t c = 0; c < 3 * coefs; c++)
            r->g->sh[k * i + 3 + c] =
                sog_flip_sh[c / 3] * book[palette.px[4 * (row * coefs + c / 3) + c % 3]];
    }
    mem_free(palette.px);
    mem_free(label.px);
    return rc;
}

static json_int_t sog_shape(const json_t *member, size_t k)
{
    return json_integer_value(json_array_get(json_object_get(member, "shape"), k));
}

/* Version 1 says neither bands nor rows of the palette: its texture's size does. The shape has the
 * number of values of a Gaussian, or that of one channel. */
static enum err_code sog_head_1(struct sog_reader *r, const json_t *sh, json_int_t *bands,
                                json_int_t *palette, struct err *e)
{
    struct sog_texture t = {0};
    const json_int_t each = sog_shape(sh, 1);
    const size_t coefs = (size_t)(each == 9 || each == 24 || each == 45 ? each / 3 : each);
    enum err_code rc =
        coefs == 3 || coefs == 8 || coefs == 15
            ? sog_load(r, "shN", 0, SOG_PALETTE_COLUMNS * coefs, SOG_PALETTE_MOST * coefs, &t, e)
            : err_set(e, ERR_FORMAT, "sog: shN: %lld values of a Gaussian", (long long)each);
    *bands = coefs == 3 ? 1 : coefs == 8 ? 2 : 3;
    *palette = rc ? 0 : (json_int_t)t.height_px * SOG_PALETTE_COLUMNS;
    mem_free(t.px);
    return rc;
}

/* meta.json: how many rows, and how large the palette is (0: none). */
static enum err_code sog_head(struct sog_reader *r, const struct codec_limits *lim,
                              size_t *n_palette, struct err *e)
{
    struct buf b = {0};
    const size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    enum err_code rc = sog_file(r, "meta.json", SOG_META_MOST, &b, e);
    if (!rc)
        rc = jsonc_parse((const char *)b.data, b.size, "meta.json", &r->meta, e);
    buf_free(&b);
    if (rc)
        return rc;
    const json_t *version = json_object_get(r->meta, "version");
    const json_t *sh = json_object_get(r->meta, "shN");
    json_int_t n = json_integer_value(json_object_get(r->meta, "count"));
    json_int_t bands = sh ? json_integer_value(json_object_get(sh, "bands")) : 0;
    json_int_t palette = sh ? json_integer_value(json_object_get(sh, "count")) : 0;
    if (version && json_integer_value(version) != 2)
        return err_set(e, ERR_FORMAT, "sog: version %lld: 1 and 2 are read",
                       (long long)json_integer_value(version));
    if (!version) { /* what has no version is the first, whose arrays have shapes */
        r->first = true;
        n = sog_shape(json_object_get(r->meta, "means"), 0);
        if (sh && (rc = sog_head_1(r, sh, &bands, &palette, e)) != ERR_OK)
            return rc;
    }
    if (n < 1 || (uint64_t)n > most)
        return err_set(e, n < 1 ? ERR_FORMAT : ERR_LIMIT, "sog: %lld Gaussians: 1 to %zu are read",
                       (long long)n, most);
    if (sh &&
        (bands < 1 || bands > GAUSS_SH_DEGREE_MAX || palette < 1 || palette > SOG_PALETTE_MOST))
        return err_set(e, ERR_FORMAT, "sog: shN: %lld bands, %lld rows: 1 to 3, 1 to %d",
                       (long long)bands, (long long)palette, SOG_PALETTE_MOST);
    *n_palette = (size_t)palette;
    r->n = (size_t)n;
    r->sh_degree = (uint32_t)bands;
    return ERR_OK;
}

/* What an archive or a folder has. */
static enum err_code sog_read_all(struct sog_reader *r, const struct codec_limits *lim,
                                  struct err *e)
{
    size_t n_palette = 0;
    enum err_code rc = sog_head(r, lim, &n_palette, e);
    if (!rc)
        rc = sog_get_means(r, e);
    if (!rc)
        rc = sog_get_quats(r, e);
    if (!rc)
        rc = sog_get_scales(r, e);
    if (!rc)
        rc = sog_get_color(r, e);
    if (!rc && n_palette)
        rc = sog_get_harmonics(r, n_palette, e);
    if (!rc) {
        r->g->n = r->n;
        r->g->antialiased = json_is_true(json_object_get(r->meta, "antialias"));
        rc = gauss_keep_good(r->g, "sog", e);
    }
    if (rc)
        gauss_free(r->g);
    json_decref(r->meta);
    return rc;
}

enum err_code sog_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e)
{
    struct sog_reader r = {.g = out};
    *out = (struct gauss){0};
    enum err_code rc = archive_open(bytes, n, &r.zip, e);
    if (!rc)
        rc = sog_read_all(&r, lim, e);
    archive_close(&r.zip);
    return rc;
}

enum err_code sog_read(const char *path, const struct codec_limits *lim, struct gauss *out,
                       struct err *e)
{
    char dir[FILE_PATH_MAX];
    const char *slash = strrchr(path, '/');
    struct sog_reader r = {.g = out, .dir = dir};
    *out = (struct gauss){0};
    if (snprintf(dir, sizeof dir, "%.*s", slash ? (int)(slash - path) + 1 : 1,
                 slash ? path : ".") >= (int)sizeof dir)
        return err_set(e, ERR_LIMIT, "%.80s...: the path is too long", path);
    return sog_read_all(&r, lim, e);
}
