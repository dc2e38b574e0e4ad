/* Photographs for the page of `citysplat mark`: whole, or, where they are large, a small picture of
 * all and parts at full size. The photographs that were asked for last are kept decoded.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/scene/mark_work.h"

#include <string.h>

#include "codec/limits.h"

enum { PHOTO_BYTES_MAX = 512 << 20, PHOTO_QUALITY = 95, PHOTO_SMALL_QUALITY = 90 };

/* Removes EXIF, XMP and maker's data (APP1 to APP15 without colour profiles) from a JPEG. False: it
 * is none, or ends within its head. */
static bool photo_strip(const uint8_t *jpeg, size_t n, struct buf *out)
{
    size_t at = 2;
    if (n < 4 || jpeg[0] != 0xff || jpeg[1] != 0xd8)
        return false;
    buf_add(out, jpeg, 2);
    while (at + 4 <= n && jpeg[at] == 0xff) {
        const unsigned kind = jpeg[at + 1];
        const size_t size = 2 + ((size_t)jpeg[at + 2] << 8 | jpeg[at + 3]);
        if (kind == 0xda) { /* pixels, to the end */
            buf_add(out, jpeg + at, n - at);
            return true;
        }
        if (kind == 0xff) { /* fill */
            at++;
            continue;
        }
        if (size < 4 || size > n - at)
            return false;
        /* APP0 is JFIF's, APP2 has colour profiles, APP14 says what three channels are */
        if (kind < 0xe1 || kind > 0xef || kind == 0xe2 || kind == 0xee)
            buf_add(out, jpeg + at, size);
        at += size;
    }
    return false;
}

/* A JPEG as it is but without EXIF, by which browsers would turn it, and COLMAP does not; others as
 * JPEG. */
static enum err_code photo_read(const char *path, struct buf *out, struct err *e)
{
    const struct codec_limits lim = {0};
    struct buf file = {0};
    struct image img = {0};
    enum err_code rc = file_read(path, PHOTO_BYTES_MAX, &file, e);
    if (rc)
        return rc;
    if (photo_strip(file.data, file.size, out)) {
        buf_free(&file);
        return buf_check(out, e);
    }
    buf_free(&file);
    buf_free(out);
    rc = image_read(path, &lim, &img, e);
    if (!rc)
        rc = image_encode(&img, "jpg", PHOTO_QUALITY, out, e);
    image_free(&img);
    return rc;
}

/* ---- large photographs ---- */

/* Decodes a photograph, or finds it. It is valid while the lock of the album is held. */
static enum err_code photo_decoded(struct mark_album *a, const char *path, size_t photo,
                                   const struct image **out, struct err *e)
{
    const struct codec_limits lim = {0};
    struct mark_album_page *oldest = &a->pages[0];
    for (size_t k = 0; k < MARK_ALBUM_PAGES; k++) {
        struct mark_album_page *p = &a->pages[k];
        if (p->image.px && p->photo == photo) {
            p->used = ++a->now;
            *out = &p->image;
            return ERR_OK;
        }
        if (p->used < oldest->used)
            oldest = p;
    }
    image_free(&oldest->image);
    enum err_code rc = image_read(path, &lim, &oldest->image, e);
    if (rc)
        return rc;
    oldest->photo = photo;
    oldest->used = ++a->now;
    *out = &oldest->image;
    return ERR_OK;
}

static enum err_code photo_small(const struct image *img, struct buf *out, struct err *e)
{
    const uint32_t longest = img->width_px > img->height_px ? img->width_px : img->height_px;
    const uint64_t w = (uint64_t)img->width_px * MARK_WHOLE_PX / longest,
                   h = (uint64_t)img->height_px * MARK_WHOLE_PX / longest;
    struct image small;
    enum err_code rc = image_resize(img, w ? (uint32_t)w : 1, h ? (uint32_t)h : 1, &small, e);
    if (!rc)
        rc = image_encode(&small, "jpg", PHOTO_SMALL_QUALITY, out, e);
    image_free(&small);
    return rc;
}

static enum err_code photo_part(const struct image *img, uint32_t column, uint32_t row,
                                struct buf *out, struct err *e)
{
    const uint64_t x = (uint64_t)column * MARK_PART_PX, y = (uint64_t)row * MARK_PART_PX;
    struct image part = {0};
    if (x >= img->width_px || y >= img->height_px)
        return err_set(e, ERR_NOENT, "the photograph has no such part");
    const uint64_t w = img->width_px - x, h = img->height_px - y;
    enum err_code rc =
        image_alloc((uint32_t)(w < MARK_PART_PX ? w : MARK_PART_PX),
                    (uint32_t)(h < MARK_PART_PX ? h : MARK_PART_PX), img->channels, &part, e);
    const size_t bytes = (size_t)part.width_px * img->channels;
    for (size_t k = 0; !rc && k < part.height_px; k++)
        memcpy(part.px + k * bytes, img->px + ((y + k) * img->width_px + x) * img->channels, bytes);
    if (!rc)
        rc = image_encode(&part, "jpg", PHOTO_QUALITY, out, e);
    image_free(&part);
    return rc;
}

enum err_code mark_photo_whole(struct mark_album *a, const char *path, size_t photo,
                               uint32_t longest_px, struct buf *out, struct err *e)
{
    const struct image *img;
    if (longest_px <= MARK_WHOLE_PX)
        return photo_read(path, out, e);
    pthread_mutex_lock(&a->lock);
    enum err_code rc = photo_decoded(a, path, photo, &img, e);
    if (!rc)
        rc = photo_small(img, out, e);
    pthread_mutex_unlock(&a->lock);
    return rc;
}

enum err_code mark_photo_part(struct mark_album *a, const char *path, size_t photo, uint32_t column,
                              uint32_t row, struct buf *out, struct err *e)
{
    const struct image *img;
    pthread_mutex_lock(&a->lock);
    enum err_code rc = photo_decoded(a, path, photo, &img, e);
    if (!rc)
        rc = photo_part(img, column, row, out, e);
    pthread_mutex_unlock(&a->lock);
    return rc;
}

void mark_album_free(struct mark_album *a)
{
    for (size_t k = 0; k < MARK_ALBUM_PAGES; k++)
        image_free(&a->pages[k].image);
}
