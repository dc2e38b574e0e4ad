/* The parser of cameras that are posted to /d/{ds}/render and to streams.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_POSTED_VIEW_H
#define SERVER_POSTED_VIEW_H

#include "core/splat/camera.h"
#include "server/base/config.h"
#include "server/route/target.h"

struct geo_origin;

struct posted_view {
    struct camera cam;
    enum format format;
    int quality;
    struct composite composite;
    double timeout_s;
    char appearance[TARGET_APPEARANCE_MAX]; /* "": the default */
    int64_t number;                         /* for motion: the client's own number */
    bool still;                             /* for motion: the camera does not move */
    bool key;                               /* for motion: the reader needs a key frame */
};
/* Parses the posted JSON text [n]. ERR_FORMAT: it is not such JSON (400). ERR_DATA: impossible
 * numbers (422). ERR_MEM. */
enum err_code posted_view_read(const struct server_config *cfg, const struct geo_origin *origin,
                               const void *text, size_t n, struct posted_view *out,
                               struct err *e) ERR_USE;
/* As posted_view_read, for the camera of a stream, which may have "number" and "still". */
enum err_code posted_view_read_stream(const struct server_config *cfg,
                                      const struct geo_origin *origin, const void *text, size_t n,
                                      struct posted_view *out, struct err *e) ERR_USE;

#endif
