/* Writes SOG, version 2: meta.json, and these textures with one texel a Gaussian.
 *
 *     means_l, means_u   low and high byte of 65535 (L(p) - min) / (max - min),
 *                        L(p) = sign(p) ln(1 + |p|)
 *     quats              the three smaller of w x y z, (c sqrt(2) + 1) / 2 * 255;
 *                        alpha 252 + index of the largest
 *     scales             index of ln sigma in a codebook of 256
 *     sh0                index of the DC in a codebook of 256; alpha the opacity
 *     shN_labels         number (low byte, high byte) of a row of the palette
 *     shN_centroids      64 rows of the palette side by side, a texel a coefficient,
 *                        indices of a codebook
 *
 * Rows keep their order. Textures are smaller when the order is that of a Hilbert curve, because
 * neighbours look alike. Source: github.com/playcanvas/splat-transform.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/sog.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

#include "codec/container/archive.h"
#include "codec/image/webp.h"
#include "codec/splat/cluster.h"
#include "codec/splat/sog_layout.h"

enum {
    SOG_ROWS_A_GROUP = 16, /* Gaussians that share a row of the palette, in the mean */
    SOG_PARTS = 8,
};

struct sog_writer {
    const struct gauss *g;
    uint32_t width_px, height_px;
    uint8_t *px; /* [height][width][4], of the texture at hand */
    json_t *meta;
    struct archive_part part[SOG_PARTS];
    size_t n_parts;
};

static const char *const sog_names[SOG_PARTS] = {
    "meta.json",   "means_l.webp", "means_u.webp",       "quats.webp",
    "scales.webp", "sh0.webp",     "shN_centroids.webp", "shN_labels.webp"};

/* px becomes the archive's part `which`. */
static enum err_code sog_put(struct sog_writer *w, size_t which, const uint8_t *px,
                             uint32_t width_px, uint32_t height_px, struct err *e)
{
    struct archive_part *part = &w->part[w->n_parts++];
    part->name = sog_names[which];
    return webp_encode_exact(px, width_px, height_px, &part->bytes, e);
}

static void sog_clear(struct sog_writer *w)
{
    const size_t n = (size_t)w->width_px * w->height_px;
    memset(w->px, 0, 4 * n);
    for (size_t i = 0; i < n; i++)
        w->px[4 * i + 3] = 255;
}

static double sog_log(float p)
{
    return copysign(log1p(fabs((double)p)), (double)p);
}

static enum err_code sog_put_means(struct sog_writer *w, struct err *e)
{
    const struct gauss *g = w->g;
    double lo[3], hi[3];
    enum err_code rc = ERR_OK;
    for (int c = 0; c < 3; c++) {
        lo[c] = (double)INFINITY;
        hi[c] = -(double)INFINITY;
        for (size_t i = 0; i < g->n; i++) {
            double v = sog_log(sog_flip[c] * g->mean_m[3 * i + c]);
            lo[c] = fmin(lo[c], v);
            hi[c] = fmax(hi[c], v);
        }
    }
    json_object_set_new(w->meta, "means",
                        json_pack("{s:[f,f,f],s:[f,f,f],s:[s,s]}", "mins", lo[0], lo[1], lo[2],
                                  "maxs", hi[0], hi[1], hi[2], "files", sog_names[1],
                                  sog_names[2]));
    for (size_t half = 0; !rc && half < 2; half++) {
        sog_clear(w);
        for (size_t i = 0; i < 3 * g->n; i++) {
            const size_t c = i % 3;
            double t =
                hi[c] > lo[c] ? (sog_log(sog_flip[c] * g->mean_m[i]) - lo[c]) / (hi[c] - lo[c]) : 0;
            unsigned v = (unsigned)lround(SOG_MEAN_STEPS * t);
            w->px[4 * (i / 3) + c] = (uint8_t)(v >> 8 * half);
        }
        rc = sog_put(w, 1 + half, w->px, w->width_px, w->height_px, e);
    }
    return rc;
}

static enum err_code sog_put_quats(struct sog_writer *w, struct err *e)
{
    const struct gauss *g = w->g;
    sog_clear(w);
    for (size_t i = 0; i < g->n; i++) {
        double q[4], norm = 0;
        int largest = 0;
        uint8_t *texel = w->px + 4 * i;
        for (int c = 0; c < 4; c++) {
            q[c] = (double)(sog_flip_quat[c] * g->quat_wxyz[4 * i + c]);
            norm += q[c] * q[c];
            if (fabs(q[c]) > fabs(q[largest]))
                largest = c;
        }
        norm = copysign(sqrt(norm), q[largest]);
        for (int c = 0; c < 4; c++)
            if (c != largest)
                *texel++ = (uint8_t)lround(255 * (q[c] / norm * M_SQRT1_2 + 0.5));
        *texel = (uint8_t)(SOG_QUAT_TAG + largest);
    }
    json_object_set_new(w->meta, "quats", json_pack("{s:[s]}", "files", sog_names[3]));
    return sog_put(w, 3, w->px, w->width_px, w->height_px, e);
}

static json_t *sog_book(const float book[CLUSTER_BOOK])
{
    json_t *list = json_array();
    for (size_t k = 0; k < CLUSTER_BOOK; k++)
        json_array_append_new(list, json_real((double)book[k]));
    return list;
}

/* Three values a Gaussian as indices; with_alpha: alpha is the opacity. */
static enum err_code sog_put_indexed(struct sog_writer *w, const char *key, size_t which,
                                     const float *v, bool with_alpha, struct err *e)
{
    const struct gauss *g = w->g;
    float book[CLUSTER_BOOK];
    uint8_t *index = mem_uninit(g->n, 3);
    enum err_code rc = index ? cluster_values(v, 3 * g->n, book, index, e)
                             : err_set(e, ERR_MEM, "sog: out of memory");
    if (!rc) {
        sog_clear(w);
        for (size_t i = 0; i < g->n; i++) {
            memcpy(w->px + 4 * i, index + 3 * i, 3);
            if (with_alpha)
                w->px[4 * i + 3] = (uint8_t)lround(255 / (1 + exp(-(double)g->opacity_logit[i])));
        }
        json_object_set_new(
            w->meta, key,
            json_pack("{s:o,s:[s]}", "codebook", sog_book(book), "files", sog_names[which]));
        rc = sog_put(w, which, w->px, w->width_px, w->height_px, e);
    }
    mem_free(index);
    return rc;
}

static enum err_code sog_put_color(struct sog_writer *w, struct err *e)
{
    const struct gauss *g = w->g;
    const size_t k = 3 * gauss_sh_count(g->sh_degree);
    float *dc = mem_uninit(g->n, 3 * sizeof *dc);
    if (!dc)
        return err_set(e, ERR_MEM, "sog: out of memory");
    for (size_t i = 0; i < g->n; i++)
        memcpy(dc + 3 * i, g->sh + k * i, 3 * sizeof *dc);
    enum err_code rc = sog_put_indexed(w, "sh0", 5, dc, true, e);
    mem_free(dc);
    return rc;
}

/* ---- harmonics ---- */

struct sog_palette {
    size_t bands, coefs, most, n; /* coefs: of all bands, of one channel */
    float *rows;                  /* [g->n][coefs][3] */
    float *mean;                  /* [most][coefs][3] */
    uint16_t *label;              /* [g->n] */
    uint8_t *index, *px;          /* of mean, and as a texture */
};

static enum err_code sog_palette_find(const struct gauss *g, struct sog_palette *p, struct err *e)
{
    const size_t d = 3 * p->coefs, k = 3 * gauss_sh_count(g->sh_degree);
    p->rows = mem_uninit(g->n, d * sizeof *p->rows);
    p->mean = mem_uninit(p->most, d * sizeof *p->mean);
    p->label = mem_uninit(g->n, sizeof *p->label);
    p->index = mem_uninit(p->most, d);
    if (!p->rows || !p->mean || !p->label || !p->index)
        return err_set(e, ERR_MEM, "sog: out of memory");
    for (size_t i = 0; i < g->n; i++)
        for (size_t c = 0; c < d; c++)
            p->rows[d * i + c] = sog_flip_sh[c / 3] * g->sh[k * i + 3 + c];
    return cluster_rows(p->rows, g->n, d, p->most, p->mean, p->label, &p->n, e);
}

static enum err_code sog_put_palette(struct sog_writer *w, struct sog_palette *p, struct err *e)
{
    const uint32_t columns = (uint32_t)(SOG_PALETTE_COLUMNS * p->coefs);
    const uint32_t rows = (uint32_t)((p->n + SOG_PALETTE_COLUMNS - 1) / SOG_PALETTE_COLUMNS);
    float book[CLUSTER_BOOK];
    enum err_code rc = cluster_values(p->mean, p->n * 3 * p->coefs, book, p->index, e);
    if (!rc && !(p->px = mem_array((size_t)columns * rows, 4)))
        rc = err_set(e, ERR_MEM, "sog: out of memory");
    if (rc)
        return rc;
    for (size_t t = 0; t < (size_t)columns * rows; t++) {
        if (t < p->n * p->coefs)
            memcpy(p->px + 4 * t, p->index + 3 * t, 3);
        p->px[4 * t + 3] = 255;
    }
    json_object_set_new(w->meta, "shN",
                        json_pack("{s:I,s:I,s:o,s:[s,s]}", "count", (json_int_t)p->n, "bands",
                                  (json_int_t)p->bands, "codebook", sog_book(book), "files",
                                  sog_names[6], sog_names[7]));
    return sog_put(w, 6, p->px, columns, rows, e);
}

static enum err_code sog_put_harmonics(struct sog_writer *w, uint32_t sh_degree, struct err *e)
{
    const struct gauss *g = w->g;
    struct sog_palette p = {.bands = sh_degree, .coefs = gauss_sh_count(sh_degree) - 1};
    const size_t most = g->n / SOG_ROWS_A_GROUP;
    p.most = most < SOG_PALETTE_COLUMNS ? SOG_PALETTE_COLUMNS
             : most > SOG_PALETTE_MOST  ? SOG_PALETTE_MOST
                                        : most;
    enum err_code rc = sog_palette_find(g, &p, e);
    if (!rc)
        rc = sog_put_palette(w, &p, e);
    if (!rc) {
        sog_clear(w);
        for (size_t i = 0; i < g->n; i++) {
            w->px[4 * i] = (uint8_t)p.label[i];
            w->px[4 * i + 1] = (uint8_t)(p.label[i] >> 8);
        }
        rc = sog_put(w, 7, w->px, w->width_px, w->height_px, e);
    }
    mem_free(p.rows);
    mem_free(p.mean);
    mem_free(p.label);
    mem_free(p.index);
    mem_free(p.px);
    return rc;
}

/* ---- the file ---- */

static enum err_code sog_begin(struct sog_writer *w, struct err *e)
{
    const struct gauss *g = w->g;
    size_t bad;
    if (!g->n)
        return err_set(e, ERR_DATA, "sog: no Gaussians: a texture cannot be empty");
    if (gauss_count_bad(g, &bad))
        return err_set(e, ERR_DATA, "sog: row %zu: not finite, or no rotation", bad);
    w->width_px = 4 * (uint32_t)ceil(sqrt((double)g->n) / 4);
    w->height_px = 4 * (uint32_t)ceil((double)g->n / w->width_px / 4);
    w->px = mem_uninit((size_t)w->width_px * w->height_px, 4);
    w->part[w->n_parts++].name = sog_names[0]; /* meta.json, at the end */
    w->meta = json_pack("{s:i,s:{s:s},s:I}", "version", 2, "asset", "generator",
                        "citysplat " CITYSPLAT_VERSION, "count", (json_int_t)g->n);
    if (w->meta && g->antialiased)
        json_object_set_new(w->meta, "antialias", json_true());
    return w->px && w->meta ? ERR_OK : err_set(e, ERR_MEM, "sog: out of memory");
}

static enum err_code sog_end(struct sog_writer *w, struct err *e)
{
    char *text = json_dumps(w->meta, JSON_COMPACT | JSON_REAL_PRECISION(9));
    if (!text)
        return err_set(e, ERR_MEM, "sog: out of memory");
    buf_add(&w->part[0].bytes, text, strlen(text));
    free(text);
    return buf_check(&w->part[0].bytes, e);
}

/* All parts; sog_drop them. */
static enum err_code sog_make(struct sog_writer *w, uint32_t sh_degree, struct err *e)
{
    const struct gauss *g = w->g;
    if (sh_degree > g->sh_degree)
        return err_set(e, ERR_ARG, "sog: degree %u of Gaussians of degree %u", sh_degree,
                       g->sh_degree);
    enum err_code rc = sog_begin(w, e);
    if (!rc)
        rc = sog_put_means(w, e);
    if (!rc)
        rc = sog_put_quats(w, e);
    if (!rc)
        rc = sog_put_indexed(w, "scales", 4, g->scale_log, false, e);
    if (!rc)
        rc = sog_put_color(w, e);
    if (!rc && sh_degree)
        rc = sog_put_harmonics(w, sh_degree, e);
    return !rc ? sog_end(w, e) : rc;
}

static void sog_drop(struct sog_writer *w)
{
    for (size_t i = 0; i < w->n_parts; i++)
        buf_free(&w->part[i].bytes);
    json_decref(w->meta);
    mem_free(w->px);
}

enum err_code sog_encode(const struct gauss *g, uint32_t sh_degree, struct buf *out, struct err *e)
{
    struct sog_writer w = {.g = g};
    enum err_code rc = sog_make(&w, sh_degree, e);
    if (!rc)
        rc = archive_write(w.part, w.n_parts, out, e);
    sog_drop(&w);
    return rc;
}
