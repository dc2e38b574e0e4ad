/* A store seen straight down, and at an angle from four sides: colours and heights along parallel
 * rays, one piece of ground at a time. There is one ray a pixel. lod/surface/surface.h combines
 * these rays to the surface of maps and questions.
 *
 * The height of a ray is the depth of the Gaussian at which transmittance, from above, falls to
 * 1/2. This median is not affected by haze above a roof or by Gaussians below it; a mean would be
 * (docs/survey.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_NADIR_H
#define LOD_NADIR_H

#include "lod/store/area.h"

struct camera;
struct render;
struct view;

enum {
    NADIR_SIZE_MAX = 2048,      /* px, of a piece */
    NADIR_MARGIN_MAX = 64,      /* px, largest margin of a piece on each side */
    NADIR_WAYS = 4,             /* number of sides for slanted rays */
    NADIR_SLANT_ROWS_MAX = 4096 /* px, of a slanted picture; pixels beyond have no heights */
};

struct nadir; /* a store, a renderer and the surveyed area; only one thread may use it */
struct nadir_options {
    const char *device;     /* OpenCL device, see dev_open */
    const char *appearance; /* see lod/store/bake.h; NULL: the store's default */
    /* ENU height above which nothing is drawn. NAN: the survey's greatest height plus half of its
     * height range plus 20 m */
    double ceiling_m;
    size_t cache_bytes; /* as of view_open; 0: 256 MiB */
};
/* Opens a store. Close *out with nadir_close. ERR_NOENT, ERR_FORMAT, ERR_DATA: no usable store.
 * ERR_DEVICE, ERR_MEM. ERR_NOENT, ERR_ARG: of the appearance. */
enum err_code nadir_open(const char *store_path, const struct nadir_options *o, struct nadir **out,
                         struct err *e) ERR_USE;
/* As nadir_open, with a view and a renderer of the caller, who may draw other pictures with them
 * and closes them later. ceiling_m as in the options. The appearance is that of the view. ERR_DATA,
 * ERR_DEVICE, ERR_MEM. */
enum err_code nadir_over(struct view *v, struct render *r, double ceiling_m, struct nadir **out,
                         struct err *e) ERR_USE;
void nadir_close(struct nadir **n);
const struct store *nadir_store(const struct nadir *n);
const struct area *nadir_area(const struct nadir *n);

/* A piece of ground. Pixel (u, v), with (0, 0) the top left corner, is the vertical line through
 * center + (u - width / 2) (1 / scale_x) right + (v - height / 2) (1 / scale_y) down. */
struct nadir_piece {
    double lon_deg, lat_deg;       /* of the centre */
    double turn_rad;               /* of `right`, anticlockwise from east */
    double px_per_m_x, px_per_m_y; /* on the ground */
    uint32_t width, height;        /* up to NADIR_SIZE_MAX plus margins */
    double kernel_px2;             /* as in render_options; 0: of colours */
};
/* Places that define a piece: its middle, the middles of its right and lower edges, and its corners
 * (top left, top right, bottom left, bottom right). */
enum { NADIR_MIDDLE, NADIR_RIGHT, NADIR_DOWN, NADIR_CORNER, NADIR_PLACES = 7 };
/* Computes the piece of p->width x p->height pixels through these places. off_px: largest distance
 * between its plane and the places. ERR_ARG: not places on earth. */
enum err_code nadir_fit(const struct nadir *n, const double lon_deg[NADIR_PLACES],
                        const double lat_deg[NADIR_PLACES], struct nadir_piece *p, double *off_px,
                        struct err *e) ERR_USE;
/* Draws a piece. rgb [h][w][3] is 0 to 1, with the colours of the photographs. height_m [h][w] is
 * ellipsoidal. Both are NAN where less than half of the light is stopped. Either may be NULL.
 * ERR_ARG (size or place), ERR_CANCEL, ERR_DEVICE, ERR_FORMAT (a damaged tile), ERR_MEM, ERR_LIMIT.
 */
enum err_code nadir_draw(struct nadir *n, const struct nadir_piece *p, float *rgb, float *height_m,
                         struct err *e) ERR_USE;

/* Writes how many photographs see each pixel, [h][w], 0 to SEEN_VIEWS_MAX (codec/container/seen.h).
 * Where the store does not know, SEEN_VIEWS_MAX. The first call reads it. ERR_ARG (size or place),
 * ERR_BUSY (a store at an address), ERR_MEM. */
enum err_code nadir_seen(struct nadir *n, const struct nadir_piece *p, float *views,
                         struct err *e) ERR_USE;

/* Computes heights along slanted rays. out [h][w]: the ellipsoidal height at which the ray through
 * pixel i at height_m[i] has lost half of its light. NAN: nowhere, or height_m[i] is NAN. Rays go
 * down at 45 degrees, away from the edge `way` of the piece: 0 bottom, 1 left, 2 top, 3 right. A
 * pixel of this drawing is `coarse` pixels of the piece. Pieces whose corners differ by a multiple
 * of such a pixel have the same rays. ERR_ARG, ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_MEM,
 * ERR_LIMIT as in nadir_draw. */
enum err_code nadir_slant(struct nadir *n, const struct nadir_piece *p, unsigned way,
                          uint32_t coarse, const float *height_m, float *out,
                          struct err *e) ERR_USE;

/* What a slanted ray meets: pixel of the piece, from the top left corner, and height. */
struct nadir_point {
    double at_px[2];
    float height_m, rgb[3]; /* ellipsoidal; 0 to 1, as seen along the ray */
};
/* Calls `visit` with the points inside the piece that the rays of nadir_slant meet, one ray for
 * each pixel of the drawing. height_m [h][w] says how high the surface there is. ERR_ARG,
 * ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_MEM, ERR_LIMIT as in nadir_draw. Other errors are those
 * of `visit`. */
enum err_code nadir_slant_points(struct nadir *n, const struct nadir_piece *p, unsigned way,
                                 const float *height_m,
                                 enum err_code (*visit)(void *user, const struct nadir_point *at,
                                                        struct err *e),
                                 void *user, struct err *e) ERR_USE;

/* What a ray of a perspective camera meets. */
struct nadir_ray {
    bool found;     /* half of the light is stopped somewhere */
    double depth_m; /* depth of the surface along the optical axis; NAN: none */
    double front;   /* share of light that is stopped nearer than the limit */
};
/* Follows the ray through (x, y) of the picture, with (0, 0) the top left corner. limit_m is a
 * depth; 0: front is 0. ERR_ARG (camera), ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_MEM, ERR_LIMIT as
 * in nadir_draw. */
enum err_code nadir_look(struct nadir *n, const struct camera *cam, double x_px, double y_px,
                         double limit_m, struct nadir_ray *out, struct err *e) ERR_USE;

#endif
