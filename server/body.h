/* Encoded bytes that several answers share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_BODY_H
#define SERVER_BODY_H

#include <stdatomic.h>

#include "core/base.h"

enum { BODY_ETAG_SIZE = 32 };
struct body { /* immutable once shared; counted, body_drop frees it */
    _Atomic uint32_t refs;
    uint8_t *data;
    size_t size;
    char etag[BODY_ETAG_SIZE]; /* with its quotes */
    int64_t modified_s;        /* since 1970, for Last-Modified; 0: not said */
    uint8_t *gzip;             /* the same bytes compressed; NULL when that does not pay */
    size_t gzip_size;
    uint8_t *brotli; /* and as the viewer's build compressed them; NULL for all but its files */
    size_t brotli_size;
    void (*gone)(
        struct body *b); /* called before it is freed; NULL: nobody cares. These by flight.c: */
    struct flight *flight;
    struct hash128 id;
    struct body *flight_next;
};
/* Take b's bytes (b is left {0}). etag NULL: the hash of the bytes. NULL when out of memory (b is
 * freed). */
struct body *body_take(struct buf *b, const char *etag);
struct body *body_text(const char *text); /* copy of a string; NULL when out of memory */
struct body *body_ref(struct body *b);
/* A reference to a body that may be on its way out: false when the last one was dropped. */
bool body_revive(struct body *b);
/* Memory that it takes. */
size_t body_cost(const struct body *b);
void body_drop(struct body **b); /* accepts NULL inside, leaves NULL */
/* Add the gzip form when it saves at least a tenth. Only before the body is shared. */
void body_compress(struct body *b);
/* "22 characters of base64url", quoted: the strong entity tag of a 128-bit hash. */
void body_etag(struct hash128 h, char out[BODY_ETAG_SIZE]);

#endif
