/* The attributes of a .drc of ours, shared by the writer, the reader and the check of foreign
 * bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_DRACO_LAYOUT_H
#define CODEC_DRACO_LAYOUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct buf;
struct codec_limits;

enum draco_id { /* unique ids in the file; sh.. and embedding are there only when they have values.
                   _rb: red and blue about the green of the same coefficient */
                DRACO_POSITION,
                DRACO_OPACITY,
                DRACO_SCALE,
                DRACO_ROTATION,
                DRACO_ROTATION_INDEX,
                DRACO_COLOR_G,
                DRACO_COLOR_RB,
                DRACO_SH1_G,
                DRACO_SH1_RB,
                DRACO_SH2_G,
                DRACO_SH2_RB,
                DRACO_SH3_G,
                DRACO_SH3_RB,
                DRACO_EMBEDDING,
                DRACO_ID_COUNT
};
enum draco_type { DRACO_UINT8 = 2, DRACO_UINT16 = 4, DRACO_UINT32 = 6 }; /* Draco's own numbers */
struct draco_attribute {
    enum draco_id id;
    const char *name; /* in the attribute's metadata */
    enum draco_type type;
    uint32_t components;
};

struct draco_head {
    uint32_t n, sh_degree, embed_len;
    size_t stream_bytes; /* without the check value */
};
/* A CRC-32 follows the Draco stream: other decoders stop before it, and libdraco alone does not
 * notice when the last attribute of a file is cut short. */
enum { DRACO_CRC_BYTES = 4 };

#ifdef __cplusplus
extern "C" {
#endif

uint32_t draco_crc(const void *bytes, size_t n);
/* The attributes of this degree and embedding; returns how many. */
size_t draco_layout(uint32_t sh_degree, uint32_t embed_len,
                    struct draco_attribute out[DRACO_ID_COUNT]);
/* Is this a point cloud of exactly our attributes, of a count that the limits and the file's size
 * allow? Reads the header, skips the metadata, and reads the list of attributes and compares the
 * check value; allocates nothing. ERR_FORMAT says what is otherwise, ERR_LIMIT. Any thread. */
enum err_code draco_check(const void *bytes, size_t n, const struct codec_limits *lim,
                          struct draco_head *out, struct err *e) ERR_USE;

/* Integers as attributes of a sequential cloud without names: what other layouts than ours would
 * take (citysplat-bench layout). No reader of ours opens it. out: appended to. ERR_MEM,
 * ERR_INTERNAL. */
enum draco_prediction { DRACO_PREDICT_NEVER, DRACO_PREDICT_ROW, DRACO_PREDICT_WHERE_IT_PAYS };
struct draco_column {
    enum draco_type type;
    uint32_t components;
    enum draco_prediction prediction; /* where it pays: of bytes only */
    const void *values;               /* [n][components], below 2^31 */
};
/* See above: ERR_MEM, ERR_INTERNAL. */
enum err_code draco_encode_columns(const struct draco_column *column, size_t n_columns, size_t n,
                                   struct buf *out, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif
