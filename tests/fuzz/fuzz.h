/* Fuzz tests of decoders: the targets, and their seeds.
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

/* Decodes n bytes. If that succeeds, encoding and decoding again must give the same, else it
 * aborts. */
#define FUZZ(name) void fuzz_##name(const uint8_t *bytes, size_t n);
#include "tests/fuzz/targets.def"
#undef FUZZ

enum { FUZZ_SEEDS = 3 };
/* Writes seed i < FUZZ_SEEDS of a target, a small valid file. Returns false: there is no such
 * target. */
bool fuzz_seed(const char *target, size_t i, struct buf *out);
/* The corpus of a target is tests/fuzz/corpus/TARGET.txt: an input a line, in which \xNN is a byte;
 * all but printable characters, and the backslash, are written so. This adds a finding:
 *
 *     od -An -v -tx1 FILE | tr -d '\n' | sed 's/ /\\x/g; s/$/\n/' >>tests/fuzz/corpus/TARGET.txt
 *
 * Reads the line that begins at `at` into out, and returns where the next one begins. */
size_t fuzz_corpus_line(const struct buf *corpus, size_t at, struct buf *out);
/* Functions of files.c that make seeds, one for each of its targets: seed i, or the one seed of a
 * checkpoint. False: the seed could not be made. */
struct gauss;
bool fuzz_seed_ckpt(const struct gauss *g, struct buf *out);
bool fuzz_seed_colmap(size_t i, struct buf *out);
bool fuzz_seed_odm(size_t i, struct buf *out);
bool fuzz_seed_geojson(size_t i, struct buf *out);
/* Seeds of the targets in serve.c; false for other targets. */
bool fuzz_seed_serve(const char *target, size_t i, struct buf *out);

#endif
