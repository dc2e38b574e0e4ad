/* Every kind of address, requested in every way that changes an answer: method, condition, content
 * coding, range. The expected answer follows from two things alone: the plain answer of the address
 * in that coding, and RFC 9110. Then the same again in random order, so that anything the server
 * keeps of one answer would show in another.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"

enum { ADDRESSES = 32, CODINGS = 5, CONDITIONS = 10, RANGES = 10, DRAWN = 6000, BLOCK = 2048 };

/* ---- what is asked ---- */

enum { CODED = 1, READ = 2, POSTED = 4 }; /* of text; GET; POST */
static const struct {
    const char *path; /* REV+: revision and edition, KEY17: the tile at the origin */
    int status;       /* of a plain GET */
    unsigned is;
} matrix_paths[] = {
    {"/", 200, CODED | READ},
    {"/index.html", 200, CODED | READ},
    {"/assets/map-0123abcd.js", 200, CODED | READ},
    {"/collections", 200, CODED | READ},
    {"/collections/toy", 200, CODED | READ},
    {"/collections/toy/tiles.json", 200, CODED | READ},
    {"/collections?bbox=13,52,14,53", 200, CODED | READ},
    {"/conformance", 200, CODED | READ},
    {"/api", 200, CODED | READ},
    {"/api.html", 200, CODED | READ},
    {"/d/toy/tileset.json", 200, CODED | READ},
    {"/d/toy/tileset.json?preset=preview&sh=0", 200, CODED | READ},
    {"/d/toy/r/REV+/tileset.json", 200, CODED | READ},
    {"/d/toy/r/REV/tileset.json", 200, CODED | READ},
    {"/d/toy/seed.ndjson?f=spz", 200, CODED | READ},
    {"/d/toy/r/REV+/t/KEY17.spz", 200, READ},
    {"/d/toy/r/REV/t/KEY17.spz", 200, READ},
    {"/d/toy/r/REV+/t/KEY17.spz?preset=preview", 200, READ},
    {"/d/toy/r/REV+/t/KEY15.drc", 200, READ},
    {"/d/toy/r/REV+/t/KEY16.glb", 200, READ},
    {"/d/toy/t/KEY17.glb", 307, READ},
    {"/d/toy/static/13.4,52.5,99@0,-90/64x64.jpg", 307, READ},
    {"/d/toy/r/REV/static/13.4,52.5,99@0,-90/64x64.jpg", 503, READ}, /* there is no device */
    {"/d/toy/r/REV+/t/17/0/0.spz", 404, READ},
    {"/d/toy/r/0123456789ab/t/KEY17.spz", 404, READ},
    {"/d/none/tileset.json", 404, READ},
    {"/nothing", 404, READ},
    {"/d/toy/render", 405, POSTED},
    {"/d/toy/appearances:mix", 405, POSTED},
};
static const char *const matrix_codings[CODINGS] = {"", "gzip", "br, gzip;q=0.5", "gzip;q=0",
                                                    "deflate, *;q=0.1"};
enum condition { PLAIN, SAME, WEAK, LISTED, STAR, OTHER, MALFORMED, SINCE, EARLIER, BOTH };
enum range { WHOLE, FIRST, LAST, FROM, ONE_BYTE, LONGER, OUTSIDE, BACKWARDS, SEVERAL, UNIT };
enum if_range { ANYWAY, IF_SAME, IF_OTHER, IF_WEAK, IF_RANGES };

struct matrix_case {
    size_t address;
    bool head;
    enum condition condition;
    size_t coding;
    enum range range;
    enum if_range if_range;
};

/* The plain answer of an address in a coding. */
struct matrix_plain {
    int status;
    char etag[64], modified[40], coding[16], vary[40], cache[128];
    bool ranges;
    size_t size;
    uint8_t *bytes;
    char block[BLOCK];
};
static struct {
    char target[160];
    struct matrix_plain plain[CODINGS];
} matrix[ADDRESSES];
static struct {
    int fd;
    struct buf rest;
    size_t asked;
} line;

/* ---- asking ---- */

static void matrix_ask(const char *method, const char *target, const char *fields, struct reply *r)
{
    struct buf q = {0};
    buf_printf(&q, "%s %s HTTP/1.1\r\nHost: localhost\r\n%s\r\n", method, target, fields);
    say_bytes(line.fd, (char *)q.data, q.size);
    buf_free(&q);
    hear(line.fd, strcmp(method, "HEAD") != 0, &line.rest, r);
    line.asked++;
}

/* The header fields but those that are of the moment, in their order. */
static void matrix_block(const struct reply *r, char out[BLOCK])
{
    static const char *const moment[] = {
        "Date:", "Server-Timing:", "Cache-Status:", "X-Request-Id:"};
    size_t n = 0;
    for (const char *p = r->head; p && *p != '\r'; p = strstr(p, "\r\n") + 2) {
        size_t size = strcspn(p, "\r");
        bool kept = true;
        for (size_t i = 0; i < sizeof moment / sizeof *moment; i++)
            kept = kept && strncasecmp(p, moment[i], strlen(moment[i])) != 0;
        assert_true(n + size + 2 < BLOCK);
        if (kept)
            n += (size_t)snprintf(out + n, BLOCK - n, "%.*s\n", (int)size, p);
    }
    out[n] = '\0';
}

static void matrix_accept(size_t coding, struct buf *fields)
{
    if (*matrix_codings[coding])
        buf_printf(fields, "Accept-Encoding: %s\r\n", matrix_codings[coding]);
}

static void matrix_learn(size_t address, size_t coding)
{
    struct matrix_plain *m = &matrix[address].plain[coding];
    struct buf fields = {0};
    struct reply r;
    matrix_accept(coding, &fields);
    buf_add(&fields, "", 1);
    matrix_ask("GET", matrix[address].target, (char *)fields.data, &r);
    m->status = r.status;
    snprintf(m->etag, sizeof m->etag, "%s", header(&r, "ETag"));
    snprintf(m->modified, sizeof m->modified, "%s", header(&r, "Last-Modified"));
    snprintf(m->coding, sizeof m->coding, "%s", header(&r, "Content-Encoding"));
    snprintf(m->vary, sizeof m->vary, "%s", header(&r, "Vary"));
    snprintf(m->cache, sizeof m->cache, "%s", header(&r, "Cache-Control"));
    m->ranges = !strcmp(header(&r, "Accept-Ranges"), "bytes");
    m->size = r.body_size;
    m->bytes = mem_array(r.body_size + 1, 1);
    assert_non_null(m->bytes);
    memcpy(m->bytes, r.body, r.body_size);
    matrix_block(&r, m->block);
    buf_free(&fields);
    buf_free(&r.raw);
}

/* ---- what must come ---- */

struct matrix_want {
    int status;
    size_t first, size; /* of the bytes */
};

static bool matrix_is_known(const struct matrix_plain *m, enum condition c)
{
    return c == SAME || c == WEAK || c == LISTED || c == STAR || (c == SINCE && m->modified[0]);
}

static struct matrix_want matrix_expect(const struct matrix_case *x)
{
    const struct matrix_plain *m = &matrix[x->address].plain[x->coding];
    const size_t n = m->size;
    struct matrix_want w = {m->status, 0, n};
    if (m->status != 200)
        return w;
    if (m->etag[0] && matrix_is_known(m, x->condition))
        return (struct matrix_want){304, 0, 0};
    if (x->head || !m->ranges || x->if_range == IF_OTHER || x->if_range == IF_WEAK)
        return w;
    switch (x->range) {
    case FIRST:
        return (struct matrix_want){206, 0, n < 10 ? n : 10};
    case LAST:
        return (struct matrix_want){206, n < 7 ? 0 : n - 7, n < 7 ? n : 7};
    case FROM:
        return (struct matrix_want){206, n / 2, n - n / 2};
    case ONE_BYTE:
        return (struct matrix_want){206, n - 1, 1};
    case LONGER:
        return (struct matrix_want){206, n / 3, n - n / 3};
    case OUTSIDE:
        return (struct matrix_want){416, 0, 0};
    default: /* none, or none that can be read: several ranges, another unit, backwards */
        return w;
    }
}

static void matrix_condition(const struct matrix_case *x, struct buf *out)
{
    const struct matrix_plain *m = &matrix[x->address].plain[x->coding];
    const char *etag = m->etag[0] ? m->etag : "\"any\"";
    if (x->condition == SAME)
        buf_printf(out, "If-None-Match: %s\r\n", etag);
    else if (x->condition == WEAK)
        buf_printf(out, "If-None-Match: W/%s\r\n", etag);
    else if (x->condition == LISTED)
        buf_printf(out, "If-None-Match: \"a\", W/\"b\" ,  %s\r\n", etag);
    else if (x->condition == STAR)
        buf_printf(out, "If-None-Match: *\r\n");
    else if (x->condition == OTHER)
        buf_printf(out, "If-None-Match: \"none of these\"\r\n");
    else if (x->condition == MALFORMED)
        buf_printf(out, "If-None-Match: nonsense, %s\r\n", etag);
    else if (x->condition == BOTH) /* the date below then does not count */
        buf_printf(out, "If-None-Match: \"another\"\r\n");
    if (x->condition == SINCE || x->condition == BOTH)
        buf_printf(out, "If-Modified-Since: %s\r\n",
                   m->modified[0] ? m->modified : "Sun, 06 Nov 1994 08:49:37 GMT");
    if (x->condition == EARLIER)
        buf_printf(out, "If-Modified-Since: Sun, 06 Nov 1994 08:49:37 GMT\r\n");
}

static void matrix_range(const struct matrix_case *x, struct buf *out)
{
    const struct matrix_plain *m = &matrix[x->address].plain[x->coding];
    const size_t n = m->size;
    static const char head[] = "Range: bytes=";
    if (x->range == WHOLE)
        return;
    if (x->range == FIRST)
        buf_printf(out, "%s0-9\r\n", head);
    else if (x->range == LAST)
        buf_printf(out, "%s-7\r\n", head);
    else if (x->range == FROM)
        buf_printf(out, "%s%zu-\r\n", head, n / 2);
    else if (x->range == ONE_BYTE)
        buf_printf(out, "%s%zu-%zu\r\n", head, n ? n - 1 : 0, n ? n - 1 : 0);
    else if (x->range == LONGER)
        buf_printf(out, "%s%zu-18446744073709551615\r\n", head, n / 3);
    else if (x->range == OUTSIDE)
        buf_printf(out, "%s%zu-\r\n", head, n + 1);
    else if (x->range == BACKWARDS)
        buf_printf(out, "%s9-3\r\n", head);
    else if (x->range == SEVERAL)
        buf_printf(out, "%s0-1,4-5\r\n", head);
    else
        buf_printf(out, "Range: lines=0-1\r\n");
    if (x->if_range == IF_SAME)
        buf_printf(out, "If-Range: %s\r\n", m->etag[0] ? m->etag : "\"any\"");
    else if (x->if_range == IF_OTHER)
        buf_printf(out, "If-Range: \"another\"\r\n");
    else if (x->if_range == IF_WEAK) /* a strong one is asked for (RFC 9110, section 13.1.5) */
        buf_printf(out, "If-Range: W/%s\r\n", m->etag[0] ? m->etag : "\"any\"");
}

/* ---- comparing ---- */

static void matrix_same(const char *what, const char *request, const char *got, const char *want)
{
    if (strcmp(got, want) != 0)
        fail_msg("%s of\n%s\nis\n%s\nand must be\n%s", what, request, got, want);
}

/* Of the head of a 200, what its 304 has: RFC 9110 (15.4.5) asks for Cache-Control, ETag and Vary
 * (and Date), and for nothing that describes bytes which the client has. Last-Modified guides
 * caches. */
static void matrix_block_304(const char *block, char out[BLOCK])
{
    static const char *const of_bytes[] = {
        "Content-Type:",  "Content-Encoding:", "Content-Length:",       "Link:",
        "Accept-Ranges:", "X-Content-Type-",   "Access-Control-Expose-"};
    size_t n = (size_t)snprintf(out, BLOCK, "HTTP/1.1 304 Not Modified\n");
    for (const char *p = strchr(block, '\n') + 1; *p; p = strchr(p, '\n') + 1) {
        bool kept = true;
        for (size_t i = 0; i < sizeof of_bytes / sizeof *of_bytes; i++)
            kept = kept && strncasecmp(p, of_bytes[i], strlen(of_bytes[i])) != 0;
        if (kept)
            n += (size_t)snprintf(out + n, BLOCK - n, "%.*s\n", (int)strcspn(p, "\n"), p);
    }
}

/* Content-Length stands in a 304 (RFC 9110, 8.6, allows it: that of the 200). */
static void matrix_check_304(const struct matrix_plain *m, const char *request, struct reply *r)
{
    char block[BLOCK], want[BLOCK], *length;
    matrix_block(r, block);
    matrix_block_304(m->block, want);
    if ((length = strstr(block, "Content-Length:")))
        memmove(length, strchr(length, '\n') + 1, strlen(strchr(length, '\n') + 1) + 1);
    assert_true(*header(r, "Date"));
    matrix_same("ETag", request, header(r, "ETag"), m->etag);
    matrix_same("Cache-Control", request, header(r, "Cache-Control"), m->cache);
    matrix_same("Vary", request, header(r, "Vary"), m->vary);
    if (*header(r, "Content-Length") && (size_t)atoll(r->value) != m->size)
        fail_msg("%s: a 304 claims a length of %s, not of %zu", request, r->value, m->size);
    matrix_same("the head", request, block, want);
}

static void matrix_check_part(const struct matrix_plain *m, const struct matrix_want *w,
                              const char *request, struct reply *r)
{
    char want[80];
    if (w->status == 206)
        snprintf(want, sizeof want, "bytes %zu-%zu/%zu", w->first, w->first + w->size - 1, m->size);
    else
        snprintf(want, sizeof want, "bytes */%zu", m->size);
    matrix_same("Content-Range", request, header(r, "Content-Range"), want);
    if (w->status != 206)
        return;
    matrix_same("ETag", request, header(r, "ETag"), m->etag);
    matrix_same("Cache-Control", request, header(r, "Cache-Control"), m->cache);
    if (r->body_size != w->size || memcmp(r->body, m->bytes + w->first, w->size) != 0)
        fail_msg("%s: other bytes", request);
}

static void matrix_check(const struct matrix_case *x)
{
    const struct matrix_plain *m = &matrix[x->address].plain[x->coding];
    const struct matrix_want w = matrix_expect(x);
    struct buf fields = {0}, request = {0};
    struct reply r;
    char block[BLOCK];
    matrix_accept(x->coding, &fields);
    matrix_condition(x, &fields);
    matrix_range(x, &fields);
    buf_add(&fields, "", 1);
    const char *method = x->head ? "HEAD" : "GET";
    buf_printf(&request, "%s %s\n%s", method, matrix[x->address].target, (char *)fields.data);
    buf_add(&request, "", 1);
    const char *text = (char *)request.data;
    matrix_ask(method, matrix[x->address].target, (char *)fields.data, &r);
    if (r.status != w.status)
        fail_msg("%sis %d and must be %d", text, r.status, w.status);
    if (w.status == 304) {
        matrix_check_304(m, text, &r);
    } else if (w.status == 206 || w.status == 416) {
        matrix_check_part(m, &w, text, &r);
    } else { /* the plain answer's head, letter by letter; problems name their request */
        matrix_block(&r, block);
        matrix_same("the head", text, block, m->block);
        if (w.status == 200 && !x->head &&
            (r.body_size != m->size || memcmp(r.body, m->bytes, m->size) != 0))
            fail_msg("%s: other bytes", text);
    }
    buf_free(&fields);
    buf_free(&request);
    buf_free(&r.raw);
}

/* ---- the matrix ---- */

static size_t matrix_addresses(void)
{
    return sizeof matrix_paths / sizeof *matrix_paths;
}

static void matrix_expand(const char *path, char out[160])
{
    size_t n = 0;
    for (const char *p = path; *p;) {
        if (!strncmp(p, "REV", 3)) {
            bool edition = p[3] == '+';
            n += (size_t)snprintf(out + n, 160 - n, "%s",
                                  edition ? revision_of(EDITION_TILES) : t.rev);
            p += 3 + edition;
        } else if (!strncmp(p, "KEY", 3)) {
            struct key k = served_key((uint8_t)atoi(p + 3));
            n += (size_t)snprintf(out + n, 160 - n, "%u/%u/%u", k.z, k.x, k.y);
            p += 5;
        } else {
            out[n++] = *p++;
        }
    }
    out[n] = '\0';
}

/* Each address plainly, in each coding: what is negotiated says so, and nothing else does. */
static void matrix_learn_all(void)
{
    for (size_t i = 0; i < matrix_addresses(); i++) {
        bool coded = false;
        matrix_expand(matrix_paths[i].path, matrix[i].target);
        for (size_t c = 0; c < CODINGS; c++) {
            struct matrix_plain *m = &matrix[i].plain[c];
            matrix_learn(i, c);
            if (m->status != matrix_paths[i].status)
                fail_msg("%s is %d", matrix[i].target, m->status);
            assert_int_equal(m->status == 200, m->etag[0] != 0);
            coded |= m->coding[0] != 0;
            /* never one that was not asked for */
            if (m->coding[0] && !strstr(matrix_codings[c], m->coding))
                assert_non_null(strchr(matrix_codings[c], '*'));
            assert_false(m->coding[0] && m->ranges);
        }
        assert_true(!coded || (matrix_paths[i].is & CODED));
        for (size_t c = 0; c < CODINGS; c++) {
            assert_int_equal(coded, strstr(matrix[i].plain[c].vary, "Accept-Encoding") != NULL);
            for (size_t d = 0; d < c; d++) /* another coding, another tag */
                assert_int_equal(!strcmp(matrix[i].plain[c].etag, matrix[i].plain[d].etag),
                                 !strcmp(matrix[i].plain[c].coding, matrix[i].plain[d].coding));
        }
    }
}

static void test_matrix(void **state)
{
    char web[FILE_PATH_MAX], path[FILE_PATH_MAX], script[3000];
    struct err e = {0};
    memset(script, ';', sizeof script);
    kit_ok(file_join(web, t.dir, "web/assets", &e), e);
    kit_ok(file_mkdir(web, &e), e);
    kit_ok(file_join(path, web, "map-0123abcd.js", &e), e);
    kit_ok(file_write(path, script, sizeof script, &e), e);
    kit_ok(file_join(path, web, "map-0123abcd.js.br", &e), e);
    kit_ok(file_write(path, script, 90, &e), e); /* nobody unpacks it here */
    kit_ok(file_join(path, web, "map-0123abcd.js.gz", &e), e);
    kit_ok(file_write(path, script, 100, &e), e);
    kit_ok(file_join(web, t.dir, "web", &e), e);
    kit_ok(file_join(path, web, "index.html", &e), e);
    kit_ok(file_write(path, script, 900, &e), e);
    t.cfg.web_dir = web;
    t.cfg.requests_per_connection = 1000000;
    start();
    line.fd = dial(t.port);
    matrix_learn_all();
    for (size_t i = 0; i < matrix_addresses(); i++)
        for (int k = 0; k < 2 * CONDITIONS * CODINGS * RANGES; k++) {
            const struct matrix_case x = {
                .address = i,
                .head = k & 1,
                .coding = (size_t)(k / 2 % CODINGS),
                .condition = (enum condition)(k / 2 / CODINGS % CONDITIONS),
                .range = (enum range)(k / 2 / CODINGS / CONDITIONS),
                .if_range = (enum if_range)((k / 2 + k / 20) % IF_RANGES)};
            matrix_check(&x);
        }
    for (uint64_t k = 0; k < DRAWN; k++) {
        uint32_t draw[6];
        for (uint64_t i = 0; i < 6; i++)
            draw[i] = (uint32_t)(rng_unit(7, i, k) * 0x1p32);
        const struct matrix_case x = {.address = draw[0] % matrix_addresses(),
                                      .head = draw[1] % 4 == 0,
                                      .coding = draw[2] % CODINGS,
                                      .condition = (enum condition)(draw[3] % CONDITIONS),
                                      .range = (enum range)(draw[4] % RANGES),
                                      .if_range = (enum if_range)(draw[5] % IF_RANGES)};
        matrix_check(&x);
    }
    print_message("%zu requests\n", line.asked);
    close(line.fd);
    buf_free(&line.rest);
    for (size_t i = 0; i < matrix_addresses(); i++)
        for (size_t c = 0; c < CODINGS; c++)
            mem_free(matrix[i].plain[c].bytes);
}

/* Methods: those that the address takes, a preflight, and 405 with what would be taken; whatever
 * conditions and ranges come along. */
static void test_methods(void **state)
{
    static const char *const methods[] = {"OPTIONS", "POST", "PUT", "DELETE", "PATCH"};
    static const char *const fields[] = {"", "If-None-Match: *\r\n", "Range: bytes=0-1\r\n",
                                         "Accept-Encoding: gzip\r\n"};
    char target[160];
    struct reply r;
    start();
    line.fd = dial(t.port);
    for (size_t i = 3; i < matrix_addresses(); i++) /* the first three are the viewer's */
        for (size_t m = 0; m < sizeof methods / sizeof *methods; m++)
            for (size_t f = 0; f < sizeof fields / sizeof *fields; f++) {
                const unsigned is = matrix_paths[i].is;
                bool post = !strcmp(methods[m], "POST") && is == POSTED;
                struct buf all = {0};
                matrix_expand(matrix_paths[i].path, target);
                buf_printf(&all, "%s%s", fields[f],
                           strcmp(methods[m], "OPTIONS") != 0 ? "Content-Length: 0\r\n" : "");
                buf_add(&all, "", 1);
                matrix_ask(methods[m], target, (char *)all.data, &r);
                int want = !strcmp(target, "/nothing")      ? 404
                           : !strcmp(methods[m], "OPTIONS") ? 204
                           : post                           ? 400 /* there is no JSON in it */
                                                            : 405;
                if (r.status != want)
                    fail_msg("%s %s\n%s: %d, not %d", methods[m], target, fields[f], r.status,
                             want);
                if (want == 204 || want == 405)
                    matrix_same("Allow", target, header(&r, "Allow"),
                                is == POSTED ? "POST, OPTIONS" : "GET, HEAD, OPTIONS");
                assert_string_equal(header(&r, "ETag"), "");
                assert_string_equal(header(&r, "Content-Range"), "");
                buf_free(&all);
                buf_free(&r.raw);
            }
    close(line.fd);
    buf_free(&line.rest);
}

/* A cache that holds few of the forms of a tile, so that bytes go and come back elsewhere while
 * answers that pointed at them are kept: every one is the first one's, byte for byte. */
static void test_evicted(void **state)
{
    enum { ROUNDS = 4, FORMS = 48 };
    static const char *const exts[] = {"glb", "spz", "drc", "plain.glb"};
    struct hash128 first[FORMS] = {{0, 0}};
    char target[128], full[160];
    struct reply r;
    t.cfg.cache_mb = 1;
    t.cfg.client_tiles_s = 0;
    start();
    line.fd = dial(t.port);
    for (size_t k = 0; k < (size_t)3 * FORMS * ROUNDS; k++) {
        size_t i = k / 3 % FORMS; /* each three times in a row: made, seen, kept */
        (void)tile_target((uint8_t)(SERVED_ZOOM_MIN + i % 3), exts[i / 3 % 4], target);
        snprintf(full, sizeof full, "%s?sh=%zu", target, i / 12);
        if (i / 3 % 4 == 3)
            memcpy(full, target, sizeof target);
        matrix_ask("GET", full, "", &r);
        assert_int_equal(r.status, 200);
        struct hash128 h = hash_bytes(r.body, r.body_size);
        if (k < 3 * FORMS && k % 3 == 0)
            first[i] = h;
        assert_true(h.lo == first[i].lo && h.hi == first[i].hi);
        buf_free(&r.raw);
    }
    close(line.fd);
    buf_free(&line.rest);
}

int main(void)
{
    const struct CMUnitTest tests[] = {HTTP_TEST(test_matrix), HTTP_TEST(test_methods),
                                       HTTP_TEST(test_evicted)};
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
