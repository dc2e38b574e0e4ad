/* Photographs that do not fit: how far each training photograph is from its drawing, and how
 * unusual that distance is among all photographs. A photograph with a wrong pose, of another season
 * or with a thumb on the lens stands out.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RESIDUAL_H
#define TRAIN_RESIDUAL_H

#include "core/base.h"

struct camera;
struct footprint;
struct photo;

#define RESIDUAL_LIMIT 3.0 /* robust z-scores above it are suspicious */

struct residual {         /* one photograph */
    const char *name;     /* borrowed from the scene */
    double mse;           /* mean squared error, colours 0..1 */
    double ssim;          /* zero padded, as in the loss */
    double coverage;      /* how many photographs show the same; 0: not known */
    double z_mse, z_ssim; /* by residual_rank: of ln mse, of 1 - ssim; larger fits worse */
    double z;             /* the larger of the two */
};
struct residual_list { /* {0} is empty; residual_free */
    struct residual *rows;
    size_t n, cap;
    size_t n_suspicious; /* by residual_rank */
};
/* Add a row. ERR_MEM. */
enum err_code residual_add(struct residual_list *l, const char *name, double mse, double ssim,
                           double coverage, struct err *e) ERR_USE;
/* Of a camera: mean of log2(1 + training photographs that show a place) over places of its picture.
 * 0 without ground. */
double residual_coverage(const struct footprint *ground, const struct camera *cam);
/* From a mean over all pixels, in which masked pixels count as a perfect fit, to the mean over the
 * pixels that the mask leaves. */
double residual_ssim(const struct photo *p, double ssim);
double residual_mse(const struct photo *p, double mse);
void residual_clear(struct residual_list *l); /* n = 0, the room stays */
void residual_free(struct residual_list *l);

/* Robust z-scores, 0.6745 (x - median) / MAD (Iglewicz and Hoaglin 1993), of the logarithm of the
 * squared error and of 1 - SSIM, among the third of the photographs (at least 16, at most 200)
 * whose coverage is nearest: at the rim of a survey all fit worse. Sorts the rows by z, worst
 * first, ties by name. A MAD below a thousandth of what the numbers are made of counts as that, so
 * that photographs which all fit alike are not suspected for rounding. ERR_MEM. */
enum err_code residual_rank(struct residual_list *l, struct err *e) ERR_USE;
/* The same for one column: z[n]; scratch[n]. `least`: of the MAD. */
void residual_z(const double *x, size_t n, double least, double *scratch, double *z);

/* After residual_rank: {"what": ..., "photographs": [worst first]} into a file. ERR_IO,
 * ERR_MEM. */
enum err_code residual_write(const struct residual_list *l, const char *path, const char *what,
                             struct err *e) ERR_USE;

#endif
