/* For tests of formats that decode to a struct quant.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_QUANT_KIT_H
#define TESTS_QUANT_KIT_H

#include "tests/codec/torture.h"

#include "codec/splat/quant.h"
#include "core/splat/gauss.h"

/* Fails unless both hold the same integers. */
static inline void quant_kit_same(const struct quant *a, const struct quant *b)
{
    size_t sh = 3 * (gauss_sh_count(a->sh_degree) - 1);
    assert_int_equal(a->n, b->n);
    assert_int_equal(a->sh_degree, b->sh_degree);
    assert_int_equal(a->embed_len, b->embed_len);
    assert_int_equal(a->antialiased, b->antialiased);
    assert_int_equal(a->frac_bits, b->frac_bits);
    assert_memory_equal(a->position, b->position, a->n * 12);
    assert_memory_equal(a->alpha, b->alpha, a->n);
    assert_memory_equal(a->color, b->color, a->n * 3);
    assert_memory_equal(a->scale, b->scale, a->n * 3);
    assert_memory_equal(a->rotation, b->rotation, a->n * 4);
    assert_memory_equal(a->sh, b->sh, a->n * sh);
    assert_memory_equal(a->embed, b->embed, a->n * a->embed_len);
    assert_memory_equal(a->embed_min, b->embed_min, a->embed_len * 4);
    assert_memory_equal(a->embed_max, b->embed_max, a->embed_len * 4);
}

/* A decoder, as `user` of a struct torture whose `decode` is quant_kit_decode. */
struct quant_kit {
    enum err_code (*decode)(const void *bytes, size_t n, const struct codec_limits *lim,
                            struct quant *out, struct err *e);
};

static inline enum err_code quant_kit_decode(const void *user, const void *bytes, size_t n,
                                             const struct codec_limits *lim, struct err *e)
{
    const struct quant_kit *k = user;
    struct quant q;
    enum err_code rc = k->decode(bytes, n, lim, &q, e);
    if (rc)
        assert_null(q.block);
    quant_free(&q);
    return rc;
}

#endif
