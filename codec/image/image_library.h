/* OpenImageIO's functions for codec/image/image.c. image_shim.cc is a library of its own, which is
 * loaded with the first image that is no plain JPEG (jpg.h). OpenImageIO needs 250 libraries: 0.8 s
 * of processor time in every process that loads it.
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
#define IMAGE_LIBRARY_VERSION 3u /* changes with every change of this table */

struct image;
struct image_input; /* an open file */
struct image_spec { /* of a file, as the file states it; not checked */
    int width_px, height_px, depth, channels;
    int alpha; /* index of its channel; -1: none */
};
struct image_why { /* the reason of a failure, in one line */
    char text[256];
};

/* The library needs nothing of the program and throws nothing. Any thread may call it, but only one
 * thread may use an input. If the result is not ERR_OK, `why` is set. Any function may return
 * ERR_MEM and ERR_INTERNAL. */
struct image_library {
    uint32_t version;
    /* The caller closes *in. ERR_FORMAT. */
    enum err_code (*open)(const char *path, struct image_input **in, struct image_spec *spec,
                          struct image_why *why);
    void (*close)(struct image_input *in);
    /* Reads `take` channels from `first` on as 8 bits, three bytes a pixel. ERR_FORMAT: damaged or
     * truncated. */
    enum err_code (*read_u8)(struct image_input *in, int first, int take, uint8_t *px,
                             struct image_why *why);
    /* Reads the first channel: integers as 0..1, floats unchanged. ERR_FORMAT. */
    enum err_code (*read_float)(struct image_input *in, float *px, struct image_why *why);
    /* Encodes .jpg and other formats in memory. quality is 1..100. ERR_ARG (format), ERR_LIMIT (too
     * large for it). */
    enum err_code (*encode)(const struct image *img, const char *format, int quality,
                            void (*add)(void *to, const void *bytes, size_t n), void *to,
                            struct image_why *why);
    /* Writes a TIFF to the disk, because libtiff seeks while it writes. ERR_LIMIT. */
    enum err_code (*write_tiff)(const char *path, const struct image *img, struct image_why *why);
};

#endif
