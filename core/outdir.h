/* A folder that appears whole or not at all. Written beside its final place, renamed at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OUTDIR_H
#define CORE_OUTDIR_H

#include "core/base.h"

struct outdir {
    char path[FILE_PATH_MAX]; /* where it will be */
    char part[FILE_PATH_MAX]; /* where to write until then */
};
/* Make the working folder beside `path`. An existing `path` is refused, unless it is an empty
 * folder, or `overwrite` is set and it holds the file `marker` (so that only our own output can be
 * replaced). outdir_commit or outdir_abort it. ERR_ARG (refused), ERR_IO, ERR_LIMIT (path). */
enum err_code outdir_begin(const char *path, const char *marker, bool overwrite, struct outdir *out,
                           struct err *e) ERR_USE;
/* Put it in place; what was there before is removed afterwards. ERR_IO. */
enum err_code outdir_commit(struct outdir *d, struct err *e) ERR_USE;
/* Remove what was written; does nothing after a commit or on {0}. */
void outdir_abort(struct outdir *d);

#endif
