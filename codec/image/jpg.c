/* Plain JPEG pictures. See jpg.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/jpg.h"

#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jpeglib.h>

#include "core/base.h"

enum { JPG_FULL_CHROMA_QUALITY = 95 }; /* as in image_shim.cc */

struct jpg {
    struct jpeg_decompress_struct dec;
    struct jpeg_error_mgr say;
    jmp_buf failed;
    FILE *file;
};

/* libjpeg has no other way back. */
static void jpg_fail(j_common_ptr any)
{
    longjmp(*(jmp_buf *)any->client_data, 1);
}

static void jpg_be_quiet(j_common_ptr any)
{
    (void)any;
}

static struct jpeg_error_mgr *jpg_errors(struct jpeg_error_mgr *say)
{
    jpeg_std_error(say);
    say->error_exit = jpg_fail;
    say->output_message = jpg_be_quiet;
    return say;
}

static bool jpg_is_plain(const struct jpg *j)
{
    const struct jpeg_decompress_struct *d = &j->dec;
    return d->data_precision == 8 && !d->err->num_warnings &&
           ((d->num_components == 1 && d->jpeg_color_space == JCS_GRAYSCALE) ||
            (d->num_components == 3 &&
             (d->jpeg_color_space == JCS_YCbCr || d->jpeg_color_space == JCS_RGB)));
}

static bool jpg_read_head(struct jpg *j)
{
    if (setjmp(j->failed))
        return false;
    jpeg_create_decompress(&j->dec);
    jpeg_stdio_src(&j->dec, j->file);
    return jpeg_read_header(&j->dec, TRUE) == JPEG_HEADER_OK && jpg_is_plain(j);
}

bool jpg_open(const char *path, struct jpg **out, uint32_t *width_px, uint32_t *height_px)
{
    static const uint8_t start[2] = {0xff, 0xd8};
    uint8_t head[2];
    struct jpg *j = mem_array(1, sizeof *j);
    *out = NULL;
    if (!j)
        return false;
    j->dec.err = jpg_errors(&j->say);
    j->dec.client_data = &j->failed;
    j->file = fopen(path, "rb");
    if (!j->file || fread(head, 1, 2, j->file) != 2 || memcmp(head, start, 2) != 0 ||
        fseek(j->file, 0, SEEK_SET) || !jpg_read_head(j)) {
        jpg_close(j);
        return false;
    }
    *width_px = j->dec.image_width;
    *height_px = j->dec.image_height;
    *out = j;
    return true;
}

/* From the end, because the grey of a pixel lies before its place as RGB. */
static void jpg_expand(uint8_t *row, size_t n)
{
    for (size_t i = n; i-- > 0;)
        row[3 * i] = row[3 * i + 1] = row[3 * i + 2] = row[i];
}

bool jpg_read(struct jpg *j, uint8_t *px)
{
    if (setjmp(j->failed))
        return false;
    j->dec.out_color_space = j->dec.num_components == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_start_decompress(&j->dec);
    const size_t width = j->dec.output_width;
    while (j->dec.output_scanline < j->dec.output_height) {
        JSAMPROW row = px + 3 * width * j->dec.output_scanline;
        if (jpeg_read_scanlines(&j->dec, &row, 1) != 1)
            return false;
        if (j->dec.num_components == 1)
            jpg_expand(row, width);
    }
    jpeg_finish_decompress(&j->dec);
    return !j->say.num_warnings;
}

void jpg_close(struct jpg *j)
{
    if (!j)
        return;
    if (!setjmp(j->failed))
        jpeg_destroy_decompress(&j->dec);
    if (j->file)
        fclose(j->file);
    mem_free(j);
}

/* ---- writing ---- */

/* EXIF 2.30: components Y Cb Cr, FlashPix 1.0, colours are sRGB. */
static const uint8_t jpg_exif[] =
    "Exif\0\0II*\0\10\0\0\0\1\0\151\207\4\0\1\0\0\0\32\0\0\0\0\0\0\0"
    "\4\0\0\220\7\0\4\0\0\0000230\1\221\7\0\4\0\0\0\1\2\3\0\0\240\7\0\4\0\0\0000100"
    "\1\240\3\0\1\0\0\0\1\0\0\0\0\0\0\0";

struct jpg_writer {
    struct jpeg_compress_struct enc;
    struct jpeg_error_mgr say;
    jmp_buf failed;
    unsigned char *bytes; /* libjpeg's */
    unsigned long n;
};

static void jpg_setup(struct jpg_writer *w, int quality)
{
    struct jpeg_compress_struct *c = &w->enc;
    c->in_color_space = c->input_components == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_set_defaults(c);
    c->density_unit = 0;
    jpeg_set_quality(c, quality, TRUE);
    if (quality >= JPG_FULL_CHROMA_QUALITY)
        c->comp_info[0].h_samp_factor = c->comp_info[0].v_samp_factor = 1;
}

static bool jpg_compress(struct jpg_writer *w, const uint8_t *px, const uint32_t size_px[2],
                         uint32_t channels, int quality)
{
    if (setjmp(w->failed))
        return false;
    jpeg_create_compress(&w->enc);
    jpeg_mem_dest(&w->enc, &w->bytes, &w->n);
    w->enc.image_width = size_px[0];
    w->enc.image_height = size_px[1];
    w->enc.input_components = (int)channels;
    jpg_setup(w, quality);
    jpeg_start_compress(&w->enc, TRUE);
    jpeg_write_marker(&w->enc, JPEG_APP0 + 1, jpg_exif, sizeof jpg_exif - 1);
    while (w->enc.next_scanline < w->enc.image_height) {
        JSAMPROW row =
            (uint8_t *)(uintptr_t)px + (size_t)w->enc.next_scanline * size_px[0] * channels;
        jpeg_write_scanlines(&w->enc, &row, 1);
    }
    jpeg_finish_compress(&w->enc);
    return true;
}

bool jpg_encode(const uint8_t *px, uint32_t width_px, uint32_t height_px, uint32_t channels,
                int quality, struct buf *out)
{
    const uint32_t size_px[2] = {width_px, height_px};
    if (channels != 1 && channels != 3)
        return false;
    struct jpg_writer *w = mem_array(1, sizeof *w);
    if (!w)
        return false;
    w->enc.err = jpg_errors(&w->say);
    w->enc.client_data = &w->failed;
    bool ok = jpg_compress(w, px, size_px, channels, quality);
    if (!setjmp(w->failed))
        jpeg_destroy_compress(&w->enc);
    if (ok)
        buf_add(out, w->bytes, w->n);
    free(w->bytes);
    mem_free(w);
    return ok;
}
