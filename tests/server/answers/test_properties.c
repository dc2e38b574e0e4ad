/* Properties of every request, by random examples: equal tags mean equal bytes, ranges make up the
 * whole, a condition is met exactly if one of its tags is the resource's, a result has one name
 * however it is requested. Examples come from a counter, so a failure can be repeated by its
 * number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/routed.h"

enum { LISTS = 4000, HEADERS = 4000, CUTS = 400, SPELLINGS = 400, FORMS_MAX = 400 };

static uint32_t draw(uint64_t example, uint64_t what, uint32_t n)
{
    return (uint32_t)(rng_unit(11, what, example) * n);
}

/* ---- conditions ---- */

/* A list of tags, weak ones among them, with the white space that is allowed; *meets: one of them
 * is the tag. */
static void draw_list(uint64_t k, const char tag[BODY_ETAG_SIZE], struct buf *out, bool *meets)
{
    static const char *const gaps[] = {"", " ", "\t", " \t "};
    const uint32_t n = 1 + draw(k, 0, 6);
    *meets = false;
    for (uint32_t i = 0; i < n; i++) {
        char other[BODY_ETAG_SIZE];
        const uint64_t word = hash_bytes(&(uint64_t){k * 8 + i}, sizeof(uint64_t)).lo;
        const bool same = draw(k, 10 + i, 8) == 0;
        /* near misses: one letter changed, cut, longer */
        memcpy(other, tag, sizeof other);
        const uint32_t how = draw(k, 20 + i, 3);
        if (how == 0)
            other[1 + word % (strlen(tag) - 2)] ^= 1;
        else if (how == 1)
            snprintf(other, sizeof other, "%.*s\"", (int)(1 + word % (strlen(tag) - 2)), tag);
        else
            snprintf(other, sizeof other, "\"%016llx\"", (unsigned long long)word);
        buf_printf(out, "%s%s%s%s", i ? "," : "", gaps[draw(k, 30 + i, 4)],
                   draw(k, 40 + i, 2) ? "W/" : "", same ? tag : other);
        buf_printf(out, "%s", gaps[draw(k, 50 + i, 4)]);
        *meets |= same || !strcmp(other, tag);
    }
}

static void test_conditions(void **state)
{
    char tag[BODY_ETAG_SIZE], target[160];
    size_t met = 0;
    struct response first = get("/d/toy/r/REV+/t/KEY17.spz");
    assert_int_equal(first.status, 200);
    memcpy(tag, first.etag, sizeof tag);
    response_free(&first);
    snprintf(target, sizeof target, "/d/toy/r/REV+/t/KEY17.spz");
    for (uint64_t k = 0; k < LISTS; k++) {
        struct buf list = {0};
        bool meets;
        draw_list(k, tag, &list, &meets);
        struct response r = answer(&(struct ask){
            .method = draw(k, 60, 2) ? METHOD_GET : METHOD_HEAD,
            .target = target,
            .if_none_match = (char *)list.data,
            .range = draw(k, 61, 2) ? "bytes=1-2" : NULL, /* comes second (RFC 9110, 13.2.2) */
        });
        if ((r.status == 304) != meets)
            fail_msg("example %llu: %s: %d", (unsigned long long)k, (char *)list.data, r.status);
        assert_string_equal(r.etag, tag);
        met += meets;
        response_free(&r);
        buf_free(&list);
    }
    assert_true(met > LISTS / 10 && met < LISTS * 9 / 10);
}

/* ---- ranges ---- */

static uint64_t draw_size(uint64_t k, uint64_t what, uint64_t size)
{
    switch (draw(k, what, 6)) {
    case 0:
        return 0;
    case 1:
        return size - 1 + draw(k, what + 100, 3);
    case 2:
        return size * 1000 + 7;
    case 3:
        return UINT64_MAX / 10;
    default:
        return draw(k, what + 200, (uint32_t)size);
    }
}

/* Range: bytes=A-B, A-, -B with all kinds of numbers, against the definition of RFC 9110, section
 * 14.1.2. */
static void test_ranges(void **state)
{
    size_t parts = 0;
    struct response whole = get("/d/toy/r/REV+/t/KEY17.ply");
    const uint64_t size = whole.size;
    assert_true(size > 1000);
    for (uint64_t k = 0; k < HEADERS; k++) {
        char text[80];
        const uint64_t a = draw_size(k, 1, size), b = draw_size(k, 2, size);
        const uint32_t form = draw(k, 3, 3);
        uint64_t first = a, last = b;
        int status = 206;
        if (form == 0) {
            snprintf(text, sizeof text, "bytes=%llu-%llu", (unsigned long long)a,
                     (unsigned long long)b);
            status = b < a ? 200 : a >= size ? 416 : 206;
        } else if (form == 1) {
            snprintf(text, sizeof text, "bytes=%llu-", (unsigned long long)a);
            last = size - 1;
            status = a >= size ? 416 : 206;
        } else {
            snprintf(text, sizeof text, "bytes=-%llu", (unsigned long long)b);
            first = b < size ? size - b : 0;
            last = size - 1;
            status = b ? 206 : 416;
        }
        last = last < size ? last : size - 1;
        struct response r =
            answer(&(struct ask){.target = "/d/toy/r/REV+/t/KEY17.ply", .range = text});
        if (r.status != status)
            fail_msg("example %llu: %s of %llu: %d", (unsigned long long)k, text,
                     (unsigned long long)size, r.status);
        if (status == 206) {
            assert_int_equal(r.range_first, first);
            assert_int_equal(r.size, last - first + 1);
            assert_int_equal(r.range_total, size);
            assert_memory_equal(r.data, whole.data + first, r.size);
            assert_string_equal(r.etag, whole.etag);
            parts++;
        }
        response_free(&r);
    }
    assert_true(parts > HEADERS / 4);
    response_free(&whole);
}

/* Cut anywhere, in any number of parts, asked for in any order: together they are the whole. */
static void test_parts(void **state)
{
    static const char *const targets[] = {"/d/toy/r/REV+/t/KEY15.drc", "/d/toy/r/REV+/t/KEY16.glb",
                                          "/d/toy/r/REV+/t/KEY17.sog"};
    for (uint64_t k = 0; k < CUTS; k++) {
        const char *target = targets[k % 3];
        struct response whole = get(target);
        uint8_t *joined = mem_array(whole.size, 1);
        assert_non_null(joined);
        const size_t n = 1 + draw(k, 70, 9);
        size_t cut[11] = {0};
        for (size_t i = 1; i < n; i++)
            cut[i] = draw(k, 80 + i, (uint32_t)whole.size);
        for (size_t i = 1; i < n; i++) /* into order */
            for (size_t j = i; j > 1 && cut[j] < cut[j - 1]; j--) {
                size_t t_cut = cut[j];
                cut[j] = cut[j - 1];
                cut[j - 1] = t_cut;
            }
        cut[n] = whole.size;
        for (size_t i = n; i-- > 0;) { /* the last one first */
            char text[80];
            if (cut[i] == cut[i + 1])
                continue;
            snprintf(text, sizeof text, "bytes=%zu-%zu", cut[i], cut[i + 1] - 1);
            struct response r =
                answer(&(struct ask){.target = target, .range = text, .if_range = whole.etag});
            assert_int_equal(r.status, 206);
            memcpy(joined + r.range_first, r.data, r.size);
            response_free(&r);
        }
        assert_memory_equal(joined, whole.data, whole.size);
        mem_free(joined);
        response_free(&whole);
    }
}

/* ---- tags and names ---- */

static struct {
    char etag[BODY_ETAG_SIZE];
    struct hash128 bytes;
} forms[FORMS_MAX];

/* Every form of every tile, and documents in each coding: no tag stands for two things. */
static void test_tags(void **state)
{
    static const char *const exts[] = {
        "glb", "spz", "drc", "plain.glb", "lowpass.glb", "compressed.ply", "ply", "sog"};
    static const char *const presets[] = {"", "&preset=spz", "&preset=preview", "&preset=balanced",
                                          "&preset=near-lossless"};
    static const char *const documents[] = {"/collections",
                                            "/collections/toy",
                                            "/collections/toy/tiles.json",
                                            "/d/toy/tileset.json",
                                            "/conformance",
                                            "/api",
                                            "/d/toy/r/REV+/tileset.json",
                                            "/d/toy/seed.ndjson?f=spz",
                                            "/d/toy/seed.ndjson?f=glb"};
    size_t n = 0;
    for (int z = 15; z <= 17; z++)
        for (size_t i = 0; i < sizeof exts / sizeof *exts; i++)
            for (size_t p = 0; p < sizeof presets / sizeof *presets; p++)
                for (int sh = 0; sh < 2; sh++) {
                    char target[160];
                    snprintf(target, sizeof target, "/d/toy/r/REV+/t/KEY%d.%s?sh=%d%s", z, exts[i],
                             sh, presets[p]);
                    struct response r = get(target);
                    assert_int_equal(r.status, 200);
                    memcpy(forms[n].etag, r.etag, sizeof r.etag);
                    forms[n++].bytes = hash_bytes(r.data, r.size);
                    response_free(&r);
                }
    for (size_t i = 0; i < sizeof documents / sizeof *documents; i++)
        for (int gzip = 0; gzip < 2; gzip++) {
            struct response r = answer(
                &(struct ask){.target = documents[i], .accept_encoding = gzip ? "gzip" : NULL});
            assert_int_equal(r.status, 200);
            memcpy(forms[n].etag, r.etag, sizeof r.etag);
            forms[n++].bytes = hash_bytes(r.data, r.size);
            response_free(&r);
        }
    assert_true(n <= FORMS_MAX);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < i; j++)
            if (!strcmp(forms[i].etag, forms[j].etag) &&
                (forms[i].bytes.lo != forms[j].bytes.lo || forms[i].bytes.hi != forms[j].bytes.hi))
                fail_msg("forms %zu and %zu: two things with the tag %s", i, j, forms[i].etag);
}

/* The keys of a query in any order, with others among them that are not the server's: one result,
 * one tag. */
static void test_spellings(void **state)
{
    static const char *const own[] = {"preset=preview", "sh=0"};
    static const char *const others[] = {"v=1", "utm_source=a%20b", "x", "cache=bust&cache=2"};
    char tag[64] = "";
    for (uint64_t k = 0; k < SPELLINGS; k++) {
        struct buf target = {0};
        buf_printf(&target, "/d/toy/r/REV+/t/KEY17.spz");
        bool turned = draw(k, 90, 2);
        int said = 0;
        for (uint64_t i = 0; i < 5; i++) {
            const char *part = NULL;
            if (i == 1 || i == 3)
                part = own[(i == 3) != turned];
            else if (draw(k, 91 + i, 2))
                part = others[draw(k, 100 + i, 4)];
            if (part)
                buf_printf(&target, "%c%s", said++ ? '&' : '?', part);
        }
        struct response r = get((char *)target.data);
        if (r.status != 200 || (tag[0] && strcmp(tag, r.etag) != 0))
            fail_msg("example %llu: %s: %d %s, not %s", (unsigned long long)k, (char *)target.data,
                     r.status, r.etag, tag);
        snprintf(tag, sizeof tag, "%s", r.etag);
        response_free(&r);
        buf_free(&target);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_conditions), cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_parts),      cmocka_unit_test(test_tags),
        cmocka_unit_test(test_spellings),
    };
    log_set_level(LOG_ERROR);
    return cmocka_run_group_tests(tests, setup, teardown);
}
