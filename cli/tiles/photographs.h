/* The photographs of a scene as blobs of a store: time, pose and thumbnail of each.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_PHOTOGRAPHS_H
#define CLI_PHOTOGRAPHS_H

#include "codec/scene/scene.h"
#include "lod/store/store.h"

struct appearance;

struct photographs { /* {0} is empty; photographs_free */
    struct store_blob *blobs;
    size_t n_blobs;
    struct photographs_one *all;
    size_t n;
    size_t thumbnail_bytes; /* total of all thumbnails */
};
/* Makes blobs for the photographs of the scene that the appearance model has. If a file cannot be
 * read it warns and leaves the thumbnail out. s must outlive *out. It runs in parallel. ERR_LIMIT,
 * ERR_MEM, ERR_DATA. */
enum err_code photographs_of(const struct scene *s, const struct appearance *a, bool thumbnails,
                             struct photographs *out, struct err *e) ERR_USE;
void photographs_free(struct photographs *p);

#endif
