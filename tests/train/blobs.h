/* The toy that whole runs of training are tested on: coloured blobs on a patch of ground,
 * photographed from above by cameras on a ring. The renderer draws the photographs, so a perfect
 * fit exists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_TRAIN_BLOBS_H
#define TESTS_TRAIN_BLOBS_H

#include "tests/stability/toy.h"
#include "train/train.h"

enum { BLOBS = 60, BLOBS_PHOTOS = 9, BLOBS_WIDTH = 64, BLOBS_HEIGHT = 48 };

extern char blobs_dir[FILE_PATH_MAX]; /* a scene, made by blobs_open */

struct camera blobs_camera(size_t i);
/* Writes a scene into the existing folder `dir`: BLOBS_PHOTOS photographs, the first one for tests,
 * and a sparse point a blob, or none. */
void blobs_write(const char *dir, bool with_points);
/* train_run into a result that is in use. */
enum err_code blobs_train(const char *dir, const struct train_config *c, struct train_result *r,
                          struct err *e) ERR_USE;
/* Two runs have the same bytes of levels 1 to finest. */
void blobs_same_levels(unsigned finest, const char *a, const char *b);

/* A run that a test changes and makes again. */
struct trial {
    const char *dir;                               /* the scene */
    char out[FILE_PATH_MAX], parts[FILE_PATH_MAX]; /* empty folders for results */
    struct train_config c;
    struct train_result r;
    struct err e;
    struct arena a;
};
/* With toy_config: of blobs_dir, with results to t->out. Free it with trial_close. */
void trial_open(struct trial *t);
/* Of the empty folder t->out, for a scene of the test's own, whose results go there too. */
void trial_open_in(struct trial *t);
enum err_code trial_run(struct trial *t) ERR_USE;
void trial_close(struct trial *t);

/* Group setup and teardown: toy_dev and blobs_dir. */
int blobs_open(void **state);
int blobs_close(void **state);

#endif
