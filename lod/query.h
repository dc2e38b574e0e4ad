/* Questions about the surface of a store as JSON: heights at places, what a pixel of a camera
 * shows, a profile, lengths, areas and volumes, lines of sight. What the server answers under
 * /d/{ds}/ and the commands print is the same.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_QUERY_H
#define LOD_QUERY_H

#include "core/camera.h"
#include "lod/measure.h"

struct geoid;
struct json_t;

enum query_kind { QUERY_HEIGHT, QUERY_PICK, QUERY_PROFILE, QUERY_MEASURE, QUERY_VISIBLE };
enum { QUERY_PLACES_MAX = 256 };
struct query { /* {0}, then query_read: no pointers, so its bytes are its name */
    uint32_t kind;
    uint32_t n;                        /* places */
    uint32_t ring;                     /* QUERY_MEASURE: they are the corners of a polygon */
    uint32_t above;                    /* QUERY_VISIBLE: heights are above the surface */
    double place[QUERY_PLACES_MAX][2]; /* longitude, latitude */
    double height_m[2];                /* QUERY_VISIBLE: of the two places */
    double gsd_m, step_m;              /* 0: not said */
    double base_m;                     /* QUERY_MEASURE; NAN: a plane through the rim */
    struct camera cam;                 /* QUERY_PICK, as */
    double pixel[2];
};
/* Read a question. origin: of the store, in whose frame cameras are. ERR_DATA: says what is
 * allowed. */
enum err_code query_read(enum query_kind kind, const struct json_t *o,
                         const struct geo_origin *origin, struct query *out, struct err *e) ERR_USE;
/* Answer it; the caller gives *out back (json_decref). geoid: heights above sea level as well,
 * NULL: none. ERR_DATA: no such line or polygon; errors of measure.h and probe.h: ERR_ARG,
 * ERR_CANCEL, ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code query_answer(struct nadir *n, const struct geoid *geoid, const struct query *q,
                           struct json_t **out, struct err *e) ERR_USE;

#endif
