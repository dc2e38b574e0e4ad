/* The part of a remote object that is on this machine: a sparse file with one slot for each block
 * of the object, and a table in front that says which slots are filled. It is named after the
 * address and the state (entity tag) of the object, so a restart finds it again.
 *
 * Threads and processes share it without locks: a block counts only if its bytes have the hash that
 * the table names. A torn or lost write is therefore an empty slot.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_BLOCKS_H
#define LOD_BLOCKS_H

#include "lod/store/range.h"

enum { BLOCKS_BYTES = 65536 };

struct blocks; /* an open file; threads may share it */

/* Sets the folder of the files, and how much one file may hold. Where dir is NULL the folder is
 * XDG_CACHE_HOME/citysplat/stores or ~/.cache/citysplat/stores. Call it before threads start. */
void blocks_configure(const char *dir, uint64_t limit_bytes);
/* Opens the file of an object, or makes it. If the folder cannot be written, the file has no name
 * and lies in TMPDIR or /tmp. Files of other states of the object are removed. The caller closes
 * *fd. ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code blocks_make(const char *url, const struct range_object *o, int *fd,
                          struct err *e) ERR_USE;
/* Returns whether fd is such a file. */
bool blocks_is(int fd);
/* Uses an open file; fd is borrowed during the call. ERR_FORMAT (it is none), ERR_IO, ERR_MEM. */
enum err_code blocks_attach(int fd, struct blocks **out, struct err *e) ERR_USE;
void blocks_detach(struct blocks **b);
const char *blocks_url(const struct blocks *b); /* borrowed */
const struct range_object *blocks_object(const struct blocks *b);
/* Returns whether the table names a block; its bytes may turn out to be lost. */
bool blocks_has(const struct blocks *b, uint64_t i);
/* Number of bytes of a block: fewer at the object's end. */
size_t blocks_size(const struct blocks *b, uint64_t i);
/* Reads a block [BLOCKS_BYTES]. False: it is not here. */
bool blocks_get(struct blocks *b, uint64_t i, uint8_t *out);
/* Keeps a block, unless the disk is full. If the file would exceed its limit, the least recently
 * used blocks are dropped. */
void blocks_put(struct blocks *b, uint64_t i, const uint8_t *bytes);
/* State of the object, shared by all users of the file. Changed: the server has another object now.
 * Down: the server did not answer, and nobody asks it again for for_s seconds. */
void blocks_note_changed(struct blocks *b, bool changed);
bool blocks_changed(const struct blocks *b);
void blocks_note_down(struct blocks *b, double for_s);
bool blocks_down(const struct blocks *b);

#endif
