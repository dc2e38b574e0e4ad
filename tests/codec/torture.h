/* Tortures decoders: it cuts bytes anywhere and changes bytes anywhere. Each try decodes a copy in
 * its own allocation, so that sanitizers see a read beyond its end. A failure names the try: "spz:
 * byte 17 of 411 changed from 0x02 to 0xf3 (seed 3, try 122): got ERR_MEM (...)".
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_TORTURE_H
#define TESTS_TORTURE_H

#include "tests/kit.h"

struct codec_limits;

struct torture {
    const char *name; /* for messages; every error about cut bytes must contain it */
    /* Decodes and frees. After an error it checks that the result is empty. */
    enum err_code (*decode)(const void *user, const void *bytes, size_t n,
                            const struct codec_limits *lim, struct err *e);
    const void *user;
    /* TORTURE(ERR_LIMIT) | ...: codes that changed bytes may give besides ERR_FORMAT */
    unsigned errors;
    /* text: digits mostly become other digits, because counts and offsets are dangerous */
    bool digits;
    /* Corrects the check value of the bytes. Changed bytes are then tried with and without that;
     * those with a wrong check value must be refused. NULL: there is no check value. */
    void (*mend)(struct buf *b);
};
#define TORTURE(code) (1u << (code))

/* Decodes a copy of n bytes; lim may be NULL. */
enum err_code torture_decode(const struct torture *t, const void *bytes, size_t n,
                             const struct codec_limits *lim, struct err *e);
/* Cuts to 0, step, 2 step ... bytes. Each must give ERR_FORMAT. */
void torture_cuts(const struct torture *t, const struct buf *whole, size_t step);
/* Changes one of the first `within` bytes (0: all), `tries` times. Each must decode or give one of
 * the errors. The bytes are restored afterwards. */
void torture_flips(const struct torture *t, struct buf *whole, size_t within, uint64_t seed,
                   size_t tries);

#endif
