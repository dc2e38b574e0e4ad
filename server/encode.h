/* One tile of Gaussians to bytes of a format.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ENCODE_H
#define SERVER_ENCODE_H

#include "lod/clip.h"
#include "lod/store.h"
#include "server/config.h"
#include "server/target.h"

/* What a target leaves unsaid: the preset that `citysplat serve` was given, the dataset's degree.
 * Of formats that are not quantised there is one form only. */
struct form encode_form(const struct server_config *cfg, const struct store_meta *meta,
                        const struct form *asked);
/* Append one tile's bytes of a form. image: an embedding [len_image] of the store's appearance
 * model, NULL for the default one. clip: what is left of the tile, NULL: all of it. ERR_NOENT (no
 * such tile, or nothing of it is left), ERR_FORMAT (damaged), ERR_IO, ERR_MEM,
 * ERR_DATA, ERR_LIMIT. */
enum err_code encode_tile(struct store *s, struct key key, struct form form, const float *image,
                          const struct clip *clip, struct buf *out, struct err *e) ERR_USE;
/* About how many bytes a tile of so many Gaussians takes, by what trained cities take in each form
 * (docs/formats.md); the same for equal arguments. */
uint64_t encode_bytes(const struct store_meta *meta, struct form form, uint32_t count);
/* Hash of what the encoders make of a fixed sample with this meta. Entity tags contain it, so that
 * they change whenever the encoders, or the libraries below them, do: equal tags are equal bytes.
 * ERR_MEM, and what encoders return. */
enum err_code encode_fingerprint(const struct store_meta *meta, struct hash128 *out,
                                 struct err *e) ERR_USE;

#endif
