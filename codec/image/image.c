/* Images: 8-bit RGB in, .jpg .png .webp .tif out. See image.h.
 *
 * Files are encoded in memory, get their EXIF block from exif.c, and reach the disk through
 * file_write, so no half image is ever left behind.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "codec/image/image_library.h"
#include "codec/image/jpg.h"
#include "codec/image/png.h"
#include "codec/image/webp.h"
#include "codec/limits.h"
#include "core/library.h"

/* ---- the library ---- */

static const struct image_library *image_table; /* NULL: could not be loaded, image_table_why */
static struct err image_table_why;

static void image_load_once(void)
{
    static const struct library l = {"images", IMAGE_LIBRARY_FILE, IMAGE_LIBRARY_SYMBOL,
                                     IMAGE_LIBRARY_VERSION};
    const void *table;
    if (!library_load(&l, &table, &image_table_why))
        image_table = table;
}

static enum err_code image_load(struct err *e)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, image_load_once);
    return image_table ? ERR_OK : err_set(e, image_table_why.code, "%s", image_table_why.msg);
}

/* ---- memory ---- */

enum err_code image_alloc(uint32_t width_px, uint32_t height_px, uint32_t channels,
                          struct image *out, struct err *e)
{
    *out = (struct image){0};
    if (channels != 1 && channels != 3 && channels != 4)
        return err_set(e, ERR_ARG, "image: %u channels: only 1, 3 and 4 are known", channels);
    out->px = mem_array((size_t)width_px * height_px, channels);
    if (!out->px)
        return err_set(e, ERR_MEM, "image: %u x %u: out of memory", width_px, height_px);
    out->width_px = width_px;
    out->height_px = height_px;
    out->channels = channels;
    return ERR_OK;
}

void image_free(struct image *img)
{
    mem_free(img->px);
    *img = (struct image){0};
}

/* ---- reading ---- */

static enum err_code image_open(const char *path, struct image_input **in, struct image_spec *s,
                                struct err *e)
{
    struct image_why why;
    *in = NULL;
    *s = (struct image_spec){0};
    if (!file_exists(path))
        return err_set(e, ERR_NOENT, "image: %s: no such file", path);
    enum err_code rc = image_load(e);
    if (rc)
        return rc;
    rc = image_table->open(path, in, s, &why);
    if (rc)
        return err_set(e, rc, "image: %s: not an image that can be read (%s)", path, why.text);
    if (s->width_px >= 1 && s->height_px >= 1 && s->depth <= 1 && s->channels >= 1)
        return ERR_OK;
    image_table->close(*in);
    *in = NULL;
    return err_set(e, ERR_FORMAT, "image: %s: %d x %d x %d pixels of %d channels", path,
                   s->width_px, s->height_px, s->depth, s->channels);
}

static size_t image_limit(const struct codec_limits *lim)
{
    return lim && lim->max_pixels ? lim->max_pixels : CODEC_MAX_PIXELS;
}

static enum err_code image_check(const char *path, const struct image_spec *s,
                                 const struct codec_limits *lim, struct err *e)
{
    size_t limit = image_limit(lim);
    return (size_t)s->width_px * (size_t)s->height_px <= limit
               ? ERR_OK
               : err_set(e, ERR_LIMIT, "image: %s: %d x %d pixels are more than the limit of %zu",
                         path, s->width_px, s->height_px, limit);
}

/* Reads a plain JPEG without OpenImageIO. Returns false for any other file, and for one that is
 * damaged or beyond a limit: OpenImageIO's way says so. */
static bool image_read_plain(const char *path, const struct codec_limits *lim, struct image *out)
{
    struct err e;
    struct jpg *j;
    uint32_t width_px, height_px;
    if (!jpg_open(path, &j, &width_px, &height_px))
        return false;
    bool ok = (size_t)width_px * height_px <= image_limit(lim) &&
              !image_alloc(width_px, height_px, 3, out, &e) && jpg_read(j, out->px);
    jpg_close(j);
    if (!ok)
        image_free(out);
    return ok;
}

enum err_code image_read(const char *path, const struct codec_limits *lim, struct image *out,
                         struct err *e)
{
    struct image_input *in;
    struct image_spec s;
    struct image_why why;
    struct image img = {0};
    *out = img;
    if (image_read_plain(path, lim, out))
        return ERR_OK;
    enum err_code rc = image_open(path, &in, &s, e);
    if (rc)
        return rc;
    rc = image_check(path, &s, lim, e);
    if (!rc)
        rc = image_alloc((uint32_t)s.width_px, (uint32_t)s.height_px, 3, &img, e);
    int take = s.channels >= 3 ? 3 : 1; /* 2 is grey and alpha */
    if (!rc && (rc = image_table->read_u8(in, 0, take, img.px, &why)) != ERR_OK)
        (void)err_set(e, rc, "image: %s: damaged or truncated (%s)", path, why.text);
    if (!rc && take == 1)
        for (size_t i = 0; i < (size_t)img.width_px * img.height_px; i++)
            img.px[3 * i + 1] = img.px[3 * i + 2] = img.px[3 * i];
    image_table->close(in);
    if (rc)
        image_free(&img);
    *out = img;
    return rc;
}

enum err_code image_read_alpha(const char *path, const struct codec_limits *lim, struct image *out,
                               struct err *e)
{
    struct image_input *in;
    struct image_spec s;
    struct image_why why;
    struct jpg *j;
    uint32_t size_px[2];
    *out = (struct image){0};
    if (jpg_open(path, &j, &size_px[0], &size_px[1])) { /* none has any */
        jpg_close(j);
        return ERR_OK;
    }
    enum err_code rc = image_open(path, &in, &s, e);
    if (rc)
        return rc;
    const bool there = s.alpha >= 0 && s.alpha < s.channels;
    if (there)
        rc = image_check(path, &s, lim, e);
    if (!rc && there)
        rc = image_alloc((uint32_t)s.width_px, (uint32_t)s.height_px, 3, out, e);
    if (!rc && there && (rc = image_table->read_u8(in, s.alpha, 1, out->px, &why)) != ERR_OK)
        (void)err_set(e, rc, "image: %s: damaged or truncated (%s)", path, why.text);
    image_table->close(in);
    if (rc)
        image_free(out);
    return rc;
}

enum err_code image_read_map(const char *path, const struct codec_limits *lim, uint32_t *width_px,
                             uint32_t *height_px, float **data, struct err *e)
{
    struct image_input *in;
    struct image_spec s;
    struct image_why why;
    *data = NULL;
    enum err_code rc = image_open(path, &in, &s, e);
    if (rc)
        return rc;
    rc = image_check(path, &s, lim, e);
    size_t n = (size_t)s.width_px * (size_t)s.height_px;
    float *px = rc ? NULL : mem_array(n, sizeof *px);
    if (!rc && !px)
        rc = err_set(e, ERR_MEM, "image: %s: out of memory for %zu pixels", path, n);
    if (!rc && (rc = image_table->read_float(in, px, &why)) != ERR_OK)
        (void)err_set(e, rc, "image: %s: damaged or truncated (%s)", path, why.text);
    image_table->close(in);
    if (rc) {
        mem_free(px);
        return rc;
    }
    *width_px = (uint32_t)s.width_px;
    *height_px = (uint32_t)s.height_px;
    *data = px;
    return ERR_OK;
}

/* The size of a plain JPEG without OpenImageIO. */
static bool image_size_plain(const char *path, uint32_t size_px[2])
{
    struct jpg *j;
    if (!jpg_open(path, &j, &size_px[0], &size_px[1]))
        return false;
    jpg_close(j);
    return true;
}

enum err_code image_read_info(const char *path, uint32_t *width_px, uint32_t *height_px,
                              struct image_gps *gps, struct drone_meta *drone, struct err *e)
{
    struct image_input *in;
    struct image_spec s;
    uint32_t size_px[2];
    struct image_gps gps_here;
    struct drone_meta drone_here;
    if (!image_size_plain(path, size_px)) {
        enum err_code rc = image_open(path, &in, &s, e);
        if (rc)
            return rc;
        size_px[0] = (uint32_t)s.width_px;
        size_px[1] = (uint32_t)s.height_px;
        image_table->close(in);
    }
    if (width_px)
        *width_px = size_px[0];
    if (height_px)
        *height_px = size_px[1];
    gps = gps ? gps : &gps_here;
    drone = drone ? drone : &drone_here;
    enum err_code rc = exif_read(path, gps, drone, e);
    if (!rc && !gps->has_position && drone->has_position) {
        gps->has_position = true;
        gps->lat_deg = drone->lat_deg;
        gps->lon_deg = drone->lon_deg;
    } else if (!rc && gps->no_letter && drone->has_position) { /* XMP has signs */
        gps->lat_deg = copysign(gps->lat_deg, drone->lat_deg);
        gps->lon_deg = copysign(gps->lon_deg, drone->lon_deg);
    }
    return rc;
}

/* ---- writing ---- */

static int image_quality(int quality)
{
    return quality <= 0 ? 95 : quality > 100 ? 100 : quality;
}

static void image_add(void *to, const void *bytes, size_t n)
{
    buf_add(to, bytes, n);
}

enum err_code image_encode(const struct image *img, const char *format, int quality,
                           struct buf *out, struct err *e)
{
    struct image_why why;
    if (!strcmp(format, "png"))
        return png_encode(img->px, img->width_px, img->height_px, img->channels, out, e);
    if (!strcmp(format, "webp") && img->channels >= 3)
        return webp_encode(img->px, img->width_px, img->height_px, img->channels,
                           image_quality(quality), out, e);
    if (!strcmp(format, "jpg") && jpg_encode(img->px, img->width_px, img->height_px, img->channels,
                                             image_quality(quality), out))
        return buf_check(out, e);
    enum err_code rc = image_load(e);
    if (rc)
        return rc;
    rc = image_table->encode(img, format, image_quality(quality), image_add, out, &why);
    return rc ? err_set(e, rc, "image: %u x %u as %s: %s", img->width_px, img->height_px, format,
                        why.text)
              : buf_check(out, e);
}

/* libtiff seeks while it writes: by way of the disk. */
static enum err_code image_encode_tiff(const char *path, const struct image *img, struct buf *out,
                                       struct err *e)
{
    char part[FILE_PATH_MAX];
    struct image_why why;
    enum err_code rc = image_load(e);
    if (!rc)
        rc = file_begin(path, part, e);
    if (rc)
        return rc;
    rc = image_table->write_tiff(part, img, &why);
    rc = rc ? err_set(e, rc, "image: %u x %u as tif: %s", img->width_px, img->height_px, why.text)
            : file_read(part, 0, out, e);
    file_abort(part);
    return rc;
}

/* NULL: not one that is written. */
static const char *image_format(const char *path)
{
    static const char *const known[][2] = {{"jpg", "jpg"},   {"jpeg", "jpg"}, {"png", "png"},
                                           {"webp", "webp"}, {"tif", "tif"},  {"tiff", "tif"}};
    const char *dot = strrchr(path, '.');
    for (size_t i = 0; dot && i < sizeof known / sizeof *known; i++)
        if (!strcasecmp(dot + 1, known[i][0]))
            return known[i][1];
    return NULL;
}

enum err_code image_write(const char *path, const struct image *img, int quality,
                          const struct image_gps *gps, struct err *e)
{
    const char *format = image_format(path);
    struct buf b = {0};
    if (!format)
        return err_set(e, ERR_ARG, "image: %s: the name must end in .jpg .png .webp or .tif", path);
    enum err_code rc = strcmp(format, "tif") ? image_encode(img, format, quality, &b, e)
                                             : image_encode_tiff(path, img, &b, e);
    if (!rc && gps)
        rc = exif_insert(&b, gps, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    else
        (void)err_add(e, "%s", path);
    buf_free(&b);
    return rc;
}
