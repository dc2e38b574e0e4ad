/* A store seen straight down: colour and height of the surface, orthographically, for a piece of
 * ground at a time.
 *
 * The surface is where transmittance, on its way down, falls to 1/2: the depth of the Gaussian at
 * which it does. Of haze above a roof and of Gaussians below it the median takes no notice, where a
 * mean would be moved by both; see docs/survey.md.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_NADIR_H
#define SURVEY_NADIR_H

#include "survey/area.h"

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
void nadir_close(struct nadir **n);
const struct store *nadir_store(const struct nadir *n);
const struct area *nadir_area(const struct nadir *n);

/* A piece of ground: pixel (u, v), the top left corner being (0, 0), lies on the vertical through
 * center + (u - width / 2) (1 / scale_x) right + (v - height / 2) (1 / scale_y) down. */
struct nadir_piece {
    double lon_deg, lat_deg;       /* of the centre */
    double turn_rad;               /* of right, anticlockwise from east */
    double px_per_m_x, px_per_m_y; /* on the ground */
    uint32_t width, height;        /* up to NADIR_SIZE_MAX */
};
/* rgb [h][w][3], 0 to 1 and not premultiplied; height_m [h][w], ellipsoidal; both NAN where less
 * than half of the light is stopped. Either may be NULL. ERR_ARG: size or place; ERR_DEVICE,
 * ERR_FORMAT (a damaged tile), ERR_MEM, ERR_LIMIT. */
enum err_code nadir_draw(struct nadir *n, const struct nadir_piece *p, float *rgb, float *height_m,
                         struct err *e) ERR_USE;

#endif
