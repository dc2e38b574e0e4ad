/* Appearances of a tile store: from trained colours to the colours of one photograph or of a blend
 * (docs/appearance.md).
 *
 * Tiles keep trained colours and embeddings; an appearance is an embedding of an image, [len_image]
 * floats, and applying it changes colours and opacities of what was read. As struct store, for one
 * thread at a time, except where a function says otherwise.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_BAKE_H
#define LOD_BAKE_H

#include "core/appearance.h"
#include "core/base.h"
#include "lod/store.h"

#define BAKE_BLOB "appearance"
#define BAKE_DEFAULT "default" /* the appearance of clients that ask for none */

/* The store's appearance model, read once; NULL when it has none. Borrowed, until store_close. Its
 * rows are the training photographs and BAKE_DEFAULT. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code bake_of(struct store *s, const struct appearance **out, struct err *e) ERR_USE;
/* Do Gaussians with embeddings that model `a` reads (NULL: none) belong into the store? Only with
 * the store's own network and the same embedding of every photograph that both know; other
 * photographs are the store's affair. ERR_DATA says what differs; errors of bake_of. */
enum err_code bake_fits(struct store *s, const struct appearance *a, struct err *e) ERR_USE;
/* The store's model and the photographs that only `a` has, as a blob into `out` (caller frees); the
 * default appearance stays the store's, so nothing that was made with it changes. Empty where the
 * store has no appearance. ERR_DATA where bake_fits says no, ERR_MEM; errors of bake_of. */
enum err_code bake_join(struct store *s, const struct appearance *a, struct buf *out,
                        struct err *e) ERR_USE;
/* Hash of the model, for names of what is made with it; 0 when there is none. ERR_FORMAT, ERR_IO,
 * ERR_MEM. */
enum err_code bake_hash(struct store *s, struct hash128 *out, struct err *e) ERR_USE;
/* The embedding [len_image] that a text stands for: a photograph's name, BAKE_DEFAULT, a blend
 * "NAME:WEIGHT,NAME:WEIGHT" of unit embeddings (weights are divided by their sum), or "=" and the
 * embedding itself, see bake_text. ERR_NOENT: no such photograph, or a store without appearance;
 * ERR_ARG: the text means nothing; errors of bake_of. Threads may share a store for this once
 * bake_of was called. */
enum err_code bake_find(struct store *s, const char *text, float *image, struct err *e) ERR_USE;
/* float32 values, little-endian, as base64url without padding (RFC 4648): bake_base64_size(n) bytes
 * with the NUL. */
static inline size_t bake_base64_size(size_t n)
{
    return (16 * n + 2) / 3 + 1;
}
void bake_base64(const float *v, size_t n, char *out);
/* An embedding as text: "=" and its float32 values, little-endian, in base64url without padding
 * (RFC 4648). */
enum { BAKE_TEXT_MAX = 2 + (4 * 4 * APPEARANCE_IMAGE_MAX + 2) / 3 };
void bake_text(const float *image, uint32_t len_image, char out[BAKE_TEXT_MAX]);
/* Change g's colours and opacities to an appearance [len_image] (NULL: the default one); does
 * nothing where the store has none. g carries the store's embeddings. ERR_DATA (other embeddings),
 * ERR_MEM; errors of bake_of. */
enum err_code bake_apply(struct store *s, const float *image, struct gauss *g,
                         struct err *e) ERR_USE;
/* store_read_gauss and bake_apply, with the errors of both (ERR_NOENT: no such tile). gauss_free
 * it. */
enum err_code bake_read(struct store *s, struct key k, const float *image, struct gauss *out,
                        struct err *e) ERR_USE;
/* The default appearance of a model whose Gaussians have embeddings like g's: image [len_image].
 * ERR_DATA (no photographs, no rows, other embeddings), ERR_MEM. Any thread. */
enum err_code bake_default(const struct appearance *a, const struct gauss *g, float *image,
                           struct err *e) ERR_USE;
/* A copy of the model with it as last row, named BAKE_DEFAULT: what a store keeps. appearance_free
 * it. ERR_DATA as bake_default, or a photograph of that name; ERR_MEM. Any thread. */
enum err_code bake_with_default(const struct appearance *a, const struct gauss *g,
                                struct appearance *out, struct err *e) ERR_USE;
/* A row of the model's table [len_image], scaled to length 1. */
void bake_unit(const struct appearance *a, size_t row, float *out);

#endif
