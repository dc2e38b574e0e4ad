/* PNG: see png.h. Every row gets the filter whose differences are smallest, taken as signed bytes:
 * the heuristic that the specification (section 12.8) recommends.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/png.h"

#include <libdeflate.h>
#include <stdlib.h>
#include <string.h>

enum { PNG_SIDE_MAX = 1 << 16, PNG_LEVEL = 3, PNG_FILTERS = 4, PNG_KEYWORD_MAX = 79 };

static void png_u32(uint8_t *p, uint32_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (uint8_t)(v >> (24 - 8 * i));
}

static void png_chunk(struct buf *out, const char *type, const uint8_t *bytes, size_t n)
{
    uint8_t word[4];
    png_u32(word, (uint32_t)n);
    buf_add(out, word, 4);
    buf_add(out, type, 4);
    if (n)
        buf_add(out, bytes, n);
    uint32_t crc = libdeflate_crc32(0, type, 4);
    if (n) /* of NULL it is 0, whatever came before */
        crc = libdeflate_crc32(crc, bytes, n);
    png_u32(word, crc);
    buf_add(out, word, 4);
}

static int png_paeth(int a, int b, int c)
{
    int pa = abs(b - c), pb = abs(a - c), pc = abs(a + b - 2 * c);
    return pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
}

/* One row with a filter: 0 none, 1 sub, 2 up, 3 paeth (number 4 in the file). Returns its cost. */
static uint64_t png_filter(int filter, const uint8_t *row, const uint8_t *above, size_t n,
                           size_t step, uint8_t *out)
{
    uint64_t cost = 0;
    for (size_t i = 0; i < n; i++) {
        int a = i >= step ? row[i - step] : 0, b = above[i], c = i >= step ? above[i - step] : 0;
        int from = filter == 0 ? 0 : filter == 1 ? a : filter == 2 ? b : png_paeth(a, b, c);
        out[i] = (uint8_t)(row[i] - from);
        cost += out[i] < 128 ? out[i] : 256 - out[i];
    }
    return cost;
}

/* Filtered rows, each with its filter's number before it. */
static void png_rows(const uint8_t *px, size_t height, size_t n, size_t step, uint8_t *scratch,
                     uint8_t *out)
{
    static const uint8_t number[PNG_FILTERS] = {0, 1, 2, 4};
    const uint8_t *above = scratch + n; /* zeros */
    for (size_t y = 0; y < height; y++) {
        const uint8_t *row = px + y * n;
        uint8_t *to = out + y * (n + 1);
        uint64_t least = UINT64_MAX;
        for (int f = 0; f < PNG_FILTERS; f++) {
            uint64_t cost = png_filter(f, row, above, n, step, scratch);
            if (cost >= least)
                continue;
            least = cost;
            to[0] = number[f];
            memcpy(to + 1, scratch, n);
        }
        above = row;
    }
}

/* bytes [h][n]: rows as they go into the file. kind: bit depth and colour type; step: bytes a
 * pixel. text [n_text]: of a tEXt chunk, NULL: none. */
static enum err_code png_write(const uint8_t *bytes, uint32_t width_px, uint32_t height_px,
                               size_t step, const uint8_t kind[2], const char *text, size_t n_text,
                               struct buf *out, struct err *e)
{
    static const uint8_t magic[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
    size_t n = (size_t)width_px * step, rows = (n + 1) * height_px, packed = 0;
    uint8_t head[13] = {[8] = kind[0], [9] = kind[1]};
    struct libdeflate_compressor *z = libdeflate_alloc_compressor(PNG_LEVEL);
    size_t room = libdeflate_zlib_compress_bound(z, rows);
    uint8_t *scratch = mem_array(2 * n, 1), *filtered = mem_array(rows, 1),
            *idat = mem_array(room, 1);
    png_u32(head, width_px);
    png_u32(head + 4, height_px);
    bool ok = z && scratch && filtered && idat;
    if (ok) {
        png_rows(bytes, height_px, n, step, scratch, filtered);
        packed = libdeflate_zlib_compress(z, filtered, rows, idat, room);
    }
    libdeflate_free_compressor(z);
    if (ok) {
        buf_add(out, magic, sizeof magic);
        png_chunk(out, "IHDR", head, sizeof head);
        if (text)
            png_chunk(out, "tEXt", (const uint8_t *)text, n_text);
        for (size_t at = 0; at < packed; at += 1 << 30) /* a chunk holds less than 2^31 bytes */
            png_chunk(out, "IDAT", idat + at, packed - at < 1 << 30 ? packed - at : 1 << 30);
        png_chunk(out, "IEND", NULL, 0);
    }
    mem_free(scratch);
    mem_free(filtered);
    mem_free(idat);
    return ok ? buf_check(out, e) : err_set(e, ERR_MEM, "png: out of memory");
}

static bool png_fits(uint32_t width_px, uint32_t height_px)
{
    return width_px && height_px && width_px <= PNG_SIDE_MAX && height_px <= PNG_SIDE_MAX;
}

enum err_code png_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px,
                         uint32_t channels, struct buf *out, struct err *e)
{
    const uint8_t kind[2] = {8, channels == 1 ? 0 : channels == 3 ? 2 : 6};
    if (!png_fits(width_px, height_px) || (channels != 1 && channels != 3 && channels != 4))
        return err_set(e, ERR_ARG, "png: %u x %u px of %u channels: 1 to %d px, 1, 3 or 4",
                       width_px, height_px, channels, PNG_SIDE_MAX);
    return png_write(px, width_px, height_px, channels, kind, NULL, 0, out, e);
}

enum err_code png_encode_grey16(const uint16_t *px, uint32_t width_px, uint32_t height_px,
                                const char *keyword, const char *text, struct buf *out,
                                struct err *e)
{
    static const uint8_t kind[2] = {16, 0};
    size_t n = (size_t)width_px * height_px, n_key = strlen(keyword);
    struct buf chunk = {0};
    if (!png_fits(width_px, height_px) || !n_key || n_key > PNG_KEYWORD_MAX)
        return err_set(e, ERR_ARG, "png: %u x %u px with text \"%.80s\": 1 to %d px", width_px,
                       height_px, keyword, PNG_SIDE_MAX);
    uint8_t *bytes = mem_array(n, 2);
    for (size_t i = 0; bytes && i < n; i++) {
        bytes[2 * i] = (uint8_t)(px[i] >> 8);
        bytes[2 * i + 1] = (uint8_t)px[i];
    }
    buf_add(&chunk, keyword, n_key + 1);
    buf_add(&chunk, text, strlen(text));
    enum err_code rc = bytes ? buf_check(&chunk, e) : err_set(e, ERR_MEM, "png: out of memory");
    if (!rc)
        rc = png_write(bytes, width_px, height_px, 2, kind, (const char *)chunk.data, chunk.size,
                       out, e);
    mem_free(bytes);
    buf_free(&chunk);
    return rc;
}
