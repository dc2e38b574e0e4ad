/* Objects at a web server or in a bucket: parts by HTTP range requests (RFC 9110, 14), and small
 * objects as a whole, which can also be replaced (RFC 9110, 13). libcurl speaks the protocol, and
 * signs requests to S3.
 *
 * What a server sends is not trusted. An answer must hold all of the bytes that were asked for, and
 * no others. Parts must come from the object that was opened: its size is the same, and so is its
 * entity tag, or its date where there is no tag.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_RANGE_H
#define LOD_RANGE_H

#include "core/base.h"

enum { RANGE_URL_MAX = 2048, RANGE_TAG_MAX = 160, RANGE_DATE_MAX = 48 };

struct range_object { /* one state of an object; size_bytes 0: not known yet */
    uint64_t size_bytes;
    char etag[RANGE_TAG_MAX];      /* with its quotes; "": the server sends none */
    char modified[RANGE_DATE_MAX]; /* Last-Modified as it was sent; "": none */
};

/* Returns whether a path is an address: http://, https:// or s3://. */
bool range_is_url(const char *path);
/* Writes an address for messages: without user, password and query, which may hold secrets. */
void range_show(const char *url, char out[RANGE_URL_MAX]);

struct range; /* one connection; one thread at a time */
/* Prepares a connection. ERR_ARG (the address, or the environment for S3), ERR_LIMIT (too long),
 * ERR_MEM. */
enum err_code range_open(const char *url, struct range **out, struct err *e) ERR_USE;
void range_close(struct range **r);
/* Reads bytes [at, at + n) into `out`, which has room for n. Fewer come only at the object's end;
 * *got says how many. If o->size_bytes is 0, *o is filled from the answer; else the answer must be
 * of *o. Temporary failures are repeated until until_s of clock_s(). ERR_BUSY: temporary; ERR_DATA:
 * the object is another one now; ERR_NOENT (404, 410), ERR_FORMAT (the server does not answer range
 * requests as it must), ERR_IO (refused: 401, 403 and others), ERR_MEM. */
enum err_code range_get(struct range *r, struct range_object *o, uint64_t at, size_t n,
                        uint8_t *out, size_t *got, double until_s, struct err *e) ERR_USE;
/* Asks whether the object is still *o. ERR_DATA: the object is another one now. Other errors are
 * those of range_get. */
enum err_code range_check(struct range *r, const struct range_object *o, double until_s,
                          struct err *e) ERR_USE;
/* Requests that were sent by this process. */
uint64_t range_requests(void);

#endif
