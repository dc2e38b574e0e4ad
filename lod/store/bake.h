/* Appearances of a tile store: from trained colours to the colours of one photograph, or of a blend
 * of several (docs/appearance.md).
 *
 * Tiles keep trained colours and embeddings. An appearance is the embedding of an image,
 * [len_image] floats. Applying it changes colours and opacities of Gaussians that were read. Only
 * one thread at a time may use a struct store here, unless a function says otherwise.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_BAKE_H
#define LOD_BAKE_H

#include "core/base.h"
#include "core/splat/appearance.h"
#include "lod/store/store.h"

#define BAKE_BLOB "appearance"
#define BAKE_DEFAULT "default" /* the appearance for clients that ask for none */

/* Reads the store's appearance model once and keeps it; NULL: there is none. It is borrowed until
 * store_close. Its rows are the training photographs and BAKE_DEFAULT. ERR_FORMAT, ERR_IO, ERR_MEM.
 */
enum err_code bake_of(struct store *s, const struct appearance **out, struct err *e) ERR_USE;
/* Checks whether Gaussians with embeddings for model `a` (NULL: none) may be put into the store.
 * The networks must be equal, and so must the embeddings of photographs that both models have.
 * ERR_DATA says what differs. ERR_FORMAT, ERR_IO, ERR_MEM as in bake_of. */
enum err_code bake_fits(struct store *s, const struct appearance *a, struct err *e) ERR_USE;
/* Makes a blob with the store's model and the photographs that only `a` has; the caller frees
 * `out`. The default appearance stays that of the store, so results made with it stay valid. *out
 * is empty if the store has no appearance. ERR_DATA (see bake_fits), ERR_FORMAT, ERR_IO, ERR_MEM.
 */
enum err_code bake_join(struct store *s, const struct appearance *a, struct buf *out,
                        struct err *e) ERR_USE;
/* Hash of the model, for the names of results; 0: there is none. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code bake_hash(struct store *s, struct hash128 *out, struct err *e) ERR_USE;
/* Finds the embedding [len_image] that a text names: a photograph's name, BAKE_DEFAULT, a blend
 * "NAME:WEIGHT,NAME:WEIGHT", or "=" and an embedding (see bake_text). A blend uses embeddings of
 * length 1 and divides weights by their sum, which is more than 0: otherwise every weight would
 * count with the other sign. After bake_of, threads may share a store for this.
 * ERR_NOENT: there is no such photograph, or the store has no appearance. ERR_ARG: the text is
 * invalid. ERR_FORMAT, ERR_IO, ERR_MEM as in bake_of. */
enum err_code bake_find(struct store *s, const char *text, float *image, struct err *e) ERR_USE;
/* Writes an embedding as text: "=" and its values, little-endian float32, by base64_write. */
enum { BAKE_TEXT_MAX = 2 + (4 * 4 * APPEARANCE_IMAGE_MAX + 2) / 3 };
void bake_text(const float *image, uint32_t len_image, char out[BAKE_TEXT_MAX]);
/* As store_read_gauss, with colours and opacities of an appearance [len_image]; NULL: the default
 * one. A store without appearances has one only. Free *out with gauss_free. ERR_NOENT (no such
 * tile), ERR_DATA (other embeddings), ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code bake_read(struct store *s, struct key k, const float *image, struct gauss *out,
                        struct err *e) ERR_USE;
/* Reads all Gaussians of the cut through the tree at `zoom`: tiles of that zoom, and leaves above
 * it, about the store's origin. bar (NULL: none) is stepped from tile to tile. Free *out with
 * gauss_free. ERR_DATA, ERR_FORMAT, ERR_IO, ERR_MEM as in bake_read. */
struct progress;
enum err_code bake_read_cut(struct store *s, uint8_t zoom, const float *image, struct progress *bar,
                            struct gauss *out, struct err *e) ERR_USE;
/* Computes the default appearance, image [len_image], of model a. The Gaussians g have embeddings
 * for it. ERR_DATA (no photographs, no rows, other embeddings), ERR_MEM. Any thread. */
enum err_code bake_default(const struct appearance *a, const struct gauss *g, float *image,
                           struct err *e) ERR_USE;
/* Copies the model and appends the default appearance as a row named BAKE_DEFAULT. A store keeps
 * this copy. Free it with appearance_free. ERR_DATA: as bake_default, or a photograph has that
 * name. ERR_MEM. Any thread. */
enum err_code bake_with_default(const struct appearance *a, const struct gauss *g,
                                struct appearance *out, struct err *e) ERR_USE;
/* Writes a row of the model's table, [len_image], scaled to length 1. */
void bake_unit(const struct appearance *a, size_t row, float *out);

#endif
