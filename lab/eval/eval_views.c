/* citysplat-lab eval-views: drawings of a scene against map views (map_views.h). One row for each
 * kind of view, and one for all.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cli/train/eval_score.h"
#include "core/splat/exposure.h"
#include "lab/eval/eval_lab.h"
#include "lab/lab.h"
#include "lab/truth/map_views.h"
#include "render/render.h"

struct eval_views_options {
#define OPT OPTIONS_MEMBER
#include "lab/eval/eval_views.def"
};

static const struct options_def eval_views_defs[] = {
#define OPT(...) OPTIONS_ROW(struct eval_views_options, __VA_ARGS__)
#include "lab/eval/eval_views.def"
};

struct eval_views_kind {
    const char *name; /* borrowed from the views; "all" */
    struct map_sums sums;
};
struct eval_views {
    struct eval_lab lab;
    struct eval_views_options o;
    const char
        *pictures; /* folder for "truth | drawing | where it is wrong" of this row, or NULL */
    struct render_surface *surface;
    struct map_views views;
    struct eval_views_kind kinds[MAP_VIEWS_KINDS_MAX]; /* [0] is all */
    size_t n_kinds;
    double gaussians;
};

static void eval_views_print_head(void)
{
    printf("%-14s %-9s %5s %8s %9s %7s %8s %9s %9s %8s %8s %7s %7s %7s %7s %7s %7s %8s\n", "what",
           "kind", "views", "PSNR dB", "bright dB", "SSIM", "GMSD", "square dB", "bright dB",
           "depth %", "95 % %", ">2 %", "halo", "fog", "gaps", "haze %", "veil %", "mask %");
}

/* A number, or "-" where there was nothing to measure. */
static void eval_views_cell(int width, int digits, double v)
{
    if (isfinite(v))
        printf(" %*.*f", width, digits, v);
    else
        printf(" %*s", width, "-");
}

static enum err_code eval_views_row(const struct eval_views *v, const char *what, const char *kind,
                                    const struct map_score *m, struct err *e)
{
    printf("%-14s %-9s %5zu", what, kind, m->n_views);
    eval_views_cell(8, 3, m->psnr_db);
    eval_views_cell(9, 3, m->bright_psnr_db);
    eval_views_cell(7, 4, m->ssim);
    eval_views_cell(8, 5, m->gmsd);
    eval_views_cell(9, 3, m->square_psnr_db);
    eval_views_cell(9, 3, m->bright_square_psnr_db);
    eval_views_cell(8, 3, 100.0 * m->depth_median);
    eval_views_cell(8, 2, 100.0 * m->depth_95);
    eval_views_cell(7, 2, 100.0 * m->depth_above);
    eval_views_cell(7, 4, m->halo);
    eval_views_cell(7, 4, m->fog);
    eval_views_cell(7, 4, m->gaps);
    eval_views_cell(7, 2, 100.0 * m->haze);
    eval_views_cell(7, 2, 100.0 * m->veil);
    eval_views_cell(8, 1, 100.0 * m->supported);
    putchar('\n');
    fflush(stdout);
    json_t *row = json_pack(
        "{s:s, s:s, s:I, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, "
        "s:o, s:o, "
        "s:f}",
        "what", what, "views_of", kind, "views", (json_int_t)m->n_views, "psnr_db",
        jsonc_real(m->psnr_db), "ssim", jsonc_real(m->ssim), "gmsd", jsonc_real(m->gmsd),
        "square_psnr_db", jsonc_real(m->square_psnr_db), "bright_psnr_db",
        jsonc_real(m->bright_psnr_db), "bright_square_psnr_db",
        jsonc_real(m->bright_square_psnr_db), "depth_median", jsonc_real(m->depth_median),
        "depth_95", jsonc_real(m->depth_95), "depth_above_2pct", jsonc_real(m->depth_above), "halo",
        jsonc_real(m->halo), "fog", jsonc_real(m->fog), "gaps", jsonc_real(m->gaps), "haze",
        jsonc_real(m->haze), "veil", jsonc_real(m->veil), "mask_share", jsonc_real(m->supported),
        "unobserved_share", jsonc_real(m->unobserved), "gaussians",
        v->gaussians / (double)v->views.n);
    if (!row || json_array_append_new(v->lab.rows, row))
        return err_set(e, ERR_MEM, "eval: out of memory");
    return ERR_OK;
}

static enum err_code eval_views_kind(struct eval_views *v, const char *name, struct map_sums **out,
                                     struct err *e)
{
    for (size_t i = 1; i < v->n_kinds; i++)
        if (!strcmp(v->kinds[i].name, name)) {
            *out = &v->kinds[i].sums;
            return ERR_OK;
        }
    if (v->n_kinds == MAP_VIEWS_KINDS_MAX)
        return err_set(e, ERR_LIMIT, "%s: more than %d kinds of views", v->lab.args.arg[1],
                       MAP_VIEWS_KINDS_MAX - 1);
    v->kinds[v->n_kinds].name = name;
    *out = &v->kinds[v->n_kinds++].sums;
    return ERR_OK;
}

/* What is wrong with a pixel, over the truth in grey: red is halo, blue is haze. */
static void eval_views_wrong(const struct map_truth *t, const struct map_drawing *d,
                             const float *limit_m, size_t i, uint8_t out[3])
{
    const uint8_t *p = t->picture.px + 3 * i;
    float grey = 0.4f * (float)(p[0] + p[1] + p[2]) / 3.0f, red = 0.0f;
    bool haze =
        t->mask[i] >= MAP_VIEWS_SEEN && d->median_m[i] > 0.0f && d->median_m[i] < limit_m[i];
    if (!t->mask[i])
        red = 255.0f * fminf(fmaxf(1.0f - d->transmittance[i], 0.0f), 1.0f);
    out[0] = (uint8_t)fmaxf(grey, red);
    out[1] = (uint8_t)grey;
    out[2] = haze ? 255 : (uint8_t)grey;
}

/* Truth, drawing, and where the drawing is wrong. */
static enum err_code eval_views_picture(const struct eval_views *v, const struct map_view *view,
                                        const struct map_truth *t, const struct map_drawing *d,
                                        const float *limit_m, struct err *e)
{
    const float *rgb = d->rgb;
    char name[MAP_VIEWS_NAME + 8], path[FILE_PATH_MAX];
    struct image img = {0};
    size_t w = t->width_px, h = t->height_px;
    if (!v->pictures)
        return ERR_OK;
    snprintf(name, sizeof name, "%s.png", view->name);
    enum err_code rc = file_mkdir(v->pictures, e);
    if (!rc)
        rc = file_join(path, v->pictures, name, e);
    if (!rc)
        rc = image_alloc(3 * t->width_px, t->height_px, 3, &img, e);
    for (size_t y = 0; !rc && y < h; y++) {
        uint8_t *to = img.px + y * 9 * w;
        memcpy(to, t->picture.px + y * 3 * w, 3 * w);
        for (size_t x = 0; x < w; x++)
            eval_views_wrong(t, d, limit_m, y * w + x, to + 6 * w + 3 * x);
        for (size_t i = 0; i < 3 * w; i++)
            to[3 * w + i] = (uint8_t)(fminf(fmaxf(rgb[y * 3 * w + i], 0.0f), 1.0f) * 255.0f + 0.5f);
    }
    if (!rc)
        rc = image_write(path, &img, 0, NULL, e);
    image_free(&img);
    return rc;
}

/* Draw as that photograph would have been taken from there. */
static enum err_code eval_views_draw(const struct eval_views *v, const struct eval_drawing *d,
                                     const struct map_view *view, float *rgb, double *gaussians,
                                     struct err *e)
{
    bool lit = view->photograph != MAP_VIEWS_ONE_LIGHT;
    if (d->appearance)
        d->appearance->photograph = lit ? view->photograph : APPEARANCE_VIEW_NEAREST;
    enum err_code rc = d->src.draw(d->src.user, &view->cam, rgb, gaussians, e);
    if (!rc && lit && d->exposure)
        exposure_expose(v->lab.city.scene.images[view->photograph].exposure_ev, rgb,
                        (size_t)view->cam.width_px * view->cam.height_px);
    return rc;
}

static enum err_code eval_views_one(struct eval_views *v, const struct eval_drawing *of, size_t i,
                                    struct err *e)
{
    enum { RGB = 0, MEDIAN = 3, FRONT, LEFT, LIMIT, PLANES };
    const struct map_view *view = &v->views.views[i];
    struct map_truth t = {0};
    struct map_sums *sums = NULL;
    double gaussians = 0.0;
    size_t n = (size_t)view->cam.width_px * view->cam.height_px;
    float *px = mem_array(n, PLANES * sizeof *px);
    enum err_code rc = px ? map_views_load(&v->views, i, &t, e)
                          : err_set(e, ERR_MEM, "eval: out of memory for a picture");
    if (!rc)
        rc = eval_views_draw(v, of, view, px, &gaussians, e);
    if (!rc && of->own_size) /* the maps are of the last frame */
        rc = of->src.draw(of->own_size, &view->cam, px + MEDIAN * n, &gaussians, e);
    if (!rc) {
        const struct render_surface_maps maps = {
            .median_m = px + MEDIAN * n, .front = px + FRONT * n, .transmittance = px + LEFT * n};
        map_views_limit(&t, px + LIMIT * n);
        rc = render_surface_run(v->surface, px + LIMIT * n, &maps, e);
    }
    const struct map_drawing d = {px, px + MEDIAN * n, px + FRONT * n, px + LEFT * n};
    if (!rc)
        rc = eval_views_kind(v, view->kind, &sums, e);
    if (!rc)
        rc = map_sums_add(sums, &t, &d, e);
    if (!rc)
        rc = map_sums_add(&v->kinds[0].sums, &t, &d, e);
    if (!rc)
        rc = eval_views_picture(v, view, &t, &d, px + LIMIT * n, e);
    v->gaussians += gaussians;
    map_truth_free(&t);
    mem_free(px);
    return rc;
}

static enum err_code eval_views_drawing(void *user, const struct eval_drawing *d, struct err *e)
{
    struct eval_views *v = user;
    char path[FILE_PATH_MAX];
    v->n_kinds = 1;
    v->kinds[0] = (struct eval_views_kind){.name = "all"};
    v->gaussians = 0.0;
    enum err_code rc = eval_score_folder(v->o.pictures, d->what, path, &v->pictures, e);
    if (!rc)
        rc = map_views_read(v->lab.args.arg[1], &v->lab.city.scene, &v->views, e);
    if (!rc)
        rc = render_surface_open(v->lab.city.render, &v->surface, e);
    for (size_t i = 0; !rc && i < v->views.n; i++) {
        rc = eval_views_one(v, d, i, e);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped while scoring");
    }
    for (size_t i = 1; !rc && i <= v->n_kinds; i++) { /* all of them come last */
        struct eval_views_kind *k = &v->kinds[i % v->n_kinds];
        struct map_score m = map_sums_score(&k->sums);
        rc = eval_views_row(v, d->what, k->name, &m, e);
    }
    for (size_t i = 0; i < v->n_kinds; i++)
        map_sums_free(&v->kinds[i].sums);
    if (d->appearance)
        d->appearance->photograph = APPEARANCE_VIEW_NEAREST;
    render_surface_close(&v->surface);
    map_views_free(&v->views);
    return rc;
}

enum err_code lab_eval_views(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "eval-views",
        .usage = "citysplat-lab eval-views SCENE VIEWS [options]",
        .about = "Scores map views with ground truth (`citysplat-lab map-views`) instead of "
                 "photographs: the finest trained level, or a tile store with and without level of "
                 "detail.",
        .example = "citysplat-lab eval-views scene city/map-views -o views.json",
        .defs = eval_views_defs,
        .n_defs = sizeof eval_views_defs / sizeof *eval_views_defs,
        .min_args = 2,
        .max_args = 2};
    struct eval_views v = {0};
    enum err_code rc = eval_lab_open(&v.lab, &spec, argc, argv, &v.o, sizeof v.o, e);
    if (rc || v.lab.args.done)
        goto out;
    eval_views_print_head();
    rc = eval_city_each(&v.lab.city, EVAL_CITY_FINEST, eval_views_drawing, &v, e);
    if (!rc)
        rc = eval_lab_write(&v.lab, e);
out:
    eval_lab_close(&v.lab);
    return rc;
}
