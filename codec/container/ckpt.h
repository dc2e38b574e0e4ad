/* Checkpoints: files with a JSON head, a set of Gaussians and named blobs, each with a hash.
 *
 * Any thread may call these functions. Only one thread at a time may use one path or one struct.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_CKPT_H
#define CODEC_CKPT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/splat/gauss.h"

struct ckpt_blob {
    char name[32];
    const void *data; /* write: borrowed; read: lies in the ckpt's buffer, aligned to 64 */
    size_t size_bytes;
};
struct ckpt {            /* {0} is empty; free with ckpt_free */
    struct json_t *meta; /* a JSON object: level, step, seed, config, metrics ... */
    struct gauss g;
    struct ckpt_blob *blobs;
    size_t n_blobs;
    struct buf file;
};
/* Writes a checkpoint. meta must be an object. g may be empty. The file is written under another
 * name and renamed. ERR_ARG (meta), ERR_LIMIT, ERR_IO, ERR_MEM. */
enum err_code ckpt_write(const char *path, const struct json_t *meta, const struct gauss *g,
                         const struct ckpt_blob *blobs, size_t n_blobs, struct err *e) ERR_USE;
/* Gaussians that are not in a struct gauss. ckpt_write_from asks for each array in slices, from the
 * first row to the last. */
enum ckpt_field { CKPT_MEAN, CKPT_SCALE, CKPT_QUAT, CKPT_OPACITY, CKPT_SH, CKPT_EMBED };
struct ckpt_source {
    /* number of rows, SH degree, embedding length and origin; its arrays are not read */
    const struct gauss *like;
    /* writes rows [first, first + n) of a field to `out`, as in struct gauss */
    enum err_code (*rows)(void *user, enum ckpt_field field, size_t first, size_t n, float *out,
                          struct err *e);
    void *user;
};
/* As ckpt_write, with Gaussians from `from`. ERR_ARG, ERR_LIMIT, ERR_IO, ERR_MEM, and what
 * from->rows returns. */
enum err_code ckpt_write_from(const char *path, const struct json_t *meta,
                              const struct ckpt_source *from, const struct ckpt_blob *blobs,
                              size_t n_blobs, struct err *e) ERR_USE;
/* Reads a whole checkpoint into memory. Free it with ckpt_free. ERR_NOENT, ERR_FORMAT (truncated,
 * or a hash is wrong), ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code ckpt_read(const char *path, struct ckpt *out, struct err *e) ERR_USE;
const struct ckpt_blob *ckpt_find(const struct ckpt *c, const char *name); /* NULL when absent */
void ckpt_free(struct ckpt *c);
/* Reads the Gaussians of a checkpoint in slices, for checkpoints larger than memory. Opening reads
 * the file once and checks all hashes. Several threads may then read rows. Close it with
 * ckpt_rows_close. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
struct ckpt_rows;
enum err_code ckpt_rows_open(const char *path, struct ckpt_rows **out, struct err *e) ERR_USE;
size_t ckpt_rows_count(const struct ckpt_rows *r);
const struct gauss *ckpt_rows_like(const struct ckpt_rows *r); /* without arrays */
/* Read the JSON head (release it with json_decref), or the rows [from, from + n) (free them with
 * gauss_free). ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code ckpt_rows_meta(const struct ckpt_rows *r, struct json_t **out, struct err *e) ERR_USE;
enum err_code ckpt_rows_read(const struct ckpt_rows *r, size_t from, size_t n, struct gauss *out,
                             struct err *e) ERR_USE;
/* Reads a named blob and checks its hash. If there is no such blob, *out stays empty. Free it with
 * buf_free. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code ckpt_rows_blob(const struct ckpt_rows *r, const char *name, struct buf *out,
                             struct err *e) ERR_USE;
bool ckpt_rows_has(const struct ckpt_rows *r, const char *name);
/* As ckpt_rows_blob, into out [n_bytes]. ERR_FORMAT: the blob is missing or has another size.
 * ERR_IO. */
enum err_code ckpt_rows_blob_to(const struct ckpt_rows *r, const char *name, void *out,
                                size_t n_bytes, struct err *e) ERR_USE;
void ckpt_rows_close(struct ckpt_rows **r);
#endif
