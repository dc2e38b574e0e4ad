/* Encoded bytes that several answers share: a counter, the bytes, their entity tag, for text also
 * the gzip form, and for the viewer's files the brotli form. One thread writes a body; then it is
 * shared and never changed. The holder of a reference may read it without a lock. libmicrohttpd
 * sends directly from these bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/body.h"

#include <assert.h>
#include <libdeflate.h>
#include <string.h>

void body_etag(struct hash128 h, char out[BODY_ETAG_SIZE])
{
    static const char digit[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
    uint64_t hi = h.hi, lo = h.lo;
    out[0] = '"';
    for (int i = 22; i >= 1;
         i--) { /* 22 digits of 6 bits hold the 128 bits, least significant last */
        out[i] = digit[lo & 63];
        lo = lo >> 6 | hi << 58;
        hi >>= 6;
    }
    out[23] = '"';
    out[24] = 0;
}

struct body *body_take(struct buf *b, const char *etag)
{
    struct body *body = b->failed ? NULL : mem_array(1, sizeof *body);
    if (!body) {
        buf_free(b);
        return NULL;
    }
    atomic_init(&body->refs, 1);
    /* What growing by doubling left over would be held as long as the slowest reader takes. */
    uint8_t *exact =
        b->cap - b->size > b->cap / 8 && b->size ? mem_resize(b->data, b->cap, b->size, 1) : NULL;
    body->data = exact ? exact : b->data;
    body->size = b->size;
    memset(b, 0, sizeof *b);
    if (etag) {
        size_t n = strlen(etag);
        assert(n < BODY_ETAG_SIZE);
        memcpy(body->etag, etag, n + 1);
    } else {
        body_etag(hash_bytes(body->data, body->size), body->etag);
    }
    return body;
}

struct body *body_text(const char *text)
{
    struct buf b = {0};
    buf_add(&b, text, strlen(text));
    return body_take(&b, NULL);
}

struct body *body_ref(struct body *b)
{
    if (b)
        atomic_fetch_add_explicit(&b->refs, 1, memory_order_relaxed);
    return b;
}

bool body_revive(struct body *b)
{
    uint32_t n = atomic_load(&b->refs);
    while (n && !atomic_compare_exchange_weak(&b->refs, &n, n + 1))
        continue;
    return n;
}

size_t body_cost(const struct body *b)
{
    enum { OVERHEAD = 256 };
    return (b->data ? b->size : 0) + b->gzip_size + b->brotli_size + OVERHEAD;
}

void body_drop(struct body **b)
{
    struct body *body = *b;
    *b = NULL;
    if (!body || atomic_fetch_sub_explicit(&body->refs, 1, memory_order_acq_rel) != 1)
        return;
    if (body->gone)
        body->gone(body);
    struct buf bytes = {.data = body->data, .size = body->size};
    buf_free(&bytes);
    mem_free(body->gzip);
    mem_free(body->brotli);
    mem_free(body);
}

void body_compress(struct body *b)
{
    if (b->size < 256)
        return;
    size_t room = b->size - b->size / 10; /* a larger result is not worth a second form */
    uint8_t *out = mem_uninit(room, 1);
    struct libdeflate_compressor *c = out ? libdeflate_alloc_compressor(6) : NULL;
    if (c)
        b->gzip_size = libdeflate_gzip_compress(c, b->data, b->size, out, room);
    if (b->gzip_size) {
        uint8_t *exact = mem_resize(out, room, b->gzip_size, 1);
        b->gzip = exact ? exact : out;
    } else {
        mem_free(out);
    }
    b->coded = b->coded || b->gzip;
    libdeflate_free_compressor(c);
}
