/* A store with one tile whose Gaussians have embeddings, for tests of the server's appearances.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_LIT_H
#define TESTS_LIT_H

#include "tests/server/served.h"

#include "core/splat/appearance.h"
#include "core/splat/gauss.h"
#include "lod/store/bake.h"

/* Writes the store. The caller allocates and names `photos`. *out: their model with the default
 * appearance, as in the store; free it with appearance_free. beside (may be NULL) adds other blobs
 * about photographs. */
static inline void lit_city(const char *path, const char *name, const struct appearance *photos,
                            void (*beside)(struct store *s), struct appearance *out)
{
    struct err e = {0};
    struct store *s = NULL;
    struct gauss g;
    struct buf blob = {0};
    struct store_meta meta = {.origin = served_origin,
                              .sh_degree = 1,
                              .embed_len = photos->len_gauss,
                              .zoom_min = SERVED_ZOOM_MAX,
                              .zoom_max = SERVED_ZOOM_MAX};
    snprintf(meta.name, sizeof meta.name, "%s", name);
    kit_gauss(7, 60, 20, 1, photos->len_gauss, &g);
    kit_ok(bake_with_default(photos, &g, out, &e), e);
    kit_ok(appearance_write(out, &blob, &e), e);
    kit_ok(store_create(path, &meta, &s, &e), e);
    struct store_entry tile = {.tile = {.key = served_key(SERVED_ZOOM_MAX), .level = 1}};
    kit_ok(store_put(s, &tile, &g, &e), e);
    kit_ok(store_put_blob(s, BAKE_BLOB, blob.data, blob.size, &e), e);
    if (beside)
        beside(s);
    kit_ok(store_commit(&s, &e), e);
    buf_free(&blob);
    gauss_free(&g);
}

enum { LIT_PHOTOS = 5, LIT_LEN = 4, LIT_IMAGE = 6 };

/* The city "toy" in the light of five photographs: dawn, p1.jpg to p4.jpg. seed: of the network. */
static inline void lit_by_five(const char *path, uint64_t seed)
{
    struct err e = {0};
    struct appearance photos, model;
    kit_ok(appearance_alloc(&photos, LIT_LEN, LIT_IMAGE, 8, LIT_PHOTOS, &e), e);
    appearance_init(&photos, seed);
    for (size_t i = 0; i < LIT_PHOTOS; i++)
        snprintf(photos.names[i], APPEARANCE_NAME_MAX, i ? "p%zu.jpg" : "dawn", i);
    lit_city(path, "toy", &photos, NULL, &model);
    appearance_free(&photos);
    appearance_free(&model);
}

#endif
