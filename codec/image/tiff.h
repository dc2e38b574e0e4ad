/* TIFF directories (IFDs) in memory: their numbers and texts, read and written. EXIF is one small
 * TIFF file inside a picture. All arithmetic is in double, and every offset is checked against the
 * bytes at hand. All functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_TIFF_H
#define CODEC_TIFF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct buf;

enum {
    TIFF_BYTE = 1,
    TIFF_ASCII = 2,
    TIFF_SHORT = 3,
    TIFF_LONG = 4,
    TIFF_RATIONAL = 5,
    TIFF_SBYTE = 6,
    TIFF_SSHORT = 8,
    TIFF_SLONG = 9,
    TIFF_SRATIONAL = 10,
    TIFF_FLOAT = 11,
    TIFF_DOUBLE = 12,
    TIFF_IFD = 13 /* of Adobe's supplement to TIFF, as libtiff writes it */
};

/* ---- reading ---- */

struct tiff { /* points into the bytes that tiff_open got */
    const uint8_t *p;
    size_t n;
    bool big_endian;
};
struct tiff_field {
    unsigned type;
    uint32_t count;
    const uint8_t *data; /* [n], the bytes of count values */
    size_t n;
};

/* ifd0: where the first directory is. Returns false if it is no TIFF. */
bool tiff_open(const uint8_t *p, size_t n, struct tiff *t, uint32_t *ifd0);
/* The number in bytes 1 to 4 at p, which the caller has checked to be in the file. */
uint32_t tiff_uint(const struct tiff *t, const uint8_t *p, unsigned bytes);
/* Returns false if the directory at `ifd`, which may be anything, has no such field, or one of an
 * unknown type, or a part of one. */
bool tiff_find(const struct tiff *t, uint32_t ifd, unsigned tag, struct tiff_field *f);
/* Value i. Returns false if there is none, its denominator is 0, its numerator is all ones, which
 * stands for unknown, or it is not finite. Any type of numbers is taken: cameras write what the
 * standard does not allow. */
bool tiff_field_num(const struct tiff *t, const struct tiff_field *f, size_t i, double *out);
/* The first value of a field; 0 if there is none. */
double tiff_num(const struct tiff *t, uint32_t ifd, unsigned tag);
/* The same, where another directory is. */
uint32_t tiff_offset(const struct tiff *t, uint32_t ifd, unsigned tag);
/* Printable text of a field, as far as there is room, without blanks at its end; "" if none. */
void tiff_text(const struct tiff *t, uint32_t ifd, unsigned tag, char *out, size_t room);

/* ---- writing: little-endian ---- */

struct tiff_entry { /* a field of a directory */
    uint16_t tag, type;
    uint32_t count, size; /* values; bytes of data in use */
    uint8_t data[32];
};

void tiff_put_u32(uint8_t *p, uint32_t v);
/* Texts longer than 31 bytes are cut. */
struct tiff_entry tiff_entry_text(unsigned tag, const char *text);
struct tiff_entry tiff_entry_num(unsigned tag, unsigned type, uint32_t v);
/* v >= 0 as n/den, with a smaller den where n would not fit. */
struct tiff_entry tiff_entry_rational(unsigned tag, double v, double den);
/* One more rational of an entry: four fit. */
void tiff_entry_ratio(struct tiff_entry *en, double v, double den);
/* Appends a directory that is at offset `base` of the TIFF, its values right behind it. The n
 * entries are sorted by tag. */
void tiff_write(struct buf *b, uint32_t base, const struct tiff_entry *en, size_t n);

#endif
