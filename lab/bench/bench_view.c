/* Cities of 0.1, 1 and 10.4 million Gaussians with levels of detail, as the server draws them:
 * select tiles, bring them to the device, draw with the appearance of a photograph, encode a JPEG.
 * Two flights, each once to fill the cache of tiles, then timed:
 *
 *   fast   across the city in 60 pictures; the appearance changes every few of them
 *   slow   10 m/s and 3 degrees a second at 30 pictures a second, and a tenth of that (hovering),
 *          in one appearance: every picture by itself, and as a view stream makes them
 *          (view_render_moving), in turns, each kind with a renderer of its own
 *
 * The city is that of bench_frame repeated side by side, with random appearance embeddings; the
 * pyramid makes its coarser levels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "codec/image/image.h"
#include "core/geo/geo.h"
#include "core/math/sort.h"
#include "core/splat/appearance.h"
#include "lab/bench/bench.h"
#include "lab/bench/city.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/make/pyramid.h"
#include "lod/store/bake.h"
#include "render/render.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum {
    VIEW_FRAMES = 60,
    VIEW_PHOTOS = 8,
    VIEW_SIZES = 2,
    VIEW_JPEG = 85,
    VIEW_GAUSSIANS = 1200000, /* the server's default limit of a picture */
    VIEW_SEED = 11
};
/* City.h draws each disc to cover its neighbours; trained ones reach about half way to the next. */
#define VIEW_THINNER 3.0f

static const struct city_size view_cities[] = {{100000, 1}, {1000000, 2}, {10400000, 4}, {0}},
                              view_quick[] = {{160000, 4}, {0}};
static const uint32_t view_px[VIEW_SIZES][2] = {{640, 360}, {1280, 720}};

static const struct geo_origin flight_origin = {8.6821, 50.1109, 160};

struct flight {
    const struct city_size *city;
    uint32_t width_px, height_px;
    bool moving;
    double slow; /* share of the slow flight's speed; 0: the fast one */
    struct render *render;
    struct view *view;
    const struct appearance *appearance; /* borrowed */
    float *rgb;
    struct image picture;
    double ms[VIEW_FRAMES], pick_ms, load_ms, draw_ms, jpeg_ms;
    uint64_t gaussians, visible;
};

/* SH of degree 1, with embeddings. */
static enum err_code view_flight_city(const struct city_size *city, struct gauss *out,
                                      struct err *e)
{
    enum err_code rc = city_square(city, 1, APPEARANCE_GAUSS_LEN, out, e);
    for (size_t i = 0; i < out->n; i++) {
        for (size_t k = 0; k < 3; k++)
            out->scale_log[3 * i + k] -= logf(VIEW_THINNER);
        for (size_t k = 0; k < APPEARANCE_GAUSS_LEN; k++)
            out->embed[APPEARANCE_GAUSS_LEN * i + k] = (float)rng_normal(VIEW_SEED, k, i);
    }
    return rc;
}

static enum err_code view_flight_store(struct bench *b, const struct appearance *appearance,
                                       const struct city_size *city, const char *path,
                                       struct err *e)
{
    struct appearance kept = {0};
    struct buf bytes = {0};
    const struct pyramid_config cfg = {.name = "bench", .tile_edge_m = 60};
    struct pyramid_report report;
    struct gauss g = {0};
    char text[96];
    enum err_code rc = view_flight_city(city, &g, e);
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

/* Picture k of a flight: over the roofs, looking ahead and down. */
static struct camera view_flight_camera(const struct flight *c, int k)
{
    double along = c->slow > 0 ? 0.0 : 2.4 * k / VIEW_FRAMES, passed_s = c->slow * k / 30.0;
    double at = CITY_M * (double)c->city->side / 4 * (-1.4 + along) + 8.6 * passed_s;
    double turned = atan2(120, 200) - 3.0 * passed_s * M_PI / 180.0;
    const double eye[3] = {at, 0.6 * at, 120},
                 target[3] = {at + 233 * cos(turned), 0.6 * at + 233 * sin(turned), 10};
    return camera_look_at(eye, target, 0.9, c->width_px, c->height_px);
}

static enum err_code view_flight_frame(struct flight *c, int k, struct err *e)
{
    struct camera cam = view_flight_camera(c, k);
    const size_t pixels = (size_t)c->width_px * c->height_px;
    const int photo = c->slow > 0 ? 0 : k / 8 % VIEW_PHOTOS;
    struct view_stats stats;
    struct buf jpeg = {0};
    double start_s = clock_s();
    enum err_code rc = view_set_appearance(
        c->view, c->appearance->images + (size_t)photo * c->appearance->len_image, e);
    const struct render_options ro = {.aa = RENDER_AA_2D, .sh_degree = -1};
    const struct pick_options po = {.max_gaussians = VIEW_GAUSSIANS};
    if (!rc)
        rc = (c->moving ? view_render_moving : view_render)(c->view, &cam, &ro, &po, c->rgb, &stats,
                                                            e);
    double drawn_s = clock_s();
    for (size_t i = 0; !rc && i < 3 * pixels; i++)
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
    size_t n = 3 * (size_t)c->width_px * c->height_px;
    float *full = mem_array(n, sizeof *full);
    struct camera cam = view_flight_camera(c, VIEW_FRAMES / 2);
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

static enum err_code view_flight_open(const struct bench *b, const char *path, struct flight *c,
                                      struct err *e)
{
    const uint32_t *most = view_px[VIEW_SIZES - 1];
    enum err_code rc = ERR_OK;
    c->rgb = mem_array(3 * (size_t)most[0] * most[1], sizeof *c->rgb);
    if (!c->rgb)
        rc = err_set(e, ERR_MEM, "bench_view: out of memory");
    if (!rc)
        rc = render_open(b->dev, &c->render, e);
    return !rc ? view_open(path, c->render, (size_t)4 << 30, &c->view, e) : rc;
}

/* A flight twice, of which the second time counts. *mean_ms: of a picture. */
static enum err_code view_fly(struct flight *c, double *mean_ms, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (int pass = 0; !rc && pass < 2; pass++) {
        c->pick_ms = c->load_ms = c->draw_ms = c->jpeg_ms = *mean_ms = 0;
        c->gaussians = c->visible = 0;
        for (int k = 0; !rc && k < VIEW_FRAMES; k++) {
            rc = view_flight_frame(c, k, e);
            *mean_ms += c->ms[k] / VIEW_FRAMES;
        }
    }
    return !rc && c->gaussians == 0
               ? err_set(e, ERR_INTERNAL, "bench_view: check: nothing was drawn")
               : rc;
}

static void view_row(struct bench *b, const struct flight *c, const char *what, double value,
                     const char *unit, double ratio, const char *to)
{
    char text[96];
    snprintf(text, sizeof text, "%.1f M, %ux%u, appearance: %s", (double)c->city->n * 1e-6,
             c->width_px, c->height_px, what);
    bench_report(b, text, value, unit, ratio, to);
}

static enum err_code view_fast(struct bench *b, struct flight *c, struct err *e)
{
    double mean_ms, psnr_db = 0;
    c->slow = 0;
    enum err_code rc = view_fly(c, &mean_ms, e);
    if (!rc)
        rc = view_flight_loss(c, &psnr_db, e);
    if (rc)
        return rc;
    sort_doubles(c->ms, VIEW_FRAMES);
    const struct {
        const char *name, *unit;
        double value;
    } rows[] = {{"frames", "1/s", 1e3 / c->ms[VIEW_FRAMES / 2]},
                {"median frame", "ms", c->ms[VIEW_FRAMES / 2]},
                {"slowest of twenty", "ms", c->ms[VIEW_FRAMES * 19 / 20]},
                {"select tiles", "ms", c->pick_ms},
                {"bring tiles", "ms", c->load_ms},
                {"draw", "ms", c->draw_ms},
                {"JPEG", "ms", c->jpeg_ms},
                {"Gaussians a frame", "", (double)c->gaussians},
                {"Gaussians in the picture", "", (double)c->visible},
                {"against no limit of Gaussians", "dB", psnr_db}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        view_row(b, c, rows[i].name, rows[i].value, rows[i].unit, 0, NULL);
    return ERR_OK;
}

/* own draws every picture by itself, stream those of a moving camera. */
static enum err_code view_slow(struct bench *b, struct flight *own, struct flight *stream,
                               const char *name, double slow, struct err *e)
{
    char text[64];
    double own_ms = 0, stream_ms = 0, psnr_db = 99;
    size_t n = 3 * (size_t)own->width_px * own->height_px;
    enum err_code rc = ERR_OK;
    own->slow = stream->slow = slow;
    stream->moving = true;
    for (int pass = 0; !rc && pass < 2; pass++)
        for (int k = 0; !rc && k < VIEW_FRAMES; k++) {
            double sum = 1e-9;
            rc = view_flight_frame(own, k, e);
            if (!rc)
                rc = view_flight_frame(stream, k, e);
            own_ms += pass * own->ms[k] / VIEW_FRAMES;
            stream_ms += pass * stream->ms[k] / VIEW_FRAMES;
            for (size_t i = 0; i < n; i++) {
                const double d = (double)(own->rgb[i] - stream->rgb[i]);
                sum += d * d;
            }
            psnr_db = fmin(psnr_db, -10 * log10(sum / (double)n));
        }
    if (rc)
        return rc;
    snprintf(text, sizeof text, "%s, pictures by themselves", name);
    view_row(b, own, text, 1e3 / own_ms, "1/s", 0, NULL);
    snprintf(text, sizeof text, "%s, as a stream", name);
    view_row(b, own, text, 1e3 / stream_ms, "1/s", own_ms / stream_ms, "by themselves");
    snprintf(text, sizeof text, "%s, the worst of a stream", name);
    view_row(b, own, text, psnr_db, "dB", 0, NULL);
    return ERR_OK;
}

static enum err_code view_at(struct bench *b, struct flight c[2], const uint32_t px[2],
                             struct err *e)
{
    enum err_code rc = ERR_OK;
    for (int i = 0; !rc && i < 2; i++) {
        c[i].width_px = px[0];
        c[i].height_px = px[1];
        rc = image_alloc(px[0], px[1], 3, &c[i].picture, e);
    }
    if (!rc)
        rc = view_fast(b, &c[0], e);
    if (!rc)
        rc = view_slow(b, &c[0], &c[1], "slow flight", 1, e);
    if (!rc)
        rc = view_slow(b, &c[0], &c[1], "hovering", 0.1, e);
    for (int i = 0; i < 2; i++)
        image_free(&c[i].picture);
    return rc;
}

static enum err_code view_of_city(struct bench *b, const struct city_size *city, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct appearance appearance = {0};
    struct flight c[2] = {{.city = city}, {.city = city}};
    enum err_code rc = file_join(path, bench_tmpdir(b), "city.tiles", e);
    if (!rc)
        rc = appearance_alloc(&appearance, APPEARANCE_GAUSS_LEN, APPEARANCE_IMAGE_LEN,
                              APPEARANCE_HIDDEN, VIEW_PHOTOS, e);
    if (!rc) {
        appearance_init(&appearance, VIEW_SEED);
        rc = view_flight_store(b, &appearance, city, path, e);
    }
    for (int i = 0; !rc && i < 2; i++) {
        c[i].appearance = &appearance;
        rc = view_flight_open(b, path, &c[i], e);
    }
    for (size_t i = 0; !rc && i < VIEW_SIZES; i++)
        rc = view_at(b, c, view_px[i], e);
    for (int i = 0; i < 2; i++) {
        view_close(&c[i].view);
        render_close(&c[i].render);
        mem_free(c[i].rgb);
    }
    appearance_free(&appearance);
    return rc;
}

enum err_code bench_view(struct bench *b, struct err *e)
{
    return city_each(b, b->quick ? view_quick : view_cities, view_of_city, e);
}
