/* .ply files of Gaussians: INRIA's, and SuperSplat's compressed ones.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_PLY_H
#define CODEC_PLY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "codec/splat/ply_info.h"
#include "core/err.h"

struct buf;
struct codec_limits;
struct gauss;

/* Read both kinds. Properties are found by name and may have any scalar type; unknown ones are
 * skipped. The SH degree follows from the number of f_rest properties. The comment "citysplat
 * origin lon lat h" gives info->origin and info->has_origin. Means become float32 relative to
 * origin_enu_m, which is 0 unless the file has doubles. info may be NULL. Free *out with
 * gauss_free; it is empty on errors. Unusable rows are left out. Colours of red, green and blue
 * alone are taken, and 2DGS' two scales: the third is a thousandth of the smaller. ERR_NOENT and
 * ERR_IO (ply_read), ERR_FORMAT names line or
 * property, ERR_DATA, ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code ply_read(const char *path, const struct codec_limits *lim, struct gauss *out,
                       struct ply_info *info, struct err *e) ERR_USE;
enum err_code ply_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct ply_info *info, struct err *e) ERR_USE;
/* Appends an INRIA .ply to `out`. info may be NULL. ERR_MEM. */
enum err_code ply_encode(const struct gauss *g, const struct ply_info *info, struct buf *out,
                         struct err *e) ERR_USE;
/* Write an INRIA .ply that is larger than memory in parts: the head, then the rows in any order,
 * each at its place in the file. Positions farther than PLY_FLOAT_REACH_M from 0 should be doubles.
 */
#define PLY_FLOAT_REACH_M 4096.0
struct ply_rows {
    size_t n; /* of all rows */
    uint32_t sh_degree;
    bool antialiased;
    bool doubles; /* positions */
};
void ply_encode_head(const struct ply_rows *r, const struct ply_info *info, struct buf *out);
size_t ply_row_bytes(const struct ply_rows *r);
/* out [g->n][ply_row_bytes]. Values are not checked. */
void ply_encode_rows(const struct gauss *g, bool doubles, uint8_t *out);
/* Reads an INRIA .ply in parts. *out is NULL, without an error, when the file cannot be read in
 * parts (text, compressed); ply_read reads such files. Counts are checked against the size of the
 * file. Any thread may read; close it with ply_stream_close, idempotent. Each part has an origin of
 * its own where coordinates are doubles. Unusable rows are returned unchanged. ply_stream_open:
 * ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_MEM.
 * ply_stream_read (free *out with gauss_free): ERR_IO, ERR_FORMAT (the file became shorter),
 * ERR_ARG (rows that are not there), ERR_MEM. */
struct ply_stream;
enum err_code ply_stream_open(const char *path, struct ply_stream **out, struct ply_info *info,
                              struct err *e) ERR_USE;
void ply_stream_close(struct ply_stream **s);
struct ply_rows ply_stream_rows(const struct ply_stream *s);
enum err_code ply_stream_read(const struct ply_stream *s, size_t first, size_t n, struct gauss *out,
                              struct err *e) ERR_USE;
/* Appends SuperSplat's compressed .ply to `out`, with harmonics up to sh_degree and without
 * embeddings. Rows keep their order. 256 rows share a box, so neighbours in space should follow
 * each other (gauss_hilbert_order). ERR_DATA (a value is not finite), ERR_ARG (sh_degree above that
 * of g), ERR_MEM. */
enum err_code ply_packed_encode(const struct gauss *g, uint32_t sh_degree,
                                const struct ply_info *info, struct buf *out,
                                struct err *e) ERR_USE;
#endif
