/* A procedural city of any size as Gaussians, without training.
 *
 * The city is districts (synth_city_district) in rows and columns about the origin. Gaussians are
 * thin discs, spread evenly over all surfaces, with the colour, sun and shadow of their place. Any
 * range of rows can be made alone, by any thread, in the memory of one district.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_SYNTH_SPLATS_H
#define LAB_SYNTH_SPLATS_H

#include "core/splat/gauss.h"
#include "scene/synth/synth.h"

struct synth_splats { /* {0} is empty; synth_splats_free */
    uint32_t seed, sh_degree;
    size_t columns, rows, n_districts;
    double *area_m2; /* [n_districts + 1] surface area in all districts before this one */
    double reach_m;  /* largest coordinate */
};
/* Plans a city that about n Gaussians cover with spacing_m between neighbours. ERR_MEM,
 * ERR_CANCEL. */
enum err_code synth_splats_open(uint32_t seed, uint32_t sh_degree, size_t n, double spacing_m,
                                struct synth_splats *out, struct err *e) ERR_USE;
void synth_splats_free(struct synth_splats *s);
/* Mean distance between neighbours where n Gaussians cover the whole city, m. */
double synth_splats_spacing(const struct synth_splats *s, size_t n);
/* Makes the rows [first, first + count) of the n that cover the city. Free *out with gauss_free.
 * They depend on the plan and n alone. Without `colour`, harmonics are 0. Any thread. ERR_MEM. */
enum err_code synth_splats_make(const struct synth_splats *s, size_t n, size_t first, size_t count,
                                bool colour, struct gauss *out, struct err *e) ERR_USE;

/* ---- synth_splats_write.c ---- */

struct synth_splats_options {
#define OPT OPTIONS_MEMBER
#include "lab/truth/synth_splats.def"
};
/* Writes o->count Gaussians into o->output. A name that ends in .ply is one file with all of
 * them. Any other name is a folder that `citysplat tile` takes: a scene without photographs, whose
 * three levels have a quarter, a half and all of them. Memory is that of a few hundred thousand
 * Gaussians. Room on the disk is checked before work starts. A .ply has no name until it is
 * complete. ERR_ARG, ERR_IO (also: not enough room), ERR_LIMIT, ERR_MEM, ERR_CANCEL. */
enum err_code synth_splats_write(const struct synth_splats_options *o, struct err *e) ERR_USE;

#endif
