/* Documents about the service: landing page and conformance. Also the parser of cameras that are
 * posted to /d/{ds}/render.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DESCRIBE_H
#define SERVER_DESCRIBE_H

#include "core/camera.h"
#include "server/body.h"
#include "server/config.h"
#include "server/target.h"

struct geo_origin;

/* The caller owns the reference. ERR_MEM. */
enum err_code describe_landing(struct body **out, struct err *e) ERR_USE;
enum err_code describe_conformance(struct body **out, struct err *e) ERR_USE;

struct describe_render {
    struct camera cam;
    enum format format;
    int quality;
    struct paint paint;
    double timeout_s;
    char appearance[TARGET_APPEARANCE_MAX]; /* "": the default */
    int64_t number;                         /* for motion: the client's own number */
    bool still;                             /* for motion: the camera does not move */
    bool key;                               /* for motion: the reader needs a key frame */
};
/* Parses the posted JSON text [n]. ERR_FORMAT: it is not such JSON (400). ERR_DATA: impossible
 * numbers (422). ERR_MEM. */
enum err_code describe_read_render(const struct server_config *cfg, const struct geo_origin *origin,
                                   const void *text, size_t n, struct describe_render *out,
                                   struct err *e) ERR_USE;
/* As describe_read_render, for the camera of a stream, which may have "number" and "still". */
enum err_code describe_read_motion(const struct server_config *cfg, const struct geo_origin *origin,
                                   const void *text, size_t n, struct describe_render *out,
                                   struct err *e) ERR_USE;

#endif
