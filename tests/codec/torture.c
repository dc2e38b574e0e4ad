/* See torture.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/codec/torture.h"

#include <string.h>

enum err_code torture_decode(const struct torture *t, const void *bytes, size_t n,
                             const struct codec_limits *lim, struct err *e)
{
    uint8_t *copy = mem_array(n, 1);
    assert_non_null(copy);
    if (n)
        memcpy(copy, bytes, n);
    enum err_code rc = t->decode(t->user, copy, n, lim, e);
    mem_free(copy);
    return rc;
}

void torture_cuts(const struct torture *t, const struct buf *whole, size_t step)
{
    for (size_t n = 0; n < whole->size; n += step) {
        struct err e = {0};
        enum err_code rc = torture_decode(t, whole->data, n, NULL, &e);
        if (rc != ERR_FORMAT)
            fail_msg("%s: cut to %zu of %zu bytes: got %s (%s), want ERR_FORMAT", t->name, n,
                     whole->size, kit_err(rc), e.msg);
        if (!strstr(e.msg, t->name))
            fail_msg("%s: cut to %zu of %zu bytes: the message does not say whose it is: %s",
                     t->name, n, whole->size, e.msg);
    }
}

/* What the byte becomes; it may stay what it is. */
static uint8_t torture_byte(const struct torture *t, uint8_t old, uint64_t seed, uint64_t k)
{
    uint64_t r = rng_u64(seed, k, 1);
    return (uint8_t)(t->digits && old >= '0' && old <= '9' && k % 4 ? '0' + r % 10 : r);
}

void torture_flips(const struct torture *t, struct buf *whole, size_t within, uint64_t seed,
                   size_t tries)
{
    size_t room = within && within < whole->size ? within : whole->size, refused = 0;
    struct buf good = {0};
    buf_add(&good, whole->data, whole->size);
    for (uint64_t k = 0; k < tries; k++) {
        struct err e = {0};
        size_t at = rng_u64(seed, k, 0) % room;
        uint8_t old = whole->data[at];
        bool mend = t->mend && k & 1;
        whole->data[at] = torture_byte(t, old, seed, k);
        if (mend)
            t->mend(whole);
        enum err_code rc = torture_decode(t, whole->data, whole->size, NULL, &e);
        bool fine = rc ? (TORTURE(rc) & (t->errors | TORTURE(ERR_FORMAT))) != 0
                       : !t->mend || mend || whole->data[at] == old;
        if (!fine)
            fail_msg("%s: byte %zu of %zu changed from 0x%02x to 0x%02x (seed %llu, try %llu%s): "
                     "got %s (%s)",
                     t->name, at, whole->size, old, whole->data[at], (unsigned long long)seed,
                     (unsigned long long)k, mend ? ", check value put right" : "", kit_err(rc),
                     e.msg);
        refused += rc != 0;
        memcpy(whole->data, good.data, good.size);
    }
    if (!refused)
        fail_msg("%s: %zu changed bytes and not one was refused", t->name, tries);
    buf_free(&good);
}
