/* Internal to train/: trains one cell, from its first step to done.json.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_RUN_H
#define TRAIN_RUN_H

#include "core/err.h"
#include "train/base/run_cell.h"

struct train_cell_result;

/* Locks the cell's folder, trains what is missing in it and writes done.json last. ERR_BUSY:
 * another process trains the cell. ERR_ARG: the folder has a finished run with other options, or
 * options are invalid. ERR_CANCEL: stopped; the state was saved. ERR_DATA, ERR_LIMIT: it cannot be
 * trained. ERR_NOENT, ERR_IO, ERR_FORMAT: of files. ERR_MEM, ERR_DEVICE. */
enum err_code run_cell(const struct run_cell *job, struct train_cell_result *out,
                       struct err *e) ERR_USE;
#endif
