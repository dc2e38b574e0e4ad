/* Chooses the neighbours that each photograph is compared with, and the heights.
 *
 * A neighbour is good if it sees many of the same points at a good angle: each shared point counts
 * exp(-(a - a0)^2 / (2 s^2)) by its angle a at the point, with a0 = 12 degrees, s = 4 degrees below
 * and 10 above (after Yao et al. 2018, MVSNet).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STEREO_PAIRS_H
#define STEREO_PAIRS_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "stereo/sweep.h"

struct scene;

enum { PAIRS_SHARED_MIN = 8 }; /* least number of points that neighbours share */

struct pairs {
    size_t n;                         /* images of the scene */
    uint32_t (*near)[SWEEP_NEAR_MAX]; /* [n], best first */
    uint8_t *n_near;                  /* [n], 0: not used, or no neighbour */
    double low_m, high_m;             /* heights of the scene's points, with a margin */
};
/* use [n_images]: photographs that may be compared. most: 1 to SWEEP_NEAR_MAX neighbours. Free *out
 * with pairs_free. ERR_DATA: the scene has no points. ERR_MEM. */
enum err_code pairs_find(const struct scene *s, const uint8_t *use, size_t most, struct pairs *out,
                         struct err *e) ERR_USE;
void pairs_free(struct pairs *p);
/* Chooses the distance of planes in metres. A step moves no neighbour's pixel by more than move_px,
 * unless more than SWEEP_PLANES_MAX planes would be needed for the heights. Fills the last three
 * members of *in from the others. Returns false if the reference does not look down. */
bool pairs_planes(const struct pairs *p, double move_px, struct sweep_input *in);

#endif
