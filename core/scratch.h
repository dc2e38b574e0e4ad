/* Memory that lies in a file: what is not in use leaves memory for the disk, and comes back when it
 * is touched. The file has no name, so nothing is left of it when the process ends, however it
 * ends. Its room on the disk is reserved at once: a full disk is an error of scratch_open.
 *
 * A read error of the disk ends the process (SIGBUS), as it does for a program's own file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SCRATCH_H
#define CORE_SCRATCH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct scratch { /* {0} is none; free with scratch_close */
    uint8_t *at; /* [n_bytes], at the start of a page */
    size_t n_bytes;
    int fd;
};
/* A file of n_bytes (above 0) of zeros in a folder. ERR_IO: the disk has no room, or the folder is
 * not writable. ERR_LIMIT: no address space is left. */
enum err_code scratch_open(const char *dir, size_t n_bytes, struct scratch *out,
                           struct err *e) ERR_USE;
void scratch_close(struct scratch *s);
/* All bytes become 0; nothing is written for that where the file system can. ERR_IO. */
enum err_code scratch_zero(struct scratch *s, struct err *e) ERR_USE;

/* Whether the whole is read from its start on now, or in places: then nothing is read but what is
 * touched or fetched. */
void scratch_stream(const struct scratch *s, bool on);
/* These concern the bytes [from, to). They are advice: the content is the same before and after.
 * Do not call scratch_drop while others use these bytes. */
void scratch_fetch(const struct scratch *s, size_t from, size_t to); /* begin to read them */
void scratch_flush(const struct scratch *s, size_t from, size_t to); /* begin to write them */
/* Pages that lie in there as a whole leave memory, written where they have changed. It waits for
 * the disk. */
void scratch_drop(const struct scratch *s, size_t from, size_t to);
/* Bytes of the file that are in memory now. */
size_t scratch_held_bytes(const struct scratch *s);

/* Files in this folder lie in memory themselves (tmpfs). */
bool scratch_is_memory(const char *dir);

#endif
