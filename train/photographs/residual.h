/* Photographs that do not fit: the difference between each training photograph and its drawing, and
 * how unusual the difference is among all photographs. This finds photographs with a wrong pose, of
 * another season, or with a thumb on the lens.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RESIDUAL_H
#define TRAIN_RESIDUAL_H

#include "core/base.h"

struct camera;
struct footprint;
struct photo;

#define RESIDUAL_LIMIT 3.0 /* a larger robust z-score is suspicious */

struct residual {     /* one photograph */
    const char *name; /* borrowed from the scene */
    double mse;       /* mean squared error, colours 0..1 */
    double ssim;      /* zero padded, as in the loss */
    double coverage;  /* mean log2 of the number of photographs of the same places; 0: not known */
    /* set by residual_rank: of ln mse and of 1 - ssim; a larger value fits worse */
    double z_mse, z_ssim;
    double z; /* the larger of the two */
};
struct residual_list { /* {0} is empty; residual_free */
    struct residual *rows;
    size_t n, cap;
    size_t n_suspicious; /* set by residual_rank */
};
/* Adds a row. ERR_MEM. */
enum err_code residual_add(struct residual_list *l, const char *name, double mse, double ssim,
                           double coverage, struct err *e) ERR_USE;
/* The coverage of a camera: the mean of log2(1 + number of training photographs) over places in its
 * picture. 0: without ground. */
double residual_coverage(const struct footprint *ground, const struct camera *cam);
/* Correct a mean over all pixels, in which masked pixels count as perfect, to the mean over
 * unmasked pixels. */
double residual_ssim(const struct photo *p, double ssim);
double residual_mse(const struct photo *p, double mse);
void residual_clear(struct residual_list *l); /* sets n = 0 and keeps the memory */
void residual_free(struct residual_list *l);

/* Ranks the rows by robust z-scores, 0.6745 (x - median) / MAD (Iglewicz and Hoaglin 1993), of the
 * logarithm of the squared error and of 1 - SSIM. A photograph is compared with the third of the
 * photographs (at least 16, at most 200) whose coverage is nearest, because at the rim of a survey
 * all fit worse. Rows are sorted by z, worst first, then by name. The MAD is at least a thousandth
 * of the size of the values, so that rounding does not make equal photographs suspicious. ERR_MEM.
 */
enum err_code residual_rank(struct residual_list *l, struct err *e) ERR_USE;
/* The same for one column: z [n], scratch [n]. `least`: smallest MAD. */
void residual_z(const double *x, size_t n, double least, double *scratch, double *z);

/* Writes {"what": ..., "photographs": [worst first]} to a file, after residual_rank. ERR_IO,
 * ERR_MEM. */
enum err_code residual_write(const struct residual_list *l, const char *path, const char *what,
                             struct err *e) ERR_USE;

#endif
