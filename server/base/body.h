/* Encoded bytes that several answers share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_BODY_H
#define SERVER_BODY_H

#include <stdatomic.h>

#include "core/base.h"

enum { BODY_ETAG_SIZE = 32 };
struct body { /* immutable once shared; reference-counted; body_drop frees it */
    _Atomic uint32_t refs;
    uint8_t *data; /* NULL: only the gzip form is there (static.h) */
    size_t size;
    bool coded; /* it has other forms, whether they are here or not */
    /* frees data, which is a mapping of the file fd (body_file.h); NULL: it is in no file */
    void (*unmap)(struct body *b);
    int fd;
    char etag[BODY_ETAG_SIZE]; /* with quotation marks */
    int64_t modified_s;        /* seconds since 1970, for Last-Modified; 0: not known */
    uint8_t *gzip;             /* the same bytes compressed; NULL: that saves too little */
    size_t gzip_size;
    /* the same bytes, compressed by the viewer's build; NULL except for the viewer's files */
    uint8_t *brotli;
    size_t brotli_size;
    void (*gone)(struct body *b); /* called before it is freed; NULL: none. By live_bodies.c: */
    struct live_bodies *live_bodies;
    struct hash128 id;
    struct body *live_bodies_next;
};
/* Makes a body of b's bytes, and leaves b {0}. etag NULL: the hash of the bytes. NULL: out of
 * memory, and b was freed. */
struct body *body_take(struct buf *b, const char *etag);
struct body *body_text(const char *text); /* copy of a string; NULL: out of memory */
struct body *body_ref(struct body *b);
/* Takes a reference to a body that may be about to be freed. Returns false if its last reference
 * was dropped already. */
bool body_revive(struct body *b);
/* Memory of a body in bytes. */
size_t body_cost(const struct body *b);
void body_drop(struct body **b); /* *b may be NULL; sets it to NULL */
/* Adds the gzip form if it saves at least a tenth. Call it before the body is shared. */
void body_compress(struct body *b);
/* Writes the strong entity tag of a hash: 22 characters of base64url in quotation marks. */
void body_etag(struct hash128 h, char out[BODY_ETAG_SIZE]);

#endif
