/* An output folder that appears only when it is complete. It is written under another name and
 * renamed at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OUTDIR_H
#define CORE_OUTDIR_H

#include "core/base.h"

struct outdir {
    char path[FILE_PATH_MAX]; /* final name */
    char part[FILE_PATH_MAX]; /* where to write until outdir_commit */
};
/* Makes the working folder beside `path`. An existing `path` is allowed in two cases: it is an
 * empty folder, or `overwrite` is set and it contains the file `marker`. The marker ensures that
 * only our own output is replaced. End with outdir_commit or outdir_abort. ERR_ARG (`path` exists),
 * ERR_IO, ERR_LIMIT (path too long). */
enum err_code outdir_begin(const char *path, const char *marker, bool overwrite, struct outdir *out,
                           struct err *e) ERR_USE;
/* Renames the folder to `path`, then removes what was there before. ERR_IO. */
enum err_code outdir_commit(struct outdir *d, struct err *e) ERR_USE;
/* Removes the working folder. After a commit, or on {0}, it does nothing. */
void outdir_abort(struct outdir *d);

#endif
