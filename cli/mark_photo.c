/* Photographs for the page of `citysplat mark`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/mark_work.h"

#include "codec/image.h"
#include "codec/limits.h"

enum { PHOTO_BYTES_MAX = 512 << 20, PHOTO_QUALITY = 95 };

bool mark_photo_strip(const uint8_t *jpeg, size_t n, struct buf *out)
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

enum err_code mark_photo_read(const char *path, struct buf *out, struct err *e)
{
    const struct codec_limits lim = {0};
    struct buf file = {0};
    struct image img = {0};
    enum err_code rc = file_read(path, PHOTO_BYTES_MAX, &file, e);
    if (rc)
        return rc;
    if (mark_photo_strip(file.data, file.size, out)) {
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
