/* Pictures, EXIF and .npy: what is written comes back, and damaged files are refused by name. It is
 * one long file, because every case writes a picture, changes its bytes and reads it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/npy.h"
#include "codec/image/exif.h"
#include "codec/image/image.h"
#include "codec/limits.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

/* EXIF keeps 1e-7 arc seconds; half of that, in degrees. */
#define ANGLE_TOL_DEG (0.5e-7 / 3600 * 1.01)
/* ... and 0.1 mm of height. */
#define HEIGHT_TOL_M 0.51e-4

static const char *in_tmp(const char *name)
{
    static char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, kit_tmp, name, &e), e);
    return path;
}

/* Smooth colours with an off-centre dark square: no symmetry to hide a flip. */
static struct image picture(uint32_t w, uint32_t h, uint32_t channels)
{
    struct image img;
    struct err e = {0};
    kit_ok(image_alloc(w, h, channels, &img, &e), e);
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++)
            for (uint32_t c = 0; c < channels; c++) {
                bool dark = x < w / 3 && y < h / 4;
                double v = 128 + 90 * sin(0.02 * (x + 2.0 * y) + c);
                img.px[(y * w + x) * channels + c] = (uint8_t)(dark ? 20 + 10 * c : lround(v));
            }
    return img;
}

static void test_write_read(void **state)
{
    /* largest mean absolute difference: lossless, or what quality 95 does to a smooth picture */
    static const struct {
        const char *name;
        double tol;
    } files[] = {{"a.png", 0},   {"a.tif", 0},    {"a.TIFF", 0},
                 {"a.jpg", 1.5}, {"a.jpeg", 1.5}, {"a.webp", 2.5}};
    struct err e = {0};
    struct image img = picture(97, 61, 3), back;
    for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
        kit_ok(image_write(in_tmp(files[i].name), &img, 95, NULL, &e), e);
        kit_ok(image_read(in_tmp(files[i].name), NULL, &back, &e), e);
        assert_int_equal(back.width_px, 97);
        assert_int_equal(back.height_px, 61);
        assert_int_equal(back.channels, 3);
        double sum = 0;
        for (size_t k = 0; k < 97 * 61 * 3; k++)
            sum += abs(img.px[k] - back.px[k]);
        if (sum / (97 * 61 * 3) > files[i].tol)
            fail_msg("%s: mean difference %g > %g", files[i].name, sum / (97 * 61 * 3),
                     files[i].tol);
        image_free(&back);
    }
    image_free(&img);
}

static void test_encode_is_deterministic(void **state)
{
    struct err e = {0};
    struct image img = picture(64, 48, 3);
    for (const char *const *f = (const char *const[]){"jpg", "png", "webp", NULL}; *f; f++) {
        struct buf a = {0}, b = {0};
        kit_ok(image_encode(&img, *f, 80, &a, &e), e);
        kit_ok(image_encode(&img, *f, 80, &b, &e), e);
        assert_int_equal(a.size, b.size);
        assert_memory_equal(a.data, b.data, a.size);
        buf_free(&a);
        buf_free(&b);
    }
    struct buf none = {0};
    kit_fails(image_encode(&img, "xyz", 80, &none, &e), ERR_ARG, e, "xyz");
    kit_fails(image_write(in_tmp("a.gif"), &img, 80, NULL, &e), ERR_ARG, e, ".png");
    image_free(&img);
}

static void test_quality_decides_chroma_and_size(void **state)
{
    struct err e = {0};
    struct image img = picture(128, 128, 3);
    struct buf lo = {0}, hi = {0};
    kit_ok(image_encode(&img, "jpg", 30, &lo, &e), e);
    kit_ok(image_encode(&img, "jpg", 98, &hi, &e), e);
    assert_true(lo.size < hi.size);
    buf_free(&lo);
    buf_free(&hi);
    image_free(&img);
}

static void write_all(const char *path, const struct buf *b)
{
    struct err e = {0};
    kit_ok(file_write(path, b->data, b->size, &e), e);
}

/* Plain JPEGs do not go through OpenImageIO: its own program reads them, and writes them, alike. */
static void test_jpegs_are_openimageios(void **state)
{
    static const struct {
        uint32_t width_px, height_px, channels;
        int quality;
    } kinds[] = {{37, 23, 3, 90}, {64, 48, 3, 97}, {33, 17, 1, 80}, {1, 1, 3, 1}};
    struct err e = {0};
    struct buf out = {0};
    if (kit_run(&out, "command -v oiiotool"))
        skip();
    buf_free(&out);
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
        struct image img = picture(kinds[i].width_px, kinds[i].height_px, kinds[i].channels), own,
                     theirs;
        struct buf jpg = {0};
        size_t n = (size_t)3 * img.width_px * img.height_px;
        kit_ok(image_encode(&img, "jpg", kinds[i].quality, &jpg, &e), e);
        write_all(in_tmp("own.jpg"), &jpg);
        kit_ok(image_write(in_tmp("pixels.png"), &img, 0, NULL, &e), e);
        if (kit_run(&out,
                    "cd '%s' && oiiotool own.jpg -o read.png && oiiotool pixels.png --eraseattrib "
                    "'.*' --attrib oiio:ColorSpace sRGB --attrib:type=string "
                    "jpeg:subsampling %s --quality %d -o theirs.jpg",
                    kit_tmp, kinds[i].quality >= 95 ? "4:4:4" : "4:2:0", kinds[i].quality))
            fail_msg("%s", (const char *)out.data);
        kit_ok(image_read(in_tmp("own.jpg"), NULL, &own, &e), e);
        kit_ok(image_read(in_tmp("read.png"), NULL, &theirs, &e), e);
        assert_memory_equal(own.px, theirs.px, n);
        image_free(&theirs);
        kit_ok(image_read(in_tmp("theirs.jpg"), NULL, &theirs, &e), e);
        assert_memory_equal(own.px, theirs.px, n);
        image_free(&own);
        image_free(&theirs);
        image_free(&img);
        buf_free(&jpg);
        buf_free(&out);
    }
}

static void test_grey_is_expanded(void **state)
{
    struct err e = {0};
    struct image img = picture(20, 10, 1), back;
    kit_ok(image_write(in_tmp("grey.png"), &img, 0, NULL, &e), e);
    kit_ok(image_read(in_tmp("grey.png"), NULL, &back, &e), e);
    assert_int_equal(back.channels, 3);
    for (size_t i = 0; i < 200; i++)
        for (size_t c = 0; c < 3; c++)
            assert_int_equal(back.px[3 * i + c], img.px[i]);
    image_free(&img);
    image_free(&back);
}

static void png_chunk(struct buf *b, const char *type, const uint8_t *data, size_t n)
{
    uint32_t crc = (uint32_t)crc32(crc32(0, (const Bytef *)type, 4), data, (uInt)n);
    for (int i = 3; i >= 0; i--)
        buf_u8(b, (uint32_t)n >> 8 * i & 255);
    buf_add(b, type, 4);
    buf_add(b, data, n);
    for (int i = 3; i >= 0; i--)
        buf_u8(b, crc >> 8 * i & 255);
}

/* Colours under a low alpha must come back as stored: drone masks are often transparent. */
static void test_alpha_is_dropped_not_multiplied(void **state)
{
    static const uint8_t head[] = {0, 0, 0, 1, 0, 0, 0, 1, 8, 6, 0, 0, 0};
    static const uint8_t row[] = {0, 200, 100, 50, 10};
    uint8_t z[64];
    uLongf nz = sizeof z;
    assert_int_equal(compress(z, &nz, row, sizeof row), Z_OK);
    struct buf b = {0};
    buf_add(&b, "\x89PNG\r\n\x1a\n", 8);
    png_chunk(&b, "IHDR", head, sizeof head);
    png_chunk(&b, "IDAT", z, nz);
    png_chunk(&b, "IEND", z, 0);
    struct err e = {0};
    struct image img;
    kit_ok(file_write(in_tmp("rgba.png"), b.data, b.size, &e), e);
    kit_ok(image_read(in_tmp("rgba.png"), NULL, &img, &e), e);
    assert_int_equal(img.px[0], 200);
    assert_int_equal(img.px[1], 100);
    assert_int_equal(img.px[2], 50);
    image_free(&img);
    buf_free(&b);
}

static void expect_gps(const struct image_gps *got, const struct image_gps *want, const char *name)
{
    if (!got->has_position || !got->has_altitude ||
        fabs(got->lat_deg - want->lat_deg) > ANGLE_TOL_DEG ||
        fabs(got->lon_deg - want->lon_deg) > ANGLE_TOL_DEG ||
        fabs(got->alt_m - want->alt_m) > HEIGHT_TOL_M)
        fail_msg("%s: got %d %.12f %.12f %d %.6f, want %.12f %.12f %.6f", name, got->has_position,
                 got->lat_deg, got->lon_deg, got->has_altitude, got->alt_m, want->lat_deg,
                 want->lon_deg, want->alt_m);
    assert_string_equal(got->time, want->time);
    assert_true(fabs(got->exposure_s - want->exposure_s) <= 1e-9 + 1e-6 * want->exposure_s);
    assert_true(got->iso == want->iso);
    assert_true(fabs(got->focal_mm - want->focal_mm) <= 1e-5);
}

static void test_exif_round_trip(void **state)
{
    static const struct image_gps all[] = {
        {true, true, 47.376912345678, 8.541234567891, 408.1234, "2026:05:17 10:20:30", 0.002, 100,
         24, false, false, false, false, false},
        {true, true, -33.856784, -151.215296, -12.5, "2026:05:17 10:20:31", 0.5, 6400, 4.5, false,
         false, false, false, false},
        {true, true, 0.00013888888888888889, 180, 0, "", 0, 0, 0, false, false, false, false,
         false}, /* 0.5 arc seconds; the date line */
        {true, true, 89.99999999999, -0.016666666666666666, 8848.86, "2026:01:01 00:00:00", 30, 50,
         8.8, false, false, false, false, false},
    };
    struct err e = {0};
    struct image img = picture(33, 17, 3), back;
    for (const char *const *f = (const char *const[]){"g.jpg", "g.png", "g.webp", "g.tif", NULL};
         *f; f++)
        for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
            struct image_gps got;
            uint32_t w = 0, h = 0;
            kit_ok(image_write(in_tmp(*f), &img, 95, &all[i], &e), e);
            kit_ok(image_read_info(in_tmp(*f), &w, &h, &got, NULL, &e), e);
            assert_int_equal(w, 33);
            assert_int_equal(h, 17);
            expect_gps(&got, &all[i], *f);
            kit_ok(image_read(in_tmp(*f), NULL, &back, &e), e); /* still a picture */
            image_free(&back);
        }
    image_free(&img);
}

/* Every chunk's check sum is right, also of the last, which is empty: QGIS refuses others. */
static void test_png_chunks(void **state)
{
    struct err e = {0};
    struct buf b = {0};
    struct image img = picture(33, 17, 3);
    size_t at = 8, n = 0;
    kit_ok(image_encode(&img, "png", 0, &b, &e), e);
    while (at + 12 <= b.size) {
        const uint8_t *p = b.data + at;
        size_t len = (size_t)p[0] << 24 | (size_t)p[1] << 16 | (size_t)p[2] << 8 | p[3];
        assert_true(at + 12 + len <= b.size);
        const uint8_t *sum = p + 8 + len;
        uint32_t got =
            (uint32_t)sum[0] << 24 | (uint32_t)sum[1] << 16 | (uint32_t)sum[2] << 8 | sum[3];
        if (got != crc32(0, p + 4, (uInt)len + 4))
            fail_msg("chunk %.4s: its check sum is wrong", (const char *)p + 4);
        at += 12 + len;
        n++;
    }
    assert_int_equal(at, b.size);
    assert_true(n >= 3 && !memcmp(b.data + b.size - 8, "IEND", 4));
    buf_free(&b);
    image_free(&img);
}

/* Readers take the first or the last of several. */
static void test_one_exif(void **state)
{
    struct err e = {0};
    struct buf b = {0};
    const struct image_gps gps = {true, true, 47,    8,     400,   "",    0,
                                  0,    0,    false, false, false, false, false};
    struct image img = picture(33, 17, 3);
    size_t n = 0;
    kit_ok(image_write(in_tmp("one.jpg"), &img, 95, &gps, &e), e);
    kit_ok(file_read(in_tmp("one.jpg"), 0, &b, &e), e);
    for (size_t i = 0; i + 6 <= b.size; i++)
        n += !memcmp(b.data + i, "Exif\0\0", 6);
    assert_int_equal(n, 1);
    buf_free(&b);
    image_free(&img);
}

static void test_no_exif(void **state)
{
    struct err e = {0};
    struct image_gps got;
    struct image img = picture(8, 8, 3);
    kit_ok(image_write(in_tmp("plain.jpg"), &img, 90, NULL, &e), e);
    kit_ok(image_read_info(in_tmp("plain.jpg"), NULL, NULL, &got, NULL, &e), e);
    assert_false(got.has_position);
    assert_false(got.has_altitude);
    assert_string_equal(got.time, "");
    image_free(&img);
}

static void be16(struct buf *b, unsigned v)
{
    buf_u8(b, v >> 8 & 255);
    buf_u8(b, v & 255);
}

static void be32(struct buf *b, uint32_t v)
{
    be16(b, v >> 16);
    be16(b, v & 0xffff);
}

static void be_entry(struct buf *b, unsigned tag, unsigned type, uint32_t count, uint32_t value)
{
    be16(b, tag);
    be16(b, type);
    be32(b, count);
    be32(b, value);
}

/* Big-endian, decimal degrees in the first rational, 0/0 minutes and seconds, as some cameras
 * write. */
/* The GPS directory's place is of this type: LONG as by EXIF, or IFD as by libtiff. */
static void big_endian_exif(unsigned type, struct buf *out)
{
    struct buf b = {0};
    buf_add(&b, "MM\0*", 4);
    be32(&b, 8);
    be16(&b, 1);
    be_entry(&b, 0x8825, type, 1, 26);
    be32(&b, 0);
    be16(&b, 4);                       /* GPS IFD at 26; values follow at 26 + 2 + 48 + 4 = 80 */
    be_entry(&b, 1, 2, 2, 0x53000000); /* "S" */
    be_entry(&b, 2, 5, 3, 80);
    be_entry(&b, 3, 2, 2, 0x57000000); /* "W" */
    be_entry(&b, 4, 5, 1, 104);
    be32(&b, 0);
    for (int i = 0; i < 2; i++) {
        be32(&b, i ? 1401234567 : 338567891);
        be32(&b, 10000000);
        for (int k = 0; k < (i ? 0 : 4); k++)
            be32(&b, 0);
    }
    assert_int_equal(b.size, 112);
    *out = b;
}

static void expect_south_west(const struct buf *b)
{
    struct image_gps got;
    exif_parse(b->data, b->size, &got, NULL);
    assert_true(got.has_position);
    assert_true(fabs(got.lat_deg + 33.8567891) < 1e-12);
    assert_true(fabs(got.lon_deg + 140.1234567) < 1e-12);
}

static void test_exif_big_endian_decimal_degrees(void **state)
{
    struct buf b = {0};
    struct image_gps got;
    big_endian_exif(13, &b);
    expect_south_west(&b);
    buf_free(&b);
    big_endian_exif(4, &b);
    expect_south_west(&b);
    for (size_t n = 0; n < b.size;
         n++) { /* every prefix, in its own allocation for the sanitizer */
        uint8_t *part = mem_array(n, 1);
        if (n)
            memcpy(part, b.data, n);
        exif_parse(part, n, &got, NULL);
        assert_false(got.has_position);
        mem_free(part);
    }
    buf_free(&b);
}

/* EXIF as text, plain and compressed, as Exiv2 (darktable, digiKam, GIMP) and ImageMagick write it.
 */
static void test_png_raw_profiles(void **state)
{
    static const char *const keys[] = {"Raw profile type exif", "Raw profile type APP1"};
    struct buf exif = {0}, text = {0};
    (void)state;
    big_endian_exif(4, &exif);
    buf_printf(&text, "\nexif\n%8zu", exif.size + 6);
    for (size_t i = 0; i < exif.size + 6; i++)
        buf_printf(&text, "%s%02x", i % 36 ? "" : "\n",
                   i < 6 ? (uint8_t) "Exif\0\0"[i] : exif.data[i - 6]);
    buf_printf(&text, "\n");
    for (int k = 0; k < 4; k++) {
        struct buf png = {0}, chunk = {0};
        uint8_t z[1024];
        uLongf nz = sizeof z;
        buf_add(&png, "\x89PNG\r\n\x1a\n", 8);
        png_chunk(&png, "IHDR", (const uint8_t *)"\0\0\0\1\0\0\0\1\x8\2\0\0\0", 13);
        assert_int_equal(compress(z, &nz, text.data, text.size), Z_OK);
        buf_add(&chunk, keys[k % 2], strlen(keys[0]) + 1);
        if (k < 2)
            buf_u8(&chunk, 0);
        buf_add(&chunk, k < 2 ? z : text.data, k < 2 ? nz : text.size);
        png_chunk(&png, k < 2 ? "zTXt" : "tEXt", chunk.data, chunk.size);
        expect_south_west(&png);
        for (size_t n = 0; n < png.size; n++) { /* every prefix, for the sanitizer */
            struct image_gps got;
            uint8_t *part = mem_array(n + 1, 1);
            memcpy(part, png.data, n);
            exif_parse(part, n, &got, NULL);
            mem_free(part);
        }
        buf_free(&png);
        buf_free(&chunk);
    }
    buf_free(&exif);
    buf_free(&text);
}

#define GPS(...)                                                                                   \
    {                                                                                              \
        __VA_ARGS__                                                                                \
    } /* rows of the table below, and numbers in them, on one line */

/* What cameras write against the standard: signs beside letters, signed and unsigned types, floats,
 * a fraction that the next number repeats, altitudes from the ellipsoid. */
static void test_exif_odd_numbers(void **state)
{
    enum { BYTE = 1, ASCII, LONG = 4, RATIONAL, SLONG = 9, SRATIONAL, FLOAT, DOUBLE };
    static const struct {
        char north, east;
        uint32_t type, count, lat[6], lon[6];
        uint32_t ref_type, ref, alt_type, alt[2];
        bool place, ellipsoidal;
        unsigned odd; /* 1: a sign and a letter contradict each other; 2: neither tells */
        double lat_deg, lon_deg, alt_m;
    } cases[] = {
        /* both say south and west */
        GPS('S', 'W', SRATIONAL, 1, GPS((uint32_t)-338600000, 10000000), GPS(-706500000, 10000000),
            BYTE, 0, RATIONAL, GPS(520, 1), true, false, false, -33.86, -70.65, 520),
        /* only the sign does; the letter is wrong, or missing */
        GPS('N', 'E', SRATIONAL, 1, GPS(-3386, 100), GPS(-7065, 100), BYTE, 0, RATIONAL,
            GPS(520, 1), true, false, true, -33.86, -70.65, 520),
        GPS(0, 0, SRATIONAL, 1, GPS(-3386, 100), GPS(7065, 100), BYTE, 0, RATIONAL, GPS(520, 1),
            true, false, 2, -33.86, 70.65, 520),
        /* neither does, or the letters are those of the other axis */
        GPS(0, 0, SRATIONAL, 1, GPS(-3386, 100), GPS(-7065, 100), BYTE, 0, RATIONAL, GPS(520, 1),
            true, false, false, -33.86, -70.65, 520),
        GPS('N', 0, RATIONAL, 1, GPS(3386, 100), GPS(7065, 100), BYTE, 0, RATIONAL, GPS(520, 1),
            true, false, 2, 33.86, 70.65, 520),
        GPS('E', 'N', RATIONAL, 1, GPS(3386, 100), GPS(7065, 100), BYTE, 0, RATIONAL, GPS(520, 1),
            true, false, 2, 33.86, 70.65, 520),
        /* the sign in each of the three, small letters */
        GPS('s', 'w', SRATIONAL, 3, GPS(-33, 1, -51, 1, -36, 1), GPS(-70, 1, -39, 1, 0, 1), BYTE, 0,
            RATIONAL, GPS(520, 1), true, false, false, -33.86, -70.65, 520),
        /* a negative number in an unsigned type */
        GPS('S', 'E', RATIONAL, 1, GPS(-3386, 100), GPS(7065, 100), BYTE, 0, RATIONAL, GPS(-50, 10),
            true, false, false, -33.86, 70.65, -5),
        /* decimal degrees, and minutes and seconds once more */
        GPS('N', 'E', RATIONAL, 3, GPS(4755, 100, 33, 1, 0, 1), GPS(750, 100, 30, 1, 0, 1), BYTE, 0,
            RATIONAL, GPS(520, 1), true, false, false, 47.55, 7.5, 520),
        GPS('N', 'E', RATIONAL, 3, GPS(47, 1, 335, 10, 30, 1), GPS(7, 1, 305, 10, 0, 0), BYTE, 0,
            RATIONAL, GPS(520, 1), true, false, false, 47 + 33.5 / 60, 7 + 30.5 / 60, 520),
        /* floats; a whole number */
        GPS('N', 'W', FLOAT, 1, GPS(0x423e0000), GPS(0x40f00000), BYTE, 0, LONG, GPS(520), true,
            false, false, 47.5, -7.5, 520),
        GPS('S', 'E', FLOAT, 1, GPS(0x423e0000), GPS(0x7fc00000), BYTE, 0, SLONG, GPS(-7), false,
            false, false, 0, 0, -7),
        /* altitudes: below the sea, however it is said; from the ellipsoid */
        GPS('N', 'E', RATIONAL, 1, GPS(47, 1), GPS(7, 1), BYTE, 1u << 24, SRATIONAL, GPS(-12, 1),
            true, false, false, 47, 7, -12),
        GPS('N', 'E', RATIONAL, 1, GPS(47, 1), GPS(7, 1), ASCII, '1' << 24, RATIONAL, GPS(12, 1),
            true, false, false, 47, 7, -12),
        GPS('N', 'E', RATIONAL, 1, GPS(47, 1), GPS(7, 1), BYTE, 2u << 24, RATIONAL, GPS(470, 1),
            true, true, false, 47, 7, 470),
        GPS('N', 'E', RATIONAL, 1, GPS(47, 1), GPS(7, 1), BYTE, 3u << 24, RATIONAL, GPS(20, 1),
            true, true, false, 47, 7, -20),
        /* n/0 is no number; there is no 91 degrees north */
        GPS('N', 'E', RATIONAL, 1, GPS(47, 0), GPS(7, 1), BYTE, 0, RATIONAL, GPS(470, 1), false,
            false, false, 0, 0, 470),
        GPS('N', 'E', RATIONAL, 1, GPS(91, 1), GPS(7, 1), BYTE, 0, RATIONAL, GPS(470, 1), false,
            false, false, 0, 0, 470),
        /* nor 61 minutes; 60 seconds are a minute that was rounded */
        GPS('N', 'E', RATIONAL, 3, GPS(47, 1, 61, 1, 0, 1), GPS(7, 1, 0, 1, 0, 1), BYTE, 0,
            RATIONAL, GPS(470, 1), false, false, false, 0, 0, 470),
        GPS('N', 'E', RATIONAL, 3, GPS(47, 1, 29, 1, 60, 1), GPS(7, 1, 0, 1, 0, 1), BYTE, 0,
            RATIONAL, GPS(470, 1), true, false, false, 47.5, 7, 470),
        /* longitudes to 360, either letter; 0, 0 and a numerator of all ones stand for unknown */
        GPS('N', 'E', RATIONAL, 1, GPS(47, 1), GPS(1411, 4), BYTE, 0, RATIONAL, GPS(470, 1), true,
            false, false, 47, -7.25, 470),
        GPS('N', 'W', RATIONAL, 1, GPS(47, 1), GPS(1411, 4), BYTE, 0, RATIONAL, GPS(470, 1), true,
            false, false, 47, 7.25, 470),
        GPS('N', 'E', RATIONAL, 1, GPS(0, 1), GPS(0, 1), BYTE, 0, RATIONAL, GPS(470, 1), false,
            false, false, 0, 0, 470),
        GPS('N', 'E', RATIONAL, 1, GPS(47, 1), GPS(7, 1), BYTE, 0, RATIONAL,
            GPS(UINT32_MAX, UINT32_MAX), true, false, false, 47, 7, (double)NAN),
        GPS('N', 'E', RATIONAL, 1, GPS(47, 1), GPS(7, 1), BYTE, 0, RATIONAL, GPS(UINT32_MAX, 1),
            true, false, false, 47, 7, (double)NAN),
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        enum { VALUES = 26 + 2 + 6 * 12 + 4 };
        const bool wide = cases[i].type != FLOAT;
        struct buf b = {0};
        struct image_gps got;
        buf_add(&b, "MM\0*", 4);
        be32(&b, 8);
        be16(&b, 1);
        be_entry(&b, 0x8825, 4, 1, 26);
        be32(&b, 0);
        be16(&b, 6);
        be_entry(&b, 1, ASCII, 2, (uint32_t)cases[i].north << 24);
        be_entry(&b, 2, cases[i].type, cases[i].count, wide ? VALUES : cases[i].lat[0]);
        be_entry(&b, 3, ASCII, 2, (uint32_t)cases[i].east << 24);
        be_entry(&b, 4, cases[i].type, cases[i].count, wide ? VALUES + 24 : cases[i].lon[0]);
        be_entry(&b, 5, cases[i].ref_type, cases[i].ref_type == ASCII ? 2 : 1, cases[i].ref);
        be_entry(&b, 6, cases[i].alt_type, 1,
                 cases[i].alt_type == RATIONAL || cases[i].alt_type == SRATIONAL ? VALUES + 48
                                                                                 : cases[i].alt[0]);
        be32(&b, 0);
        for (int k = 0; k < 12; k++)
            be32(&b, k < 6 ? cases[i].lat[k] : cases[i].lon[k - 6]);
        be32(&b, cases[i].alt[0]);
        be32(&b, cases[i].alt[1]);
        exif_parse(b.data, b.size, &got, NULL);
        buf_free(&b);
        const unsigned odd = got.odd_sign + 2u * got.no_letter;
        if (got.has_position != cases[i].place || fabs(got.lat_deg - cases[i].lat_deg) > 1e-9 ||
            fabs(got.lon_deg - cases[i].lon_deg) > 1e-9 ||
            got.has_altitude != isfinite(cases[i].alt_m) ||
            fabs(got.alt_m - cases[i].alt_m) > 1e-9 || got.ellipsoidal != cases[i].ellipsoidal ||
            odd != cases[i].odd)
            fail_msg("case %zu: %d %.9f %.9f %.3f %d %u", i, got.has_position, got.lat_deg,
                     got.lon_deg, got.alt_m, got.ellipsoidal, odd);
    }
}

/* GPSMapDatum: what lies within metres of WGS 84, or says nothing, is no other datum. */
static void test_exif_datum(void **state)
{
    static const struct {
        const char *text;
        bool far;
    } cases[] = {{"WGS-84", false},  {"WGS84", false}, {"JGD2011", false}, {"", false},
                 {"unknown", false}, {"TOKYO", true},  {"Tokyo", true},    {"NAD27", true}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct buf b = {0};
        struct image_gps got;
        const size_t n = strlen(cases[i].text) + 1;
        char text[8] = "";
        memcpy(text, cases[i].text, n);
        buf_add(&b, "MM\0*", 4);
        be32(&b, 8);
        be16(&b, 1);
        be_entry(&b, 0x8825, 4, 1, 26);
        be32(&b, 0);
        be16(&b, 1);
        be_entry(&b, 0x12, 2, (uint32_t)n, n > 4 ? 44 : 0);
        be32(&b, 0);
        buf_add(&b, text, sizeof text);
        exif_parse(b.data, b.size, &got, NULL);
        if (got.far_datum != cases[i].far)
            fail_msg("'%s'", cases[i].text);
        buf_free(&b);
    }
}

/* Random bytes over good files: nothing may be read out of bounds, and angles stay angles. */
static void test_exif_survives_flips(void **state)
{
    static const struct image_gps gps = {true,  true, 12.5, -7.25, 90,    "2026:05:17 10:20:30",
                                         0.01,  100,  8,    false, false, false,
                                         false, false};
    struct err e = {0};
    struct image img = picture(9, 9, 3);
    for (const char *const *f = (const char *const[]){"jpg", "png", "webp", NULL}; *f; f++) {
        struct buf b = {0};
        kit_ok(image_encode(&img, *f, 90, &b, &e), e);
        kit_ok(exif_insert(&b, &gps, &e), e);
        uint8_t *copy = mem_array(b.size, 1);
        for (uint64_t i = 0; i < 3000; i++) {
            struct image_gps got;
            memcpy(copy, b.data, b.size);
            for (uint64_t k = 0; k < 3; k++)
                copy[rng_u64(1, i, 2 * k) % (b.size < 400 ? b.size : 400)] =
                    (uint8_t)rng_u64(1, i, 2 * k + 1);
            exif_parse(copy, b.size, &got, NULL);
            if (got.has_position)
                assert_true(fabs(got.lat_deg) <= 90 && fabs(got.lon_deg) <= 180);
        }
        mem_free(copy);
        buf_free(&b);
    }
    image_free(&img);
}

static void test_bad_files(void **state)
{
    struct err e = {0};
    struct image img, pic = picture(160, 120, 3);
    kit_fails(image_read(in_tmp("missing.jpg"), NULL, &img, &e), ERR_NOENT, e, "missing.jpg");
    kit_ok(file_write(in_tmp("text.jpg"), "hello, this is no picture", 25, &e), e);
    kit_fails(image_read(in_tmp("text.jpg"), NULL, &img, &e), ERR_FORMAT, e, "text.jpg");
    kit_ok(file_write(in_tmp("empty.png"), "", 0, &e), e);
    kit_fails(image_read(in_tmp("empty.png"), NULL, &img, &e), ERR_FORMAT, e, "empty.png");
    struct codec_limits lim = {.max_pixels = 160 * 120 - 1};
    kit_ok(image_write(in_tmp("big.png"), &pic, 0, NULL, &e), e);
    kit_fails(image_read(in_tmp("big.png"), &lim, &img, &e), ERR_LIMIT, e, "limit");
    assert_null(img.px);
    image_free(&pic);
}

static void test_truncated(void **state)
{
    struct err e = {0};
    struct image img, pic = picture(160, 120, 3);
    for (const char *const *f = (const char *const[]){"t.jpg", "t.png", "t.webp", "t.tif", NULL};
         *f; f++) {
        struct buf b = {0};
        kit_ok(image_write(in_tmp(*f), &pic, 90, NULL, &e), e);
        kit_ok(file_read(in_tmp(*f), 0, &b, &e), e);
        for (size_t k = 1; k < 8; k++) {
            kit_ok(file_write(in_tmp(*f), b.data, b.size * k / 8, &e), e);
            kit_fails(image_read(in_tmp(*f), NULL, &img, &e), ERR_FORMAT, e, *f);
        }
        buf_free(&b);
    }
    image_free(&pic);
}

static void test_resize(void **state)
{
    struct err e = {0};
    struct image img = picture(160, 120, 3), half, flat;
    kit_ok(image_resize(&img, 80, 60, &half, &e), e);
    assert_int_equal(half.width_px, 80);
    assert_int_equal(half.height_px, 60);
    /* In the smooth part the result is the mean of the 2 x 2 source pixels, within rounding. */
    for (uint32_t y = 25; y < 50; y++)
        for (uint32_t x = 40; x < 70; x++)
            for (uint32_t c = 0; c < 3; c++) {
                const uint8_t *p = img.px + (2 * y * 160 + 2 * x) * 3 + c;
                int mean = (p[0] + p[3] + p[480] + p[483] + 2) / 4;
                assert_true(abs(half.px[(y * 80 + x) * 3 + c] - mean) <= 2);
            }
    image_free(&half);
    kit_ok(image_resize(&img, 160, 120, &half, &e),
           e); /* at the same size every tap but one is 0 */
    assert_memory_equal(half.px, img.px, 160 * 120 * 3);
    image_free(&half);
    kit_ok(image_resize(&img, 480, 360, &half, &e),
           e); /* enlarged: the middle of each 3 x 3 is the pixel */
    for (uint32_t y = 0; y < 120; y++)
        for (uint32_t x = 0; x < 480; x++)
            assert_int_equal(half.px[(3 * y + 1) * 480 * 3 + (x / 3 * 3 + 1) * 3 + x % 3],
                             img.px[y * 480 + x / 3 * 3 + x % 3]);
    memset(img.px, 77, 160 * 120 * 3);
    kit_ok(image_resize(&img, 33, 71, &flat, &e), e);
    for (size_t i = 0; i < 33 * 71 * 3; i++)
        assert_int_equal(flat.px[i], 77);
    image_free(&flat);
    kit_fails(image_resize(&img, 0, 5, &flat, &e), ERR_ARG, e, "0 x 5");
    image_free(&half);
    image_free(&img);
}

static void test_npy(void **state)
{
    static const float data[6] = {1, -2.5f, 3e-8f, 4, 5, -0.0f};
    struct err e = {0};
    size_t shape[2] = {2, 3}, got[2] = {0};
    float *back = NULL;
    kit_ok(npy_write(in_tmp("a.npy"), data, 2, shape, &e), e);
    kit_ok(npy_read(in_tmp("a.npy"), 2, got, &back, &e), e);
    assert_int_equal(got[0], 2);
    assert_int_equal(got[1], 3);
    assert_memory_equal(back, data, sizeof data);
    mem_free(back);
    kit_fails(npy_read(in_tmp("a.npy"), 1, got, &back, &e), ERR_FORMAT, e, "more than 1");
    kit_fails(npy_read(in_tmp("none.npy"), 1, got, &back, &e), ERR_NOENT, e, "none.npy");
    struct buf b = {0};
    kit_ok(file_read(in_tmp("a.npy"), 0, &b, &e), e);
    assert_int_equal((b.size - sizeof data) % 64, 0);
    for (size_t n = 0; n < b.size; n++) {
        kit_ok(file_write(in_tmp("b.npy"), b.data, n, &e), e);
        kit_fails(npy_read(in_tmp("b.npy"), 2, got, &back, &e), ERR_FORMAT, e, "b.npy");
        assert_null(back);
    }
    memcpy(strstr((char *)b.data + 10, "<f4"), "<f8", 3);
    kit_ok(file_write(in_tmp("b.npy"), b.data, b.size, &e), e);
    kit_fails(npy_read(in_tmp("b.npy"), 2, got, &back, &e), ERR_FORMAT, e, "<f4");
    buf_free(&b);
    buf_add(&b, "\x93NUMPY\x01\x00\x60\x00", 10);
    buf_printf(&b, "%-96s",
               "{'descr': '<f4', 'fortran_order': False, "
               "'shape': (4611686018427387904, 8), }");
    kit_ok(file_write(in_tmp("b.npy"), b.data, b.size, &e), e);
    kit_fails(npy_read(in_tmp("b.npy"), 2, got, &back, &e), ERR_LIMIT, e, "overflow");
    buf_free(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_write_read),
        cmocka_unit_test(test_encode_is_deterministic),
        cmocka_unit_test(test_quality_decides_chroma_and_size),
        cmocka_unit_test(test_jpegs_are_openimageios),
        cmocka_unit_test(test_grey_is_expanded),
        cmocka_unit_test(test_alpha_is_dropped_not_multiplied),
        cmocka_unit_test(test_exif_round_trip),
        cmocka_unit_test(test_png_chunks),
        cmocka_unit_test(test_one_exif),
        cmocka_unit_test(test_no_exif),
        cmocka_unit_test(test_exif_big_endian_decimal_degrees),
        cmocka_unit_test(test_png_raw_profiles),
        cmocka_unit_test(test_exif_odd_numbers),
        cmocka_unit_test(test_exif_datum),
        cmocka_unit_test(test_exif_survives_flips),
        cmocka_unit_test(test_bad_files),
        cmocka_unit_test(test_truncated),
        cmocka_unit_test(test_resize),
        cmocka_unit_test(test_npy),
    };
    return cmocka_run_group_tests(tests, kit_tmp_make, kit_tmp_remove);
}
