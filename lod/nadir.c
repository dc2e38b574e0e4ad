/* A store seen straight down: see nadir.h.
 *
 * Pieces have no seams and need no margin. A Gaussian is drawn in every piece that it reaches,
 * wherever its mean is. The tiles that are used depend on the scale alone, so neighbouring pieces
 * show the same Gaussians in the same order.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/nadir.h"

#include <math.h>
#include <string.h>

#include "core/appearance.h"
#include "core/base.h"
#include "core/camera.h"
#include "core/dev.h"
#include "lod/pick.h"
#include "lod/store.h"
#include "lod/view.h"
#include "render/render.h"

#define NADIR_CACHE_BYTES ((size_t)256 << 20)
#define NADIR_CEILING_SHARE 0.5 /* of the survey's own height, and */
#define NADIR_CEILING_M 20.0    /* above the survey's top */
#define NADIR_ERROR_PX 0.5      /* median sigma of the tiles taken, where there are finer ones */
#define NADIR_EARTH_M 6371000.0

enum { NADIR_WINDOW_PX = 16 /* around a ray: one tile of the renderer */ };

struct nadir {
    struct dev dev;
    bool dev_open;
    struct render *own_render; /* NULL: of the caller, as */
    struct view *own_view;
    struct view *view;
    struct render_surface *surface;
    struct area area;
    double ceiling_m; /* ENU */
    float *rgb, *depth, *transmittance;
    size_t pixels;                  /* room in them */
    bool (*stop)(const void *user); /* NULL: never */
    const void *stop_user;
};

static enum err_code nadir_appearance(struct nadir *n, const char *name, struct err *e)
{
    float image[APPEARANCE_IMAGE_MAX];
    if (!name)
        return ERR_OK;
    enum err_code rc = view_find_appearance(n->view, name, image, e);
    return rc ? rc : view_set_appearance(n->view, image, e);
}

/* What nadir_open and nadir_over have in common; n->view is set. */
static enum err_code nadir_begin(struct nadir *n, struct render *r, double ceiling_m, struct err *e)
{
    enum err_code rc = area_make(view_store(n->view), &n->area, e);
    if (!rc)
        rc = render_surface_open(r, &n->surface, e);
    double own = n->area.ceiling_m - n->area.floor_m;
    n->ceiling_m = isfinite(ceiling_m)
                       ? ceiling_m
                       : n->area.ceiling_m + NADIR_CEILING_SHARE * own + NADIR_CEILING_M;
    return rc;
}

enum err_code nadir_open(const char *store_path, const struct nadir_options *o, struct nadir **out,
                         struct err *e)
{
    *out = NULL;
    struct nadir *n = mem_array(1, sizeof *n);
    if (!n)
        return err_set(e, ERR_MEM, "%s: out of memory", store_path);
    enum err_code rc = dev_open(o->device, &n->dev, e);
    n->dev_open = !rc;
    if (!rc)
        rc = render_open(&n->dev, &n->own_render, e);
    if (!rc)
        rc = view_open(store_path, n->own_render,
                       o->cache_bytes ? o->cache_bytes : NADIR_CACHE_BYTES, &n->own_view, e);
    n->view = n->own_view;
    if (!rc)
        rc = nadir_begin(n, n->own_render, o->ceiling_m, e);
    if (!rc)
        rc = nadir_appearance(n, o->appearance, e);
    if (rc)
        nadir_close(&n);
    *out = n;
    return rc;
}

enum err_code nadir_over(struct view *v, struct render *r, double ceiling_m, struct nadir **out,
                         struct err *e)
{
    *out = NULL;
    struct nadir *n = mem_array(1, sizeof *n);
    if (!n)
        return err_set(e, ERR_MEM, "maps: out of memory");
    n->view = v;
    enum err_code rc = nadir_begin(n, r, ceiling_m, e);
    if (rc)
        nadir_close(&n);
    *out = n;
    return rc;
}

void nadir_close(struct nadir **np)
{
    struct nadir *n = *np;
    if (!n)
        return;
    area_free(&n->area);
    render_surface_close(&n->surface);
    view_close(&n->own_view);
    render_close(&n->own_render);
    if (n->dev_open)
        dev_close(&n->dev);
    mem_free(n->rgb);
    mem_free(n->depth);
    mem_free(n->transmittance);
    mem_free(n);
    *np = NULL;
}

const struct store *nadir_store(const struct nadir *n)
{
    return view_store(n->view);
}

const struct area *nadir_area(const struct nadir *n)
{
    return &n->area;
}

void nadir_set_stop(struct nadir *n, bool (*stop)(const void *user), const void *user)
{
    n->stop = stop;
    n->stop_user = user;
}

static enum err_code nadir_go(const struct nadir *n, struct err *e)
{
    return n->stop && n->stop(n->stop_user) ? err_set(e, ERR_CANCEL, "cancelled") : ERR_OK;
}

static enum err_code nadir_room(struct nadir *n, size_t pixels, struct err *e)
{
    if (pixels <= n->pixels)
        return ERR_OK;
    mem_free(n->rgb);
    mem_free(n->depth);
    mem_free(n->transmittance);
    n->rgb = mem_array(pixels, 3 * sizeof *n->rgb);
    n->depth = mem_array(pixels, sizeof *n->depth);
    n->transmittance = mem_array(pixels, sizeof *n->transmittance);
    n->pixels = n->rgb && n->depth && n->transmittance ? pixels : 0;
    return n->pixels ? ERR_OK : err_set(e, ERR_MEM, "out of memory for %zu pixels", pixels);
}

enum err_code nadir_fit(const struct nadir *n, const double lon_deg[NADIR_PLACES],
                        const double lat_deg[NADIR_PLACES], struct nadir_piece *p, double *off_px,
                        struct err *e)
{
    const double half_w = 0.5 * p->width, half_h = 0.5 * p->height,
                 at[NADIR_PLACES][2] = {{0, 0},
                                        {half_w, 0},
                                        {0, half_h},
                                        {-half_w, -half_h},
                                        {half_w, -half_h},
                                        {-half_w, half_h},
                                        {half_w, half_h}};
    const struct geo_origin here = {lon_deg[0], lat_deg[0], store_info(nadir_store(n))->origin.h_m};
    double enu[NADIR_PLACES][3];
    for (size_t i = 0; i < NADIR_PLACES; i++) {
        enum err_code rc = geo_to_enu(&here, lon_deg[i], lat_deg[i], here.h_m, enu[i], e);
        if (rc)
            return rc;
    }
    p->lon_deg = here.lon_deg;
    p->lat_deg = here.lat_deg;
    p->turn_rad = atan2(enu[NADIR_RIGHT][1], enu[NADIR_RIGHT][0]);
    p->px_per_m_x = half_w / hypot(enu[NADIR_RIGHT][0], enu[NADIR_RIGHT][1]);
    p->px_per_m_y = half_h / hypot(enu[NADIR_DOWN][0], enu[NADIR_DOWN][1]);
    double c = cos(p->turn_rad), s = sin(p->turn_rad);
    *off_px = 0;
    for (size_t i = 0; i < NADIR_PLACES; i++) {
        double u = (c * enu[i][0] + s * enu[i][1]) * p->px_per_m_x,
               v = (s * enu[i][0] - c * enu[i][1]) * p->px_per_m_y;
        *off_px = fmax(*off_px, hypot(u - at[i][0], v - at[i][1]));
    }
    return ERR_OK;
}

/* The camera stands on the vertical of the piece's centre, at the ceiling. */
static enum err_code nadir_camera(const struct nadir *n, const struct nadir_piece *p,
                                  struct camera *cam, double *eye_h_m, struct err *e)
{
    const struct geo_origin *origin = &store_info(nadir_store(n))->origin;
    double axes[9], ground[3], eye[3], lon, lat;
    double c = cos(p->turn_rad), s = sin(p->turn_rad);
    enum err_code rc = geo_to_enu(origin, p->lon_deg, p->lat_deg, origin->h_m, ground, e);
    if (!rc)
        rc = geo_local_axes(origin, p->lon_deg, p->lat_deg, axes, e);
    if (rc)
        return rc;
    /* Up by so much that z reaches the ceiling; up is (almost) z. */
    double rise = (n->ceiling_m - ground[2]) / axes[8];
    memset(cam, 0, sizeof *cam);
    for (size_t k = 0; k < 3; k++) {
        double east = axes[3 * k], north = axes[3 * k + 1], up = axes[3 * k + 2];
        eye[k] = ground[k] + rise * up;
        cam->rot[k] = c * east + s * north;
        cam->rot[3 + k] = s * east - c * north;
        cam->rot[6 + k] = -up;
    }
    for (size_t r = 0; r < 3; r++)
        for (size_t k = 0; k < 3; k++)
            cam->trans[r] -= cam->rot[3 * r + k] * eye[k];
    cam->width_px = p->width;
    cam->height_px = p->height;
    cam->cx_px = 0.5 * p->width;
    cam->cy_px = 0.5 * p->height;
    cam->fx_px = p->px_per_m_x;
    cam->fy_px = p->px_per_m_y;
    return geo_from_enu(origin, eye, &lon, &lat, eye_h_m, e);
}

/* Plane depths to heights: the ellipsoid falls away from its tangent plane by r^2 / 2 R. */
static void nadir_heights(const struct nadir *n, const struct nadir_piece *p, double eye_h_m,
                          float *height_m)
{
    for (size_t y = 0; y < p->height; y++)
        for (size_t x = 0; x < p->width; x++) {
            size_t i = y * p->width + x;
            double dx = ((double)x + 0.5 - 0.5 * p->width) / p->px_per_m_x,
                   dy = ((double)y + 0.5 - 0.5 * p->height) / p->px_per_m_y;
            height_m[i] = n->depth[i] > 0 ? (float)(eye_h_m - (double)n->depth[i] +
                                                    (dx * dx + dy * dy) / (2 * NADIR_EARTH_M))
                                          : NAN;
        }
}

/* Training fits colours over black, so the little light that passes between the Gaussians of a city
 * is in them already: dividing by what was stopped would make everything too bright. Where much
 * passes, at the rim and in holes, nothing was fitted, and what is drawn gets dark: there it is
 * divided. */
static float nadir_color(float drawn, float transmittance)
{
    static const float fitted = 0.35f, rim = 0.5f; /* at more than the latter there is no surface */
    float share = fminf(fmaxf((transmittance - fitted) / (rim - fitted), 0), 1);
    return fminf(drawn / (1 - share * transmittance), 1);
}

enum err_code nadir_draw(struct nadir *n, const struct nadir_piece *p, float *rgb, float *height_m,
                         struct err *e)
{
    struct camera cam;
    double eye_h_m;
    size_t pixels = (size_t)p->width * p->height;
    if (p->width < 1 || p->height < 1 || p->width > NADIR_SIZE_MAX || p->height > NADIR_SIZE_MAX ||
        !(p->px_per_m_x > 0) || !(p->px_per_m_y > 0))
        return err_set(e, ERR_ARG, "nadir: a piece of %u x %u px: 1 to %d, of positive size",
                       p->width, p->height, NADIR_SIZE_MAX);
    const struct render_options ro = {
        .aa = store_info(nadir_store(n))->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
        .sh_degree = -1,
        .orthographic = true};
    const struct pick_options po = {.error_px = NADIR_ERROR_PX};
    enum err_code rc = nadir_go(n, e);
    if (!rc)
        rc = nadir_room(n, pixels, e);
    if (!rc)
        rc = nadir_camera(n, p, &cam, &eye_h_m, e);
    if (!rc)
        rc = view_render(n->view, &cam, &ro, &po, n->rgb, NULL, e);
    const struct render_surface_maps maps = {.median_m = n->depth,
                                             .transmittance = n->transmittance};
    if (!rc)
        rc = render_surface_run(n->surface, NULL, &maps, e);
    if (rc)
        return rc;
    for (size_t i = 0; rgb && i < 3 * pixels; i++)
        rgb[i] = n->depth[i / 3] > 0 ? nadir_color(n->rgb[i], n->transmittance[i / 3]) : NAN;
    if (height_m)
        nadir_heights(n, p, eye_h_m, height_m);
    return ERR_OK;
}

/* A window of the camera's picture whose pixel in the middle has its centre on the ray. */
enum err_code nadir_look(struct nadir *n, const struct camera *cam, double x_px, double y_px,
                         double limit_m, struct nadir_ray *out, struct err *e)
{
    enum { PIXELS = NADIR_WINDOW_PX * NADIR_WINDOW_PX, MIDDLE = NADIR_WINDOW_PX / 2 };
    const double middle = MIDDLE + 0.5;
    const size_t at = MIDDLE * NADIR_WINDOW_PX + MIDDLE;
    float median[PIXELS], front[PIXELS], limit[PIXELS], rgb[3 * PIXELS];
    struct camera window = *cam;
    window.width_px = window.height_px = NADIR_WINDOW_PX;
    window.cx_px += middle - x_px;
    window.cy_px += middle - y_px;
    for (size_t i = 0; i < PIXELS; i++)
        limit[i] = (float)limit_m;
    const struct render_options ro = {
        .aa = store_info(nadir_store(n))->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
        .sh_degree = -1};
    const struct pick_options po = {.error_px = 0};
    const struct render_surface_maps maps = {.median_m = median, .front = front};
    *out = (struct nadir_ray){.depth_m = (double)NAN};
    enum err_code rc = nadir_go(n, e);
    if (!rc)
        rc = view_render(n->view, &window, &ro, &po, rgb, NULL, e);
    if (!rc)
        rc = render_surface_run(n->surface, limit_m > 0 ? limit : NULL, &maps, e);
    if (rc)
        return rc;
    out->found = median[at] > 0;
    out->depth_m = out->found ? (double)median[at] : (double)NAN;
    out->front = limit_m > 0 ? (double)front[at] : 0;
    return ERR_OK;
}
