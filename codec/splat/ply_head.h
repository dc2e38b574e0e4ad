/* The header of a .ply: elements, properties, comments. The readers of both kinds of splat files
 * use it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PLY_HEAD_H
#define CODEC_PLY_HEAD_H

#include <stddef.h>
#include <stdint.h>

#include "codec/splat/ply_info.h"
#include "core/base.h"

struct codec_limits;
struct gauss;

enum ply_type { PLY_I8, PLY_U8, PLY_I16, PLY_U16, PLY_I32, PLY_U32, PLY_F32, PLY_F64, PLY_LIST };
enum ply_format { PLY_ASCII, PLY_LITTLE, PLY_BIG };

struct ply_property {
    const char *name; /* lives in the head's arena */
    enum ply_type type;
    size_t offset; /* binary: offset in a row; ASCII: column */
};
struct ply_element {
    const char *name;
    size_t count;
    struct ply_property *props;
    size_t n_props;
    size_t row_bytes; /* 0 if it has a list */
    /* binary: count * row_bytes bytes, checked; NULL after an ASCII or list element */
    const uint8_t *rows;
    uint64_t rows_at; /* binary: where they begin in the file; 0 after an ASCII or list element */
};
struct ply_head { /* {0} is empty */
    enum ply_format format;
    struct ply_element *elements;
    size_t n_elements;
    struct ply_info info;
    bool antialiased;
    const uint8_t *body; /* NULL: only the head was at hand */
    size_t body_at, n_body;
    struct arena arena;
};

/* Parses a header and checks it against the n bytes. Call ply_head_free afterwards, also on error.
 * ERR_FORMAT names the line. */
enum err_code ply_head_read(const void *bytes, size_t n, struct ply_head *out,
                            struct err *e) ERR_USE;
/* As ply_head_read, from the first n bytes of a file of n_file bytes. The rows are not given.
 * ERR_FORMAT. */
enum err_code ply_head_read_of(const void *bytes, size_t n, size_t n_file, struct ply_head *out,
                               struct err *e) ERR_USE;
void ply_head_free(struct ply_head *h);
const struct ply_element *ply_head_element(const struct ply_head *h, const char *name);
const struct ply_property *ply_head_property(const struct ply_element *el, const char *name);
/* Writes the first lines of a file: magic, format (little-endian), and comments about `info` (NULL:
 * axes ENU) and `antialiased`. */
void ply_head_comments(const struct ply_info *info, bool antialiased, struct buf *out);
/* Reads one binary value and converts it. */
double ply_head_value(const struct ply_head *h, const struct ply_property *p, const uint8_t *row);

/* ply_packed.c: test for, and read, SuperSplat's compressed .ply. Free *out with gauss_free.
 * ERR_FORMAT, ERR_DATA, ERR_LIMIT, ERR_MEM. */
bool ply_packed_is(const struct ply_head *h);
enum err_code ply_packed_read(const struct ply_head *h, const struct codec_limits *lim,
                              struct gauss *out, struct err *e) ERR_USE;

#endif
