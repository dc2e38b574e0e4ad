/* Rows of Gaussians on disk between two passes. Internal to lod/.
 *
 * A city does not fit into memory, and its rows come in the order of training. Each part that is
 * read is sorted along the Morton curve and written here as one run. A tile is then one slice of
 * each run. An index of the codes stays in memory, with less than a byte a Gaussian. It lists
 * groups of rows that share a code, at a zoom where a group has 16 rows on average. Where a slice
 * begins or ends within a group, the means of some of its rows are read.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_SPILL_H
#define LOD_SPILL_H

#include <pthread.h>

#include "core/base.h"
#include "core/math/sort.h"

struct gauss;
struct locate;

struct spill {                   /* made by spill_open; any thread may add and read */
    bool lossless;               /* float32; else as in a payload: float16 except for means */
    int fd;                      /* of an unnamed file, which disappears with the process */
    const struct locate *locate; /* makes the codes; borrowed, set by the caller */
    uint64_t size;               /* guarded by lock */
    pthread_mutex_t lock;
    char near[FILE_PATH_MAX]; /* for messages */
};
struct spill_group { /* rows whose codes differ only in the last `shift` bits */
    uint64_t code;   /* those bits are 0 */
    uint32_t begin;  /* first row */
};
struct spill_run {             /* {0} is empty; spill_run_free */
    struct spill_group *group; /* [n_groups], ascending; NULL: all rows have code_first */
    size_t n_groups;
    unsigned shift;
    uint64_t code_first, code_last, offset;
    size_t n;
    uint32_t sh_degree, embed_len;
    double origin_enu_m[3];
};

/* Makes the file in the folder of `near`, the file to be written, because that disk has room.
 * ERR_IO, ERR_LIMIT. */
enum err_code spill_open(const char *near, bool lossless, struct spill *out, struct err *e) ERR_USE;
void spill_close(struct spill *s); /* idempotent, also on {0} and after spill_open failed */
size_t spill_row_bytes(const struct spill *s, const struct spill_run *r);
/* Makes the run's index from the sorted codes of its rows, items[0..n). n is below 2^32. ERR_MEM.
 */
enum err_code spill_index(struct spill_run *run, const struct sort_item *items, size_t n,
                          struct err *e) ERR_USE;
/* Appends rows order[0..n) of g as a run. The caller makes the index, or sets code_first. ERR_IO,
 * ERR_MEM. */
enum err_code spill_add(struct spill *s, const struct gauss *g, const struct sort_item *order,
                        size_t n, struct spill_run *run, struct err *e) ERR_USE;
/* Reads rows [from, to) of a run, spill_row_bytes each. A row begins with its mean in float32.
 * ERR_IO, ERR_FORMAT: the file was cut. */
enum err_code spill_read(const struct spill *s, const struct spill_run *r, size_t from, size_t to,
                         void *out, struct err *e) ERR_USE;
/* Writes all of a row except its mean to row i of g. g may have a higher degree and a longer
 * embedding; the rest becomes 0. */
void spill_unpack(const struct spill *s, const struct spill_run *r, const void *row,
                  struct gauss *g, size_t i);
/* Finds the rows with first <= code < last. ERR_IO, ERR_FORMAT. */
enum err_code spill_slice(const struct spill *s, const struct spill_run *r, uint64_t first,
                          uint64_t last, size_t *from, size_t *to, struct err *e) ERR_USE;
/* Writes the code of row `from` without its last `shift` bits (shifted right by them) to *code, and
 * the end of the rows that share it to *to. The run has an index. ERR_IO, ERR_FORMAT. */
enum err_code spill_tile(const struct spill *s, const struct spill_run *r, unsigned shift,
                         size_t from, uint64_t *code, size_t *to, struct err *e) ERR_USE;
void spill_run_free(struct spill_run *r);

#endif
