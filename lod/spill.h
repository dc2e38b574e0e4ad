/* Rows of Gaussians on disk between two passes. Internal to lod/.
 *
 * A city does not fit into memory, and its rows come in the order of training. Each part that is
 * read is sorted along the Morton curve and written here as one run. A tile is then one slice of
 * each run. Only the codes stay in memory, 8 bytes a Gaussian.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SPILL_H
#define LOD_SPILL_H

#include <pthread.h>

#include "core/base.h"
#include "core/sort.h"

struct gauss;

struct spill {     /* made by spill_open; any thread may add and read */
    bool lossless; /* float32; else as in a payload: float16 except for means */
    int fd;        /* of an unnamed file, which disappears with the process */
    uint64_t size; /* guarded by lock */
    pthread_mutex_t lock;
    char near[FILE_PATH_MAX]; /* for messages */
};
struct spill_run {  /* {0} is empty; spill_run_free */
    uint64_t *code; /* [n], ascending, at the finest zoom; NULL: all rows have code_first */
    uint64_t code_first, offset;
    size_t n;
    uint32_t sh_degree, embed_len;
    double origin_enu_m[3];
};

/* Makes the file in the folder of `near`, the file to be written, because that disk has room.
 * ERR_IO, ERR_LIMIT. */
enum err_code spill_open(const char *near, bool lossless, struct spill *out, struct err *e) ERR_USE;
void spill_close(struct spill *s); /* idempotent, also on {0} and after spill_open failed */
size_t spill_row_bytes(const struct spill *s, const struct spill_run *r);
/* Appends rows order[0..n) of g as a run. The caller sets run->code and code_first. ERR_IO,
 * ERR_MEM. */
enum err_code spill_add(struct spill *s, const struct gauss *g, const struct sort_item *order,
                        size_t n, struct spill_run *run, struct err *e) ERR_USE;
/* Reads rows [from, to) of a run, spill_row_bytes each. A row begins with its mean in float32.
 * ERR_IO. */
enum err_code spill_read(struct spill *s, const struct spill_run *r, size_t from, size_t to,
                         void *out, struct err *e) ERR_USE;
/* Writes all of a row except its mean to row i of g. g may have a higher degree and a longer
 * embedding; the rest becomes 0. */
void spill_unpack(const struct spill *s, const struct spill_run *r, const void *row,
                  struct gauss *g, size_t i);
/* Finds the rows with first <= code < last. */
void spill_slice(const struct spill_run *r, uint64_t first, uint64_t last, size_t *from,
                 size_t *to);
void spill_run_free(struct spill_run *r);

#endif
