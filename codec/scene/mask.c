/* Masks of photographs: reading, shrinking, undistorting, and their effect on points and residuals.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/mask.h"

#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/scene/scene.h"

enum {
    MASK_USE = 128,
    MASK_COLOUR = 48, /* channels of a grey differ by less */
    MASK_FEW = 1000   /* a thousandth of the pixels may be anything */
};

enum err_code mask_path(const char *dir, const char *photo_name, char out[FILE_PATH_MAX],
                        struct err *e)
{
    char name[FILE_PATH_MAX];
    if (snprintf(name, sizeof name, "%s.png", photo_name) >= (int)sizeof name)
        return err_set(e, ERR_LIMIT, "%.100s...: the name is too long", photo_name);
    return file_join(out, dir, name, e);
}

/* The greatest channel: black is black, and any colour is not. */
static uint8_t mask_value(const struct image *img, size_t i)
{
    const uint8_t *p = img->px + i * img->channels;
    if (img->channels < 3)
        return p[0];
    const uint8_t most = p[0] > p[1] ? p[0] : p[1];
    return most > p[2] ? most : p[2];
}

/* `from` is freed. */
static enum err_code mask_take(const char *path, struct image *from, uint8_t use, uint32_t width_px,
                               uint32_t height_px, struct image *out, struct err *e)
{
    struct image img = *from;
    enum err_code rc = ERR_OK;
    *from = (struct image){0};
    if (!rc && (img.width_px != width_px || img.height_px != height_px))
        rc = err_set(e, ERR_DATA, "%s: a mask of %u x %u pixels for a photograph of %u x %u", path,
                     img.width_px, img.height_px, width_px, height_px);
    if (!rc)
        rc = image_alloc(width_px, height_px, 1, out, e);
    for (size_t i = 0; !rc && i < (size_t)width_px * height_px; i++)
        out->px[i] = mask_value(&img, i) < use ? 0 : 255;
    image_free(&img);
    return rc;
}

static atomic_flag mask_told = ATOMIC_FLAG_INIT; /* one such file: all of a folder are alike */

/* The least value that means use. Where nothing is bright, values are numbers, as of a mask of 0
 * and 1: all but 0 mean use, as for COLMAP. Two greys without black are likely meant otherwise; a
 * mask of 1 alone has nothing to ignore. */
static uint8_t mask_use_from(const char *path, const struct image *img)
{
    uint8_t least = 255, most = 0;
    for (size_t i = 0; i < (size_t)img->width_px * img->height_px; i++) {
        const uint8_t v = mask_value(img, i);
        least = v < least ? v : least;
        most = v > most ? v : most;
    }
    if (least > 0 && most > 1 && most < MASK_USE && !atomic_flag_test_and_set(&mask_told))
        log_warn("mask",
                 "%s: has greys from %u to %u alone, so it masks nothing: write 0 (black) for what "
                 "to ignore and 255 (white) for the rest; other masks are not checked",
                 path, least, most);
    return most < MASK_USE ? 1 : MASK_USE;
}

static bool mask_apart(const uint8_t *a, const uint8_t *b)
{
    return abs(a[0] - b[0]) > MASK_COLOUR || abs(a[1] - b[1]) > MASK_COLOUR ||
           abs(a[2] - b[2]) > MASK_COLOUR;
}

/* Black and one colour are a mask. Of several colours, as classes have, nothing says which are to
 * be ignored. A few pixels are noise. */
static enum err_code mask_check_colours(const char *path, const struct image *img, struct err *e)
{
    const size_t n = img->channels < 3 ? 0 : (size_t)img->width_px * img->height_px;
    const uint8_t *colour = NULL;
    size_t coloured = 0, other = 0;
    for (size_t i = 0; i < n; i++) {
        const uint8_t *p = img->px + i * img->channels;
        if (abs(p[0] - p[1]) < MASK_COLOUR && abs(p[1] - p[2]) < MASK_COLOUR &&
            abs(p[0] - p[2]) < MASK_COLOUR)
            continue;
        colour = colour ? colour : p;
        coloured++;
    }
    for (size_t i = 0; colour && i < n; i++)
        other +=
            mask_value(img, i) >= MASK_COLOUR && mask_apart(img->px + i * img->channels, colour);
    if (coloured <= n / MASK_FEW || other <= n / MASK_FEW)
        return ERR_OK;
    return err_set(e, ERR_DATA,
                   "%s: has several colours, (%d, %d, %d) for one, as a picture of classes has: "
                   "write a mask that is black where the photograph is to be ignored and white "
                   "elsewhere",
                   path, colour[0], colour[1], colour[2]);
}

enum err_code mask_read(const char *path, uint32_t width_px, uint32_t height_px, struct image *out,
                        struct err *e)
{
    struct image img = {0};
    *out = (struct image){0};
    enum err_code rc = image_read(path, NULL, &img, e);
    if (!rc)
        rc = mask_check_colours(path, &img, e);
    if (!rc)
        return mask_take(path, &img, mask_use_from(path, &img), width_px, height_px, out, e);
    image_free(&img);
    return rc;
}

bool mask_is_empty(const uint8_t *px, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (px[i])
            return false;
    return true;
}

enum err_code mask_read_alpha(const char *photo, uint32_t width_px, uint32_t height_px,
                              struct image *out, bool *blank, struct err *e)
{
    struct image img = {0};
    *out = (struct image){0};
    enum err_code rc = image_read_alpha(photo, NULL, &img, e);
    if (!rc && img.px)
        rc = mask_take(photo, &img, MASK_USE, width_px, height_px, out, e);
    const size_t n = (size_t)out->width_px * out->height_px;
    *blank = !rc && out->px && mask_is_empty(out->px, n);
    if (!rc && out->px && (*blank || !memchr(out->px, 0, n)))
        image_free(out);
    return rc;
}

enum err_code mask_resize(const struct image *in, uint32_t width_px, uint32_t height_px,
                          struct image *out, struct err *e)
{
    enum err_code rc = image_alloc(width_px, height_px, 1, out, e);
    if (rc)
        return rc;
    memset(out->px, 255, (size_t)width_px * height_px);
    for (uint32_t y = 0; y < in->height_px; y++)
        for (uint32_t x = 0; x < in->width_px; x++) {
            if (in->px[(size_t)y * in->width_px + x])
                continue;
            /* All pixels of the result that this one touches. */
            uint64_t x0 = (uint64_t)x * width_px / in->width_px;
            uint64_t x1 = ((uint64_t)(x + 1) * width_px - 1) / in->width_px;
            uint64_t y0 = (uint64_t)y * height_px / in->height_px;
            uint64_t y1 = ((uint64_t)(y + 1) * height_px - 1) / in->height_px;
            for (uint64_t j = y0; j <= y1; j++)
                memset(out->px + j * width_px + x0, 0, x1 - x0 + 1);
        }
    return ERR_OK;
}

enum err_code mask_points(const struct scene *s, const uint32_t *images, size_t n_images,
                          uint8_t *use, struct err *e)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    enum err_code rc = file_join(dir, s->dir, "masks", e);
    if (rc || !file_is_dir(dir))
        return rc;
    for (size_t i = 0; !rc && i < n_images; i++) {
        const struct scene_image *im = &s->images[images[i]];
        struct image mask = {0};
        rc = mask_path(dir, im->name, path, e);
        if (rc || !file_exists(path))
            continue;
        rc = mask_read(path, im->cam.width_px, im->cam.height_px, &mask, e);
        for (size_t t = scene_first_track(s, images[i]);
             !rc && t < s->n_tracks && s->tracks[t].image == images[i]; t++) {
            float x = s->tracks[t].x_px, y = s->tracks[t].y_px;
            if (x >= 0.0f && y >= 0.0f && x < (float)mask.width_px && y < (float)mask.height_px &&
                !mask.px[(size_t)y * mask.width_px + (size_t)x])
                use[s->tracks[t].point] = 0;
        }
        image_free(&mask);
    }
    return rc;
}
