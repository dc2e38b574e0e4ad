/* A large city with levels of detail, as the server draws it: select tiles, bring them to the
 * device, draw with the appearance of a photograph, encode a JPEG. A camera flies over the city in
 * small steps, once to fill the cache of tiles, then timed. The appearance changes every few
 * frames.
 *
 * The city is that of bench_frame repeated side by side, with random appearance embeddings; the
 * pyramid makes its coarser levels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "bench/bench.h"
#include "bench/city.h"
#include "codec/ckpt.h"
#include "codec/image.h"
#include "core/appearance.h"
#include "core/geo.h"
#include "core/sort.h"
#include "lod/bake.h"
#include "lod/pick.h"
#include "lod/pyramid.h"
#include "lod/view.h"
#include "render/render.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum {
    VIEW_SIDE = 4, /* cities along an edge */
    VIEW_FRAMES = 60,
    VIEW_PHOTOS = 8,
    VIEW_W = 1280,
    VIEW_H = 720,
    VIEW_JPEG = 85,
    VIEW_GAUSSIANS = 1200000, /* the server's default limit of a picture */
    VIEW_SEED = 11
};
#define VIEW_CITY_M 420.0
/* City.h draws each disc to cover its neighbours; trained ones reach about half way to the next. */
#define VIEW_THINNER 3.0f

static const struct geo_origin flight_origin = {8.6821, 50.1109, 160};

struct flight {
    struct render *render;
    struct view *view;
    struct appearance appearance;
    float *frame, *rgb;
    struct image picture;
    double ms[VIEW_FRAMES], pick_ms, load_ms, draw_ms, jpeg_ms;
    uint64_t gaussians, visible;
};

/* n Gaussians in VIEW_SIDE^2 copies of the city, SH degree 1, with embeddings. */
static enum err_code view_flight_city(size_t n, struct gauss *out, struct err *e)
{
    struct gauss one = {0};
    size_t copies = (size_t)VIEW_SIDE * VIEW_SIDE, per = n / copies;
    enum err_code rc = city_sorted(per, &one, e);
    if (!rc)
        rc = gauss_alloc(out, per * copies, 1, APPEARANCE_GAUSS_LEN, e);
    for (size_t c = 0; !rc && c < copies; c++)
        for (size_t i = 0; i < per; i++) {
            size_t to = out->n++;
            gauss_copy_row(out, to, &one, i);
            out->mean_m[3 * to] += (float)(VIEW_CITY_M * ((double)(c % VIEW_SIDE) - 1.5));
            out->mean_m[3 * to + 1] += (float)(VIEW_CITY_M * ((double)(c / VIEW_SIDE) - 1.5));
            for (size_t k = 0; k < 3; k++)
                out->scale_log[3 * to + k] -= logf(VIEW_THINNER);
            for (size_t k = 0; k < APPEARANCE_GAUSS_LEN; k++)
                out->embed[APPEARANCE_GAUSS_LEN * to + k] = (float)rng_normal(VIEW_SEED, k, to);
        }
    gauss_free(&one);
    return rc;
}

static enum err_code view_flight_store(struct bench *b, const struct appearance *appearance,
                                       size_t n, const char *path, struct err *e)
{
    struct appearance kept = {0};
    struct buf bytes = {0};
    const struct pyramid_config cfg = {.name = "bench", .tile_edge_m = 60};
    struct pyramid_report report;
    struct gauss g = {0};
    char text[96];
    enum err_code rc = view_flight_city(n, &g, e);
    const struct pyramid_level level = {.g = &g, .level = 3};
    if (!rc)
        rc = bake_with_default(appearance, &g, &kept, e);
    if (!rc)
        rc = appearance_write(&kept, &bytes, e);
    const struct store_blob blob = {.name = "appearance", bytes.data, bytes.size};
    double start_s = clock_s();
    if (!rc)
        rc = pyramid_build(&flight_origin, &level, 1, &cfg, &blob, 1, path, &report, e);
    if (!rc) {
        snprintf(text, sizeof text, "%.1f M: tiling", (double)g.n * 1e-6);
        bench_report(b, text, (double)g.n * 1e-6 / (clock_s() - start_s), "M Gaussians/s", 0, NULL);
    }
    gauss_free(&g);
    appearance_free(&kept);
    buf_free(&bytes);
    return rc;
}

/* Frame k of the flight: over the roofs, looking ahead and down. */
static struct camera view_flight_camera(int k)
{
    double at = VIEW_CITY_M * (-1.4 + 2.4 * k / VIEW_FRAMES);
    const double eye[3] = {at, 0.6 * at, 120}, target[3] = {at + 200, 0.6 * at + 120, 10};
    return camera_look_at(eye, target, 0.9, VIEW_W, VIEW_H);
}

static enum err_code view_flight_frame(struct flight *c, int k, struct err *e)
{
    struct camera cam = view_flight_camera(k);
    struct view_stats stats;
    struct buf jpeg = {0};
    double start_s = clock_s();
    appearance_frame(&c->appearance,
                     c->appearance.images + (size_t)(k / 8 % VIEW_PHOTOS) * c->appearance.len_image,
                     c->frame);
    const struct render_options ro = {.aa = RENDER_AA_2D,
                                      .sh_degree = -1,
                                      .appearance_frame = c->frame,
                                      .appearance_hidden = c->appearance.hidden};
    const struct pick_options po = {.max_gaussians = VIEW_GAUSSIANS};
    enum err_code rc = view_render(c->view, &cam, &ro, &po, c->rgb, &stats, e);
    double drawn_s = clock_s();
    for (size_t i = 0; !rc && i < 3 * (size_t)VIEW_W * VIEW_H; i++)
        c->picture.px[i] = (uint8_t)(255.0f * (c->rgb[i] < 1.0f ? c->rgb[i] : 1.0f) + 0.5f);
    if (!rc)
        rc = image_encode(&c->picture, "jpg", VIEW_JPEG, &jpeg, e);
    c->ms[k] = (clock_s() - start_s) * 1e3;
    c->pick_ms += stats.ms_pick / VIEW_FRAMES;
    c->load_ms += stats.ms_load / VIEW_FRAMES;
    c->draw_ms += stats.ms_render / VIEW_FRAMES;
    c->jpeg_ms += (clock_s() - drawn_s) * 1e3 / VIEW_FRAMES;
    c->gaussians += stats.n_gaussians / VIEW_FRAMES;
    c->visible += stats.n_visible / VIEW_FRAMES;
    buf_free(&jpeg);
    return rc;
}

/* What the limit costs: PSNR of a picture with it against the same without. */
static enum err_code view_flight_loss(struct flight *c, double *psnr_db, struct err *e)
{
    size_t n = 3 * (size_t)VIEW_W * VIEW_H;
    float *full = mem_array(n, sizeof *full);
    struct camera cam = view_flight_camera(VIEW_FRAMES / 2);
    const struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
    struct pick_options po = {0};
    double sum = 0;
    enum err_code rc = full ? view_render(c->view, &cam, &ro, &po, full, NULL, e)
                            : err_set(e, ERR_MEM, "bench_view: out of memory");
    po.max_gaussians = VIEW_GAUSSIANS;
    if (!rc)
        rc = view_render(c->view, &cam, &ro, &po, c->rgb, NULL, e);
    for (size_t i = 0; !rc && i < n; i++)
        sum += (double)(full[i] - c->rgb[i]) * (double)(full[i] - c->rgb[i]);
    *psnr_db = sum > 0 ? -10 * log10(sum / (double)n) : 99;
    mem_free(full);
    return rc;
}

static enum err_code view_flight_open(struct bench *b, const char *path, struct flight *c,
                                      struct err *e)
{
    enum err_code rc = ERR_OK;
    c->frame = mem_array(appearance_frame_floats(APPEARANCE_GAUSS_LEN, APPEARANCE_HIDDEN),
                         sizeof *c->frame);
    c->rgb = mem_array(3 * (size_t)VIEW_W * VIEW_H, sizeof *c->rgb);
    if (!c->frame || !c->rgb)
        rc = err_set(e, ERR_MEM, "bench_view: out of memory");
    if (!rc)
        rc = image_alloc(VIEW_W, VIEW_H, 3, &c->picture, e);
    if (!rc)
        rc = render_open(b->dev, &c->render, e);
    return !rc ? view_open(path, c->render, (size_t)4 << 30, &c->view, e) : rc;
}

enum err_code bench_view(struct bench *b, struct err *e)
{
    char path[FILE_PATH_MAX], text[96];
    struct flight c = {0};
    double psnr_db = 0;
    size_t n = b->quick ? 160000 : 10400000;
    enum err_code rc = file_join(path, bench_tmpdir(b), "city.tiles", e);
    if (!rc)
        rc = appearance_alloc(&c.appearance, APPEARANCE_GAUSS_LEN, APPEARANCE_IMAGE_LEN,
                              APPEARANCE_HIDDEN, VIEW_PHOTOS, e);
    if (!rc) {
        appearance_init(&c.appearance, VIEW_SEED);
        rc = view_flight_store(b, &c.appearance, n, path, e);
    }
    if (!rc)
        rc = view_flight_open(b, path, &c, e);
    for (int pass = 0; !rc && pass < 2; pass++) {
        c.pick_ms = c.load_ms = c.draw_ms = c.jpeg_ms = 0;
        c.gaussians = c.visible = 0;
        for (int k = 0; !rc && k < VIEW_FRAMES; k++)
            rc = view_flight_frame(&c, k, e);
    }
    if (!rc && c.gaussians == 0)
        rc = err_set(e, ERR_INTERNAL, "bench_view: check: nothing was drawn");
    if (!rc)
        rc = view_flight_loss(&c, &psnr_db, e);
    if (!rc) {
        sort_doubles(c.ms, VIEW_FRAMES);
        const struct {
            const char *name, *unit;
            double value;
        } rows[] = {{"frames", "1/s", 1e3 / c.ms[VIEW_FRAMES / 2]},
                    {"median frame", "ms", c.ms[VIEW_FRAMES / 2]},
                    {"slowest of twenty", "ms", c.ms[VIEW_FRAMES * 19 / 20]},
                    {"select tiles", "ms", c.pick_ms},
                    {"bring tiles", "ms", c.load_ms},
                    {"draw", "ms", c.draw_ms},
                    {"JPEG", "ms", c.jpeg_ms},
                    {"Gaussians a frame", "", (double)c.gaussians},
                    {"Gaussians in the picture", "", (double)c.visible},
                    {"against no limit of Gaussians", "dB", psnr_db}};
        for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
            snprintf(text, sizeof text, "%.1f M, %dx%d, appearance: %s", (double)n * 1e-6, VIEW_W,
                     VIEW_H, rows[i].name);
            bench_report(b, text, rows[i].value, rows[i].unit, 0, NULL);
        }
    }
    view_close(&c.view);
    render_close(&c.render);
    image_free(&c.picture);
    appearance_free(&c.appearance);
    mem_free(c.frame);
    mem_free(c.rgb);
    return rc;
}
