/* Poses of the training photographs, refined with the Gaussians (--refine-poses).
 *
 * A photograph's pose is that of the scene, moved by six numbers that step as the Gaussians do: by
 * Adam, whenever the photograph is shown. What all of them do together says nothing about any one
 * of them: the city can be moved, turned and scaled with its cameras and looks the same. So after
 * every step the common part is taken out, and the city stays on the map where GPS or control
 * points put it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_POSE_H
#define TRAIN_POSE_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct camera;
struct scene;

enum { POSE_NUMBERS = 6, POSE_STATE = 3 * POSE_NUMBERS + 1 };
#define POSE_BLOB "poses" /* of a state to go on from: block */

struct pose_set {           /* {0} is empty: poses are the scene's; pose_free */
    size_t n;               /* photographs of the scene */
    double unit_m;          /* a step of 1 rad is as much as one of so many metres */
    double *block;          /* [n][POSE_STATE]: metres and radians, both moments, steps so far */
    double *center_m;       /* [n][3] as the scene has them */
    const uint32_t *images; /* borrowed: those that train, */
    size_t n_images;        /* which alone step and keep the gauge */
};
/* Unmoved poses. images [n_images] is borrowed. unit_m: median distance of the photographs from
 * what they show, m, positive. ERR_MEM. */
enum err_code pose_open(struct pose_set *p, const struct scene *s, const uint32_t *images,
                        size_t n_images, double unit_m, struct err *e) ERR_USE;
void pose_free(struct pose_set *p);
/* Move the camera of a photograph (index into the scene's): its centre by the first three numbers,
 * and turned about it by the others, world to camera R -> R exp([w]x). Any picture size. */
void pose_apply(const struct pose_set *p, size_t image, struct camera *cam);
/* One step of Adam against render_adam's pose_grad, of `rate` radians, and the gauge again. A
 * gradient that is not finite is left out. */
void pose_update(struct pose_set *p, size_t image, const double grad[POSE_NUMBERS], double rate);
/* Root mean squares over the training photographs, and the largest: metres and degrees. */
struct pose_report {
    double rms_m, rms_deg, largest_m, largest_deg;
};
struct pose_report pose_describe(const struct pose_set *p);
/* {"format": "citysplat-poses", "photographs": [{"name", "move_m": [3], "turn_rad": [3]}]}: of the
 * training photographs. ERR_IO, ERR_MEM. */
enum err_code pose_write(const struct pose_set *p, const struct scene *s, const char *path,
                         struct err *e) ERR_USE;
/* Back, by name; photographs that the file does not name stay. ERR_NOENT, ERR_IO, ERR_FORMAT: no
 * such file or another one, a name that the scene has not; ERR_MEM. */
enum err_code pose_read(struct pose_set *p, const struct scene *s, const char *path,
                        struct err *e) ERR_USE;

#endif
