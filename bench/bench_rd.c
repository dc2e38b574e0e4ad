/* Rate against distortion of the tile formats: what a trained scene's pictures lose for how few
 * bytes a Gaussian.
 *
 * The leaves of a store (--tiles) are written in a format on a grid of the quantiser, read back and
 * drawn from the scene's (--scene) test photographs. psnr_db is against the photographs, drop_db
 * what the files as they are score better by, self_db against pictures of the files as they are:
 * each a mean over the pictures. First all presets in all formats, then `balanced` as .drc with one
 * field finer and coarser at a time, and ladders of all SH bands together: a preset is well chosen
 * when nothing here is smaller and better.
 *
 * Every row is a line of a recorded study (--record docs/runs/rd.jsonl), written when all are
 * there.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "lod/lod.h"
#include "lod/tree.h"
#include "train/train.h"

enum { NAME_MAX_BYTES = 64 };

enum rd_format { RD_DRC, RD_SPZ3, RD_SPZ4, RD_FORMATS };
static const char *const format_names[RD_FORMATS] = {"drc", "spz 3", "spz 4"};

struct rd {
    struct bench *b;
    struct scene scene;
    uint32_t *images;
    size_t n_images;
    struct feed *feed;
    struct render *render;
    struct gauss *tiles; /* [n_tiles], glTF axes about each one's centre */
    size_t n_tiles, n;
    float **truth; /* [n_images] pictures of the tiles as they are */
    double psnr_db;
    json_t *lines;
};

static double clamped(float v)
{
    return (double)fminf(fmaxf(v, 0), 1);
}

static double psnr_of(const float *a, const float *b, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        double d = clamped(a[i]) - clamped(b[i]);
        sum += d * d;
    }
    return 10 * log10((double)n / (sum + 1e-12));
}

/* Mean scores of g (ENU); with `keep` its pictures become the truth. */
static enum err_code rd_score(struct rd *r, const struct gauss *g, bool keep, double *psnr_db,
                              double *self_db, struct err *e)
{
    const struct render_options ro = {.aa = g->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
                                      .sh_degree = -1};
    struct render_model m = {0};
    enum err_code rc = render_model_upload(r->render, g, &m, e);
    *psnr_db = *self_db = 0;
    for (size_t i = 0; !rc && i < r->n_images; i++) {
        struct feed_photo photo;
        double psnr;
        rc = feed_get_nth(r->feed, i, &photo, e);
        uint32_t w = rc ? 0 : photo.cam.width_px, h = rc ? 0 : photo.cam.height_px;
        size_t n = (size_t)w * h * 3;
        float *rgb = rc ? NULL : mem_array(n, sizeof *rgb);
        if (!rc && !rgb)
            rc = err_set(e, ERR_MEM, "out of memory for a picture");
        if (!rc)
            rc = render_forward(r->render, &m, &photo.cam, &ro, rgb, NULL, e);
        if (!rc)
            rc = metric_psnr(rgb, photo.px, NULL, w, h, &psnr, e);
        if (!rc) {
            *psnr_db += psnr / (double)r->n_images;
            *self_db += keep ? 0 : psnr_of(rgb, r->truth[i], n) / (double)r->n_images;
        }
        if (!rc && keep) {
            r->truth[i] = rgb;
            rgb = NULL;
        }
        mem_free(rgb);
    }
    render_model_free(&m);
    return rc;
}

/* One tile through a format; what a reader gets is added to `all` in ENU. */
static enum err_code rd_tile(const struct gauss *tile, enum rd_format f,
                             const struct quant_grid *grid, struct gauss *all, size_t *bytes,
                             struct err *e)
{
    struct quant q = {0}, back = {0};
    struct gauss g = {0};
    struct buf file = {0};
    enum err_code rc = quant_from_gauss(tile, tile->sh_degree, grid, &q, e);
    if (!rc)
        rc = f == RD_DRC ? draco_encode(&q, "18/0/0", &file, e)
                         : spz_encode(&q, f == RD_SPZ3 ? 3 : 4, &file, e);
    if (!rc)
        rc = f == RD_DRC ? draco_decode(file.data, file.size, NULL, &back, e)
                         : spz_decode(file.data, file.size, NULL, &back, e);
    if (!rc)
        rc = quant_to_gauss(&back, &g, e);
    if (!rc) {
        memcpy(g.origin_enu_m, tile->origin_enu_m, sizeof g.origin_enu_m);
        frame_gltf_to_enu(&g);
        rc = gauss_append(all, &g, NULL, g.n, e);
        all->antialiased = g.antialiased;
    }
    *bytes += file.size;
    gauss_free(&g);
    quant_free(&q);
    quant_free(&back);
    buf_free(&file);
    return rc;
}

static enum err_code rd_record(struct rd *r, const char *row, const char *what, double bytes,
                               double psnr_db, double self_db, struct err *e)
{
    char name[2 * NAME_MAX_BYTES];
    json_t *o =
        json_pack("{s:s, s:s, s:s, s:s, s:s, s:s, s:{s:f, s:f, s:f, s:f, s:I, s:i}}", "study",
                  r->b->study, "row", row, "what", what, "dataset", r->b->dataset, "command",
                  r->b->command, "device", r->b->dev->name, "numbers", "bytes_per_gaussian", bytes,
                  "psnr_db", psnr_db, "drop_db", r->psnr_db - psnr_db, "self_db", self_db,
                  "gaussians", (json_int_t)r->n, "photographs", (int)r->n_images);
    if (!o || json_array_append_new(r->lines, o))
        return err_set(e, ERR_MEM, "out of memory");
    snprintf(name, sizeof name, "%s, %s", row, what);
    bench_report(r->b, name, bytes, "bytes", psnr_db, "dB");
    return ERR_OK;
}

static enum err_code rd_row(struct rd *r, const char *row, enum rd_format f,
                            const struct quant_grid *grid, struct err *e)
{
    struct gauss all = {0};
    double psnr_db, self_db;
    size_t bytes = 0;
    enum err_code rc = gauss_alloc(&all, r->n, r->tiles[0].sh_degree, r->tiles[0].embed_len, e);
    memcpy(all.origin_enu_m, r->tiles[0].origin_enu_m, sizeof all.origin_enu_m);
    for (size_t i = 0; !rc && i < r->n_tiles; i++)
        rc = rd_tile(&r->tiles[i], f, grid, &all, &bytes, e);
    if (!rc)
        rc = rd_score(r, &all, false, &psnr_db, &self_db, e);
    if (!rc)
        rc = rd_record(r, row, format_names[f], (double)bytes / (double)r->n, psnr_db, self_db, e);
    gauss_free(&all);
    if (!rc && clock_stopping())
        rc = err_set(e, ERR_CANCEL, "stopped");
    return rc;
}

/* ---- what is varied ---- */

static enum err_code rd_presets(struct rd *r, struct err *e)
{
    enum err_code rc = ERR_OK;
    char row[NAME_MAX_BYTES];
    for (int p = 0; !rc && p < QUANT_PRESETS; p++)
        for (int f = 0; !rc && f < RD_FORMATS; f++) {
            snprintf(row, sizeof row, "preset:%s", quant_preset_name((enum quant_preset)p));
            rc = rd_row(r, row, (enum rd_format)f, quant_preset_grid((enum quant_preset)p), e);
        }
    for (uint32_t degree = 0; !rc && degree < r->tiles[0].sh_degree; degree++) {
        struct quant_grid spz = *quant_preset_grid(QUANT_SPZ),
                          balanced = *quant_preset_grid(QUANT_BALANCED);
        spz.sh_degree = balanced.sh_degree = (uint8_t)degree;
        snprintf(row, sizeof row, "spz to degree:%u", degree);
        rc = rd_row(r, row, RD_SPZ3, &spz, e);
        snprintf(row, sizeof row, "balanced to degree:%u", degree);
        if (!rc)
            rc = rd_row(r, row, RD_DRC, &balanced, e);
    }
    return rc;
}

static enum err_code rd_fields(struct rd *r, struct err *e)
{
    const struct quant_grid middle = *quant_preset_grid(QUANT_BALANCED);
    struct quant_grid g;
    const struct {
        const char *name;
        uint8_t *field, lo, hi;
    } sweep[] = {{"position", &g.position, 3, 10}, {"scale", &g.scale, 0, 3},
                 {"rotation", &g.rotation, 0, 6},  {"alpha", &g.alpha, 0, 4},
                 {"color", &g.color, 0, 3},        {"sh1", &g.sh[0], 0, 5},
                 {"sh2", &g.sh[1], 0, 5},          {"sh3", &g.sh[2], 0, 5}};
    char row[NAME_MAX_BYTES];
    enum err_code rc = ERR_OK;
    for (size_t s = 0; s < sizeof sweep / sizeof *sweep; s++)
        for (unsigned v = sweep[s].lo; !rc && v <= sweep[s].hi; v++) {
            g = middle;
            *sweep[s].field = (uint8_t)v;
            snprintf(row, sizeof row, "%s:%u", sweep[s].name, v);
            rc = rd_row(r, row, RD_DRC, &g, e);
        }
    return rc;
}

/* All bands together, on the geometry of each preset. */
static enum err_code rd_ladders(struct rd *r, struct err *e)
{
    static const uint8_t steps[][3] = {{5, 5, 5}, {4, 4, 4}, {3, 3, 3}, {3, 3, 2}, {3, 2, 2},
                                       {2, 2, 2}, {2, 2, 1}, {2, 1, 1}, {1, 1, 1}, {0, 0, 0}};
    char row[NAME_MAX_BYTES];
    enum err_code rc = ERR_OK;
    for (int p = QUANT_PREVIEW; p < QUANT_PRESETS; p++)
        for (size_t i = 0; !rc && i < sizeof steps / sizeof *steps; i++) {
            struct quant_grid g = *quant_preset_grid((enum quant_preset)p);
            memcpy(g.sh, steps[i], sizeof g.sh);
            g.sh_degree = 3;
            snprintf(row, sizeof row, "%s geometry:%u%u%u", quant_preset_name((enum quant_preset)p),
                     g.sh[0], g.sh[1], g.sh[2]);
            rc = rd_row(r, row, RD_DRC, &g, e);
        }
    return rc;
}

/* ---- the scene ---- */

static enum err_code rd_read_tiles(struct rd *r, struct err *e)
{
    struct store *s = NULL;
    size_t n = 0;
    enum err_code rc = store_open(r->b->tiles, &s, e);
    const struct store_tile *t = rc ? NULL : store_tiles(s, &n);
    r->tiles = mem_array(n, sizeof *r->tiles);
    if (!rc && !r->tiles)
        rc = err_set(e, ERR_MEM, "out of memory");
    for (size_t i = 0; !rc && i < n; i++) {
        if (store_tree(s)->nodes[i].child_count) /* leaves show the finest level */
            continue;
        rc = store_read_gauss(s, t[i].key, &r->tiles[r->n_tiles], e);
        if (!rc)
            r->n += r->tiles[r->n_tiles++].n;
    }
    store_close(&s);
    return rc;
}

static enum err_code rd_open(struct rd *r, struct err *e)
{
    struct gauss all = {0};
    double self_db;
    enum err_code rc = scene_read(r->b->scene, &r->scene, e);
    if (!rc)
        rc = train_images(&r->scene, SCENE_TEST, true, &r->images, &r->n_images, e);
    if (!rc && !r->n_images)
        rc = err_set(e, ERR_DATA, "%s: keeps no test photographs", r->b->scene);
    const struct feed_config f = {.scene = &r->scene,
                                  .images = r->images,
                                  .n_images = r->n_images,
                                  .downsample = 1,
                                  .cache_bytes = (size_t)1 << 30};
    if (!rc)
        rc = feed_open(&f, &r->feed, e);
    if (!rc)
        rc = render_open(r->b->dev, &r->render, e);
    if (!rc)
        rc = rd_read_tiles(r, e);
    if (!rc && !r->n)
        rc = err_set(e, ERR_DATA, "%s: no Gaussians", r->b->tiles);
    r->lines = json_array();
    r->truth = mem_array(r->n_images, sizeof *r->truth);
    if (!rc && (!r->truth || !r->lines))
        rc = err_set(e, ERR_MEM, "out of memory");
    if (!rc)
        rc = gauss_alloc(&all, r->n, r->tiles[0].sh_degree, r->tiles[0].embed_len, e);
    for (size_t i = 0; !rc && i < r->n_tiles; i++) {
        if (i == 0)
            memcpy(all.origin_enu_m, r->tiles[0].origin_enu_m, sizeof all.origin_enu_m);
        all.antialiased = r->tiles[i].antialiased;
        rc = gauss_append(&all, &r->tiles[i], NULL, r->tiles[i].n, e);
        frame_enu_to_gltf(&r->tiles[i]);
    }
    if (!rc)
        rc = rd_score(r, &all, true, &r->psnr_db, &self_db, e);
    gauss_free(&all);
    return rc;
}

static enum err_code rd_write(const struct rd *r, struct err *e)
{
    struct buf b = {0};
    json_t *line;
    size_t i;
    json_array_foreach(r->lines, i, line)
    {
        char *text = json_dumps(line, JSON_COMPACT | JSON_REAL_PRECISION(7));
        buf_printf(&b, "%s\n", text ? text : "");
        free(text);
    }
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = file_write(r->b->record, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

enum err_code bench_rd(struct bench *b, struct err *e)
{
    struct rd r = {.b = b};
    if (!b->scene || !b->tiles) {
        log_info("bench", "rd skipped: it takes --scene DIR --tiles FILE");
        return ERR_OK;
    }
    enum err_code rc = rd_open(&r, e);
    if (!rc)
        rc = rd_record(
            &r, "trained", "float32",
            4.0 * (11 + 3 * (double)gauss_sh_count(r.tiles[0].sh_degree) + r.tiles[0].embed_len),
            r.psnr_db, 120, e);
    if (!rc)
        rc = rd_presets(&r, e);
    if (!rc && !b->quick)
        rc = rd_fields(&r, e);
    if (!rc && !b->quick)
        rc = rd_ladders(&r, e);
    if (!rc && b->record)
        rc = rd_write(&r, e);
    for (size_t i = 0; r.truth && i < r.n_images; i++)
        mem_free(r.truth[i]);
    for (size_t i = 0; i < r.n_tiles; i++)
        gauss_free(&r.tiles[i]);
    mem_free(r.truth);
    mem_free(r.tiles);
    json_decref(r.lines);
    render_close(&r.render);
    feed_close(&r.feed);
    scene_free(&r.scene);
    return rc;
}
