/* Photographs that a store keeps beside its appearance model, for people to choose from: a blob
 * "photograph/NAME" with time and pose as JSON, and where wanted "thumbnail/NAME", a small JPEG.
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
    PHOTOGRAPH_NAME_MAX = 160, /* of a blob, with its NUL */
    PHOTOGRAPH_EDGE_PX = 160,  /* the longer side of a thumbnail */
    PHOTOGRAPH_BYTES_MAX = 6144,
};

struct photograph {
    char time[20]; /* as struct scene_image */
    double lon_deg, lat_deg, h_m;
    double heading_deg, pitch_deg,
        fov_y_deg; /* heading 0..360 from north; pitch above the horizon */
    bool has_thumbnail;
};

/* The name of a blob about a photograph. ERR_LIMIT: too long. */
enum err_code photograph_blob(const char *kind, const char *name, char out[PHOTOGRAPH_NAME_MAX],
                              struct err *e) ERR_USE;
/* The blob's bytes, appended to out. ERR_DATA: a number is not finite; ERR_MEM. */
enum err_code photograph_write(const struct photograph *p, struct buf *out, struct err *e) ERR_USE;
/* What a store knows of a photograph. ERR_NOENT: nothing; ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code photograph_read(struct store *s, const char *name, struct photograph *out,
                              struct err *e) ERR_USE;
/* Its JPEG into out (caller frees). ERR_NOENT, ERR_FORMAT (no JPEG), ERR_IO, ERR_MEM. */
enum err_code photograph_thumbnail(struct store *s, const char *name, struct buf *out,
                                   struct err *e) ERR_USE;
/* Is this the name of such a blob? */
bool photograph_is_blob(const char *name);

#endif
