/* A store seen straight down: see nadir.h.
 *
 * Pieces have no seams and need no margin. A Gaussian is drawn in every piece that it reaches,
 * wherever its mean is. The tiles that are used depend on the scale alone, so neighbouring pieces
 * show the same Gaussians in the same order.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/surface/nadir.h"

#include <math.h>
#include <string.h>

#include "codec/container/seen.h"
#include "core/base.h"
#include "core/device/dev.h"
#include "core/splat/appearance.h"
#include "core/splat/camera.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/store/store.h"
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
    struct seen_grid seen; /* how many photographs see a place; {0}: not known */
    bool seen_read;
    double ceiling_m; /* ENU */
    float *rgb, *depth, *transmittance;
    size_t pixels; /* room in them */
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
    seen_free(&n->seen);
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

/* A piece in the plane that touches the Earth in its middle: its eye, on the vertical there at the
 * ceiling, and axes to the right, down the picture and down to the ground, ENU of the store. */
struct nadir_frame {
    double eye[3], axis[3][3], eye_h_m;
};

static enum err_code nadir_frame(const struct nadir *n, const struct nadir_piece *p,
                                 struct nadir_frame *f, struct err *e)
{
    const struct geo_origin *origin = &store_info(nadir_store(n))->origin;
    double axes[9], ground[3], lon, lat, c = cos(p->turn_rad), s = sin(p->turn_rad);
    if (p->width < 1 || p->height < 1 || p->width > NADIR_SIZE_MAX + 2 * NADIR_MARGIN_MAX ||
        p->height > NADIR_SIZE_MAX + 2 * NADIR_MARGIN_MAX || !(p->px_per_m_x > 0) ||
        !(p->px_per_m_y > 0))
        return err_set(e, ERR_ARG, "nadir: a piece of %u x %u px: 1 to %d, of positive size",
                       p->width, p->height, NADIR_SIZE_MAX);
    enum err_code rc = geo_to_enu(origin, p->lon_deg, p->lat_deg, origin->h_m, ground, e);
    if (!rc)
        rc = geo_local_axes(origin, p->lon_deg, p->lat_deg, axes, e);
    if (rc)
        return rc;
    /* Up by so much that z reaches the ceiling; up is (almost) z. */
    double rise = (n->ceiling_m - ground[2]) / axes[8];
    for (size_t k = 0; k < 3; k++) {
        double east = axes[3 * k], north = axes[3 * k + 1], up = axes[3 * k + 2];
        f->eye[k] = ground[k] + rise * up;
        f->axis[0][k] = c * east + s * north;
        f->axis[1][k] = s * east - c * north;
        f->axis[2][k] = -up;
    }
    return geo_from_enu(origin, f->eye, &lon, &lat, &f->eye_h_m, e);
}

/* World -> camera of axes right, down, forward; the camera stands `back` metres behind the eye. */
static void nadir_pose(const struct nadir_frame *f, const double axis[3][3], double back,
                       struct camera *cam)
{
    for (size_t r = 0; r < 3; r++) {
        cam->trans[r] = r == 2 ? back : 0;
        for (size_t k = 0; k < 3; k++) {
            cam->rot[3 * r + k] = axis[r][k];
            cam->trans[r] -= axis[r][k] * f->eye[k];
        }
    }
}

static struct camera nadir_camera(const struct nadir_frame *f, const struct nadir_piece *p)
{
    struct camera cam = {.width_px = p->width,
                         .height_px = p->height,
                         .cx_px = 0.5 * p->width,
                         .cy_px = 0.5 * p->height,
                         .fx_px = p->px_per_m_x,
                         .fy_px = p->px_per_m_y};
    nadir_pose(f, f->axis, 0, &cam);
    return cam;
}

/* Metres from the middle of a piece to the centre of pixel (x, y), right and down. */
static void nadir_place(const struct nadir_piece *p, size_t x, size_t y, double at[2])
{
    at[0] = ((double)x + 0.5 - 0.5 * p->width) / p->px_per_m_x;
    at[1] = ((double)y + 0.5 - 0.5 * p->height) / p->px_per_m_y;
}

/* What `tile` counted. Pictures and most commands have no use for it, so it is read only here. A
 * damaged one is left out: verify finds it. */
static enum err_code nadir_read_seen(struct nadir *n, struct err *e)
{
    struct err why = {0};
    struct buf b = {0};
    if (n->seen_read)
        return ERR_OK;
    enum err_code rc = view_get_blob(n->view, SEEN_BLOB, &b, &why);
    if (!rc)
        rc = seen_decode(b.data, b.size, &n->seen, &why);
    buf_free(&b);
    if (rc == ERR_BUSY || rc == ERR_MEM)
        return err_set(e, rc, "%s", why.msg);
    if (rc && rc != ERR_NOENT)
        log_warn("store", "%s: heights are said to be as certain everywhere", why.msg);
    n->seen_read = true;
    return ERR_OK;
}

enum err_code nadir_seen(struct nadir *n, const struct nadir_piece *p, float *views, struct err *e)
{
    struct nadir_frame f;
    enum err_code rc = nadir_frame(n, p, &f, e);
    if (!rc)
        rc = nadir_read_seen(n, e);
    for (size_t i = 0; !rc && i < (size_t)p->width * p->height; i++) {
        double at[2], enu[2];
        nadir_place(p, i % p->width, i / p->width, at);
        for (size_t k = 0; k < 2; k++)
            enu[k] = f.eye[k] + at[0] * f.axis[0][k] + at[1] * f.axis[1][k];
        views[i] = (float)seen_at(&n->seen, enu[0], enu[1]);
    }
    return rc;
}

/* The ellipsoid falls away from its tangent plane by r^2 / 2 R. */
static double nadir_fall(const double at[2])
{
    return (at[0] * at[0] + at[1] * at[1]) / (2 * NADIR_EARTH_M);
}

static void nadir_heights(const struct nadir *n, const struct nadir_piece *p, double eye_h_m,
                          float *height_m)
{
    for (size_t y = 0; y < p->height; y++)
        for (size_t x = 0; x < p->width; x++) {
            size_t i = y * p->width + x;
            double at[2];
            nadir_place(p, x, y, at);
            height_m[i] =
                n->depth[i] > 0 ? (float)(eye_h_m - (double)n->depth[i] + nadir_fall(at)) : NAN;
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

/* Draw parallel rays into n->rgb, n->depth and n->transmittance. error_px: of level selection. */
static enum err_code nadir_rays(struct nadir *n, const struct camera *cam, double kernel_px2,
                                double error_px, struct err *e)
{
    const struct render_options ro = {
        .aa = store_info(nadir_store(n))->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
        .sh_degree = -1,
        .orthographic = true,
        .kernel_px2 = kernel_px2};
    const struct pick_options po = {.error_px = error_px};
    enum err_code rc = nadir_room(n, (size_t)cam->width_px * cam->height_px, e);
    if (!rc)
        rc = view_render(n->view, cam, &ro, &po, n->rgb, NULL, e);
    const struct render_surface_maps maps = {.median_m = n->depth,
                                             .transmittance = n->transmittance};
    if (!rc)
        rc = render_surface_run(n->surface, NULL, &maps, e);
    return rc;
}

enum err_code nadir_draw(struct nadir *n, const struct nadir_piece *p, float *rgb, float *height_m,
                         struct err *e)
{
    struct nadir_frame f;
    enum err_code rc = nadir_frame(n, p, &f, e);
    if (rc)
        return rc;
    const struct camera cam = nadir_camera(&f, p);
    rc = nadir_rays(n, &cam, p->kernel_px2, NADIR_ERROR_PX, e);
    if (rc)
        return rc;
    for (size_t i = 0; rgb && i < 3 * (size_t)p->width * p->height; i++)
        rgb[i] = n->depth[i / 3] > 0 ? nadir_color(n->rgb[i], n->transmittance[i / 3]) : NAN;
    if (height_m)
        nadir_heights(n, p, f.eye_h_m, height_m);
    return ERR_OK;
}

/* ---- aslant ---- */

/* Rays that go `along` a horizontal axis of the piece and down as much. A place at `along` metres
 * and height z above the eye lies on row (-along - z) px_per_m; rows are counted from the edge that
 * rays come over, at the height of the store's origin, so pieces side by side count alike. */
struct nadir_side {
    double along[2], across[2]; /* unit axes: right, down */
    double px_per_m_along, px_per_m_across, coarse;
    uint32_t px_along, px_across; /* of the piece */
    double row;                   /* of a place at along 0, z 0 */
    double first;                 /* row of the picture's top, in its own pixels */
    uint32_t rows;                /* of the picture */
};
static const double nadir_half = 0.70710678118654752; /* sine and cosine of 45 degrees */

static struct nadir_side nadir_side(const struct nadir *n, const struct nadir_frame *f,
                                    const struct nadir_piece *p, unsigned way, uint32_t coarse)
{
    static const double along[NADIR_WAYS][2] = {{0, -1}, {1, 0}, {0, 1}, {-1, 0}};
    bool up = way % 2 == 0; /* the picture's columns are those of the piece */
    struct nadir_side s = {.along = {along[way][0], along[way][1]},
                           .across = {-along[way][1], along[way][0]},
                           .px_per_m_along = up ? p->px_per_m_y : p->px_per_m_x,
                           .px_per_m_across = up ? p->px_per_m_x : p->px_per_m_y,
                           .coarse = coarse,
                           .px_along = up ? p->height : p->width,
                           .px_across = up ? p->width : p->height};
    double eye_z = f->eye_h_m - store_info(nadir_store(n))->origin.h_m;
    s.row = 0.5 * s.px_along - eye_z * s.px_per_m_along;
    return s;
}

/* Row of a place, in pixels of the picture from the edge. */
static double nadir_side_row(const struct nadir_side *s, const double at[2], double z)
{
    double along = s->along[0] * at[0] + s->along[1] * at[1];
    return ((-along - z) * s->px_per_m_along + s->row) / s->coarse;
}

/* The rows that the heights need. */
static void nadir_side_span(struct nadir_side *s, const struct nadir_piece *p,
                            const struct nadir_frame *f, const float *height_m)
{
    double lo = HUGE_VAL, hi = -HUGE_VAL;
    for (size_t y = 0; y < p->height; y++)
        for (size_t x = 0; x < p->width; x++) {
            double at[2], h = (double)height_m[y * p->width + x];
            nadir_place(p, x, y, at);
            double row = nadir_side_row(s, at, h - nadir_fall(at) - f->eye_h_m);
            lo = fmin(lo, row); /* fmin and fmax take no notice of NAN */
            hi = fmax(hi, row);
        }
    s->first = floor(lo);
    s->rows = lo <= hi ? (uint32_t)fmin(floor(hi) - s->first + 1, NADIR_SLANT_ROWS_MAX) : 0;
}

static struct camera nadir_side_camera(const struct nadir_side *s, const struct nadir_frame *f,
                                       double *back)
{
    double axis[3][3];
    for (size_t k = 0; k < 3; k++) {
        double along = s->along[0] * f->axis[0][k] + s->along[1] * f->axis[1][k];
        axis[0][k] = s->across[0] * f->axis[0][k] + s->across[1] * f->axis[1][k];
        axis[1][k] = nadir_half * (f->axis[2][k] - along);
        axis[2][k] = nadir_half * (f->axis[2][k] + along);
    }
    struct camera cam = {.width_px = (uint32_t)ceil(s->px_across / s->coarse),
                         .height_px = s->rows,
                         .cx_px = 0.5 * s->px_across / s->coarse,
                         .cy_px = s->row / s->coarse - s->first,
                         .fx_px = s->px_per_m_across / s->coarse,
                         .fy_px = s->px_per_m_along / (nadir_half * s->coarse)};
    /* What lies at the near edge at the height of the eye is at depth 0. */
    *back = nadir_half * 0.5 * s->px_along / s->px_per_m_along;
    nadir_pose(f, (const double(*)[3])axis, *back, &cam);
    return cam;
}

/* A drawing along slanted rays. */
struct nadir_aslant {
    struct nadir_frame f;
    struct nadir_side s;
    double back;
    size_t columns;
};

static enum err_code nadir_aslant(struct nadir *n, const struct nadir_piece *p, unsigned way,
                                  uint32_t coarse, const float *height_m, struct nadir_aslant *a,
                                  struct err *e)
{
    *a = (struct nadir_aslant){0};
    enum err_code rc = nadir_frame(n, p, &a->f, e);
    if (rc)
        return rc;
    a->s = nadir_side(n, &a->f, p, way, coarse);
    a->columns = (size_t)ceil(a->s.px_across / a->s.coarse);
    nadir_side_span(&a->s, p, &a->f, height_m);
    if (!a->s.rows)
        return ERR_OK;
    struct camera cam = nadir_side_camera(&a->s, &a->f, &a->back);
    double scale = fmax(cam.fx_px, cam.fy_px) / fmax(p->px_per_m_x, p->px_per_m_y);
    /* the Gaussians seen from above */
    return nadir_rays(n, &cam, p->kernel_px2, NADIR_ERROR_PX * scale, e);
}

/* Of a pixel of the drawing: rows tell -along - z, depth tells along - z. */
static void nadir_aslant_meets(const struct nadir_aslant *a, double row, double depth,
                               double *along, double *z)
{
    double down = ((a->s.first + row + 0.5) * a->s.coarse - a->s.row) / a->s.px_per_m_along,
           forward = (depth - a->back) / nadir_half;
    *along = 0.5 * (forward - down);
    *z = -0.5 * (down + forward);
}

enum err_code nadir_slant_points(struct nadir *n, const struct nadir_piece *p, unsigned way,
                                 const float *height_m,
                                 enum err_code (*visit)(void *user, const struct nadir_point *at,
                                                        struct err *e),
                                 void *user, struct err *e)
{
    struct nadir_aslant a;
    enum err_code rc = nadir_aslant(n, p, way, 1, height_m, &a, e);
    for (size_t i = 0; !rc && i < a.s.rows * a.columns; i++) {
        double along, z,
            across = ((double)(i % a.columns) + 0.5 - 0.5 * a.s.px_across) / a.s.px_per_m_across;
        if (!(n->depth[i] > 0))
            continue;
        nadir_aslant_meets(&a, (double)(i / a.columns), (double)n->depth[i], &along, &z);
        const double at[2] = {along * a.s.along[0] + across * a.s.across[0],
                              along * a.s.along[1] + across * a.s.across[1]};
        struct nadir_point point = {
            {at[0] * p->px_per_m_x + 0.5 * p->width, at[1] * p->px_per_m_y + 0.5 * p->height},
            (float)(z + a.f.eye_h_m + nadir_fall(at)),
            {0}};
        for (size_t k = 0; k < 3; k++)
            point.rgb[k] = nadir_color(n->rgb[3 * i + k], n->transmittance[i]);
        if (point.at_px[0] >= 0 && point.at_px[0] < p->width && point.at_px[1] >= 0 &&
            point.at_px[1] < p->height)
            rc = visit(user, &point, e);
    }
    return rc;
}

enum err_code nadir_slant(struct nadir *n, const struct nadir_piece *p, unsigned way,
                          uint32_t coarse, const float *height_m, float *out, struct err *e)
{
    struct nadir_aslant a;
    enum err_code rc = nadir_aslant(n, p, way, coarse, height_m, &a, e);
    if (rc)
        return rc;
    const struct nadir_side *s = &a.s;
    for (size_t y = 0; y < p->height; y++)
        for (size_t x = 0; x < p->width; x++) {
            size_t i = y * p->width + x;
            double at[2], along, z_met;
            nadir_place(p, x, y, at);
            double fall = nadir_fall(at), z = (double)height_m[i] - fall - a.f.eye_h_m,
                   row = floor(nadir_side_row(s, at, z) - s->first),
                   column =
                       floor(((s->across[0] * at[0] + s->across[1] * at[1]) * s->px_per_m_across +
                              0.5 * s->px_across) /
                             s->coarse);
            out[i] = NAN;
            if (!(row >= 0) || !(row < s->rows))
                continue;
            double depth = (double)n->depth[(size_t)row * a.columns + (size_t)column];
            nadir_aslant_meets(&a, row, depth, &along, &z_met);
            if (depth > 0)
                out[i] = (float)(z_met + a.f.eye_h_m + fall);
        }
    return ERR_OK;
}

/* ---- one ray ---- */

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
    enum err_code rc = view_render(n->view, &window, &ro, &po, rgb, NULL, e);
    if (!rc)
        rc = render_surface_run(n->surface, limit_m > 0 ? limit : NULL, &maps, e);
    if (rc)
        return rc;
    out->found = median[at] > 0;
    out->depth_m = out->found ? (double)median[at] : (double)NAN;
    out->front = limit_m > 0 ? (double)front[at] : 0;
    return ERR_OK;
}
