/* Loads photographs from disk and decodes them before they are needed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_PHOTO_LOADER_H
#define TRAIN_PHOTO_LOADER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/splat/camera.h"

struct scene;

struct photo {
    uint32_t image; /* index into the scene's images */
    struct camera cam;
    const uint8_t *px; /* [h][w][3]; borrowed until the next photo_loader_get */
    const uint8_t
        *mask;        /* [h][w], 0 = ignore; from scene/masks (codec/scene/mask.h); NULL: use all */
    const char *name; /* of the file; borrowed from the scene */
    /* exposure for a drawing that is compared with px (core/splat/exposure.h); 0 if px was brought
     * to the mean */
    float exposure_ev[3];
};
enum photo_loader_exposure {
    PHOTO_LOADER_AS_TAKEN, /* px as in the file, exposure_ev 0: the model ignores exposure */
    PHOTO_LOADER_TO_MEAN,  /* px at the mean exposure; clipped pixels are masked */
    PHOTO_LOADER_TOLD      /* px as in the file; exposure_ev is for the comparison */
};
struct photo_loader_config {
    const struct scene *scene; /* borrowed while the loader is open, as is images */
    const uint32_t *images;
    size_t n_images;
    const struct camera_window *windows; /* [n_images] parts to use; borrowed; NULL: all of each */
    uint32_t max_edge_px;                /* 0 = as ingested */
    double downsample;
    enum photo_loader_exposure exposure;
    bool no_masks;      /* ignore masks of the scene */
    size_t cache_bytes; /* limit of decoded photographs in memory; at least one is kept */
    uint64_t seed;
    uint32_t level;
};
struct photo_loader; /* an LRU cache, and a thread that decodes in the order of use */
/* Opens a loader; nothing is read yet. Only one thread at a time may use it. Close it with
 * photo_loader_close. ERR_MEM. ERR_LIMIT: no thread can be started. */
enum err_code photo_loader_open(const struct photo_loader_config *cfg, struct photo_loader **out,
                                struct err *e) ERR_USE;
void photo_loader_close(struct photo_loader **f);
/* Returns the photograph of a step (1-based): its position in the shuffle of the epoch, a function
 * of seed, level and step. It waits until the photograph is decoded, and the thread goes on with
 * later ones. ERR_NOENT, ERR_IO, ERR_FORMAT: of the file. ERR_DATA: the mask has another size.
 * ERR_MEM. */
enum err_code photo_loader_get(struct photo_loader *f, uint32_t step, struct photo *out,
                               struct err *e) ERR_USE;
/* Returns photograph `nth` of the list, out of order, for scoring. It is also borrowed until the
 * next call. ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_DATA, ERR_MEM. */
enum err_code photo_loader_get_nth(struct photo_loader *f, size_t nth, struct photo *out,
                                   struct err *e) ERR_USE;
size_t photo_loader_bytes(const struct photo_loader *f); /* bytes in the cache now */
/* The camera of a photograph at training size. */
struct camera photo_loader_camera(const struct camera *cam, uint32_t max_edge_px,
                                  double downsample);
#endif
