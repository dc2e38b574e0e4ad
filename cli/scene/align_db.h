/* Reads COLMAP's database: how far COLMAP is, and why a photograph was not placed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_ALIGN_DB_H
#define CLI_ALIGN_DB_H

#include "core/base.h"
#include "scene/ingest/align_plan.h"

struct align_seen {    /* of a photograph */
    uint32_t features; /* 0: none were sought yet */
    uint32_t matches;  /* number of photographs that it matches, with verified geometry */
    uint32_t part;     /* photographs that matches connect have the same number */
};
/* Number of rows of a table; 0 also if there is no database yet. */
uint64_t align_db_count(const char *path, const char *table);
/* Id of the camera that photographs of a group of the plan have; -1: none has a camera yet. */
long long align_db_camera(const char *path, const struct align_plan *plan, size_t group);
/* Focal length of a camera before any model was made, in pixels; 0: unknown. */
double align_db_focal(const char *path, uint32_t camera);
/* Makes `to`, a copy of a database without features and matches of the photographs of the plan that
 * are `of`. ERR_IO: it cannot be read or written. */
enum err_code align_db_without(const char *path, const char *to, const struct align_plan *plan,
                               const bool *of, struct err *e) ERR_USE;
/* Fills seen [plan->n]. inliers: least number of inliers of a match. *largest: number of
 * photographs in the largest part. ERR_IO: it cannot be read. ERR_MEM. */
enum err_code align_db_seen(const char *path, const struct align_plan *plan, uint32_t inliers,
                            struct align_seen *seen, size_t *largest, struct err *e) ERR_USE;

#endif
