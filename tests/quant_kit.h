/* For tests of formats that decode to a struct quant.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_QUANT_KIT_H
#define TESTS_QUANT_KIT_H

#include "tests/torture.h"

#include "codec/quant.h"

/* A decoder, as `user` of a struct torture whose `decode` is quant_kit_decode. */
struct quant_kit {
    enum err_code (*decode)(const void *bytes, size_t n, const struct codec_limits *lim,
                            struct quant *out, struct err *e);
};

static enum err_code quant_kit_decode(const void *user, const void *bytes, size_t n,
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
