/* The place of foreign Gaussians by places that are known in their file and on the ground.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_IMPORT_FIT_H
#define CLI_IMPORT_FIT_H

#include "core/geo/geo.h"
#include "core/splat/gauss.h"
#include "scene/control/sim3.h"

enum { IMPORT_FIT_MOST = 100 };
struct import_fit {
    size_t n;
    double file[IMPORT_FIT_MOST][3];   /* as the file has them */
    double ground[IMPORT_FIT_MOST][3]; /* longitude, latitude, degrees; ellipsoidal height, m */
    struct geo_origin origin;          /* in their middle */
    struct sim3 sim;                   /* of the turned file into east-north-up about the origin */
};
/* Reads lines "x y z longitude latitude height". ERR_ARG: a place is none on Earth. ERR_DATA: fewer
 * than three, or more than IMPORT_FIT_MOST. ERR_FORMAT, ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code import_fit_read(const char *path, struct import_fit *out, struct err *e) ERR_USE;
/* Fits origin and sim to places that were turned as the file is: turned [n][3]. It prints how far
 * each place is off. ERR_DATA: they lie on a line. ERR_ARG, ERR_MEM. */
enum err_code import_fit_make(struct import_fit *io, const double (*turned)[3],
                              struct err *e) ERR_USE;
/* Scales means and sizes, not the origin. */
void import_fit_scale(struct gauss *g, double scale);
/* Brings Gaussians into the frame about the origin. */
void import_fit_apply(const struct import_fit *f, struct gauss *g);

#endif
