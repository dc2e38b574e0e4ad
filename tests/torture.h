/* Torture of decoders of foreign bytes: cut anywhere, bytes changed anywhere. Every try decodes a
 * copy in an allocation of its own, so that the sanitizers see a read behind its end, and a failure
 * says which try it was: "spz: byte 17 of 411 changed from 0x02 to 0xf3 (seed 3, try 122): got
 * ERR_MEM (...)".
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_TORTURE_H
#define TESTS_TORTURE_H

#include "tests/kit.h"

struct codec_limits;

struct torture {
    const char *name; /* for messages; every error of cut bytes has it in its text */
    /* Decode and free again. After an error it checks that nothing was left in the result. */
    enum err_code (*decode)(const void *user, const void *bytes, size_t n,
                            const struct codec_limits *lim, struct err *e);
    const void *user;
    unsigned errors; /* TORTURE(ERR_LIMIT) | ...: what changed bytes may give beside ERR_FORMAT */
    /* text: a digit mostly becomes another digit, as counts and offsets are the danger */
    bool digits;
    /* Bytes with a check value: put it right. Then changed bytes are tried both ways, and those
     * that do not fit their check value must be refused. NULL: there is none. */
    void (*mend)(struct buf *b);
};
#define TORTURE(code) (1u << (code))

/* Decode a copy of n bytes; lim may be NULL. */
enum err_code torture_decode(const struct torture *t, const void *bytes, size_t n,
                             const struct codec_limits *lim, struct err *e);
/* Cut to 0, step, 2 step ... bytes: each is refused with ERR_FORMAT. */
void torture_cuts(const struct torture *t, const struct buf *whole, size_t step);
/* `tries` times one byte changed among the first `within` (0: all of them): decoded, or one of the
 * errors. The bytes are afterwards what they were. */
void torture_flips(const struct torture *t, struct buf *whole, size_t within, uint64_t seed,
                   size_t tries);

#endif
