/* A toy whose photographs were taken in changing light, for tests of appearance.
 *
 * Photographs have gains for each channel, as exposure and white balance do. The truth is drawn
 * without them, so it is known.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_STABILITY_TOY_APPEARANCE_H
#define TESTS_STABILITY_TOY_APPEARANCE_H

#include "tests/stability/toy.h"

enum { TOY_APPEARANCE_PHOTOS = 24, TOY_APPEARANCE_STEPS = 1600 };

/* Changes exposure by up to +-1 EV, and adds a tint, both times *user (a double), and noise.
 * Photographs 2 k and 2 k + 1 have the same light. Without noise the toy can be fitted to 37 dB,
 * and results then only show that an optimiser with more parameters moves more. It is a `paint` of
 * a toy. */
void toy_appearance_paint(void *user, size_t i, const struct camera *cam, double *rgb);
/* The toy with this paint; strength is borrowed. */
struct toy toy_appearance(double *strength);
/* One level of TOY_APPEARANCE_STEPS without densification, because on a toy splits are a matter of
 * chance. */
struct train_config toy_appearance_config(struct arena *a, const char *out, bool appearance);
/* Makes a scene folder of the toy; remove it with kit_rmdir. */
void toy_appearance_scene(char dir[FILE_PATH_MAX], double strength);
/* Half-image score of a run's test photographs. */
struct evaluate_score toy_appearance_score(struct toy_run *r);

#endif
