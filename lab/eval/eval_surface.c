/* citysplat-lab eval-surface; see eval_surface.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/eval_surface.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "lab/eval/eval_lab.h"
#include "lab/eval/surface_match.h"
#include "lab/eval/surface_table.h"
#include "lab/lab.h"
#include "lab/truth/map_views.h"
#include "lab/truth/surface_rays.h"
#include "lab/truth/truth_rays.h"

enum {
    SURFACE_PIECE_PX = 1024, /* of the square from above */
    SURFACE_NEAR_PX = 2,     /* a step of the truth within so many pixels is an edge */
    SURFACE_VIEW_RAYS = 50000,
    SURFACE_ASKED = 400000, /* points of either side that look for a neighbour */
    SURFACE_STATIONS = 3,   /* places a side from which the surface is looked at, */
    SURFACE_LOOKS = 5,      /* so often from each: four times aslant, once from above */
    SURFACE_LOOK_WIDTH = 480,
    SURFACE_LOOK_HEIGHT = 360
};
static const double surface_step_m = 1.0;       /* of the truth's heights, that make an edge */
static const double surface_look_height = 0.75, /* flight heights */
    surface_look_turn_deg = 37.0;               /* from one station to the next */
static const double surface_roofs = 1.5,
                    surface_roofs_m = 20.0; /* the sky begins above, as for maps */

struct eval_surface {
    const struct eval_surface_request *q;
    const struct eval_drawing *d;
    struct render *render;
    struct render_surface *surface;
    struct truth_city truth;
    struct map_views views;
    struct surface_rays above, aslant;
    struct surface_cloud model, exact;
    /* Of the frame in work, truth metres: */
    size_t room; /* pixels */
    float *median, *near, *far, *left, *met, *rgb;
    struct truth_pixel *pixel;
};

/* ---- frames ---- */

static enum err_code surface_room(struct eval_surface *v, size_t pixels, struct err *e)
{
    if (pixels <= v->room)
        return ERR_OK;
    mem_free(v->median);
    mem_free(v->pixel);
    v->room = 0;
    v->median = mem_array(pixels, 8 * sizeof *v->median);
    v->pixel = mem_array(pixels, sizeof *v->pixel);
    if (!v->median || !v->pixel)
        return err_set(e, ERR_MEM, "eval: out of memory for %zu pixels", pixels);
    v->near = v->median + pixels;
    v->far = v->near + pixels;
    v->left = v->far + pixels;
    v->met = v->left + pixels;
    v->rgb = v->met + pixels;
    v->room = pixels;
    return ERR_OK;
}

/* Draw what a camera of the truth sees, and trace it. */
static enum err_code surface_frame(struct eval_surface *v, const struct truth_view *view,
                                   struct err *e)
{
    const struct eval_drawing *d = v->d;
    struct camera cam = view->cam;
    size_t pixels = (size_t)cam.width_px * cam.height_px;
    double scale = v->truth.to_scene.scale, gaussians;
    map_views_move_camera(&v->truth.to_scene, &cam);
    if (view->orthographic) {
        cam.fx_px /= scale;
        cam.fy_px /= scale;
    }
    void *user = view->orthographic ? d->above : d->own_size ? d->own_size : d->src.user;
    enum err_code rc =
        signals_stopping() ? err_set(e, ERR_CANCEL, "stopped while scoring") : ERR_OK;
    if (!rc)
        rc = surface_room(v, pixels, e);
    if (!rc)
        rc = d->src.draw(user, &cam, v->rgb, &gaussians, e);
    const struct render_surface_maps maps = {.median_m = v->median,
                                             .near_m = v->near,
                                             .far_m = v->far,
                                             .transmittance = v->left,
                                             .met = v->met};
    if (!rc)
        rc = render_surface_run(v->surface, NULL, &maps, e);
    for (size_t i = 0; !rc && i < pixels; i++) {
        v->median[i] /= (float)scale;
        v->near[i] /= (float)scale;
        v->far[i] /= (float)scale;
    }
    return rc ? rc : truth_rays(&v->truth, view, v->pixel, e);
}

/* What a pixel's ray meets; `t` is the truth of it. */
static struct surface_ray surface_pixel(const struct eval_surface *v, const struct truth_view *view,
                                        size_t x, size_t y, const struct truth_pixel *t)
{
    double from[3], dir[3];
    size_t i = y * view->cam.width_px + x;
    double slant = truth_ray(view, (double)x + 0.5, (double)y + 0.5, from, dir);
    struct surface_ray r =
        surface_ray_make((double)v->median[i], (double)v->near[i], (double)v->far[i],
                         (double)v->left[i], (double)v->met[i], slant, (double)t->t_m);
    r.kind = t->kind;
    r.bright = t->bright;
    return r;
}

/* ---- from straight above ---- */

/* The camera over pixels [x, x + w) x [y, y + h) of the square, one GSD each, north-west first. */
static struct truth_view surface_down(const struct eval_surface *v, double x, double y, uint32_t w,
                                      uint32_t h)
{
    const struct synth_city *c = &v->truth.city;
    double cs = cos(c->yaw_rad), sn = sin(c->yaw_rad), gsd = v->truth.gsd_m;
    double top = surface_roofs * c->grid.top_m + surface_roofs_m;
    double px = -c->half_m + gsd * (x + 0.5 * w), py = c->half_m - gsd * (y + 0.5 * h);
    const double eye[3] = {cs * px - sn * py, sn * px + cs * py, top},
                 rot[9] = {cs, sn, 0, sn, -cs, 0, 0, 0, -1};
    struct truth_view view = {.orthographic = true, .shaded = true, .step = 1};
    view.cam = (struct camera){.width_px = w,
                               .height_px = h,
                               .fx_px = 1.0 / gsd,
                               .fy_px = 1.0 / gsd,
                               .cx_px = 0.5 * w,
                               .cy_px = 0.5 * h};
    memcpy(view.cam.rot, rot, sizeof rot);
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++)
            view.cam.trans[r] -= rot[3 * r + k] * eye[k];
    return view;
}

static bool surface_edge(const struct eval_surface *v, size_t wide, size_t x, size_t y)
{
    double lo = HUGE_VAL, hi = -HUGE_VAL;
    for (size_t b = y - SURFACE_NEAR_PX; b <= y + SURFACE_NEAR_PX; b++)
        for (size_t a = x - SURFACE_NEAR_PX; a <= x + SURFACE_NEAR_PX; a++) {
            lo = fmin(lo, (double)v->pixel[b * wide + a].enu[2]);
            hi = fmax(hi, (double)v->pixel[b * wide + a].enu[2]);
        }
    return hi - lo > surface_step_m;
}

static enum err_code surface_above_piece(struct eval_surface *v, double x, double y, uint32_t w,
                                         uint32_t h, struct err *e)
{
    const uint32_t margin = SURFACE_NEAR_PX;
    const struct truth_view view =
        surface_down(v, x - margin, y - margin, w + 2 * margin, h + 2 * margin);
    size_t wide = view.cam.width_px;
    enum err_code rc = surface_frame(v, &view, e);
    for (size_t b = margin; !rc && b < h + margin; b++)
        for (size_t a = margin; !rc && a < w + margin; a++) {
            struct surface_ray r = surface_pixel(v, &view, a, b, &v->pixel[b * wide + a]);
            r.edge = surface_edge(v, wide, a, b);
            rc = surface_rays_add(&v->above, &r, e);
        }
    return rc;
}

static enum err_code surface_above(struct eval_surface *v, struct err *e)
{
    enum err_code rc = ERR_OK;
    size_t side = (size_t)(2.0 * v->truth.city.half_m / v->truth.gsd_m);
    for (size_t y = 0; !rc && y < side; y += SURFACE_PIECE_PX)
        for (size_t x = 0; !rc && x < side; x += SURFACE_PIECE_PX)
            rc = surface_above_piece(
                v, (double)x, (double)y,
                (uint32_t)(side - x < SURFACE_PIECE_PX ? side - x : SURFACE_PIECE_PX),
                (uint32_t)(side - y < SURFACE_PIECE_PX ? side - y : SURFACE_PIECE_PX), e);
    return rc;
}

/* ---- along the rays of map views ---- */

static enum err_code surface_view(struct eval_surface *v, size_t n, struct err *e)
{
    const struct map_view *from = &v->views.views[n];
    struct truth_view view = {.cam = from->cam, .shaded = true};
    double pixels = (double)from->cam.width_px * from->cam.height_px;
    struct map_truth t = {0};
    view.step = (uint32_t)ceil(sqrt(pixels / SURFACE_VIEW_RAYS));
    map_views_move_camera(&v->truth.from_scene, &view.cam);
    enum err_code rc = map_views_load(&v->views, n, &t, e);
    if (!rc)
        rc = surface_frame(v, &view, e);
    const struct truth_pixel *at = v->pixel;
    for (size_t y = 0; !rc && y < view.cam.height_px; y += view.step)
        for (size_t x = 0; !rc && x < view.cam.width_px; x += view.step, at++) {
            size_t i = y * view.cam.width_px + x;
            if (t.mask[i] < MAP_VIEWS_SEEN || !t.square[i] || !(at->t_m > 0.0f))
                continue;
            const struct surface_ray r = surface_pixel(v, &view, x, y, at);
            rc = surface_rays_add(&v->aslant, &r, e);
        }
    map_truth_free(&t);
    return rc;
}

static enum err_code surface_views(struct eval_surface *v, struct err *e)
{
    char path[FILE_PATH_MAX], list[FILE_PATH_MAX];
    const char *dir = v->q->views ? v->q->views : path;
    enum err_code rc = v->q->views ? ERR_OK : file_join(path, v->q->city, "map-views", e);
    if (!rc)
        rc = file_join(list, dir, "views.json", e);
    if (!rc && !v->q->views && !file_exists(list)) {
        log_warn("eval",
                 "%s: no map views: rays from above alone; `citysplat-lab map-views %s` makes them",
                 path, v->q->city);
        return ERR_OK;
    }
    if (!rc)
        rc = map_views_read(dir, v->q->scene, &v->views, e);
    for (size_t i = 0; !rc && i < v->views.n; i++)
        rc = surface_view(v, i, e);
    return rc;
}

/* ---- points on both ---- */

/* Look k of a station at a place of the ground: from straight above, or aslant from four sides. */
static struct truth_view surface_look(const struct eval_surface *v, const double at[3],
                                      size_t station, size_t k)
{
    const struct truth_city *c = &v->truth;
    double up = surface_look_height * c->flight_m, eye[3] = {at[0], at[1], up};
    double heading = 90.0 * (double)k + surface_look_turn_deg * (double)station;
    if (k + 1 < SURFACE_LOOKS) {
        eye[0] -= up * sin(heading * M_PI / 180.0);
        eye[1] -= up * cos(heading * M_PI / 180.0);
    }
    double fov = 2.0 * atan(0.5 * SURFACE_LOOK_HEIGHT * c->gsd_m / c->flight_m);
    return (struct truth_view){.cam = camera_heading(eye, heading,
                                                     k + 1 < SURFACE_LOOKS ? -45.0 : -90.0, fov,
                                                     SURFACE_LOOK_WIDTH, SURFACE_LOOK_HEIGHT),
                               .step = 1};
}

static enum err_code surface_points(struct eval_surface *v, const struct truth_view *view,
                                    struct err *e)
{
    enum err_code rc = surface_frame(v, view, e);
    size_t w = view->cam.width_px, pixels = w * view->cam.height_px;
    for (size_t i = 0; !rc && i < pixels; i++) {
        const struct truth_pixel *t = &v->pixel[i];
        double from[3], dir[3],
            place[3] = {(double)t->enu[0], (double)t->enu[1], (double)t->enu[2]};
        if (t->t_m > 0.0f && t->inside)
            rc = surface_cloud_add(&v->exact, place,
                                   (uint8_t)surface_class_base((enum surface_class)t->kind), e);
        if (rc || !(v->median[i] > 0.0f))
            continue;
        double slant = truth_ray(view, (double)(i % w) + 0.5, (double)(i / w) + 0.5, from, dir);
        for (int k = 0; k < 3; k++)
            place[k] = from[k] + slant * (double)v->median[i] * dir[k];
        if (truth_inside(&v->truth, place))
            rc = surface_cloud_add(&v->model, place, SURFACE_CLASSES, e);
    }
    return rc;
}

static enum err_code surface_look_around(struct eval_surface *v, struct err *e)
{
    const struct synth_city *c = &v->truth.city;
    double cs = cos(c->yaw_rad), sn = sin(c->yaw_rad), pitch = 2.0 * c->half_m / SURFACE_STATIONS;
    enum err_code rc = ERR_OK;
    v->model.voxel_m = v->exact.voxel_m = 0.5 * v->truth.gsd_m;
    for (size_t s = 0; s < SURFACE_STATIONS * SURFACE_STATIONS; s++) {
        double x = ((double)(s % SURFACE_STATIONS) + 0.5) * pitch - c->half_m,
               y = ((double)(s / SURFACE_STATIONS) + 0.5) * pitch - c->half_m;
        const double at[3] = {cs * x - sn * y, sn * x + cs * y, 0.0};
        for (size_t k = 0; !rc && k < SURFACE_LOOKS; k++) {
            const struct truth_view view = surface_look(v, at, s, k);
            rc = surface_points(v, &view, e);
        }
    }
    return rc;
}

/* ---- telling ---- */

struct surface_matches {
    struct surface_match within[SURFACE_MATCHES][SURFACE_CLASSES + 1];
};

static enum err_code surface_tell_match(const struct eval_surface *v, struct surface_matches *m,
                                        struct err *e)
{
    const double within[SURFACE_MATCHES] = {v->truth.gsd_m, 2.0 * v->truth.gsd_m};
    enum err_code rc =
        surface_match_tell(&v->model, &v->exact, within, SURFACE_ASKED, m->within, e);
    if (rc)
        return rc;
    printf("%-18s %8s %8s %9s %7s %7s %9s %7s %7s\n", "points", "model", "truth", "1 GSD: P", "R",
           "F1", "2 GSD: P", "R", "F1");
    for (size_t i = 0; !rc && i <= SURFACE_BASES; i++) {
        size_t k = i ? i - 1 : SURFACE_CLASSES; /* all of them first */
        const char *name = i ? surface_class_name((enum surface_class)k) : "all";
        const struct surface_match *a = &m->within[0][k], *b = &m->within[1][k];
        char of[96];
        printf("%-18s %8zu %8zu", name, a->n_model, a->n_truth);
        surface_table_cell(10, 4, a->precision);
        surface_table_cell(8, 4, a->recall);
        surface_table_cell(8, 4, a->f1);
        surface_table_cell(10, 4, b->precision);
        surface_table_cell(8, 4, b->recall);
        surface_table_cell(8, 4, b->f1);
        putchar('\n');
        snprintf(of, sizeof of, "points: %s", name);
        rc = surface_table_row(
            v->q->rows, v->d->what, of,
            json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "precision_1_gsd", jsonc_real(a->precision),
                      "recall_1_gsd", jsonc_real(a->recall), "f1_1_gsd", jsonc_real(a->f1),
                      "precision_2_gsd", jsonc_real(b->precision), "recall_2_gsd",
                      jsonc_real(b->recall), "f1_2_gsd", jsonc_real(b->f1)),
            e);
    }
    return rc;
}

/* What a table of variants has, in one row. */
static enum err_code surface_tell_short(const struct eval_surface *v,
                                        const struct surface_matches *m, struct err *e)
{
    const struct surface_pick picks[] = {
        {.level = true}, {.kinds = surface_class_bits(SURFACE_GROUND), .level = true}, {0}};
    struct surface_figures f[3];
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < 3; i++)
        rc = surface_rays_tell(&v->above, &picks[i], v->truth.gsd_m, &f[i], e);
    if (rc)
        return rc;
    const struct surface_figures *level = &f[0], *ground = &f[1], *all = &f[2];
    return surface_table_row(
        v->q->rows, v->d->what, "surface",
        json_pack(
            "{s:f, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o}",
            "gsd_m", v->truth.gsd_m, "gaussians", jsonc_real(v->d->gaussians), "faint_share",
            jsonc_real(v->d->faint), "gaussians_met", jsonc_real(all->met), "level_median_m",
            jsonc_real(level->median_m), "level_rmse_m", jsonc_real(level->rmse_m), "level_le90_m",
            jsonc_real(level->le90_m), "above_1_m", jsonc_real(all->above[SURFACE_ABOVE - 1]),
            "follows_brightness", jsonc_real(level->follows_brightness), "ground_thickness_m",
            jsonc_real(ground->thickness_m), "ground_thickness_90_m",
            jsonc_real(ground->thickness_90_m), "ground_never_opaque", jsonc_real(ground->never),
            "ground_light_through_90", jsonc_real(ground->left_90), "f1_1_gsd",
            jsonc_real(m->within[0][SURFACE_CLASSES].f1), "f1_2_gsd",
            jsonc_real(m->within[1][SURFACE_CLASSES].f1), "wall_f1_1_gsd",
            jsonc_real(m->within[0][SURFACE_WALL].f1)),
        e);
}

static enum err_code surface_tell_all(const struct eval_surface *v, struct err *e)
{
    struct surface_matches m;
    surface_table_head(v->d, v->truth.gsd_m);
    struct surface_table t = {.what = v->d->what,
                              .rays = "from above",
                              .gsd_m = v->truth.gsd_m,
                              .edges = true,
                              .kinds = true,
                              .truth = true,
                              .rows = v->q->rows};
    enum err_code rc = surface_table_print(&t, &v->above, e);
    t.rays = "map views";
    t.edges = false;
    if (!rc)
        rc = surface_table_print(&t, &v->aslant, e);
    if (!rc)
        rc = surface_tell_match(v, &m, e);
    return rc ? rc : surface_tell_short(v, &m, e);
}

enum err_code eval_surface_run(const struct eval_surface_request *q, struct render *render,
                               const struct eval_drawing *d, struct err *e)
{
    struct eval_surface v = {.q = q, .d = d, .render = render};
    enum err_code rc = truth_city_open(q->city, q->scene, &v.truth, e);
    if (!rc)
        rc = render_surface_open(render, &v.surface, e);
    if (!rc)
        rc = surface_above(&v, e);
    if (!rc)
        rc = surface_views(&v, e);
    if (!rc)
        rc = surface_look_around(&v, e);
    if (!rc)
        rc = surface_tell_all(&v, e);
    surface_rays_free(&v.above);
    surface_rays_free(&v.aslant);
    surface_cloud_free(&v.model);
    surface_cloud_free(&v.exact);
    mem_free(v.median);
    mem_free(v.pixel);
    render_surface_close(&v.surface);
    map_views_free(&v.views);
    truth_city_close(&v.truth);
    return rc;
}

/* ---- the command ---- */

struct surface_options {
#define OPT OPTIONS_MEMBER
#include "lab/eval/eval_surface.def"
};

static const struct options_def surface_defs[] = {
#define OPT(...) OPTIONS_ROW(struct surface_options, __VA_ARGS__)
#include "lab/eval/eval_surface.def"
};

struct surface_command {
    struct eval_lab lab;
    struct surface_options o;
};

static enum err_code surface_drawing(void *user, const struct eval_drawing *d, struct err *e)
{
    const struct surface_command *v = user;
    const struct eval_surface_request q = {.city = v->lab.args.arg[1],
                                           .views = v->o.views,
                                           .scene = &v->lab.city.scene,
                                           .rows = v->lab.rows};
    return strcmp(q.city, EVAL_SURFACE_POINTS) != 0 ? eval_surface_run(&q, v->lab.city.render, d, e)
                                                    : eval_points_run(&q, v->lab.city.render, d, e);
}

enum err_code lab_eval_surface(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "eval-surface",
        .usage = "citysplat-lab eval-surface SCENE CITY|points [options]",
        .about = "Scores how solid and how far off the surface is, of the finest trained level or "
                 "of a tile store: against the procedural city that `citysplat-lab synth` made in "
                 "the folder CITY, or against the scene's own points that five photographs show.",
        .example = "citysplat-lab eval-surface scene city -o surface.json\n"
                   "citysplat-lab eval-surface scene points",
        .defs = surface_defs,
        .n_defs = sizeof surface_defs / sizeof *surface_defs,
        .min_args = 2,
        .max_args = 2};
    struct surface_command v = {0};
    enum err_code rc = eval_lab_open(&v.lab, &spec, argc, argv, &v.o, sizeof v.o, e);
    if (rc || v.lab.args.done)
        goto out;
    rc = eval_city_each(&v.lab.city, EVAL_CITY_ONE, surface_drawing, &v, e);
    if (!rc)
        rc = eval_lab_write(&v.lab, e);
out:
    eval_lab_close(&v.lab);
    return rc;
}
