/* The attributes of our .drc files. Writer, reader and the check of foreign bytes share them.
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

/* Unique ids in the file. The ids from DRACO_SH1_G on are present only if they have values. _RB:
 * red and blue minus the green of the same coefficient. */
enum draco_id {
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
    const char *name; /* written to the attribute's metadata */
    enum draco_type type;
    uint32_t components;
};

struct draco_head {
    uint32_t n, sh_degree, embed_len;
    size_t stream_bytes; /* without the CRC */
};
/* A CRC-32 follows the Draco stream. Other decoders stop before it. libdraco alone would not notice
 * that the last attribute of a file is truncated. */
enum { DRACO_CRC_BYTES = 4 };

#ifdef __cplusplus
extern "C" {
#endif

uint32_t draco_crc(const void *bytes, size_t n);
/* Writes the attributes for this degree and embedding length, and returns their number. */
size_t draco_layout(uint32_t sh_degree, uint32_t embed_len,
                    struct draco_attribute out[DRACO_ID_COUNT]);
/* Checks that the bytes are a point cloud with exactly our attributes, and that limits and file
 * size allow its count. It reads header and attribute list, skips the metadata, compares the CRC
 * and allocates nothing. ERR_FORMAT says what differs. ERR_LIMIT. Any thread. */
enum err_code draco_check(const void *bytes, size_t n, const struct codec_limits *lim,
                          struct draco_head *out, struct err *e) ERR_USE;

/* Encodes integers as attributes of a sequential cloud without names. `citysplat-lab layout`
 * measures other layouts with it; none of our readers opens it. Appends to `out`. ERR_MEM,
 * ERR_INTERNAL. */
enum draco_prediction { DRACO_PREDICT_NEVER, DRACO_PREDICT_ROW, DRACO_PREDICT_WHERE_IT_PAYS };
struct draco_column {
    enum draco_type type;
    uint32_t components;
    enum draco_prediction prediction; /* WHERE_IT_PAYS: only for bytes */
    const void *values;               /* [n][components], below 2^31 */
};
/* See above: ERR_MEM, ERR_INTERNAL. */
enum err_code draco_encode_columns(const struct draco_column *column, size_t n_columns, size_t n,
                                   struct buf *out, struct err *e) ERR_USE;

#ifdef __cplusplus
}
#endif
#endif
