/* Photographs that a store offers with its appearance model. The blob "photograph/NAME" has time
 * and pose as JSON. The optional blob "thumbnail/NAME" is a small JPEG.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_PHOTOGRAPH_H
#define LOD_PHOTOGRAPH_H

#include "core/base.h"

struct store;

#define PHOTOGRAPH_BLOB "photograph/"
#define PHOTOGRAPH_THUMBNAIL "thumbnail/"
enum {
    PHOTOGRAPH_NAME_MAX = 160, /* length of a blob's name, with its NUL */
    PHOTOGRAPH_EDGE_PX = 160,  /* the longer side of a thumbnail */
    PHOTOGRAPH_BYTES_MAX = 6144,
};

struct photograph {
    char time[20]; /* as in struct scene_image */
    double lon_deg, lat_deg, h_m;
    double heading_deg, pitch_deg,
        fov_y_deg; /* heading 0..360, clockwise from north; pitch above the horizon */
    bool has_thumbnail;
};

/* Name of a photograph's blob. `kind` is PHOTOGRAPH_BLOB or PHOTOGRAPH_THUMBNAIL. ERR_LIMIT: too
 * long. */
enum err_code photograph_blob(const char *kind, const char *name, char out[PHOTOGRAPH_NAME_MAX],
                              struct err *e) ERR_USE;
/* Appends the bytes of the blob to `out`. ERR_DATA: a number is not finite. ERR_MEM. */
enum err_code photograph_write(const struct photograph *p, struct buf *out, struct err *e) ERR_USE;
/* Reads the blob of a photograph. ERR_NOENT: there is none. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code photograph_read(struct store *s, const char *name, struct photograph *out,
                              struct err *e) ERR_USE;
/* Reads the thumbnail; the caller frees `out`. ERR_NOENT, ERR_FORMAT (not a JPEG), ERR_IO, ERR_MEM.
 */
enum err_code photograph_thumbnail(struct store *s, const char *name, struct buf *out,
                                   struct err *e) ERR_USE;
/* Returns whether `name` is the name of such a blob. */
bool photograph_is_blob(const char *name);

#endif
