/* Chooses the neighbours that each photograph is compared with, and the heights.
 *
 * Each part of a picture needs neighbours that show its ground, at a good angle. A neighbour shows
 * a part with weight exp(-(a - a0)^2 / (2 s^2)), where a is the angle between both rays at the
 * ground, a0 = 12 degrees, s = 4 degrees below and 10 above (after Yao et al. 2018, MVSNet). A part
 * that chosen neighbours show with weights of sum c counts (1 + c)^-8 for the next one. Otherwise
 * corners of a picture at the rim of the survey, which few photographs show, had no neighbour
 * (docs/decisions/007-stereo.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_STEREO_PAIRS_H
#define SCENE_STEREO_PAIRS_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "scene/stereo/sweep.h"

struct scene;

enum {
    PAIRS_SHARED_MIN = 8, /* least number of points that neighbours share */
    PAIRS_NEAR_MAX = 16   /* neighbours whose maps are compared; the first of them are swept */
};

struct pairs {
    size_t n;                         /* images of the scene */
    uint32_t (*near)[PAIRS_NEAR_MAX]; /* [n], best first */
    uint8_t *n_near;                  /* [n], 0: not used, or no neighbour */
    uint8_t *n_swept;                 /* [n], the first of them */
    double low_m, high_m;             /* heights of the scene's points, with a margin */
};
/* use [n_images]: photographs that may be compared. swept: 1 to SWEEP_NEAR_MAX. Free *out with
 * pairs_free. ERR_DATA: the scene has no points. ERR_MEM. */
enum err_code pairs_find(const struct scene *s, const uint8_t *use, size_t swept, struct pairs *out,
                         struct err *e) ERR_USE;
void pairs_free(struct pairs *p);
/* Chooses the distance of planes in metres. A step moves no neighbour's pixel by more than move_px,
 * unless more than SWEEP_PLANES_MAX planes would be needed for the heights. Fills the last three
 * members of *in from the others. Returns false if the reference does not look down. */
bool pairs_planes(const struct pairs *p, double move_px, struct sweep_input *in);

#endif
