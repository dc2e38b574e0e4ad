/* What COLMAP's database holds: how far it is, and why a photograph was not placed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_ALIGN_DB_H
#define CLI_ALIGN_DB_H

#include "core/base.h"
#include "ingest/align_plan.h"

struct align_seen {    /* of a photograph */
    uint32_t features; /* 0: none were sought yet */
    uint32_t matches;  /* photographs that it matches, geometry verified */
    uint32_t part;     /* photographs that matches join have one number */
};
/* Rows of a table; 0 as well when there is no database yet. */
uint64_t align_db_count(const char *path, const char *table);
/* Camera that photographs of a group of the plan have; -1: none has one yet. */
long long align_db_camera(const char *path, const struct align_plan *plan, size_t group);
/* Fills seen [plan->n]. inliers: least number of a match. largest: photographs of the largest part.
 * ERR_IO: it cannot be read. ERR_MEM. */
enum err_code align_db_seen(const char *path, const struct align_plan *plan, uint32_t inliers,
                            struct align_seen *seen, size_t *largest, struct err *e) ERR_USE;

#endif
