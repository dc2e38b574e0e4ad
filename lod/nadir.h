/* A store seen straight down: colour and height of the surface, orthographically, for a piece of
 * ground at a time.
 *
 * The surface is where transmittance, on its way down, falls to 1/2: the depth of the Gaussian at
 * which it does. Of haze above a roof and of Gaussians below it the median takes no notice, where a
 * mean would be moved by both; see docs/survey.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_NADIR_H
#define LOD_NADIR_H

#include "lod/area.h"

struct camera;
struct render;
struct view;

enum { NADIR_SIZE_MAX = 2048 }; /* px, of a piece */

struct nadir; /* a store, a renderer and what was surveyed; one caller at a time */
struct nadir_options {
    const char *device;     /* OpenCL device, see dev_open */
    const char *appearance; /* see lod/bake.h; NULL: the store's default one */
    double ceiling_m;   /* ENU: what is higher is not drawn; NAN: half of the survey's own height
                               and 20 m above it */
    size_t cache_bytes; /* of decoded tiles; 0: 256 MiB */
};
/* ERR_NOENT, ERR_FORMAT, ERR_DATA: no usable store; ERR_DEVICE, ERR_MEM; ERR_NOENT or ERR_ARG:
 * appearance. */
enum err_code nadir_open(const char *store_path, const struct nadir_options *o, struct nadir **out,
                         struct err *e) ERR_USE;
/* The same over a view and a renderer that the caller keeps, draws other pictures with, and closes
 * after this; ceiling_m as in the options. The appearance is the view's. ERR_DATA, ERR_DEVICE,
 * ERR_MEM. */
enum err_code nadir_over(struct view *v, struct render *r, double ceiling_m, struct nadir **out,
                         struct err *e) ERR_USE;
void nadir_close(struct nadir **n);
const struct store *nadir_store(const struct nadir *n);
const struct area *nadir_area(const struct nadir *n);

/* From here on nadir_draw and nadir_look, and so whatever draws with them, ask before they begin,
 * and are ERR_CANCEL when it is true. NULL: never. */
void nadir_set_stop(struct nadir *n, bool (*stop)(const void *user), const void *user);

/* A piece of ground: pixel (u, v), the top left corner being (0, 0), lies on the vertical through
 * center + (u - width / 2) (1 / scale_x) right + (v - height / 2) (1 / scale_y) down. */
struct nadir_piece {
    double lon_deg, lat_deg;       /* of the centre */
    double turn_rad;               /* of right, anticlockwise from east */
    double px_per_m_x, px_per_m_y; /* on the ground */
    uint32_t width, height;        /* up to NADIR_SIZE_MAX */
};
/* Places that say where a piece lies: its middle, the middles of its right and its lower edge, its
 * corners: top left, top right, bottom left, bottom right. */
enum { NADIR_MIDDLE, NADIR_RIGHT, NADIR_DOWN, NADIR_CORNER, NADIR_PLACES = 7 };
/* The piece of p->width x p->height pixels at these places. off_px: how far its plane is from them
 * at most. ERR_ARG: no places on Earth. */
enum err_code nadir_fit(const struct nadir *n, const double lon_deg[NADIR_PLACES],
                        const double lat_deg[NADIR_PLACES], struct nadir_piece *p, double *off_px,
                        struct err *e) ERR_USE;
/* rgb [h][w][3], 0 to 1, as photographs were fitted; height_m [h][w], ellipsoidal; both NAN where
 * less than half of the light is stopped. Either may be NULL. ERR_ARG: size or place; ERR_CANCEL,
 * ERR_DEVICE, ERR_FORMAT (a damaged tile), ERR_MEM, ERR_LIMIT. */
enum err_code nadir_draw(struct nadir *n, const struct nadir_piece *p, float *rgb, float *height_m,
                         struct err *e) ERR_USE;

/* What one ray of a perspective camera meets. */
struct nadir_ray {
    bool found;     /* half of the light is stopped somewhere */
    double depth_m; /* along the optical axis, to the surface; NAN: none */
    double front;   /* share of the light that is stopped nearer than the limit */
};
/* The ray through (x, y) of the picture, the top left corner being (0, 0). limit_m: a depth; 0:
 * front is 0. Errors of nadir_draw: ERR_ARG (camera), ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_MEM,
 * ERR_LIMIT. */
enum err_code nadir_look(struct nadir *n, const struct camera *cam, double x_px, double y_px,
                         double limit_m, struct nadir_ray *out, struct err *e) ERR_USE;

#endif
