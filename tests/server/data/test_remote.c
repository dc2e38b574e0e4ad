/* Stores at addresses: read from nginx and equal to files, few requests, what was read is kept, and
 * a server of objects that misbehaves in each way never gives wrong bytes or calls a store damaged.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE // NOLINT(cert-dcl51-cpp): strcasestr
#include "tests/server/ranges_kit.h"

#include "tests/server/client.h"

#include <fcntl.h>
#include <nettle/base16.h>
#include <nettle/hmac.h>
#include <nettle/sha2.h>
#include <sys/stat.h>

#include "lod/store/blocks.h"
#include "lod/store/remote.h"

enum { SIDE = 8, ROWS = 800 }; /* tiles along an edge; Gaussians of a tile: about 40 KB */

static struct {
    char dir[FILE_PATH_MAX], cache[FILE_PATH_MAX], first[FILE_PATH_MAX], second[FILE_PATH_MAX];
    struct ranges_nginx nginx;
    bool has_nginx;
} r;

static void make_city(const char *path, uint32_t n_coarse)
{
    struct err e = {0};
    struct store *s = NULL;
    struct store_meta meta = {.name = "toy",
                              .origin = served_origin,
                              .sh_degree = 1,
                              .zoom_min = SERVED_ZOOM_MIN,
                              .zoom_max = SERVED_ZOOM_MAX};
    kit_ok(store_create(path, &meta, &s, &e), e);
    served_put(s, served_key(SERVED_ZOOM_MIN), n_coarse);
    const struct key at = served_key(SERVED_ZOOM_MAX);
    for (uint32_t y = 0; y < SIDE; y++)
        for (uint32_t x = 0; x < SIDE; x++)
            served_put(s, (struct key){at.z, at.x + x, at.y + y}, ROWS);
    kit_ok(store_put_blob(s, "notes", "some notes", 10, &e), e);
    kit_ok(store_commit(&s, &e), e);
}

static int remote_setup_all(void **state)
{
    struct err e = {0};
    log_set_level(LOG_ERROR);
    kit_tmpdir(r.dir);
    kit_ok(file_join(r.cache, r.dir, "cache", &e), e);
    kit_ok(file_join(r.first, r.dir, "first.tiles", &e), e);
    kit_ok(file_join(r.second, r.dir, "second.tiles", &e), e);
    make_city(r.first, 900);
    make_city(r.second, 901);
    r.has_nginx = ranges_nginx_start(&r.nginx, r.dir);
    ranges_start();
    remote_patience(5);
    return 0;
}

static int remote_teardown_all(void **state)
{
    ranges_stop();
    if (r.has_nginx)
        ranges_nginx_stop(&r.nginx);
    kit_rmdir(r.dir);
    return 0;
}

/* Nothing is kept of what was read before. */
static int remote_setup(void **state)
{
    kit_rmdir(r.cache);
    blocks_configure(r.cache, (uint64_t)1 << 30);
    atomic_store(&ranges.way, RANGES_WELL);
    ranges_serve(r.first, "one");
    return 0;
}

static const char *rude(void)
{
    static char url[64];
    snprintf(url, sizeof url, "http://127.0.0.1:%u/city.tiles", ranges.port);
    return url;
}

static const char *from_nginx(const char *name)
{
    static char url[80];
    snprintf(url, sizeof url, "http://127.0.0.1:%u/%s", r.nginx.port, name);
    return url;
}

static void assert_same_tile(struct store *a, struct store *b, struct key k)
{
    struct err e = {0};
    struct buf x = {0}, y = {0};
    kit_ok(store_read(a, k, &x, &e), e);
    kit_ok(store_read(b, k, &y, &e), e);
    assert_int_equal(x.size, y.size);
    assert_memory_equal(x.data, y.data, x.size);
    buf_free(&x);
    buf_free(&y);
}

static void assert_same_store(struct store *a, struct store *b)
{
    struct err e = {0};
    struct buf x = {0};
    size_t n, m;
    const struct store_tile *s = store_tiles(a, &n), *q = store_tiles(b, &m);
    assert_int_equal(n, m);
    assert_string_equal(store_info(a)->revision, store_info(b)->revision);
    for (size_t i = 0; i < n; i++) {
        assert_int_equal(key_compare(s[i].key, q[i].key), 0);
        assert_memory_equal(&s[i].hash, &q[i].hash, sizeof s[i].hash);
        assert_same_tile(a, b, s[i].key);
    }
    kit_ok(store_get_blob(b, "notes", &x, &e), e);
    assert_int_equal(x.size, 10);
    buf_free(&x);
}

static void a_remote_store_is_as_its_file(void **state)
{
    struct err e = {0};
    struct store *near = NULL, *far = NULL;
    size_t bad = 1;
    if (!r.has_nginx)
        skip();
    kit_ok(store_open(r.first, &near, &e), e);
    kit_ok(store_open(from_nginx("first.tiles"), &far, &e), e);
    assert_same_store(near, far);
    kit_ok(store_verify(far, &bad, &e), e);
    assert_int_equal(bad, 0);
    store_close(&far);
    /* and from another start: one request, whether it is still the same */
    const uint64_t before = range_requests();
    kit_ok(store_open(from_nginx("first.tiles"), &far, &e), e);
    assert_same_store(near, far);
    assert_int_equal(range_requests() - before, 1);
    kit_ok(store_ask(far, 5, &e), e);
    store_close(&far);
    store_close(&near);
}

/* The rows of the index lie together, and a tile lies beside its page of the index. */
static void a_cold_tile_takes_few_requests(void **state)
{
    struct err e = {0};
    struct store *near = NULL, *far = NULL;
    size_t n, most = 0;
    kit_ok(store_open(r.first, &near, &e), e);
    uint64_t before = range_requests();
    kit_ok(store_open(rude(), &far, &e), e);
    assert_in_range(range_requests() - before, 1, 6);
    const struct store_tile *tiles = store_tiles(far, &n);
    const uint64_t all = range_requests();
    for (size_t i = 0; i < n; i++) { /* far from each other */
        before = range_requests();
        assert_same_tile(near, far, tiles[i * 29 % n].key);
        most = range_requests() - before > most ? range_requests() - before : most;
    }
    assert_in_range(most, 1, 3);
    assert_in_range(range_requests() - all, 1, n / 2); /* neighbours come along */
    store_close(&far);
    store_close(&near);
}

/* As the process that draws has it: by the file of blocks alone. */
static void a_remote_store_by_its_file_of_blocks(void **state)
{
    struct err e = {0};
    struct store *near = NULL, *far = NULL, *more = NULL;
    int fd = -1;
    kit_ok(store_open(r.first, &near, &e), e);
    kit_ok(store_open_file(rude(), &fd, &e), e);
    kit_ok(store_open_fd(fd, rude(), &far, &e), e);
    kit_ok(store_open_more(fd, far, &more, &e), e);
    assert_same_store(near, more);
    store_close(&more);
    store_close(&far);
    /* a file that somebody gives for a store sends nobody anywhere */
    kit_fails(store_open_fd(fd, "city.tiles", &far, &e), ERR_FORMAT, e, "not a tile store");
    close(fd);
    store_close(&near);
}

/* Of each answer that should not be, the first that is right counts. */
static void what_passes_is_repeated(void **state)
{
    static const int ways[] = {RANGES_BUSY, RANGES_CUT};
    struct err e = {0};
    struct store *near = NULL, *far = NULL;
    kit_ok(store_open(r.first, &near, &e), e);
    for (size_t i = 0; i < 2; i++) {
        remote_setup(state);
        atomic_store(&ranges.way, ways[i]);
        kit_ok(store_open(rude(), &far, &e), e);
        assert_same_store(near, far);
        store_close(&far);
    }
    store_close(&near);
}

static void what_cannot_be_read_is_told(void **state)
{
    static const struct {
        int way;
        enum err_code code;
        const char *says;
    } cases[] = {
        {RANGES_WHOLE, ERR_FORMAT, "ignores Range"},
        {RANGES_UNNAMED, ERR_FORMAT, "neither ETag nor Last-Modified"},
        {RANGES_CODED, ERR_FORMAT, "compressed"},
        {RANGES_NONE, ERR_NOENT, "check the address"},
        {RANGES_FORBIDDEN, ERR_IO, "may not be read"},
        {RANGES_AROUND, ERR_IO, "redirects"},
        {RANGES_FILE, ERR_IO, "file"},
        {RANGES_DOWN, ERR_BUSY, "status 503"},
        {RANGES_SHIFTED, ERR_BUSY, "asked for"},
        {RANGES_SILENT, ERR_BUSY, "did not succeed"},
    };
    struct err e = {0};
    struct store *s = NULL;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        atomic_store(&ranges.way, cases[i].way);
        remote_until(clock_s() + 0.2);
        kit_fails(store_open(rude(), &s, &e), cases[i].code, e, cases[i].says);
        assert_null(s);
    }
    remote_until(0);
    atomic_store(&ranges.way, RANGES_WELL);
    kit_fails(store_open("http://", &s, &e), ERR_ARG, e, "no address");
    kit_fails(store_open("s3://bucket", &s, &e), ERR_ARG, e, "s3://BUCKET/KEY");
    ranges_serve("/etc/passwd", "one");
    kit_fails(store_open(rude(), &s, &e), ERR_FORMAT, e, "not a tile store");
}

/* Passwords and signatures of an address are in no message. */
static void secrets_are_not_told(void **state)
{
    struct err e = {0};
    struct store *s = NULL;
    char url[128];
    atomic_store(&ranges.way, RANGES_NONE);
    snprintf(url, sizeof url, "http://me:secret@127.0.0.1:%u/a?sig=secret", ranges.port);
    kit_fails(store_open(url, &s, &e), ERR_NOENT, e, "/a: status 404");
    assert_null(strstr(e.msg, "secret"));
    assert_null(strstr(e.msg, "me:"));
}

/* While its tiles are read, the object becomes another one. */
static void revisions_are_never_mixed(void **state)
{
    struct err e = {0};
    struct store *old = NULL, *far = NULL, *now = NULL;
    struct buf b = {0};
    size_t n, failed = 0;
    kit_ok(store_open(r.first, &old, &e), e);
    kit_ok(store_open(rude(), &far, &e), e);
    const struct store_tile *tiles = store_tiles(old, &n);
    assert_same_tile(old, far, tiles[n / 2].key);
    assert_false(store_replaced(far));
    ranges_serve(r.second, "two");
    for (size_t i = 0; i < n; i++) {
        const enum err_code rc = store_read(far, tiles[i].key, &b, &e);
        if (!rc)
            assert_same_tile(old, far, tiles[i].key);
        else
            kit_fails(rc, ERR_BUSY, e, "replaced");
        failed += rc ? 1 : 0;
    }
    assert_in_range(failed, n / 4, n - 1);
    assert_true(store_replaced(far));
    assert_same_tile(old, far, tiles[n / 2].key);
    kit_ok(store_open(rude(), &now, &e), e);
    assert_string_not_equal(store_info(now)->revision, store_info(old)->revision);
    assert_same_tile(now, now, tiles[0].key);
    kit_ok(store_ask(now, 5, &e), e);
    ranges_serve(r.first, "one"); /* and back */
    kit_fails(store_ask(now, 5, &e), ERR_DATA, e, "replaced");
    assert_true(store_replaced(now));
    buf_free(&b);
    store_close(&now);
    store_close(&far);
    store_close(&old);
}

/* The only file of blocks. */
static void blocks_file(char path[FILE_PATH_MAX])
{
    struct buf b = {0};
    assert_int_equal(kit_run(&b, "ls '%s'/*.blocks", r.cache), 0);
    snprintf(path, FILE_PATH_MAX, "%.*s", (int)strcspn((char *)b.data, "\n"), (char *)b.data);
    buf_free(&b);
}

static void damage_of_what_is_kept_is_mended(void **state)
{
    struct err e = {0};
    struct store *near = NULL, *far = NULL;
    char path[FILE_PATH_MAX];
    struct stat st;
    kit_ok(store_open(r.first, &near, &e), e);
    kit_ok(store_open(rude(), &far, &e), e);
    assert_same_store(near, far);
    store_close(&far);
    blocks_file(path);
    const int fd = open(path, O_RDWR | O_CLOEXEC);
    assert_int_equal(fstat(fd, &st), 0);
    for (off_t at = st.st_size / 8; at < st.st_size; at += 50000)
        assert_int_equal(pwrite(fd, "damage", 6, at), 6);
    kit_ok(store_open(rude(), &far, &e), e);
    assert_same_store(near, far);
    store_close(&far);
    assert_int_equal(ftruncate(fd, 5000), 0); /* a head without the rest */
    close(fd);
    kit_ok(store_open(rude(), &far, &e), e);
    assert_same_store(near, far);
    store_close(&far);
    store_close(&near);
}

static void what_is_kept_is_bounded(void **state)
{
    enum { LIMIT = 1 << 20 };
    struct err e = {0};
    struct store *near = NULL, *far = NULL;
    char path[FILE_PATH_MAX];
    struct stat st;
    blocks_configure(r.cache, LIMIT);
    kit_ok(store_open(r.first, &near, &e), e);
    kit_ok(store_open(rude(), &far, &e), e);
    assert_same_store(near, far);
    blocks_file(path);
    assert_int_equal(stat(path, &st), 0);
    assert_true(st.st_size > 2 * LIMIT); /* it has holes */
    assert_in_range(st.st_blocks * 512, LIMIT / 4, LIMIT + 65536);
    store_close(&far);
    blocks_configure("/proc/none", LIMIT); /* no folder: nothing is kept, and all is read */
    kit_ok(store_open(rude(), &far, &e), e);
    assert_same_store(near, far);
    store_close(&far);
    store_close(&near);
}

/* ---- S3 ---- */

static void hmac(const void *key, size_t n_key, const char *text, uint8_t out[32])
{
    struct hmac_sha256_ctx c;
    hmac_sha256_set_key(&c, n_key, key);
    hmac_sha256_update(&c, strlen(text), (const uint8_t *)text);
    hmac_sha256_digest(&c, 32, out);
}

static void hex(const uint8_t *bytes, char out[65])
{
    base16_encode_update(out, 32, bytes);
    out[64] = '\0';
}

/* A header of the last request, without the space in front. */
static void asked(const char *name, char out[512])
{
    const char *p = strcasestr((const char *)ranges.asked.data, name);
    assert_non_null(p);
    p += strlen(name) + 1;
    p += strspn(p, " ");
    snprintf(out, 512, "%.*s", (int)strcspn(p, "\r"), p);
}

/* Signature version 4 by its definition, over the request that came. */
static void assert_signed(const char *path)
{
    char auth[512], names[256], date[512], value[512], text[65];
    struct buf request = {0}, say = {0};
    uint8_t key[32], digest[32];
    struct sha256_ctx sha;
    asked("\r\nAuthorization", auth);
    asked("\r\nX-Amz-Date", date);
    const char *list = strstr(auth, "SignedHeaders=");
    assert_non_null(list);
    assert_non_null(strstr(auth, "/eu-north-1/s3/aws4_request"));
    snprintf(names, sizeof names, "%.*s", (int)strcspn(list + 14, ","), list + 14);
    assert_non_null(strstr(names, "host"));
    assert_non_null(strstr(names, "x-amz-security-token"));
    buf_printf(&request, "GET\n%s\n\n", path);
    char copy[256], *save = NULL;
    snprintf(copy, sizeof copy, "%s", names);
    for (char *name = strtok_r(copy, ";", &save); name; name = strtok_r(NULL, ";", &save)) {
        char head[80];
        snprintf(head, sizeof head, "\r\n%.70s", name);
        asked(head, value);
        buf_printf(&request, "%s:%s\n", name, value);
    }
    buf_printf(&request, "\n%s\nUNSIGNED-PAYLOAD", names);
    sha256_init(&sha);
    sha256_update(&sha, request.size, request.data);
    sha256_digest(&sha, 32, digest);
    hex(digest, text);
    buf_printf(&say, "AWS4-HMAC-SHA256\n%s\n%.8s/eu-north-1/s3/aws4_request\n%s", date, date, text);
    char day[9];
    snprintf(day, sizeof day, "%.8s", date);
    hmac("AWS4a secret", 12, day, key);
    hmac(key, 32, "eu-north-1", key);
    hmac(key, 32, "s3", key);
    hmac(key, 32, "aws4_request", key);
    hmac(key, 32, (const char *)say.data, digest);
    hex(digest, text);
    const char *signature = strstr(auth, "Signature=");
    assert_non_null(signature);
    assert_string_equal(signature + 10, text);
    buf_free(&request);
    buf_free(&say);
}

static void requests_to_a_bucket_are_signed(void **state)
{
    struct err e = {0};
    struct store *near = NULL, *far = NULL;
    char endpoint[64];
    snprintf(endpoint, sizeof endpoint, "http://127.0.0.1:%u/", ranges.port);
    setenv("AWS_ENDPOINT_URL", endpoint, 1);
    setenv("AWS_REGION", "eu-north-1", 1);
    setenv("AWS_ACCESS_KEY_ID", "name", 1);
    kit_fails(store_open("s3://some-bucket/a", &far, &e), ERR_ARG, e, "or none of them");
    setenv("AWS_SECRET_ACCESS_KEY", "a secret", 1);
    setenv("AWS_SESSION_TOKEN", "a-token", 1);
    kit_ok(store_open(r.first, &near, &e), e);
    kit_ok(store_open("s3://some-bucket/a city/first.tiles", &far, &e), e);
    assert_same_store(near, far);
    assert_string_equal(store_path(far), "s3://some-bucket/a city/first.tiles");
    assert_signed("/some-bucket/a%20city/first.tiles");
    store_close(&far);
    for (const char *const *name =
             (const char *const[]){"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY",
                                   "AWS_SESSION_TOKEN", NULL};
         *name; name++)
        unsetenv(*name);
    kit_ok(store_open("s3://some-bucket/first.tiles", &far, &e), e);
    assert_null(strcasestr((const char *)ranges.asked.data, "authorization"));
    store_close(&far);
    store_close(&near);
    unsetenv("AWS_ENDPOINT_URL");
    unsetenv("AWS_REGION");
}

/* ---- served ---- */

static void tile_path(struct key k, char out[128])
{
    snprintf(out, 128, "/d/toy/r/%s/t/%u/%u/%u.spz", revision_of(EDITION_TILES), k.z, k.x, k.y);
}

static void start_remote(void)
{
    arena_free(&t.arena);
    served_config(&t.cfg, &t.arena);
    t.cfg.cache_dir = r.cache;
    t.cfg.remote_refresh_s = 0;
    t.cfg.deadline_s = 1.5;
    t.paths[0] = rude();
    t.cfg.workers = 2;
    t.cfg.http_threads = 2;
    start();
}

/* Tiles are those of the file. Without its server, what is kept is served, and the rest is 503 with
 * Retry-After until it answers again. */
static void a_server_waits_for_its_store(void **state)
{
    struct reply x, y;
    char path[128], cold[128];
    const struct key k = served_key(SERVED_ZOOM_MAX), away = {k.z, k.x + SIDE - 1, k.y + SIDE - 1};
    t.paths[0] = r.first;
    arena_free(&t.arena);
    served_config(&t.cfg, &t.arena);
    start();
    tile_path(k, path);
    tile_path(away, cold);
    ask("GET", path, "", &x);
    server_stop(&t.server);
    start_remote();
    ask("GET", path, "", &y);
    assert_int_equal(y.status, 200);
    assert_int_equal(x.body_size, y.body_size);
    assert_memory_equal(x.body, y.body, x.body_size);
    buf_free(&y.raw);
    atomic_store(&ranges.way, RANGES_DOWN);
    ask("GET", cold, "", &y);
    assert_int_equal(y.status, 503);
    assert_true(atoi(header(&y, "Retry-After")) >= 1);
    buf_free(&y.raw);
    assert_int_equal(status_of("GET", path, ""), 200);
    assert_int_equal(status_of("GET", "/readyz", ""), 200);
    atomic_store(&ranges.way, RANGES_WELL);
    double end_s = clock_s() + PATIENCE_S;
    while (status_of("GET", cold, "") != 200 && clock_s() < end_s)
        nap_ms(50);
    assert_int_equal(status_of("GET", cold, ""), 200);
    buf_free(&x.raw);
    server_stop(&t.server);
}

static void a_server_opens_a_replaced_store(void **state)
{
    struct err e = {0};
    struct reply x;
    char path[128], old[13];
    const struct key k = served_key(SERVED_ZOOM_MAX), away = {k.z, k.x + SIDE - 1, k.y + SIDE - 1};
    start_remote();
    tile_path(k, path);
    memcpy(old, t.rev, sizeof old);
    assert_int_equal(status_of("GET", path, ""), 200);
    server_look(t.server, clock_s());
    assert_false(server_reload_asked(t.server));
    ranges_serve(r.second, "two");
    tile_path(away, path);
    ask("GET", path, "", &x); /* notices it, and does not answer with bytes of another revision */
    assert_int_equal(x.status, 503);
    buf_free(&x.raw);
    server_look(t.server, clock_s());
    assert_true(server_reload_asked(t.server));
    kit_ok(server_reload(t.server, &e), e);
    struct catalog *c = services_catalog(server_services(t.server));
    assert_int_equal(c->n_current, 1);
    assert_int_equal(c->n, 2);
    memcpy(t.rev, c->ds[0]->meta.revision, sizeof t.rev);
    catalog_drop(&c);
    assert_string_not_equal(t.rev, old);
    tile_path(away, path);
    assert_int_equal(status_of("GET", path, ""), 200);
    memcpy(t.rev, old, sizeof old); /* what was read of the older one is still there */
    tile_path(k, path);
    assert_int_equal(status_of("GET", path, ""), 200);
    server_stop(&t.server);
}

/* Without a request for a tile it asks, as often as it shall. */
static void a_server_asks_for_another_revision(void **state)
{
    start_remote();
    server_stop(&t.server);
    t.cfg.remote_refresh_s = 30;
    start();
    server_look(t.server, clock_s() + 60);
    assert_false(server_reload_asked(t.server));
    ranges_serve(r.second, "two");
    server_look(t.server, clock_s() + 80);
    assert_false(server_reload_asked(t.server));
    server_look(t.server, clock_s() + 100);
    assert_true(server_reload_asked(t.server));
    server_stop(&t.server);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(a_remote_store_is_as_its_file, remote_setup),
        cmocka_unit_test_setup(a_cold_tile_takes_few_requests, remote_setup),
        cmocka_unit_test_setup(a_remote_store_by_its_file_of_blocks, remote_setup),
        cmocka_unit_test_setup(what_passes_is_repeated, remote_setup),
        cmocka_unit_test_setup(what_cannot_be_read_is_told, remote_setup),
        cmocka_unit_test_setup(secrets_are_not_told, remote_setup),
        cmocka_unit_test_setup(revisions_are_never_mixed, remote_setup),
        cmocka_unit_test_setup(damage_of_what_is_kept_is_mended, remote_setup),
        cmocka_unit_test_setup(what_is_kept_is_bounded, remote_setup),
        cmocka_unit_test_setup(requests_to_a_bucket_are_signed, remote_setup),
        cmocka_unit_test_setup_teardown(a_server_waits_for_its_store, remote_setup, teardown),
        cmocka_unit_test_setup_teardown(a_server_opens_a_replaced_store, remote_setup, teardown),
        cmocka_unit_test_setup_teardown(a_server_asks_for_another_revision, remote_setup, teardown),
    };
    return cmocka_run_group_tests(tests, remote_setup_all, remote_teardown_all);
}
