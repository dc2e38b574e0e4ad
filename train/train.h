/* Photographs in, Gaussians at three levels of detail out.
 *
 * Reading order: level.c is the loop (one step is a dozen lines); schedule.c says what happens at
 * which step; feed.c brings photographs; init.c, densify.c and score.c decide which Gaussians there
 * are; state.c saves and restores all of it; train.c strings levels together; evaluate.c scores the
 * result. The loss and the metrics have loss/photometric.h.
 *
 * One trajectory through the levels, level 1 the coarsest: each continues from the Gaussians of the
 * one before with its own budget, densification interval and picture size (Taming 3DGS, Mallick
 * 2024, for the budgets; 3D Gaussian Splatting, Kerbl 2023, for the rest). Files of a cell:
 *   cells/<id>/level<k>.ckpt   the result of level k: Gaussians, no optimiser state
 *   cells/<id>/resume.ckpt     everything, while the cell is unfinished
 *   cells/<id>/done.json       written last
 *   cells/<id>/metrics.jsonl, config.jsonc
 * Without a plan.json (cells/partition.h) the scene is one cell, "all".
 *
 * Determinism: same seed, scene, options, device and build give the same bytes; a resumed run
 * equals the uninterrupted one. Every random number is rng_*(seed, stream, index); streams are
 * listed below.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_TRAIN_H
#define TRAIN_TRAIN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "codec/scene.h"
#include "train/config.h"
#include "train/timing.h"

struct train_cell_result {
    char id[32];
    bool was_done; /* --resume found it complete: the rest is not filled */
    uint32_t n_levels;
    size_t n_gaussians[TRAIN_LEVELS_MAX];
    double psnr_db[TRAIN_LEVELS_MAX],
        ssim[TRAIN_LEVELS_MAX]; /* test photographs at training size; NaN = none */
    double seconds;
    struct timing_seconds spent; /* of this process: what came before --resume is not in it */
};
struct train_result { /* {0} is empty; train_result_free */
    struct train_cell_result *cells;
    size_t n_cells;
    double seconds;
    size_t peak_bytes;
};
void train_result_free(struct train_result *r);
/* Do several cells with these options wait for an appearance model that they share
 * (train/shared.h)? cfg->appearance_only makes train_run train that and nothing else. */
bool train_needs_shared(const struct train_config *cfg);
/* Train the scene in `scene_dir`: the cells of its plan.json, or the one that cfg->cell names, or
 * all of it as one cell. ERR_CANCEL: stopped (signal or stop_after), the state was saved and the
 * message says how to go on. */
enum err_code train_run(const char *scene_dir, const struct train_config *cfg,
                        struct train_result *out, struct err *e) ERR_USE;
/* Indices of the photographs to train on (or, SCENE_TEST, to score), from the scene's arena. */
enum err_code train_images(struct scene *s, enum scene_split split, bool test_split, uint32_t **out,
                           size_t *n, struct err *e) ERR_USE;

#endif
