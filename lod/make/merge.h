/* Merges two stores: see merge.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_MERGE_H
#define LOD_MERGE_H

#include <stddef.h>

#include "core/err.h"

struct merge_report {
    /* written: tiles made of both stores, or moved; copied: tiles taken unchanged */
    size_t n_written, n_copied;
    double turn_deg; /* rotation between the frames of the stores */
    char revision[13];
};
/* Merges two stores of neighbouring places, in the frame of the first. A tile that both have is
 * made of the Gaussians of both. If the origins differ, the rows of the second store are moved and
 * rotated, SH too. Where both cover the same ground, both are visible. name NULL: that of the
 * first. Attributions are joined, each once. The appearance model has the photographs of both, and
 * the default appearance of the first. Where both have another blob of the same name, that of the
 * first store is kept. report may be NULL. Only one caller at a time may use a path. It uses all
 * cores. ERR_DATA: embeddings, appearance models or anti-aliasing do not match. ERR_ARG: both paths
 * are the same store, or the name is too long. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM, ERR_CANCEL.
 */
enum err_code merge_build(const char *path_a, const char *path_b, const char *name,
                          const char *out_path, struct merge_report *report, struct err *e) ERR_USE;

#endif
