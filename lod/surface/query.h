/* Questions about the surface of a store, in JSON: heights at places, the place that a pixel shows,
 * a profile, lengths, areas and volumes, lines of sight. The server's answers under /d/{ds}/ and
 * the output of commands are the same.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_QUERY_H
#define LOD_QUERY_H

#include "core/splat/camera.h"
#include "lod/surface/measure.h"

struct geoid;
struct json_t;

enum query_kind { QUERY_HEIGHT, QUERY_PICK, QUERY_PROFILE, QUERY_MEASURE, QUERY_VISIBLE };
enum { QUERY_PLACES_MAX = 256 };
/* Ranges of gsd_m and step_m, which may also be 0: not given. */
#define QUERY_LEAST_M 0.001
#define QUERY_GSD_MOST_M 1000.0
#define QUERY_STEP_MOST_M 10000.0
struct query { /* {0}, then query_read; it has no pointers, so its bytes can be a cache key */
    uint32_t kind;
    uint32_t n;                        /* number of places */
    uint32_t ring;                     /* QUERY_MEASURE: the places are the corners of a polygon */
    uint32_t above;                    /* QUERY_VISIBLE: heights are above the surface */
    double place[QUERY_PLACES_MAX][2]; /* longitude, latitude */
    double height_m[2];                /* QUERY_VISIBLE: heights of the two places */
    double gsd_m, step_m;              /* 0: not given */
    double base_m;     /* QUERY_MEASURE: height of the base; NAN: a plane through the rim */
    struct camera cam; /* QUERY_PICK: camera and pixel */
    double pixel[2];
};
/* Reads a question. origin: of the store; cameras are in its frame. ERR_DATA: the question is
 * invalid; the message says what is allowed. */
enum err_code query_read(enum query_kind kind, const struct json_t *o,
                         const struct geo_origin *origin, struct query *out, struct err *e) ERR_USE;
/* Is name [n] a key of such a question? */
bool query_takes(enum query_kind kind, const char *name, size_t n);
/* Answers a question. Release *out with json_decref. With `geoid` (may be NULL) the answer also has
 * heights above sea level. ERR_DATA: the line or polygon is invalid. ERR_ARG, ERR_CANCEL,
 * ERR_DEVICE, ERR_FORMAT, ERR_LIMIT, ERR_MEM as in measure.h and probe.h. */
enum err_code query_answer(struct nadir *n, const struct geoid *geoid, const struct query *q,
                           struct json_t **out, struct err *e) ERR_USE;

#endif
