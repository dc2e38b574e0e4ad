/* Where the nodes of a glTF file put its primitives of Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_GLB_NODES_H
#define CODEC_GLB_NODES_H

#include <jansson.h>

#include "core/err.h"

#define GLB_SPLAT "KHR_gaussian_splatting"
#define GLB_SPZ GLB_SPLAT "_compression_spz_2"

struct glb_place { /* of one primitive: p' = scale rot p + shift */
    const json_t *primitive, *splat;
    double rot[9], scale, shift[3];
};
struct glb_places {
    struct glb_place *list;
    size_t n, cap;
};
/* Finds all primitives with Gaussians of the scene; of a file without scenes, those of all meshes.
 * A mesh that two nodes show is there twice. `out` is {0}; mem_free out->list, which borrows from
 * root. ERR_FORMAT (none; nodes that are no tree, or that stretch or mirror), ERR_LIMIT,
 * ERR_MEM. */
enum err_code glb_places_find(const json_t *root, struct glb_places *out, struct err *e) ERR_USE;
/* ERR_FORMAT, with what to do: the Gaussians are in an extension that is not read, as drafts. */
enum err_code glb_other_extension(const char *name, struct err *e) ERR_USE;
/* root.ARRAY[index]; NULL: there is none. */
const json_t *glb_array_at(const json_t *root, const char *array, const json_t *index);

#endif
