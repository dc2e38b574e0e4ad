/* Checkpoints: one file, a JSON head and named blobs, hashed.
 *
 * Pure but for the file: any thread, one at a time for one path or one struct.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_CKPT_H
#define CODEC_CKPT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base.h"
#include "core/gauss.h"

struct ckpt_blob {
    char name[32];
    const void *data; /* write: borrowed; read: points into the ckpt's buffer, 64-byte aligned */
    size_t size_bytes;
};
struct ckpt {            /* {0} is empty */
    struct json_t *meta; /* level, step, seed, config, metrics ... */
    struct gauss g;
    struct ckpt_blob *blobs;
    size_t n_blobs;
    struct buf file;
};
/* meta must be an object; g may be empty. Written beside and renamed. ERR_ARG (meta), ERR_LIMIT,
 * ERR_IO, ERR_MEM. */
enum err_code ckpt_write(const char *path, const struct json_t *meta, const struct gauss *g,
                         const struct ckpt_blob *blobs, size_t n_blobs, struct err *e) ERR_USE;
/* The same of Gaussians that are not there as a container: each array is asked for in slices, from
 * front to back. Errors as ckpt_write, and what rows() returns. */
enum ckpt_field { CKPT_MEAN, CKPT_SCALE, CKPT_QUAT, CKPT_OPACITY, CKPT_SH, CKPT_EMBED };
struct ckpt_source {
    const struct gauss *like; /* counts, kind and origin; its arrays are not looked at */
    enum err_code (*rows)(void *user, enum ckpt_field field, size_t first, size_t n, float *out,
                          struct err *e); /* out: as in struct gauss, row `first` in front */
    void *user;
};
/* ERR_ARG, ERR_LIMIT, ERR_IO, ERR_MEM, and what from->rows returns. */
enum err_code ckpt_write_from(const char *path, const struct json_t *meta,
                              const struct ckpt_source *from, const struct ckpt_blob *blobs,
                              size_t n_blobs, struct err *e) ERR_USE;
/* All of it, in memory; ckpt_free it. ERR_NOENT, ERR_FORMAT (truncated, or a hash differs), ERR_IO,
 * ERR_LIMIT, ERR_MEM. */
enum err_code ckpt_read(const char *path, struct ckpt *out, struct err *e) ERR_USE;
const struct ckpt_blob *ckpt_find(const struct ckpt *c, const char *name); /* NULL when absent */
void ckpt_free(struct ckpt *c);
/* The Gaussians of a checkpoint by the slice, for those larger than memory. Opening reads it once
 * against its hashes; rows may be read from several threads. ckpt_rows_close it. Opening: errors as
 * ckpt_read, ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
struct ckpt_rows;
enum err_code ckpt_rows_open(const char *path, struct ckpt_rows **out, struct err *e) ERR_USE;
size_t ckpt_rows_count(const struct ckpt_rows *r);
const struct gauss *ckpt_rows_like(const struct ckpt_rows *r); /* without arrays */
/* The JSON head, json_decref it; rows [from, from + n), gauss_free them. ERR_FORMAT, ERR_IO,
 * ERR_MEM. */
enum err_code ckpt_rows_meta(const struct ckpt_rows *r, struct json_t **out, struct err *e) ERR_USE;
enum err_code ckpt_rows_read(const struct ckpt_rows *r, size_t from, size_t n, struct gauss *out,
                             struct err *e) ERR_USE;
/* A named blob, against its hash; *out stays empty where there is none. buf_free it. ERR_FORMAT,
 * ERR_IO, ERR_MEM. */
enum err_code ckpt_rows_blob(const struct ckpt_rows *r, const char *name, struct buf *out,
                             struct err *e) ERR_USE;
bool ckpt_rows_has(const struct ckpt_rows *r, const char *name);
/* The same into out [n_bytes]; ERR_FORMAT where it has not exactly so many bytes, ERR_IO. */
enum err_code ckpt_rows_blob_to(const struct ckpt_rows *r, const char *name, void *out,
                                size_t n_bytes, struct err *e) ERR_USE;
void ckpt_rows_close(struct ckpt_rows **r);
#endif
