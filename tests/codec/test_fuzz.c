/* Every fuzz target over its seeds and a few thousand seeded mutations: flips, runs, cuts, copies.
 *
 * libFuzzer does the real search (tests/fuzz/main.c). This test keeps the targets working, replays
 * findings (tests/fuzz/corpus/), and catches simple mistakes in every run.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <stdio.h>
#include <string.h>

#include "tests/fuzz/fuzz.h"

enum { MUTATIONS = 600, CORPUS_LEAST = 8 };

/* A mutation of `in` that depends on `seed` alone, in an allocation of its own size. */
static uint8_t *mutate(const struct buf *in, uint64_t seed, size_t *n)
{
    *n = rng_u64(seed, 0, 0) % 4 ? in->size : rng_u64(seed, 0, 1) % (in->size + 1);
    uint8_t *p = mem_array(*n, 1);
    memcpy(p, in->data, *n);
    for (uint64_t k = 0; *n && k < 1 + rng_u64(seed, 0, 2) % 4; k++) {
        size_t at = rng_u64(seed, 1, k) % *n, len = 1 + rng_u64(seed, 2, k) % 4;
        len = len > *n - at ? *n - at : len;
        switch (rng_u64(seed, 3, k) % 4) {
        case 0:
            p[at] ^= (uint8_t)(1u << rng_u64(seed, 4, k) % 8);
            break;
        case 1:
            memset(p + at, rng_u64(seed, 4, k) % 2 ? 0xff : 0, len);
            break;
        case 2:
            for (size_t i = 0; i < len; i++)
                p[at + i] = (uint8_t)rng_u64(seed, 5 + i, k);
            break;
        default:
            memmove(p + at, in->data + rng_u64(seed, 4, k) % (in->size - len + 1), len);
        }
    }
    return p;
}

static void replay(const char *name, void (*target)(const uint8_t *, size_t))
{
    target((const uint8_t *)"", 0);
    for (size_t i = 0; i < FUZZ_SEEDS; i++) {
        struct buf seed = {0};
        assert_true(fuzz_seed(name, i, &seed));
        target(seed.data, seed.size);
        for (uint64_t m = 0; m < MUTATIONS; m++) {
            size_t n;
            uint8_t *p = mutate(&seed, i * MUTATIONS + m, &n);
            target(p, n);
            mem_free(p);
        }
        buf_free(&seed);
    }
}

/* Every input of the target's corpus, each in an allocation of its own size. */
static void replay_corpus(const char *name, void (*target)(const uint8_t *, size_t))
{
    char path[FILE_PATH_MAX];
    struct buf corpus = {0}, input = {0};
    struct err e = {0};
    size_t n = 0;
    snprintf(path, sizeof path, "tests/fuzz/corpus/%s.txt", name); /* of the source folder */
    kit_ok(file_read(path, 0, &corpus, &e), e);
    for (size_t at = 0; at < corpus.size; n++) {
        at = fuzz_corpus_line(&corpus, at, &input);
        uint8_t *copy = mem_array(input.size, 1);
        if (input.size)
            memcpy(copy, input.data, input.size);
        target(copy, input.size);
        mem_free(copy);
    }
    assert_true(n >= CORPUS_LEAST);
    buf_free(&corpus);
    buf_free(&input);
}

/* An input comes back as it was written. */
static void lines_are_bytes(void **state)
{
    static const char text[] = "a \\x00\\x5c\\xff\n\nlast\\x20\n";
    struct buf corpus = {0}, input = {0};
    buf_add(&corpus, text, sizeof text - 1);
    size_t at = fuzz_corpus_line(&corpus, 0, &input);
    assert_int_equal(input.size, 5);
    assert_memory_equal(input.data, "a \0\\\xff", 5);
    at = fuzz_corpus_line(&corpus, at, &input);
    assert_int_equal(input.size, 0);
    at = fuzz_corpus_line(&corpus, at, &input);
    assert_int_equal(input.size, 5);
    assert_memory_equal(input.data, "last ", 5);
    assert_int_equal(at, corpus.size);
    buf_free(&corpus);
    buf_free(&input);
}

#define FUZZ(name)                                                                                 \
    static void test_##name(void **state)                                                          \
    {                                                                                              \
        (void)state;                                                                               \
        replay(#name, fuzz_##name);                                                                \
        replay_corpus(#name, fuzz_##name);                                                         \
    }
#include "tests/fuzz/targets.def"
#undef FUZZ

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lines_are_bytes),
#define FUZZ(name) cmocka_unit_test(test_##name),
#include "tests/fuzz/targets.def"
#undef FUZZ
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
