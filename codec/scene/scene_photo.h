/* A photograph of a scene, prepared for comparison with drawings: at a given size, with a mask of
 * the pixels that count, and optionally at the mean exposure of the survey.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_SCENE_PHOTO_H
#define CODEC_SCENE_PHOTO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "codec/image/image.h"

struct scene;

struct scene_photo {   /* free with scene_photo_free */
    struct image img;  /* [h][w][3] */
    struct image mask; /* [h][w], 0 = ignore; empty: all pixels count */
};
struct scene_photo_form {
    uint32_t width_px, height_px;
    bool to_mean;   /* to the mean exposure (core/splat/exposure.h) */
    unsigned masks; /* SCENE_PHOTO_*, from scene_photo_masks */
};
enum {
    SCENE_PHOTO_FILE = 1,   /* there is a mask in scene/masks (codec/scene/mask.h) */
    SCENE_PHOTO_CLIPPED = 2 /* at the mean exposure, clipped pixels are ignored */
};
/* Finds which masks photograph `image` has. files: those of scene/masks count too. ERR_LIMIT. */
enum err_code scene_photo_masks(const struct scene *s, uint32_t image, bool files, bool to_mean,
                                unsigned *out, struct err *e) ERR_USE;
/* Reads a photograph in this form. Any thread may call it. ERR_DATA: photograph or mask is not as
 * large as the scene says. ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_LIMIT: a file cannot be read.
 * ERR_MEM. */
enum err_code scene_photo_read(const struct scene *s, uint32_t image,
                               const struct scene_photo_form *form, struct scene_photo *out,
                               struct err *e) ERR_USE;
void scene_photo_free(struct scene_photo *p);

#endif
