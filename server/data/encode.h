/* Encodes a tile of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ENCODE_H
#define SERVER_ENCODE_H

#include "lod/export/clip.h"
#include "lod/store/store.h"
#include "server/base/config.h"
#include "server/route/target.h"

/* Fills in what a target left open: the preset of `citysplat serve`, and the degree of the dataset.
 * A format that is not quantised has one form. Only .drc has parts. */
struct form encode_form(const struct server_config *cfg, const struct store_meta *meta,
                        const struct form *asked);
/* A form of which only the format is set. */
struct form encode_form_of(enum format f);
/* What the viewer draws first: its coarsest tile in the preset preview, without harmonics. */
struct form encode_draft(void);
/* Appends the bytes of a tile in a form. image: an embedding [len_image] of the store's appearance
 * model; NULL: the default one. clip: the part of the tile; NULL: all. ERR_NOENT (no such tile,
 * nothing of it is left, or it has no second part), ERR_FORMAT (damaged), ERR_IO, ERR_MEM,
 * ERR_DATA, ERR_LIMIT. */
enum err_code encode_tile(struct store *s, struct key key, struct form form, const float *image,
                          const struct clip *clip, struct buf *out, struct err *e) ERR_USE;
/* Appends the bytes of the finest level in one file, about the store's origin, in a form. image,
 * clip: as above. ERR_NOENT (nothing is left), and the errors of encode_tile. */
enum err_code encode_city(struct store *s, struct form form, const float *image,
                          const struct clip *clip, struct buf *out, struct err *e) ERR_USE;
/* Gaussians of the finest level, which encode_city writes. */
uint64_t encode_city_count(const struct store *s);
/* Estimates the bytes of encode_city, as encode_bytes does. */
uint64_t encode_city_bytes(const struct store *s, enum format f);
/* Estimates the bytes of a tile with `count` Gaussians, from trained cities (docs/formats.md).
 * Equal arguments give equal results. */
uint64_t encode_bytes(const struct store_meta *meta, struct form form, uint32_t count);
/* Hash of the encoders' output for a fixed sample with this meta. Entity tags contain this hash.
 * They therefore change when the encoders or their libraries change, and equal tags mean equal
 * bytes. ERR_MEM, and the errors of the encoders. */
enum err_code encode_fingerprint(const struct store_meta *meta, struct hash128 *out,
                                 struct err *e) ERR_USE;

#endif
