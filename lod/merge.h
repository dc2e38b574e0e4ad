/* Two stores into one: merge.c, see there.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_MERGE_H
#define LOD_MERGE_H

#include <stddef.h>

#include "core/err.h"

struct merge_report {
    size_t n_written, n_copied; /* tiles made of both or moved; taken over as they are */
    double turn_deg;            /* between the frames of the two */
    char revision[13];
};
/* Two stores of neighbouring places in one, in the frame of the first: tiles of both with one key
 * are made of both's Gaussians. Origins may differ; rows of the second are then moved and turned,
 * SH too. Ground that both cover shows both. name NULL = the first's. Attributions are put side by
 * side, each once; the appearance model has the photographs of both and the first's default
 * appearance; of other blobs of one name the first's is kept.
 * report may be NULL. One caller at a time a path; works on all cores.
 * ERR_DATA when embeddings, the models that read them, or anti-aliasing do not fit; ERR_ARG for a
 * store and itself, or a name that is too long; ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM,
 * ERR_CANCEL. */
enum err_code merge_build(const char *path_a, const char *path_b, const char *name,
                          const char *out_path, struct merge_report *report, struct err *e) ERR_USE;

#endif
