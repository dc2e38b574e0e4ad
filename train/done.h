/* Internal to train/: the done-file and the lock of a cell's folder.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DONE_H
#define TRAIN_DONE_H

#include "core/err.h"

struct train_cell_result;

/* Writes cells/<id>/done.json: Gaussians, scores and file size of every level, seconds, version.
 * ERR_IO, ERR_MEM. ERR_FORMAT: a level's file is missing. */
enum err_code done_write(const char *cell_dir, const struct train_cell_result *r,
                         struct err *e) ERR_USE;
/* Reads it. ERR_NOENT: there is none. ERR_FORMAT: it is no done-file, or a level's file is missing
 * or has another size. */
enum err_code done_read(const char *cell_dir, struct train_cell_result *out, struct err *e) ERR_USE;
/* Locks the folder for this process, and removes the partly written files of processes that were
 * killed. The lock ends with the descriptor, also when the process is
 * killed. ERR_BUSY: another process has it. ERR_IO: the folder cannot be written. */
enum err_code done_lock(const char *cell_dir, int *fd, struct err *e) ERR_USE;
void done_unlock(int *fd);

#endif
