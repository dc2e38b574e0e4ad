/* The cache of encoded bytes: it finds entries, keeps its limit, keeps entries that are used, and
 * frees none that is being sent.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <string.h>
#include <unistd.h>

#include "core/pool.h"
#include "server/base/body_file.h"
#include "server/data/cache.h"

static struct hash128 key_of(uint64_t i)
{
    return hash_bytes(&i, sizeof i);
}

/* A body of `size` bytes that all say `i`. */
static struct body *body_of(uint64_t i, size_t size)
{
    struct buf b = {0};
    uint8_t *p = buf_grow(&b, size);
    assert_non_null(p);
    memset(p, (int)(i & 255), size);
    struct body *body = body_take(&b, NULL);
    assert_non_null(body);
    return body;
}

static void put(struct cache *c, uint64_t i, size_t size)
{
    struct body *b = body_of(i, size);
    cache_put(c, key_of(i), b);
    body_drop(&b);
}

static bool has(struct cache *c, uint64_t i)
{
    struct body *b = cache_get(c, key_of(i), NULL);
    bool found = b;
    body_drop(&b);
    return found;
}

static void test_finds_what_was_put(void **state)
{
    struct err e = {0};
    struct cache *c = NULL;
    struct cache_stats st;
    kit_ok(cache_open((size_t)64 << 20, &c, &e), e);
    for (uint64_t i = 0; i < 5000; i++) /* more than the first tables hold */
        put(c, i, 1 + i % 100);
    for (uint64_t i = 0; i < 5000; i++) {
        struct body *b = cache_get(c, key_of(i), NULL);
        assert_non_null(b);
        assert_int_equal(b->size, 1 + i % 100);
        assert_int_equal(b->data[0], i & 255);
        body_drop(&b);
    }
    assert_false(has(c, 5000));
    cache_count(c, &st);
    assert_int_equal(st.hits, 5000);
    assert_int_equal(st.misses, 1);
    assert_int_equal(st.entries, 5000);
    put(c, 7, 55); /* the newer wins */
    struct body *b = cache_get(c, key_of(7), NULL);
    assert_int_equal(b->size, 55);
    body_drop(&b);
    cache_count(c, &st);
    assert_int_equal(st.entries, 5000);
    cache_close(&c);
    assert_null(c);
}

static void test_stays_within_its_bytes(void **state)
{
    struct err e = {0};
    struct cache *c = NULL;
    struct cache_stats st;
    const size_t limit = (size_t)1 << 20;
    kit_ok(cache_open(limit, &c, &e), e);
    for (uint64_t i = 0; i < 3000; i++) {
        put(c, i, 1 + (i * 7919) % 5000);
        cache_count(c, &st);
        assert_true(st.bytes <= limit);
    }
    assert_true(st.evictions > 0);
    assert_true(st.bytes > limit / 2); /* and uses them */
    put(c, 9999, limit / 16);          /* with its own cost larger than a shard */
    assert_false(has(c, 9999));
    cache_close(&c);
}

/* A scan of many entries seen once does not push out those that were seen twice. */
static void test_keeps_what_is_used(void **state)
{
    struct err e = {0};
    struct cache *c = NULL;
    kit_ok(cache_open((size_t)4 << 20, &c, &e),
           e); /* 256 KiB a shard: about 200 entries of 1 KiB */
    for (uint64_t i = 0; i < 800; i++)
        put(c, i, 1024);
    for (uint64_t i = 0; i < 800; i++)
        assert_true(has(c, i));
    for (uint64_t i = 10000; i < 30000; i++)
        put(c, i, 1024);
    size_t kept = 0;
    for (uint64_t i = 0; i < 800; i++)
        kept += has(c, i);
    assert_int_equal(kept, 800);
    cache_close(&c);
}

static void test_evicted_bodies_live_while_held(void **state)
{
    struct err e = {0};
    struct cache *c = NULL;
    kit_ok(cache_open((size_t)1 << 20, &c, &e), e);
    put(c, 1, 1000);
    struct body *held = cache_get(c, key_of(1), NULL);
    assert_non_null(held);
    for (uint64_t i = 2; i < 4000; i++)
        put(c, i, 4000), (void)has(c, i);
    assert_false(has(c, 1));
    for (size_t i = 0; i < held->size; i++)
        assert_int_equal(held->data[i], 1);
    cache_close(&c);
    assert_int_equal(held->data[999], 1);
    body_drop(&held);
}

static enum err_code hammer(void *user, size_t t, struct err *e)
{
    struct cache *c = user;
    for (uint64_t i = 0; i < 4000; i++) {
        uint64_t id = rng_u64(3, t, i) % 300;
        struct body *b = cache_get(c, key_of(id), NULL);
        if (b && (b->size != 100 + id || b->data[id % b->size] != (id & 255)))
            return err_set(e, ERR_INTERNAL, "entry %llu holds other bytes", (unsigned long long)id);
        if (!b)
            put(c, id, 100 + id);
        body_drop(&b);
    }
    return ERR_OK;
}

static void test_many_threads(void **state)
{
    struct err e = {0};
    struct cache *c = NULL;
    struct cache_stats st;
    kit_ok(cache_open((size_t)96 << 10, &c, &e),
           e); /* room for a third of them: constant eviction */
    kit_ok(pool_for(8, 8, hammer, c, &e), e);
    cache_count(c, &st);
    assert_int_equal(st.hits + st.misses, 8 * 4000);
    assert_true(st.bytes <= (size_t)96 << 10);
    cache_close(&c);
}

static void test_etag(void **state)
{
    char a[BODY_ETAG_SIZE], b[BODY_ETAG_SIZE];
    body_etag((struct hash128){0}, a);
    assert_string_equal(a, "\"AAAAAAAAAAAAAAAAAAAAAA\"");
    body_etag((struct hash128){.lo = 1}, a);
    assert_string_equal(a, "\"AAAAAAAAAAAAAAAAAAAAAB\"");
    body_etag((struct hash128){.lo = UINT64_MAX, .hi = UINT64_MAX}, a);
    assert_string_equal(a, "\"D_____________________\"");
    for (int bit = 0; bit < 128; bit++) { /* every bit counts */
        struct hash128 h = {0};
        *(bit < 64 ? &h.lo : &h.hi) = (uint64_t)1 << (bit & 63);
        body_etag(h, b);
        assert_string_not_equal(a, b);
        memcpy(a, b, sizeof a);
    }
}

static void test_gzip_only_when_it_pays(void **state)
{
    struct body *text = body_of('x', 10000);
    body_compress(text);
    assert_non_null(text->gzip);
    assert_true(text->gzip_size < 200);
    struct buf noise = {0};
    for (uint64_t i = 0; i < 1000; i++)
        buf_u64(&noise, rng_u64(1, 2, i));
    struct body *random = body_take(&noise, NULL);
    body_compress(random);
    assert_null(random->gzip);
    body_drop(&text);
    body_drop(&random);
}

/* As many as may be lie in files, with the same bytes; the others stay as they are. */
static void test_large_bodies_in_files(void **state)
{
    enum { LARGE = 200000, AT = 1234, PART = 100 };
    uint8_t part[PART];
    uint64_t at = 0;
    body_file_limit(1);
    for (int again = 0; again < 2; again++) { /* one that is gone makes room */
        struct body *first = body_of(1, LARGE), *second = body_of(2, LARGE), *small = body_of(3, 9);
        const struct hash128 want = hash_bytes(first->data, LARGE);
        body_file_move(first);
        body_file_move(second);
        assert_non_null(first->unmap);
        assert_null(second->unmap);
        assert_int_equal(body_file_of(second, second->data, &at), -1);
        const struct hash128 got = hash_bytes(first->data, LARGE);
        assert_true(got.lo == want.lo && got.hi == want.hi && first->size == LARGE);
        const int fd = body_file_of(first, first->data + AT, &at);
        assert_true(fd >= 0);
        assert_int_equal(at, AT);
        body_drop(&first); /* the answer under way has the bytes still */
        assert_int_equal(pread(fd, part, PART, AT), PART);
        for (int i = 0; i < PART; i++)
            assert_int_equal(part[i], 1);
        close(fd);
        body_file_move(small);
        assert_null(small->unmap);
        body_drop(&second);
        body_drop(&small);
    }
    body_file_limit(0);
    struct body *none = body_of(1, LARGE);
    body_file_move(none);
    assert_null(none->unmap);
    body_drop(&none);
}

static void test_memory_failures(void **state)
{
    for (size_t k = 1; k < 40; k++) {
        struct err e = {0};
        struct cache *c = NULL;
        mem_fail_at(k);
        enum err_code rc = cache_open(1 << 20, &c, &e);
        mem_fail_at(0);
        if (!rc) {
            cache_close(&c);
            assert_true(k > 16);
            return;
        }
        assert_int_equal(rc, ERR_MEM);
        assert_null(c);
    }
    fail_msg("cache_open never succeeded");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_finds_what_was_put),
        cmocka_unit_test(test_stays_within_its_bytes),
        cmocka_unit_test(test_keeps_what_is_used),
        cmocka_unit_test(test_evicted_bodies_live_while_held),
        cmocka_unit_test(test_many_threads),
        cmocka_unit_test(test_etag),
        cmocka_unit_test(test_gzip_only_when_it_pays),
        cmocka_unit_test(test_large_bodies_in_files),
        cmocka_unit_test(test_memory_failures),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
