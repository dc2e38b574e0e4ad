/* citysplat-lab eval-surface SCENE points; see eval_surface.h.
 *
 * Structure from motion knows a point that many photographs show to a part of a pixel. Without a
 * truth, such points are the best reference. They say nothing about bare walls and lawns, which
 * have no points.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>

#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/math/sort.h"
#include "lab/eval/eval_surface.h"
#include "lab/eval/surface_table.h"

enum { POINTS_PHOTO_RAYS = 5000 /* of a photograph, for how solid it is */ };

struct eval_points {
    const struct eval_surface_request *q;
    const struct eval_drawing *d;
    struct render_surface *surface;
    struct surface_rays points, rays;
    /* Of the frame in work, [pixels] each: */
    float *rgb, *median, *near, *far, *left, *met;
};

/* Half of all tracks are finer than this: the depth of a point over the focal length. */
static enum err_code points_gsd(const struct scene *s, double *out, struct err *e)
{
    size_t n = 0;
    double *gsd = mem_array(s->n_tracks ? s->n_tracks : 1, sizeof *gsd), px[2], depth;
    if (!gsd)
        return err_set(e, ERR_MEM, "eval: out of memory for %zu tracks", s->n_tracks);
    for (size_t i = 0; i < s->n_tracks; i++) {
        const struct camera *cam = &s->images[s->tracks[i].image].cam;
        if (camera_project(cam, s->points[s->tracks[i].point].enu_m, 0.0, px, &depth))
            gsd[n++] = depth / cam->fx_px;
    }
    *out = n ? sort_median(gsd, n) : (double)NAN;
    mem_free(gsd);
    return ERR_OK;
}

static enum err_code points_draw(struct eval_points *p, const struct camera *cam, struct err *e)
{
    const struct eval_drawing *d = p->d;
    size_t pixels = (size_t)cam->width_px * cam->height_px;
    double gaussians;
    mem_free(p->rgb);
    p->rgb = mem_array(pixels, 8 * sizeof *p->rgb);
    if (!p->rgb)
        return err_set(e, ERR_MEM, "eval: out of memory for %zu pixels", pixels);
    p->median = p->rgb + 3 * pixels;
    p->near = p->median + pixels;
    p->far = p->near + pixels;
    p->left = p->far + pixels;
    p->met = p->left + pixels;
    const struct render_surface_maps maps = {.median_m = p->median,
                                             .near_m = p->near,
                                             .far_m = p->far,
                                             .transmittance = p->left,
                                             .met = p->met};
    enum err_code rc =
        signals_stopping() ? err_set(e, ERR_CANCEL, "stopped while scoring") : ERR_OK;
    if (!rc)
        rc = d->src.draw(d->own_size ? d->own_size : d->src.user, cam, p->rgb, &gaussians, e);
    return rc ? rc : render_surface_run(p->surface, NULL, &maps, e);
}

/* The ray of a pixel; depth_m: where the surface should be, 0: not known. */
static enum err_code points_add(const struct eval_points *p, const struct camera *cam, size_t x,
                                size_t y, double depth_m, double bright, struct surface_rays *to,
                                struct err *e)
{
    size_t i = y * cam->width_px + x;
    double u = ((double)x + 0.5 - cam->cx_px) / cam->fx_px,
           v = ((double)y + 0.5 - cam->cy_px) / cam->fy_px, slant = sqrt(u * u + v * v + 1.0);
    struct surface_ray r =
        surface_ray_make((double)p->median[i], (double)p->near[i], (double)p->far[i],
                         (double)p->left[i], (double)p->met[i], slant, slant * depth_m);
    r.bright = (float)bright;
    return surface_rays_add(to, &r, e);
}

static double points_bright(const uint8_t rgb[3])
{
    return (0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]) / 255.0;
}

/* Tracks are sorted by photograph; *at is the first of this one, afterwards the next one's. */
static enum err_code points_photo(struct eval_points *p, uint32_t image, size_t *at, struct err *e)
{
    const struct scene *s = p->q->scene;
    const struct camera *cam = &s->images[image].cam;
    size_t step = (size_t)ceil(sqrt((double)cam->width_px * cam->height_px / POINTS_PHOTO_RAYS));
    enum err_code rc = points_draw(p, cam, e);
    for (size_t y = step / 2; !rc && y < cam->height_px; y += step)
        for (size_t x = step / 2; !rc && x < cam->width_px; x += step) {
            const float *rgb = p->rgb + 3 * (y * cam->width_px + x);
            uint8_t byte[3];
            for (int k = 0; k < 3; k++)
                byte[k] = (uint8_t)(255.0f * fminf(fmaxf(rgb[k], 0.0f), 1.0f) + 0.5f);
            rc = points_add(p, cam, x, y, 0.0, points_bright(byte), &p->rays, e);
        }
    for (; !rc && *at < s->n_tracks && s->tracks[*at].image == image; ++*at) {
        const struct scene_point *q = &s->points[s->tracks[*at].point];
        double px[2], depth;
        if (q->track_length < EVAL_POINTS_SEEN || !camera_project(cam, q->enu_m, 0.0, px, &depth) ||
            !(px[0] >= 0.0 && px[1] >= 0.0) || !(px[0] < cam->width_px && px[1] < cam->height_px))
            continue;
        rc = points_add(p, cam, (size_t)px[0], (size_t)px[1], depth, points_bright(q->rgb),
                        &p->points, e);
    }
    return rc;
}

static enum err_code points_tell(const struct eval_points *p, struct err *e)
{
    const struct eval_drawing *d = p->d;
    const struct eval_surface_request *q = p->q;
    struct surface_figures f, all;
    struct surface_table t = {
        .what = d->what, .rays = "points seen", .truth = true, .rows = q->rows};
    enum err_code rc = points_gsd(q->scene, &t.gsd_m, e);
    if (rc)
        return rc;
    surface_table_head(d, t.gsd_m);
    rc = surface_table_print(&t, &p->points, e);
    t.rays = "photographs";
    t.truth = false;
    if (!rc)
        rc = surface_table_print(&t, &p->rays, e);
    if (!rc)
        rc = surface_rays_tell(&p->points, &(struct surface_pick){0}, t.gsd_m, &f, e);
    if (!rc)
        rc = surface_rays_tell(&p->rays, &(struct surface_pick){0}, t.gsd_m, &all, e);
    if (rc)
        return rc;
    return surface_table_row(
        q->rows, d->what, "surface",
        json_pack("{s:f, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "gsd_m", t.gsd_m,
                  "gaussians", jsonc_real(d->gaussians), "faint_share", jsonc_real(d->faint),
                  "gaussians_met", jsonc_real(all.met), "points_median_m", jsonc_real(f.median_m),
                  "points_rmse_m", jsonc_real(f.rmse_m), "points_nmad_m", jsonc_real(f.nmad_m),
                  "points_le90_m", jsonc_real(f.le90_m), "photographs_thickness_m",
                  jsonc_real(all.thickness_m), "photographs_thickness_90_m",
                  jsonc_real(all.thickness_90_m), "photographs_never_opaque", jsonc_real(all.never),
                  "photographs_light_through_90", jsonc_real(all.left_90)),
        e);
}

enum err_code eval_points_run(const struct eval_surface_request *q, struct render *render,
                              const struct eval_drawing *d, struct err *e)
{
    struct eval_points p = {.q = q, .d = d};
    size_t at = 0;
    enum err_code rc = render_surface_open(render, &p.surface, e);
    for (uint32_t i = 0; !rc && i < q->scene->n_images; i++)
        rc = points_photo(&p, i, &at, e);
    if (!rc && !p.points.n)
        rc = err_set(e, ERR_DATA, "%s: no point that %d photographs show: nothing to compare with",
                     q->scene->dir, EVAL_POINTS_SEEN);
    if (!rc)
        rc = points_tell(&p, e);
    surface_rays_free(&p.points);
    surface_rays_free(&p.rays);
    mem_free(p.rgb);
    render_surface_close(&p.surface);
    return rc;
}
