/* Internal to train/: parameters and moments of a model that does not fit in memory. Each array
 * lies in a file (core/scratch.h) that the device uses in place. A step touches the groups in its
 * frustum alone (render/defer.h), so the others can leave memory: those that were not seen for
 * longest go first. Which groups are in memory changes no byte of the result.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_PAGED_H
#define TRAIN_PAGED_H

#include "core/dev.h"
#include "core/scratch.h"

struct permutation;

enum {
    PAGED_ARRAYS = 2,  /* parameters, and both moments of each in a word */
    PAGED_PART = 4096, /* a pass over all takes so many groups at a time */
};

struct paged { /* {0}: arrays are buffers of the device as always; free with paged_close */
    /* -- set by the owner of the model before model_open, and kept by paged_close -- */
    const char *dir;   /* folder of the files; NULL: none are used */
    size_t most_bytes; /* of all arrays that may be in memory in a step; above 0 */
    /* -- of paged.c -- */
    struct dev *dev;
    struct scratch file[PAGED_ARRAYS];
    struct scratch spare; /* where rows are moved to */
    size_t group_bytes;   /* of a group in one array */
    uint32_t *seen;       /* [n_groups] step when a group was listed last; 0: not in memory */
    size_t n_groups, n_held;
    uint32_t clock;
    size_t walked;             /* groups below have left memory in the walk at hand */
    bool streams;              /* passes over all go from start to end */
    uint64_t fetched, dropped; /* groups, so far */
};
/* Makes the files of both arrays for n_groups of `planes` planes, and buffers over them. Call
 * paged_close after the buffers are released, also after an error. ERR_IO: the disk has no room.
 * ERR_LIMIT, ERR_MEM, ERR_DEVICE. */
enum err_code paged_open(struct paged *s, struct dev *dev, size_t n_groups, uint32_t planes,
                         cl_mem *const arrays[PAGED_ARRAYS], struct err *e) ERR_USE;
void paged_close(struct paged *s);
/* All values of an array become 0. ERR_IO, ERR_DEVICE. */
enum err_code paged_zero(struct paged *s, size_t nth, struct err *e) ERR_USE;
/* Moves the rows of array `nth` into a file of n_groups, which takes its place; *array is its
 * buffer. Call paged_moved once all arrays have been moved. ERR_IO, ERR_LIMIT, ERR_MEM, ERR_DEVICE.
 */
enum err_code paged_move(struct paged *s, size_t nth, const struct permutation *r, size_t n_groups,
                         cl_mem *array, struct err *e) ERR_USE;
enum err_code paged_moved(struct paged *s, size_t n_groups, struct err *e) ERR_USE;

/* For struct defer_watch; `user` is the paged. */
void paged_listed(void *user, const uint32_t *groups, size_t n);
void paged_passed(void *user, size_t from, size_t to);
/* Someone goes through parameters, or with `all` also through moments, from the first row to the
 * last, and has passed groups [from, to). They leave memory unless steps hold them, written where
 * they have changed. No one else uses them. */
void paged_walked(struct paged *s, bool all, size_t from, size_t to);
/* Everything leaves memory. The device must be idle. */
void paged_drop_all(struct paged *s);
/* Bytes on the disk that a model of n Gaussians takes, with what moves need. */
uint64_t paged_disk_bytes(size_t n, uint32_t planes);

#endif
