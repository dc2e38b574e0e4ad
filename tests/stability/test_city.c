/* A city of nine cells, from photographs to tiles with the program itself: F10 (no seam of
 * geometry between cells, every Gaussian owned once) and what levels of detail save and cost.
 *
 * Without arguments it makes its own small city. With SCENE TRUTH RESULTS CITY.tiles it measures
 * those instead: a scene of `citysplat ingest`, the truth/ of `citysplat synth` under it, what
 * `citysplat train --output` wrote, and the store of `citysplat tile`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/store/store.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "tests/stability/toy.h"
#include "train/loss/metric.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SEAM_PX 5.0
#define CITY_DB 25.0 /* below, what happens at borders says little */
#define SEAM_DB 0.5  /* worse than all pixels, near borders */
#define LOD_DB 0.3
#define LOD_SSIM 0.015
#define LOD_SHARE 0.35
enum { CELLS_LEAST = 9, PHOTOS_LEAST = 300, LOD_FAR = 16 };

struct city {
    char scene[FILE_PATH_MAX], truth[FILE_PATH_MAX], results[FILE_PATH_MAX], tiles[FILE_PATH_MAX];
};

/* ---- F10: ownership ---- */

/* The trained cell that a merged one became part of. */
static size_t trained_cell(const struct partition *p, size_t i)
{
    while (p->cells[i].parent >= 0)
        i = (size_t)p->cells[i].parent;
    return i;
}

/* Of Gaussians in all cells of a level: how many cells keep each place. Inside the cells' boxes the
 * count of boxes must be 1 and the owner that box's cell, or the trained one it was merged into;
 * everywhere the owner must be one trained cell. */
static void count_owners(const struct city *c, const struct partition *p)
{
    struct err e = {0};
    size_t n = 0, kept = 0, strip = 0, wrong = 0, cells = 0;
    for (size_t i = 0; i < p->n_cells; i++) {
        char path[2 * FILE_PATH_MAX];
        struct ckpt k;
        if (p->cells[i].parent >= 0)
            continue;
        cells++;
        snprintf(path, sizeof path, "%s/cells/%s/level3.ckpt", c->results, p->cells[i].id);
        kit_ok(ckpt_read(path, &k, &e), e);
        for (size_t g = 0; g < k.g.n; g++) {
            double x = k.g.origin_enu_m[0] + (double)k.g.mean_m[3 * g],
                   y = k.g.origin_enu_m[1] + (double)k.g.mean_m[3 * g + 1];
            size_t boxes = 0, box = 0, owner = partition_owner(p, x, y);
            bool near = false;
            for (size_t j = 0; j < p->n_cells; j++) {
                const struct partition_cell *b = &p->cells[j];
                bool in =
                    x >= b->min_m[0] && x < b->max_m[0] && y >= b->min_m[1] && y < b->max_m[1];
                boxes += in;
                box = in ? j : box;
                near = near || (j != owner && partition_distance(b, x, y) < 0.02 * p->edge_m);
            }
            wrong += boxes > 1 || owner >= p->n_cells || p->cells[owner].parent >= 0 ||
                     (boxes && owner != trained_cell(p, box));
            strip += near;
            kept += owner == i;
            n++;
        }
        ckpt_free(&k);
    }
    struct store *s = NULL;
    size_t n_tiles, stored = 0;
    kit_ok(store_open(c->tiles, &s, &e), e);
    const struct store_tile *t = store_tiles(s, &n_tiles);
    for (size_t i = 0; i < n_tiles; i++)
        stored += t[i].level == 3 ? t[i].count : 0;
    store_close(&s);
    kit_figure("F10",
               "cells=%zu gaussians=%zu in_border_strips=%zu not_owned_once=%zu limit=0 kept=%zu "
               "stored=%zu",
               cells, n, strip, wrong, kept, stored);
    assert_true(strip > 0);
    assert_int_equal(wrong, 0);
    assert_int_equal(stored, kept);
}

/* ---- F10: the picture near borders; levels of detail ---- */

struct sums {
    double all, near, middle, ssim, psnr;
    size_t n_all, n_near, n_middle, photos;
    uint64_t gaussians;
};

/* Is the ground within r of a border between two cells? */
static bool near_border(const struct partition *p, double x, double y, double r)
{
    size_t o = partition_owner(p, x, y);
    return partition_owner(p, x - r, y) != o || partition_owner(p, x + r, y) != o ||
           partition_owner(p, x, y - r) != o || partition_owner(p, x, y + r) != o;
}

/* Squared error of pixels, all of them and those whose surface lies within SEAM_PX of a border.
 * As a control, the same of lines through the middle of the cells, where nothing can go wrong.
 * depth: [h][w] along the axis, m, 0 = sky; NULL counts none as near. */
static void add_errors(const struct partition *p, const struct camera *cam, const float *depth,
                       const float *rgb, const uint8_t *px, struct sums *s)
{
    double eye[3];
    camera_center(cam, eye);
    for (size_t v = 0; v < cam->height_px; v++)
        for (size_t u = 0; u < cam->width_px; u++) {
            size_t at = v * cam->width_px + u;
            double error = 0.0, d = depth ? (double)depth[at] : 0.0;
            for (size_t k = 0; k < 3; k++) {
                double x = fmin(fmax((double)rgb[3 * at + k], 0.0), 1.0) - px[3 * at + k] / 255.0;
                error += x * x / 3.0;
            }
            s->all += error;
            s->n_all++;
            if (!(d > 0.0))
                continue;
            double ray[3] = {d * ((double)u + 0.5 - cam->cx_px) / cam->fx_px,
                             d * ((double)v + 0.5 - cam->cy_px) / cam->fy_px, d};
            double world[2];
            for (size_t k = 0; k < 2; k++)
                world[k] = eye[k] + cam->rot[k] * ray[0] + cam->rot[3 + k] * ray[1] +
                           cam->rot[6 + k] * ray[2];
            double r = SEAM_PX * d / cam->fx_px, half = 0.5 * p->edge_m;
            if (near_border(p, world[0], world[1], r)) {
                s->near += error;
                s->n_near++;
            } else if (near_border(p, world[0] + half, world[1] + half, r)) {
                s->middle += error;
                s->n_middle++;
            }
        }
}

static double sums_db(double sum, size_t n)
{
    return -10.0 * log10(sum / (double)n);
}

/* The photograph at 1 / shrink, as from shrink times as far. */
static void read_photo(const char *path, uint32_t shrink, struct camera *cam, struct image *out)
{
    struct err e = {0};
    struct image full = {0};
    kit_ok(image_read(path, NULL, &full, &e), e);
    *cam = camera_resize(cam, full.width_px / shrink, full.height_px / shrink);
    kit_ok(image_resize(&full, cam->width_px, cam->height_px, out, &e), e);
    image_free(&full);
}

/* One test photograph, drawn with these options. Borders are looked at in full size only. */
static void measure_photo(const struct city *c, const struct scene *scene,
                          const struct partition *p, size_t i, uint32_t shrink, struct view *view,
                          const struct pick_options *po, struct sums *s)
{
    struct err e = {0};
    char path[3 * FILE_PATH_MAX], name[256];
    struct image photo = {0};
    struct view_stats stats;
    const struct scene_image *img = &scene->images[i];
    const struct render_options draw = {.aa = RENDER_AA_2D, .sh_degree = -1};
    float *depth = NULL;
    size_t shape[2] = {0};
    snprintf(path, sizeof path, "%s/images/%s", c->scene, img->name);
    struct camera cam = img->cam;
    read_photo(path, shrink, &cam, &photo);
    const char *dot = strrchr(img->name, '.');
    snprintf(name, sizeof name, "%.*s", (int)(dot - img->name), img->name);
    snprintf(path, sizeof path, "%s/depth/%s.npy", c->truth, name);
    kit_ok(npy_read(path, 2, shape, &depth, &e), e);
    assert_true(shrink > 1 || (shape[0] == photo.height_px && shape[1] == photo.width_px));
    float *rgb = mem_array((size_t)photo.width_px * photo.height_px * 3, sizeof *rgb);
    assert_non_null(rgb);
    kit_ok(view_render(view, &cam, &draw, po, rgb, &stats, &e), e);
    double ssim, psnr;
    kit_ok(metric_ssim(rgb, photo.px, NULL, photo.width_px, photo.height_px, METRIC_TRAINING, &ssim,
                       &e),
           e);
    kit_ok(metric_psnr(rgb, photo.px, NULL, photo.width_px, photo.height_px, &psnr, &e), e);
    add_errors(p, &cam, shrink > 1 ? NULL : depth, rgb, photo.px, s);
    s->ssim += ssim;
    s->psnr += psnr;
    s->gaussians += stats.n_gaussians;
    s->photos++;
    mem_free(rgb);
    mem_free(depth);
    image_free(&photo);
}

static struct sums measure(const struct city *c, const struct scene *scene,
                           const struct partition *p, uint32_t shrink, struct view *view,
                           const struct pick_options *po)
{
    struct sums s = {0};
    for (size_t i = 0; i < scene->n_images; i++)
        if (scene->images[i].split == SCENE_TEST)
            measure_photo(c, scene, p, i, shrink, view, po, &s);
    assert_true(s.photos > 0);
    s.psnr /= (double)s.photos;
    s.ssim /= (double)s.photos;
    return s;
}

/* Within the limits? Level of detail against the finest level everywhere, in photographs as if from
 * `far` times as far away. */
static bool measure_lod(const struct city *c, const struct scene *scene, const struct partition *p,
                        uint32_t far, struct view *view)
{
    const struct pick_options no_lod = {.no_lod = true};
    const struct {
        const char *name;
        struct pick_options o;
    } ways[] = {{"default", {0}}, {"0.5-px", {.error_px = 0.5}}};
    struct sums fine = measure(c, scene, p, far, view, &no_lod);
    bool ok = true;
    for (size_t k = 0; k < sizeof ways / sizeof ways[0]; k++) {
        struct sums lod = measure(c, scene, p, far, view, &ways[k].o);
        double share = (double)lod.gaussians / (double)fine.gaussians;
        double loss = fine.psnr - lod.psnr, photometric_ssim = fine.ssim - lod.ssim;
        kit_figure("LOD",
                   "error_px=%s times_as_far=%u share=%.2f limit=%.2f loss_db=%.2f limit=%.2f "
                   "photometric_ssim=%.4f limit=%.3f no_lod_db=%.2f",
                   ways[k].name, far, share, LOD_SHARE, loss, LOD_DB, photometric_ssim, LOD_SSIM,
                   fine.psnr);
        ok = ok && (far < LOD_FAR || k || share <= LOD_SHARE) && loss <= LOD_DB &&
             photometric_ssim <= LOD_SSIM;
    }
    return ok;
}

static struct city measured; /* of the command line */

static void measure_city(const struct city *c)
{
    struct err e = {0};
    char path[2 * FILE_PATH_MAX];
    struct scene scene;
    struct partition plan = {0};
    struct render *render = NULL;
    struct view *view = NULL;
    kit_ok(scene_read(c->scene, &scene, &e), e);
    snprintf(path, sizeof path, "%s/plan.json", c->scene);
    kit_ok(cell_plan_read(path, &scene, &plan, &e), e);
    assert_true(scene.n_images >= PHOTOS_LEAST && plan.n_cells >= CELLS_LEAST);
    count_owners(c, &plan);
    kit_ok(render_open(&toy_dev, &render, &e), e);
    kit_ok(view_open(c->tiles, render, 0, &view, &e), e);
    const struct pick_options no_lod = {.no_lod = true};
    struct sums fine = measure(c, &scene, &plan, 1, view, &no_lod);
    assert_true(fine.n_near > 0);
    double all = sums_db(fine.all, fine.n_all), near = sums_db(fine.near, fine.n_near);
    kit_figure("F10",
               "photographs=%zu all_db=%.2f near_borders_db=%.2f worse_db=%.2f limit=%.2f "
               "middle_of_cells_db=%.2f near_pixels_percent=%.1f",
               fine.photos, all, near, all - near, SEAM_DB, sums_db(fine.middle, fine.n_middle),
               100.0 * (double)fine.n_near / (double)fine.n_all);
    bool lod_ok = true;
    for (uint32_t far = 1; far <= LOD_FAR; far *= 2)
        lod_ok = measure_lod(c, &scene, &plan, far, view) && lod_ok;
    assert_true(measured.scene[0] || all >= CITY_DB);
    assert_true(all - near <= SEAM_DB);
    assert_true(lod_ok);
    view_close(&view);
    render_close(&render);
    partition_free(&plan);
    scene_free(&scene);
}

/* One command of the program; fails the test with its output. */
#define RUN(fmt, ...)                                                                              \
    do {                                                                                           \
        struct buf run_out = {0};                                                                  \
        int run_status = kit_run(&run_out, "%s " fmt, kit_program(), __VA_ARGS__);                 \
        if (run_status)                                                                            \
            fail_msg("exit %d: %s", run_status, (const char *)run_out.data);                       \
        buf_free(&run_out);                                                                        \
    } while (0)

static void a_city_of_many_cells(void **state)
{
    if (measured.scene[0]) {
        measure_city(&measured);
        return;
    }
    char dir[FILE_PATH_MAX];
    struct city c;
    kit_tmpdir(dir);
    snprintf(c.scene, sizeof c.scene, "%.500s/scene", dir);
    snprintf(c.truth, sizeof c.truth, "%.500s/city/truth", dir);
    snprintf(c.results, sizeof c.results, "%.500s/results", dir);
    snprintf(c.tiles, sizeof c.tiles, "%.500s/city.tiles", dir);
    RUN("synth -o %s/city --photos 320 --extent-m 240 --width-px 160 --height-px 120 "
        "--points 20000",
        dir);
    RUN("ingest %s/city/images %s/city/sparse/0 -o %s", dir, dir, c.scene);
    RUN("plan %s --edge-m 80 --images-few 24 --images-least 12", c.scene);
    RUN("train %s --output %s --iterations 900 --budget 4000,8000,16000 "
        "--sh-degree 1",
        c.scene, c.results);
    /* nothing but its cell decides here what a Gaussian's tile is, and that it has one */
    RUN("tile %s --trained %s --crop none -o %s", c.scene, c.results, c.tiles);
    measure_city(&c);
    kit_rmdir(dir);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_city_of_many_cells)};
    if (argc == 5) {
        snprintf(measured.scene, sizeof measured.scene, "%s", argv[1]);
        snprintf(measured.truth, sizeof measured.truth, "%s", argv[2]);
        snprintf(measured.results, sizeof measured.results, "%s", argv[3]);
        snprintf(measured.tiles, sizeof measured.tiles, "%s", argv[4]);
    } else if (argc != 1) {
        fprintf(stderr, "usage: %s [SCENE TRUTH RESULTS CITY.tiles]\n", argv[0]);
        return 2;
    }
    return cmocka_run_group_tests_name("city", tests, toy_open_device, toy_close_device);
}
