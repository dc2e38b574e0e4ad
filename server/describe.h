/* The documents about the service itself: landing page, conformance; and the posted camera
 * of /d/{ds}/render in the other direction.
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

/* A reference is the caller's. ERR_MEM. */
enum err_code describe_landing(struct body **out, struct err *e) ERR_USE;
enum err_code describe_conformance(struct body **out, struct err *e) ERR_USE;

struct describe_render {
    struct camera cam;
    enum format format;
    int quality;
    struct paint paint;
    double timeout_s;
    char appearance[TARGET_APPEARANCE_MAX]; /* "": the default one */
    int64_t number;                         /* of motion: the client's own */
    bool still;                             /* and whether the camera rests */
};
/* Read the posted JSON text[n]. ERR_FORMAT: no such JSON (400). ERR_DATA: impossible numbers (422).
 * ERR_MEM. */
enum err_code describe_read_render(const struct server_config *cfg, const struct geo_origin *origin,
                                   const void *text, size_t n, struct describe_render *out,
                                   struct err *e) ERR_USE;
/* The same of a stream's camera, which may have a "number" and say that it is "still". */
enum err_code describe_read_motion(const struct server_config *cfg, const struct geo_origin *origin,
                                   const void *text, size_t n, struct describe_render *out,
                                   struct err *e) ERR_USE;

#endif
