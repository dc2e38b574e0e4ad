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

/* Every file of the target's corpus, each in an allocation of its own size. */
static void replay_corpus(const char *name, void (*target)(const uint8_t *, size_t))
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], **names;
    struct arena arena = {0};
    struct err e = {0};
    size_t n = 0;
    snprintf(dir, sizeof dir, "tests/fuzz/corpus/%s", name); /* ctest runs in the source folder */
    kit_ok(file_list(dir, NULL, &arena, &names, &n, &e), e);
    assert_true(n >= CORPUS_LEAST);
    for (size_t i = 0; i < n; i++) {
        struct buf b = {0};
        kit_ok(file_join(path, dir, names[i], &e), e);
        kit_ok(file_read(path, 0, &b, &e), e);
        uint8_t *copy = mem_array(b.size, 1);
        if (b.size)
            memcpy(copy, b.data, b.size);
        target(copy, b.size);
        mem_free(copy);
        buf_free(&b);
    }
    arena_free(&arena);
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
#define FUZZ(name) cmocka_unit_test(test_##name),
#include "tests/fuzz/targets.def"
#undef FUZZ
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
