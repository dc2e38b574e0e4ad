/* Internal to train/: hashes of the inputs of a run, which its checkpoints keep. A run whose
 * photographs, masks, poses or known depths have changed since is not the same run.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_INPUTS_H
#define TRAIN_INPUTS_H

#include "core/err.h"

struct json_t;
struct run_cell;

enum inputs_part {
    INPUTS_PHOTOGRAPHS, /* which ones train, and the bytes of their files */
    INPUTS_MASKS,       /* theirs; empty with --no-masks */
    INPUTS_POSES,       /* theirs: cameras, exposures, appearance groups; and the sparse points */
    INPUTS_DEPTHS,      /* maps and points of --depth-prior; empty: there are none */
    INPUTS_PARTS
};
struct inputs {
    char hash[INPUTS_PARTS][33];
};
/* Reads all files of the cell's photographs once. ERR_NOENT, ERR_IO: a photograph or the points
 * cannot be read. ERR_LIMIT, ERR_MEM. */
enum err_code inputs_read(const struct run_cell *job, struct inputs *out, struct err *e) ERR_USE;
/* Makes JSON for the head of a checkpoint. NULL: out of memory. */
struct json_t *inputs_to_json(const struct inputs *in);
/* Compares with the head `meta` of the checkpoint at `path`. A head of an older version has no
 * hashes, and is taken. ERR_DATA names the part that has changed. */
enum err_code inputs_check(const struct inputs *in, const char *path, const struct json_t *meta,
                           struct err *e) ERR_USE;

#endif
