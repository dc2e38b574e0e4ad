/* The memory of the server: how the one number --memory (core/machine.h) is shared out.
 *
 * The budget counts memory that the system cannot drop: anonymous pages of both processes. Pages of
 * the program's file and its libraries come in addition, as far as they are used (docs/scale.md).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MEMORY_H
#define SERVER_MEMORY_H

#include "core/base.h"

struct memory_needs { /* sizes in bytes */
    size_t budget;
    size_t base; /* memory of this process without caches: program, indexes, documents */
    size_t workers, connections; /* as asked for */
    size_t largest_tile;         /* the largest tile, decoded */
    bool draws;
    unsigned drawers;                   /* processes that draw, as asked for; 0: 1 */
    uint64_t gaussians;                 /* number in the store that has most */
    uint64_t view_gaussians;            /* most in a picture, as asked for; 0: no limit */
    double view_mpx;                    /* largest picture, as asked for */
    size_t video;                       /* most memory that encoders of streams can use */
    size_t cache, inflight, view_cache; /* set by options; 0: a share */
};
struct memory_plan { /* sizes in bytes */
    size_t budget, cache, inflight, workers, connections;
    /* for all processes that draw, 0: there is none; and what each keeps for the next picture */
    size_t drawing, view_cache;
    size_t video;                      /* for encoders of streams */
    uint64_t view_gaussians, drawn_px; /* drawn_px: most pixels, before they are filtered down */
    double view_mpx;
    unsigned drawers; /* no more than have room for the pictures that were asked for */
    unsigned slots;   /* stores that each of them keeps open */
    bool lowered;     /* pictures are smaller or have fewer Gaussians than asked for */
};

/* Shares the budget out. ERR_LIMIT: it is too small; the message says what is enough. */
enum err_code memory_plan(const struct memory_needs *n, struct memory_plan *out,
                          struct err *e) ERR_USE;

#endif
