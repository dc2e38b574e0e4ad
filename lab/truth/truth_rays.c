/* What rays meet of a procedural city: see truth_rays.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/truth_rays.h"

#include <math.h>
#include <string.h>

#include "core/pool.h"
#include "lab/truth/surface_rays.h"
#include "lab/truth/truth_config.h"

static const double roof_up =
    0.2; /* least z of a normal that is no wall's, as where it is painted */

enum err_code truth_city_open(const char *folder, const struct scene *s, struct truth_city *out,
                              struct err *e)
{
    *out = (struct truth_city){0};
    enum err_code rc = truth_config(folder, &out->cfg, &out->arena, e);
    if (rc)
        rc = err_add(e, "exact surface (`citysplat synth` makes a city)");
    if (!rc)
        rc = synth_city_make(&out->cfg, &out->city, e);
    if (!rc) {
        struct synth_similarity f = synth_model_frame(&out->cfg);
        struct map_move from = {.scale = f.scale};
        memcpy(from.rot, f.rot, sizeof f.rot);
        memcpy(from.trans, f.trans, sizeof f.trans);
        rc = map_views_move(&from, s, &out->to_scene, e);
    }
    if (!rc) {
        struct lens l = synth_flight_lens(&out->cfg);
        double fx, fy, cx, cy;
        lens_focal(&l, &fx, &fy, &cx, &cy);
        out->from_scene = map_views_move_back(&out->to_scene);
        out->flight_m = synth_flight_height(&out->cfg);
        out->gsd_m = out->flight_m / fx;
    }
    if (rc)
        truth_city_close(out);
    return rc;
}

void truth_city_close(struct truth_city *c)
{
    synth_city_free(&c->city);
    arena_free(&c->arena);
    *c = (struct truth_city){0};
}

double truth_ray(const struct truth_view *v, double x_px, double y_px, double from[3],
                 double dir[3])
{
    const struct camera *cam = &v->cam;
    double x = (x_px - cam->cx_px) / cam->fx_px, y = (y_px - cam->cy_px) / cam->fy_px,
           len = v->orthographic ? 1.0 : sqrt(x * x + y * y + 1.0);
    camera_center(cam, from);
    for (int k = 0; k < 3; k++) {
        double across = x * cam->rot[k] + y * cam->rot[3 + k];
        from[k] += v->orthographic ? across : 0.0;
        dir[k] = ((v->orthographic ? 0.0 : across) + cam->rot[6 + k]) / len;
    }
    return len;
}

bool truth_inside(const struct truth_city *c, const double p[3])
{
    double cs = cos(c->city.yaw_rad), sn = sin(c->city.yaw_rad), half = c->city.half_m;
    return fabs(cs * p[0] + sn * p[1]) <= half && fabs(-sn * p[0] + cs * p[1]) <= half;
}

static enum surface_class truth_kind(const struct synth_city *c, const struct synth_hit *hit)
{
    static const enum surface_class painted[] = {[SYNTH_ASPHALT] = SURFACE_ASPHALT,
                                                 [SYNTH_MARK] = SURFACE_MARK,
                                                 [SYNTH_LAWN] = SURFACE_LAWN,
                                                 [SYNTH_BLACK] = SURFACE_BLACK,
                                                 [SYNTH_GLASS] = SURFACE_GLASS};
    enum synth_paint paint = synth_shade_paint(c, hit);
    if (paint != SYNTH_RICH)
        return painted[paint];
    if (!hit->solid)
        return SURFACE_GROUND;
    switch (hit->solid->material) {
    case SYNTH_TREE:
    case SYNTH_TRUNK:
        return SURFACE_TREE;
    case SYNTH_CAR:
    case SYNTH_CABIN:
        return SURFACE_CAR;
    default:
        return hit->local_normal[2] > roof_up ? SURFACE_ROOF : SURFACE_WALL;
    }
}

struct truth_rays_job {
    const struct truth_city *c;
    const struct truth_view *v;
    struct synth_light light;
    struct truth_pixel *out;
};

/* The city's frame is ENU turned by its yaw. */
static void truth_pixel(const struct truth_rays_job *j, double x_px, double y_px,
                        struct truth_pixel *out)
{
    const struct synth_city *city = &j->c->city;
    double from[3], dir[3], cs = cos(city->yaw_rad), sn = sin(city->yaw_rad);
    (void)truth_ray(j->v, x_px, y_px, from, dir);
    const double eye[3] = {cs * from[0] + sn * from[1], -sn * from[0] + cs * from[1], from[2]},
                 to[3] = {cs * dir[0] + sn * dir[1], -sn * dir[0] + cs * dir[1], dir[2]};
    struct synth_hit hit;
    float rgb[3];
    *out = (struct truth_pixel){0};
    synth_trace_ray(city, NULL, eye, to, &hit);
    if (!isfinite(hit.t_m))
        return;
    out->t_m = (float)hit.t_m;
    for (int k = 0; k < 3; k++)
        out->enu[k] = (float)(from[k] + hit.t_m * dir[k]);
    out->kind = (uint8_t)truth_kind(city, &hit);
    out->inside = fabs(hit.pos[0]) <= city->half_m && fabs(hit.pos[1]) <= city->half_m;
    if (!out->inside || !j->v->shaded)
        return;
    double pixel_m = (j->v->orthographic ? 1.0 : hit.t_m) / j->v->cam.fx_px;
    synth_shade_hit(city, NULL, &j->light, to, &hit, pixel_m, rgb);
    out->bright = (0.299f * synth_shade_encode(rgb[0]) + 0.587f * synth_shade_encode(rgb[1]) +
                   0.114f * synth_shade_encode(rgb[2])) /
                  255.0f;
}

static enum err_code truth_row(void *user, size_t row, struct err *e)
{
    const struct truth_rays_job *j = user;
    size_t step = j->v->step, n = (j->v->cam.width_px + step - 1) / step;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    for (size_t i = 0; i < n; i++)
        truth_pixel(j, (double)(i * step) + 0.5, (double)(row * step) + 0.5, &j->out[row * n + i]);
    return ERR_OK;
}

enum err_code truth_rays(const struct truth_city *c, const struct truth_view *v,
                         struct truth_pixel *out, struct err *e)
{
    struct truth_rays_job j = {c, v, synth_shade_light(), out};
    return pool_for((v->cam.height_px + v->step - 1) / v->step, 0, truth_row, &j, e);
}
