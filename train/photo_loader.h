/* Photographs from the disk, decoded ahead of the step that needs them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_PHOTO_LOADER_H
#define TRAIN_PHOTO_LOADER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/camera.h"

struct scene;

struct photo {
    uint32_t image; /* index into the scene's images */
    struct camera cam;
    const uint8_t *px;    /* [h][w][3], borrowed until the next photo_loader_get */
    const uint8_t *mask;  /* [h][w], 0 = ignore; NULL: use all. From scene/masks (codec/mask.h) */
    const char *name;     /* of the file, borrowed from the scene */
    float exposure_ev[3]; /* the exposure of a drawing that is compared with px
                             (core/exposure.h); 0 where px was brought to the mean */
};
enum photo_loader_exposure {
    PHOTO_LOADER_AS_TAKEN, /* px as in the file; exposure_ev is 0: the model knows nothing of it */
    PHOTO_LOADER_TO_MEAN,  /* px at the mean exposure; what is clipped then is masked */
    PHOTO_LOADER_TOLD      /* px as in the file, and exposure_ev says how to compare */
};
struct photo_loader_config {
    const struct scene *scene; /* borrowed while it is open, as is images */
    const uint32_t *images;
    size_t n_images;
    uint32_t max_edge_px; /* 0 = as ingested */
    double downsample;
    enum photo_loader_exposure exposure;
    bool no_masks;      /* use photographs whole even where the scene has masks */
    size_t cache_bytes; /* decoded photographs kept; at least one is */
    uint64_t seed;
    uint32_t level;
};
struct photo_loader; /* an LRU cache and one thread that decodes ahead of the order of use */
/* Start it; nothing is read yet. One caller at a time. photo_loader_close it. ERR_MEM; ERR_LIMIT:
 * no thread can be started. */
enum err_code photo_loader_open(const struct photo_loader_config *cfg, struct photo_loader **out,
                                struct err *e) ERR_USE;
void photo_loader_close(struct photo_loader **f);
/* The photograph of a step (1-based): position in this epoch's shuffle, a function of seed, level
 * and step. Waits until it is decoded and lets the thread go on with the ones after it. ERR_NOENT,
 * ERR_IO, ERR_FORMAT: the file; ERR_DATA: its mask does not fit; ERR_MEM. */
enum err_code photo_loader_get(struct photo_loader *f, uint32_t step, struct photo *out,
                               struct err *e) ERR_USE;
/* The n-th of the list, out of order (scoring, evaluation); also borrowed until the next call.
 * ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_DATA, ERR_MEM. */
enum err_code photo_loader_get_nth(struct photo_loader *f, size_t nth, struct photo *out,
                                   struct err *e) ERR_USE;
size_t photo_loader_bytes(const struct photo_loader *f); /* held by the cache now */
/* The camera of a photograph at training size. */
struct camera photo_loader_camera(const struct camera *cam, uint32_t max_edge_px,
                                  double downsample);
#endif
