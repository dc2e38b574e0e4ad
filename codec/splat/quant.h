/* The quantiser that SPZ and Draco files share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_QUANT_H
#define CODEC_QUANT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/splat/gauss.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How fine the integers are (presets.def). */
struct quant_grid {
    /* log2 of steps in a middle sigma, median of all Gaussians; 0: steps of 2^-12 m */
    uint8_t position;
    /* number of low bits that are left out, 0..7 */
    uint8_t scale, rotation, alpha, color, sh[3], embed;
    uint8_t sh_degree; /* higher bands are dropped */
    /* 0: every integer is the nearest one. 1: the rows look alike from above, but need not have the
     * same axes and coefficients (quant_look.h); for clients that draw */
    uint8_t look;
};
enum quant_preset {
#define PRESET(id, name, about, position, scale, rotation, alpha, color, sh1, sh2, sh3, embed,     \
               degree, look)                                                                       \
    QUANT_##id,
#include "codec/splat/presets.def"
#undef PRESET
    QUANT_PRESETS
};
#define QUANT_PRESET_NAMES "spz|preview|balanced|near-lossless" /* in this order, for options */
#define QUANT_PRESET_DEFAULT "balanced"   /* for served tiles, which a browser shows and forgets */
#define QUANT_PRESET_FILE "near-lossless" /* for files, which others edit and convert again */
enum { QUANT_FRAC_BITS = 12 };
const struct quant_grid *quant_preset_grid(enum quant_preset p);
const char *quant_preset_name(enum quant_preset p);

/* Integers of SPZ v3 (docs/formats.md), for SPZ and Draco. They are in the axes to be written,
 * which for tiles are those of glTF. Positions are relative to the origin of the Gaussians. */
struct quant { /* {0} is empty; all arrays are in one allocation */
    size_t n;
    uint32_t sh_degree, embed_len;
    uint32_t frac_bits; /* of positions */
    bool antialiased;
    size_t rest;        /* rows of the tile that follow in another part (part.h) */
    int32_t *position;  /* [n][3], in 2^-frac_bits m, within +-(2^23 - 1) */
    uint8_t *alpha;     /* [n] */
    uint8_t *color;     /* [n][3] */
    uint8_t *scale;     /* [n][3] */
    uint32_t *rotation; /* [n], smallest three, packed as in SPZ v3 */
    uint8_t *sh;        /* [n][K-1][3] */
    uint8_t *embed;     /* [n][embed_len] */
    float embed_min[GAUSS_EMBED_MAX], embed_max[GAUSS_EMBED_MAX];
    void *block;
};
/* Allocates zeroed arrays of n rows. Free them with quant_free. ERR_LIMIT, ERR_MEM. */
enum err_code quant_alloc(struct quant *q, size_t n, uint32_t sh_degree, uint32_t embed_len,
                          struct err *e) ERR_USE;
/* Quantises g. sh_degree may differ from that of g: missing bands become 0. grid NULL: that of
 * QUANT_SPZ. A grid that looks alike takes y as up. Rows keep their order; files are smaller when
 * neighbours in space follow each other. frac_bits is 12; a finer grid raises it and a larger
 * extent lowers it. ERR_DATA names a row that is not finite or has no rotation. ERR_LIMIT names a
 * row that is too far from the origin for Gaussians of this size. ERR_MEM. */
enum err_code quant_from_gauss(const struct gauss *g, uint32_t sh_degree,
                               const struct quant_grid *grid, struct quant *out,
                               struct err *e) ERR_USE;
/* Converts back to Gaussians. Free *out with gauss_free. ERR_MEM. */
enum err_code quant_to_gauss(const struct quant *q, struct gauss *out, struct err *e) ERR_USE;
void quant_free(struct quant *q);
/* Packs one rotation as in SPZ v3: the index of the largest component (x y z w) << 30, then sign
 * and 9-bit magnitude of the other three. */
uint32_t quant_pack_rotation(const float quat_wxyz[4]);
void quant_unpack_rotation(uint32_t packed, float quat_wxyz[4]);

#ifdef __cplusplus
}
#endif
#endif
