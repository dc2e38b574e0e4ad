/* Rate against distortion of the tile formats: the loss of quality against bytes a Gaussian.
 *
 * The leaves of a store (--tiles) are written in a format on a grid of the quantiser, read back and
 * drawn from the test photographs of the scene (--scene). psnr_db is against the photographs.
 * drop_db is the loss of psnr_db by quantising. self_db is against pictures of the original
 * Gaussians. All are means over pictures. First come all presets in all formats, then `balanced` as
 * .drc with one field finer or coarser at a time, and last series of all SH bands together. A
 * preset is well chosen if no result here is smaller and better.
 *
 * Every row is a line of a recorded study (--record lab/runs/rd.jsonl), written when all are
 * complete.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/scene.h"
#include "codec/splat/axes.h"
#include "codec/splat/draco.h"
#include "codec/splat/glb.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/spz.h"
#include "lab/bench/bench.h"
#include "lab/bench/leaves.h"
#include "lab/bench/test_views.h"
#include "train/train.h"
#include "train/train_scene.h"

#include <stdio.h>
#include <string.h>

#include <jansson.h>

enum { NAME_MAX_BYTES = 64 };

/* .sog and .glb without SPZ have no grid but the degree: their numbers are their own. */
enum rd_format {
    RD_DRC,
    RD_SPZ3,
    RD_SPZ4,
    RD_PRESET_FORMATS,
    RD_SOG = RD_PRESET_FORMATS,
    RD_GLB_PLAIN, /* of all degrees alone */
    RD_FORMATS
};
static const char *const format_names[RD_FORMATS] = {"drc", "spz 3", "spz 4", "sog", "plain.glb"};

struct rd {
    struct bench *b;
    struct scene scene;
    uint32_t *images;
    size_t n_images;
    struct render *render;
    struct test_views shots; /* the truth: pictures of the tiles as they are */
    struct leaves leaves;    /* in glTF axes */
    double psnr_db;          /* of the tiles as they are */
};

static enum err_code rd_score(struct rd *r, const struct gauss *g, bool keep,
                              struct test_views_score *out, struct err *e)
{
    const struct render_options ro = {.aa = g->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
                                      .sh_degree = -1};
    return test_views_score(&r->shots, g, &ro, keep, out, e);
}

static enum err_code rd_trip_own(const struct gauss *tile, enum rd_format f, uint32_t sh_degree,
                                 struct buf *file, struct gauss *out, struct err *e)
{
    const uint32_t degree = sh_degree < tile->sh_degree ? sh_degree : tile->sh_degree;
    enum err_code rc =
        f == RD_SOG ? sog_encode(tile, degree, file, e) : glb_encode_plain(tile, NULL, file, e);
    if (rc)
        return rc;
    return f == RD_SOG ? sog_decode(file->data, file->size, NULL, out, e)
                       : glb_decode(file->data, file->size, NULL, out, e);
}

static enum err_code rd_trip(const struct gauss *tile, enum rd_format f,
                             const struct quant_grid *grid, struct buf *file, struct gauss *out,
                             struct err *e)
{
    struct quant q = {0}, back = {0};
    enum err_code rc = quant_from_gauss(tile, tile->sh_degree, grid, &q, e);
    if (!rc)
        rc = f == RD_DRC ? draco_encode(&q, "18/0/0", file, e)
                         : spz_encode(&q, f == RD_SPZ3 ? 3 : 4, file, e);
    if (!rc)
        rc = f == RD_DRC ? draco_decode(file->data, file->size, NULL, &back, e)
                         : spz_decode(file->data, file->size, NULL, &back, e);
    if (!rc)
        rc = quant_to_gauss(&back, out, e);
    quant_free(&q);
    quant_free(&back);
    return rc;
}

/* One tile through a format; what a reader gets is added to `all` in ENU. */
static enum err_code rd_tile(const struct gauss *tile, enum rd_format f,
                             const struct quant_grid *grid, struct gauss *all, size_t *bytes,
                             struct err *e)
{
    struct gauss g = {0};
    struct buf file = {0};
    enum err_code rc = f >= RD_SOG ? rd_trip_own(tile, f, grid->sh_degree, &file, &g, e)
                                   : rd_trip(tile, f, grid, &file, &g, e);
    if (!rc) {
        memcpy(g.origin_enu_m, tile->origin_enu_m, sizeof g.origin_enu_m);
        axes_gltf_to_enu(&g);
        rc = gauss_append(all, &g, NULL, g.n, e);
        all->antialiased = tile->antialiased; /* which a .glb without SPZ does not say */
    }
    *bytes += file.size;
    gauss_free(&g);
    buf_free(&file);
    return rc;
}

static enum err_code rd_record(struct rd *r, const char *row, const char *what, double bytes,
                               const struct test_views_score *score, struct err *e)
{
    char name[2 * NAME_MAX_BYTES];
    snprintf(name, sizeof name, "%s, %s", row, what);
    bench_report(r->b, name, bytes, "bytes", score->psnr_db, "dB");
    return bench_record(r->b, row, what,
                        json_pack("{s:f, s:f, s:f, s:f, s:I, s:i}", "bytes_per_gaussian", bytes,
                                  "psnr_db", score->psnr_db, "drop_db", r->psnr_db - score->psnr_db,
                                  "self_db", score->self_db, "gaussians", (json_int_t)r->leaves.n,
                                  "photographs", (int)r->n_images),
                        e);
}

static enum err_code rd_row(struct rd *r, const char *row, enum rd_format f,
                            const struct quant_grid *grid, struct err *e)
{
    struct gauss all = {0};
    struct test_views_score score;
    size_t bytes = 0;
    enum err_code rc =
        gauss_alloc(&all, r->leaves.n, r->leaves.tile[0].sh_degree, r->leaves.tile[0].embed_len, e);
    memcpy(all.origin_enu_m, r->leaves.tile[0].origin_enu_m, sizeof all.origin_enu_m);
    for (size_t i = 0; !rc && i < r->leaves.n_tiles; i++)
        rc = rd_tile(&r->leaves.tile[i], f, grid, &all, &bytes, e);
    if (!rc)
        rc = rd_score(r, &all, false, &score, e);
    if (!rc)
        rc = rd_record(r, row, format_names[f], (double)bytes / (double)r->leaves.n, &score, e);
    gauss_free(&all);
    if (!rc && signals_stopping())
        rc = err_set(e, ERR_CANCEL, "stopped");
    return rc;
}

/* ---- what is varied ---- */

static enum err_code rd_presets(struct rd *r, struct err *e)
{
    enum err_code rc = ERR_OK;
    char row[NAME_MAX_BYTES];
    for (int p = 0; !rc && p < QUANT_PRESETS; p++)
        for (int f = 0; !rc && f < RD_PRESET_FORMATS; f++) {
            snprintf(row, sizeof row, "preset:%s", quant_preset_name((enum quant_preset)p));
            rc = rd_row(r, row, (enum rd_format)f, quant_preset_grid((enum quant_preset)p), e);
        }
    for (uint32_t degree = 0; !rc && degree < r->leaves.tile[0].sh_degree; degree++) {
        struct quant_grid spz = *quant_preset_grid(QUANT_SPZ),
                          balanced = *quant_preset_grid(QUANT_BALANCED);
        spz.sh_degree = balanced.sh_degree = (uint8_t)degree;
        snprintf(row, sizeof row, "spz to degree:%u", degree);
        rc = rd_row(r, row, RD_SPZ3, &spz, e);
        snprintf(row, sizeof row, "balanced to degree:%u", degree);
        if (!rc)
            rc = rd_row(r, row, RD_DRC, &balanced, e);
    }
    for (uint32_t degree = 0; !rc && degree <= r->leaves.tile[0].sh_degree; degree++) {
        const struct quant_grid g = {.sh_degree = (uint8_t)degree};
        snprintf(row, sizeof row, "degree:%u", degree);
        rc = rd_row(r, row, RD_SOG, &g, e);
    }
    const struct quant_grid all = {.sh_degree = (uint8_t)r->leaves.tile[0].sh_degree};
    snprintf(row, sizeof row, "degree:%u", all.sh_degree);
    return rc ? rc : rd_row(r, row, RD_GLB_PLAIN, &all, e);
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

static enum err_code rd_open(struct rd *r, struct test_views_score *trained, struct err *e)
{
    struct gauss all = {0};
    enum err_code rc = scene_read(r->b->scene, &r->scene, e);
    if (!rc)
        rc = train_scene_images(&r->scene, SCENE_TEST, true, &r->images, &r->n_images, e);
    if (!rc && !r->n_images)
        rc = err_set(e, ERR_DATA, "%s: keeps no test photographs", r->b->scene);
    if (!rc)
        rc = render_open(r->b->dev, &r->render, e);
    if (!rc)
        rc = test_views_open(r->render, &r->scene, r->images, r->n_images, 0, 1, &r->shots, e);
    if (!rc)
        rc = leaves_read(r->b->tiles, &r->leaves, e);
    if (!rc)
        rc = gauss_alloc(&all, r->leaves.n, r->leaves.tile[0].sh_degree,
                         r->leaves.tile[0].embed_len, e);
    for (size_t i = 0; !rc && i < r->leaves.n_tiles; i++) {
        if (i == 0)
            memcpy(all.origin_enu_m, r->leaves.tile[0].origin_enu_m, sizeof all.origin_enu_m);
        all.antialiased = r->leaves.tile[i].antialiased;
        rc = gauss_append(&all, &r->leaves.tile[i], NULL, r->leaves.tile[i].n, e);
        axes_enu_to_gltf(&r->leaves.tile[i]);
    }
    if (!rc)
        rc = rd_score(r, &all, true, trained, e);
    r->psnr_db = trained->psnr_db;
    gauss_free(&all);
    return rc;
}

enum err_code bench_rd(struct bench *b, struct err *e)
{
    struct rd r = {.b = b};
    if (!b->scene || !b->tiles) {
        log_info("bench", "rd skipped: it takes --scene DIR --tiles FILE");
        return ERR_OK;
    }
    struct test_views_score trained;
    enum err_code rc = rd_open(&r, &trained, e);
    if (!rc)
        rc = rd_record(&r, "trained", "float32",
                       4.0 * (11 + 3 * (double)gauss_sh_count(r.leaves.tile[0].sh_degree) +
                              r.leaves.tile[0].embed_len),
                       &trained, e);
    if (!rc)
        rc = rd_presets(&r, e);
    if (!rc && !b->quick)
        rc = rd_fields(&r, e);
    if (!rc && !b->quick)
        rc = rd_ladders(&r, e);
    if (!rc)
        rc = bench_record_write(b, e);
    leaves_free(&r.leaves);
    test_views_close(&r.shots);
    render_close(&r.render);
    scene_free(&r.scene);
    return rc;
}
