/* What OpenImageIO does for codec/image.c: image_shim.cc, a library of its own that is loaded with
 * the first image. OpenImageIO brings 250 libraries, which cost 0.35 s at the start of every
 * process that is linked with it, and most commands and tests see no image.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_IMAGE_LIBRARY_H
#define CODEC_IMAGE_LIBRARY_H

#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

#define IMAGE_LIBRARY_FILE "citysplat-image.so"
#define IMAGE_LIBRARY_SYMBOL "image_library_table"
#define IMAGE_LIBRARY_VERSION 1u /* another one with every change of this table */

struct image;
struct image_input; /* an open file */
struct image_spec { /* of a file: as it says, unchecked */
    int width_px, height_px, depth, channels;
};
struct image_why { /* of what failed, one line */
    char text[256];
};

/* Needs nothing of the program and throws nothing. Any thread; an input is one thread's. Every
 * `why` is set where the code is not ERR_OK; ERR_MEM and ERR_INTERNAL come from all. */
struct image_library {
    uint32_t version;
    /* close it. ERR_FORMAT. */
    enum err_code (*open)(const char *path, struct image_input **in, struct image_spec *spec,
                          struct image_why *why);
    void (*close)(struct image_input *in);
    /* The first `take` channels, 8 bits, three bytes a pixel. ERR_FORMAT: damaged or truncated. */
    enum err_code (*read_u8)(struct image_input *in, int take, uint8_t *px, struct image_why *why);
    /* The first channel: integers as 0..1, floats as they are. ERR_FORMAT. */
    enum err_code (*read_float)(struct image_input *in, float *px, struct image_why *why);
    /* XMP as OpenImageIO has it, "prefix:Name"; `in` is an image_input. See drone_read. */
    bool (*attribute)(const void *in, const char *name, char *text, size_t room);
    /* .jpg and other formats in memory; quality 1..100. ERR_ARG (format), ERR_LIMIT (too large for
     * it). */
    enum err_code (*encode)(const struct image *img, const char *format, int quality,
                            void (*add)(void *to, const void *bytes, size_t n), void *to,
                            struct image_why *why);
    /* A TIFF on the disk: libtiff seeks while it writes. ERR_LIMIT. */
    enum err_code (*write_tiff)(const char *path, const struct image *img, struct image_why *why);
};

#endif
