/* Compiled OpenCL programs that are kept as files, so that a later start does not compile or parse
 * them. Only the device uses it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_PROGRAMS_H
#define CORE_PROGRAMS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base.h"

enum { PROGRAMS_KEPT = 256 }; /* files in the folder; the oldest are removed first */

/* May programs be kept in this folder? It is made if it is missing. It holds code that will be run,
 * so it must be ours, and nobody else may write to it. */
bool programs_folder(const char *dir);
/* Reads the program that was kept under `key`. A file that is cut short, damaged, of another key or
 * of another owner counts as missing. Free `out` with buf_free. */
bool programs_read(const char *dir, struct hash128 key, struct buf *out);
/* Keeps a program under `key`, then removes programs that nobody has used for a month, and the
 * oldest above PROGRAMS_KEPT. ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code programs_write(const char *dir, struct hash128 key, const void *bytes, size_t n,
                             struct err *e) ERR_USE;

#endif
