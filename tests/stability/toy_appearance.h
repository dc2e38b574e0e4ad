/* A toy whose photographs were taken in changing light, for the tests of appearance.
 *
 * Photographs get gains per channel, as exposure and white balance do; whatever a test asks about
 * is known, because the truth is drawn without them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_STABILITY_TOY_APPEARANCE_H
#define TESTS_STABILITY_TOY_APPEARANCE_H

#include "tests/stability/toy.h"

enum { TOY_APPEARANCE_PHOTOS = 24, TOY_APPEARANCE_STEPS = 1600 };

/* Exposure of up to +-1 EV and tint times *user (a double), in pairs: photographs 2 k and 2 k + 1
 * have the same light. And the noise that photographs have: without it the toy can be fitted to 37
 * dB, where what shows is only how restless an optimiser with more parameters is. A toy's paint. */
void toy_appearance_paint(void *user, size_t i, const struct camera *cam, double *rgb);
/* The toy, painted so; strength is borrowed. */
struct toy toy_appearance(double *strength);
/* One level of TOY_APPEARANCE_STEPS without densification: who is split is chance on a toy. */
struct train_config toy_appearance_config(struct arena *a, const char *out, bool appearance);
/* A scene folder of it, made here: kit_rmdir it. */
void toy_appearance_scene(char dir[FILE_PATH_MAX], double strength);
/* Half-image score of a run's test photographs. */
struct evaluate_score toy_appearance_score(struct toy_run *r);

#endif
