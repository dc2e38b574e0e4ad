/* Decoders of foreign bytes under random input: what each target does, and where its seeds come
 * from.
 *
 * The same targets run in three ways: as libFuzzer programs (-DCITYSPLAT_FUZZ=ON with clang:
 * fuzz_ply, fuzz_spz, ...), as a short deterministic replay of seeds and mutations in every ctest
 * run (test_fuzz.c), and over a folder of findings with the same programs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_FUZZ_FUZZ_H
#define TESTS_FUZZ_FUZZ_H

#include "core/base.h"

/* Decode n bytes; what decodes must encode again and come back the same. Aborts when it does not.
 */
#define FUZZ(name) void fuzz_##name(const uint8_t *bytes, size_t n);
#include "tests/fuzz/targets.def"
#undef FUZZ

enum { FUZZ_SEEDS = 3 };
/* Seed i < FUZZ_SEEDS of the named target, a small valid file; false when there is no such target.
 */
bool fuzz_seed(const char *target, size_t i, struct buf *out);
/* Of the targets in files.c. */
struct gauss;
bool fuzz_seed_ckpt(const struct gauss *g, struct buf *out);
bool fuzz_seed_colmap(size_t i, struct buf *out);
bool fuzz_seed_geojson(size_t i, struct buf *out);
/* Of those in serve.c; false for other targets. */
bool fuzz_seed_serve(const char *target, size_t i, struct buf *out);

#endif
