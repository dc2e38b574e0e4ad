/* Named appearances: what is answered is on the disk, conditions, rights, what names mean for
 * tiles, documents and caches, files that are not ours, and a process that is killed while it
 * writes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/client.h"
#include "tests/server/lit.h"

#include <jansson.h>
#include <nettle/sha2.h>
#include <signal.h>
#include <sqlite3.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>

#include "server/access/auth.h"
#include "server/base/condition.h"
#include "server/data/named_appearance.h"

static const char TOKEN[] = "a token that opens the names of one dataset";
static char state_dir[FILE_PATH_MAX], state_file[FILE_PATH_MAX];

static int setup_lit(void **state)
{
    struct err e = {0};
    setup(state);
    kit_ok(file_join(state_dir, t.dir, "state", &e), e);
    kit_ok(file_join(state_file, state_dir, "appearances.sqlite", &e), e);
    if (!access(state_dir, F_OK))
        kit_rmdir(state_dir);
    lit_by_five(t.path, 5);
    t.cfg.state_dir = state_dir;
    t.cfg.admin = "127.0.0.1:0";
    return 0;
}

/* One request on the operators' listener; the status alone. */
static int change(const char *method, const char *target, const char *extra, const char *body)
{
    struct reply r;
    say_to(server_admin_port(t.server), method, target, extra, body, &r);
    buf_free(&r.raw);
    return r.status;
}

static json_t *read_json(const char *target)
{
    struct reply r;
    json_error_t je;
    ask("GET", target, "", &r);
    if (r.status != 200)
        fail_msg("%s: %d %.*s", target, r.status, (int)r.body_size, (const char *)r.body);
    json_t *o = json_loadb((const char *)r.body, r.body_size, JSON_REJECT_DUPLICATES, &je);
    assert_non_null(o);
    buf_free(&r.raw);
    return o;
}

#define BLEND "{\"weights\":{\"p1.jpg\":1,\"p2.jpg\":3}}"
#define PATH "/d/toy/appearances/evening"

/* ---- the life of a name ---- */

static void is_kept(const char *tag)
{
    struct reply r;
    ask("GET", PATH, "", &r);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "ETag"), tag);
    assert_string_equal(header(&r, "Surrogate-Key"), "ds-toy a-evening");
    assert_null(strstr(header(&r, "Cache-Control"), "immutable"));
    buf_free(&r.raw);
}

static void test_a_name_is_kept_over_restarts_and_reloads(void **state)
{
    struct err e = {0};
    struct reply r;
    start();
    assert_int_equal(status_of("GET", PATH, ""), 404);
    assert_int_equal(change("DELETE", PATH, "", NULL), 404);
    say_to(server_admin_port(t.server), "PUT", PATH, "If-None-Match: *\r\n", BLEND, &r);
    assert_int_equal(r.status, 201);
    assert_string_equal(header(&r, "Location"), "evening");
    assert_string_equal(header(&r, "Cache-Control"), "no-store");
    assert_non_null(strstr((const char *)r.body, "\"appearance\": \"p1.jpg:1,p2.jpg:3\""));
    char tag[64];
    snprintf(tag, sizeof tag, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    is_kept(tag);
    kit_ok(server_reload(t.server, &e), e);
    is_kept(tag);
    server_stop(&t.server);
    start();
    is_kept(tag);
}

static void test_names_change_are_copied_and_forgotten(void **state)
{
    struct reply r;
    char tag[64];
    start();
    assert_int_equal(change("PUT", PATH, "", BLEND), 201);
    ask("GET", PATH, "", &r);
    snprintf(tag, sizeof tag, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    assert_int_equal(change("PUT", PATH, "", BLEND), 204);                       /* as it is */
    assert_int_equal(change("PUT", PATH, "", "{\"appearance\":\"dawn\"}"), 204); /* another */
    ask("GET", PATH, "", &r);
    assert_string_not_equal(header(&r, "ETag"), tag);
    buf_free(&r.raw);
    assert_int_equal(change("PUT", "/d/toy/appearances/copy", "", "{\"appearance\":\"evening\"}"),
                     201);
    assert_int_equal(change("DELETE", PATH, "", NULL), 204);
    assert_int_equal(status_of("GET", PATH, ""), 404);
    json_t *o = read_json("/d/toy/appearances/copy"); /* it has its own */
    assert_string_equal(json_string_value(json_object_get(o, "appearance")), "dawn");
    json_decref(o);
    server_stop(&t.server);
    start();
    assert_int_equal(status_of("GET", PATH, ""), 404);
}

static void test_conditions(void **state)
{
    static const char tag[] = "\"aaaaaaaaaaaaaaaaaaaaaa\"";
    static const struct {
        const char *match, *none;
        bool there, absent; /* may one that is there, one that is not, be written? */
    } row[] = {
        {NULL, NULL, true, true},
        {"*", NULL, true, false},
        {NULL, "*", false, true},
        {tag, NULL, true, false},
        {" \"x\" , \"aaaaaaaaaaaaaaaaaaaaaa\"", NULL, true, false},
        {"\"x\"", NULL, false, false},
        {"W/\"aaaaaaaaaaaaaaaaaaaaaa\"", NULL, false, false},
        {NULL, tag, false, true},
        {NULL, "W/\"aaaaaaaaaaaaaaaaaaaaaa\"", false, true},
        {NULL, "\"x\"", true, true},
        {"nonsense", NULL, false, false},
        {NULL, "nonsense", false, false},
        {"*", "*", false, false},
        {tag, "\"x\"", true, false},
    };
    struct reply r;
    char extra[128], own[64];
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        assert_int_equal(condition_may_write(row[i].match, row[i].none, tag), row[i].there);
        assert_int_equal(condition_may_write(row[i].match, row[i].none, NULL), row[i].absent);
    }
    start();
    assert_int_equal(change("PUT", PATH, "If-Match: *\r\n", BLEND), 412);
    assert_int_equal(change("PUT", PATH, "If-None-Match: *\r\n", BLEND), 201);
    assert_int_equal(change("PUT", PATH, "If-None-Match: *\r\n", BLEND), 412);
    ask("GET", PATH, "", &r);
    snprintf(own, sizeof own, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    snprintf(extra, sizeof extra, "If-Match: %s\r\n", own);
    assert_int_equal(change("PUT", PATH, extra, "{\"appearance\":\"dawn\"}"), 204);
    assert_int_equal(change("PUT", PATH, extra, BLEND), 412); /* it is another by now */
    assert_int_equal(change("DELETE", PATH, extra, NULL), 412);
    assert_int_equal(change("PUT", PATH, "", BLEND), 204);
    assert_int_equal(change("DELETE", PATH, extra, NULL), 204);
    snprintf(extra, sizeof extra, "If-None-Match: %s\r\n", own);
    assert_int_equal(status_of("GET", PATH, extra), 404);
}

/* ---- what a name means ---- */

static void reply_of(const char *target, struct reply *r)
{
    ask("GET", target, "", r);
    if (r->status != 200)
        fail_msg("%s: %d %.*s", target, r->status, (int)r->body_size, (const char *)r->body);
}

static void test_a_name_is_what_it_stands_for_and_never_immutable(void **state)
{
    struct reply by_name, by_text, r;
    char target[256], plain[128];
    start();
    assert_int_equal(change("PUT", PATH, "", BLEND), 201);
    tile_target(17, "ply", plain);
    snprintf(target, sizeof target, "%s?appearance=evening", plain);
    reply_of(target, &by_name);
    snprintf(target, sizeof target, "%s?appearance=p1.jpg:1,p2.jpg:3", plain);
    reply_of(target, &by_text);
    assert_int_equal(by_name.body_size, by_text.body_size);
    assert_memory_equal(by_name.body, by_text.body, by_text.body_size);
    char tag[64];
    snprintf(tag, sizeof tag, "%s", header(&by_text, "ETag"));
    assert_string_equal(header(&by_name, "ETag"), tag);
    assert_non_null(strstr(header(&by_text, "Cache-Control"), "immutable"));
    assert_null(strstr(header(&by_name, "Cache-Control"), "immutable"));
    assert_non_null(strstr(header(&by_name, "Surrogate-Key"), " a-evening"));
    assert_null(strstr(header(&by_text, "Surrogate-Key"), " a-"));
    buf_free(&by_name.raw);
    buf_free(&by_text.raw);

    /* documents hand out what it stands for */
    static const char *const documents[] = {"/d/toy/tileset.json?appearance=evening",
                                            "/d/toy/seed.ndjson?appearance=evening",
                                            "/d/toy/appearance?appearance=evening"};
    for (size_t i = 0; i < sizeof documents / sizeof *documents; i++) {
        reply_of(documents[i], &r);
        buf_u8(&r.raw, 0);
        const char *body = strstr((const char *)r.raw.data, "\r\n\r\n");
        assert_non_null(strstr(body, "p1.jpg:1,p2.jpg:3"));
        assert_null(strstr(body, "evening"));
        buf_free(&r.raw);
    }
    snprintf(target, sizeof target, "/d/toy/r/%s/tileset.json?appearance=evening",
             revision_of(EDITION_TILES));
    reply_of(target, &r);
    assert_null(strstr(header(&r, "Cache-Control"), "immutable"));
    buf_free(&r.raw);
    say_to(t.port, "POST", "/d/toy/appearances:mix", "", "{\"appearance\":\"evening\"}", &r);
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "p1.jpg:1,p2.jpg:3"));
    buf_free(&r.raw);

    /* another meaning is other bytes at once */
    assert_int_equal(change("PUT", PATH, "", "{\"appearance\":\"dawn\"}"), 204);
    snprintf(target, sizeof target, "%s?appearance=evening", plain);
    reply_of(target, &r);
    assert_string_not_equal(header(&r, "ETag"), tag);
    buf_free(&r.raw);
    assert_int_equal(change("DELETE", PATH, "", NULL), 204);
    assert_int_equal(status_of("GET", target, ""), 404);
}

static size_t listed(const char *name, char tag[64])
{
    static const char target[] = "/d/toy/appearances";
    struct reply r;
    ask("GET", target, "", &r);
    snprintf(tag, 64, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    json_t *o = read_json(target), *one;
    size_t i, n = 0;
    json_array_foreach(json_object_get(o, "appearances"), i, one)
    {
        if (strcmp(json_string_value(json_object_get(one, "name")), name) != 0)
            continue;
        n++;
        assert_true(json_is_true(json_object_get(one, "kept")));
        assert_null(json_object_get(one, "lon")); /* of no place and no time, but of a colour */
        assert_null(json_object_get(one, "time"));
        assert_non_null(json_object_get(one, "colour"));
        assert_int_equal(json_array_size(json_object_get(one, "links")), 2);
    }
    json_decref(o);
    return n;
}

static void test_names_are_listed(void **state)
{
    char tag[64], before[64];
    start();
    assert_int_equal(listed("evening", before), 0);
    assert_int_equal(change("PUT", PATH, "", BLEND), 201);
    assert_int_equal(listed("evening", tag), 1);
    assert_string_not_equal(tag, before);
    assert_int_equal(change("DELETE", PATH, "", NULL), 204);
    assert_int_equal(listed("evening", tag), 0);
    assert_string_equal(tag, before);
}

/* An embedding is of one network; a blend of photographs is of any that has them. */
static void test_names_outlive_the_network_or_say_that_they_do_not(void **state)
{
    struct err e = {0};
    struct reply r;
    char target[128];
    start();
    assert_int_equal(change("PUT", PATH, "", BLEND), 201);
    assert_int_equal(
        change("PUT", "/d/toy/appearances/exact", "", "{\"embedding\":[0.5,-0.25,1,0,0.125,2]}"),
        201);
    snprintf(target, sizeof target, "/d/toy/appearance?appearance=exact");
    assert_int_equal(status_of("GET", target, ""), 200);
    lit_by_five(t.path, 6);
    kit_ok(server_reload(t.server, &e), e);
    assert_int_equal(status_of("GET", target, ""), 404);
    assert_int_equal(status_of("GET", "/d/toy/tileset.json?appearance=exact", ""), 404);
    assert_int_equal(status_of("GET", "/d/toy/appearance?appearance=evening", ""), 200);
    ask("GET", "/d/toy/appearances/exact", "", &r); /* what it was can still be read */
    assert_int_equal(r.status, 200);
    assert_non_null(strstr((const char *)r.body, "another network"));
    buf_free(&r.raw);
    char tag[64];
    assert_int_equal(listed("exact", tag), 0);
    assert_int_equal(listed("evening", tag), 1);
    assert_int_equal(change("DELETE", "/d/toy/appearances/exact", "", NULL), 204);
}

/* ---- what is refused ---- */

static void test_what_is_refused(void **state)
{
    static const struct {
        const char *target, *body;
        int status;
    } row[] = {
        {PATH, "", 400},
        {PATH, "{", 400},
        {PATH, "[]", 422},
        {PATH, "{}", 422},
        {PATH, "{\"appearance\":7}", 422},
        {PATH, "{\"appearance\":\"\"}", 422},
        {PATH, "{\"appearance\":\"none\"}", 422},
        {PATH, "{\"appearance\":\"p1.jpg:x\"}", 422},
        {PATH, "{\"appearance\":\"p1.jpg:1,p2.jpg:-1\"}", 422},
        {PATH, "{\"appearance\":\"p9.jpg\"}", 404},
        {PATH, "{\"appearance\":\"=AAAA\"}", 422},
        {PATH, "{\"weights\":{\"p1.jpg\":1},\"appearance\":\"dawn\"}", 422},
        {PATH, "{\"embedding\":[1,2]}", 422},
        {"/d/toy/appearances/dawn", BLEND, 409}, /* a photograph's name */
        {"/d/toy/appearances/default", BLEND, 404},
        {"/d/toy/appearances/none", BLEND, 404},
        {"/d/toy/appearances/Evening", BLEND, 404},
        {"/d/toy/appearances/-x", BLEND, 404},
        {"/d/toy/appearances/a.b", BLEND, 404},
        {"/d/toy/appearances/a/b", BLEND, 404},
        {"/d/toy/appearances/", BLEND, 404},
        {"/d/toy/appearances/..", BLEND, 400},
        {"/d/toy/appearances/a%20b", BLEND, 400},
        {"/d/toy/appearances/0123456789012345678901234567890123456789012345678901234567890123",
         BLEND, 404},
        {"/d/city/appearances/x", BLEND, 404},
    };
    struct buf big = {0};
    start();
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        if (change("PUT", row[i].target, "", row[i].body) != row[i].status)
            fail_msg("PUT %s %s: not %d", row[i].target, row[i].body, row[i].status);
    buf_printf(&big, "{\"appearance\":\"p1.jpg");
    for (int i = 0; i < 100; i++)
        buf_printf(&big, ",p1.jpg");
    buf_printf(&big, "\"}");
    assert_int_equal(change("PUT", PATH, "", (const char *)big.data), 422);
    buf_free(&big);
    assert_int_equal(change("PATCH", PATH, "", BLEND), 405);
    assert_int_equal(change("POST", PATH, "", BLEND), 405);
    json_t *o = read_json("/d/toy/appearances"), *one;
    size_t k;
    json_array_foreach(json_object_get(o, "appearances"), k, one)
        assert_null(json_object_get(one, "kept"));
    json_decref(o);
    server_stop(&t.server);
    t.cfg.state_dir = NULL; /* nothing is kept without a folder, and the answer says so */
    struct reply r;
    start();
    say_to(server_admin_port(t.server), "PUT", PATH, "", BLEND, &r);
    assert_int_equal(r.status, 405);
    assert_string_equal(header(&r, "Allow"), "GET, HEAD, OPTIONS");
    assert_non_null(strstr((const char *)r.body, "--state-dir"));
    buf_free(&r.raw);
    assert_int_equal(status_of("GET", PATH, ""), 404);
}

static void test_who_may(void **state)
{
    static const struct {
        const char *scope;
        int status;
    } row[] = {{"\"write:toy\"", 201},
               {"\"write:*\"", 201},
               {"\"read:*\",\"render:*\",\"admin\"", 403},
               {"\"write:other\"", 403}};
    struct sha256_ctx h;
    struct err e = {0};
    struct buf text = {0};
    uint8_t digest[SHA256_DIGEST_SIZE];
    char path[FILE_PATH_MAX], line[128], query[AUTH_QUERY_MAX], target[800];
    start();
    assert_int_equal(change("PUT", PATH, "Origin: https://elsewhere.example\r\n", BLEND), 403);
    struct reply r;
    say_to(t.port, "PUT", PATH, "", BLEND, &r); /* everybody's listener */
    assert_int_equal(r.status, 403);
    assert_non_null(strstr((const char *)r.body, "--admin"));
    buf_free(&r.raw);
    assert_int_equal(status_of("DELETE", PATH, ""), 403);
    server_stop(&t.server);
    sha256_init(&h);
    sha256_update(&h, strlen(TOKEN), (const uint8_t *)TOKEN);
    sha256_digest(&h, sizeof digest, digest);
    kit_ok(file_join(path, t.dir, "auth.jsonc", &e), e);
    snprintf(line, sizeof line, "Authorization: Bearer %s\r\n", TOKEN);
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        text.size = 0;
        buf_printf(&text, "{\"keys\":{\"k\":\"0123456789012345678901234567890123456789\"},"
                          "\"public\":[\"toy\"],\"tokens\":[{\"sha256\":\"");
        for (size_t k = 0; k < sizeof digest; k++)
            buf_printf(&text, "%02x", digest[k]);
        buf_printf(&text, "\",\"scope\":[%s]}]}", row[i].scope);
        kit_ok(file_write(path, text.data, text.size, &e), e);
        assert_int_equal(chmod(path, 0600), 0);
        t.cfg.auth = path;
        start();
        say_to(t.port, "PUT", PATH, "", BLEND, &r); /* public is who may read */
        assert_int_equal(r.status, 401);
        buf_free(&r.raw);
        say_to(t.port, "PUT", PATH, line, BLEND, &r);
        assert_int_equal(r.status, row[i].status);
        buf_free(&r.raw);
        struct auth *a = NULL;
        kit_ok(auth_open(path, &a, &e), e);
        const int64_t now_s = (int64_t)time(NULL);
        kit_ok(auth_sign(a, NULL, AUTH_SCOPE_BOTH, "toy", now_s + 60, now_s, query, &e), e);
        auth_close(&a);
        snprintf(target, sizeof target, "/signed/%s" PATH, query);
        say_to(t.port, "DELETE", target, "", NULL, &r); /* a signature reads */
        assert_int_equal(r.status, 401);
        buf_free(&r.raw);
        say_to(t.port, "DELETE", PATH, line, NULL, &r);
        assert_int_equal(r.status, row[i].status == 201 ? 204 : 403);
        buf_free(&r.raw);
        server_stop(&t.server);
    }
    buf_free(&text);
}

/* ---- the file ---- */

static void put_row(struct named_appearance *k, const char *name, const char *text,
                    enum err_code want)
{
    struct err e = {0};
    struct named_appearance_row row = {.ds = "toy"};
    const struct named_appearance_condition when = {0};
    bool created;
    snprintf(row.name, sizeof row.name, "%s", name);
    snprintf(row.text, sizeof row.text, "%s", text);
    kit_fails(named_appearance_put(k, &row, &when, &created, &e), want, e, "");
}

static void sql(const char *text)
{
    sqlite3 *db = NULL;
    assert_int_equal(sqlite3_open(state_file, &db), SQLITE_OK);
    if (sqlite3_exec(db, text, NULL, NULL, NULL) != SQLITE_OK)
        fail_msg("%s: %s", text, sqlite3_errmsg(db));
    sqlite3_close(db);
}

static void test_files_of_others_and_limits(void **state)
{
    static const char *const bad[] = {
        "UPDATE kept SET name='../../etc'",
        "UPDATE kept SET name='default'",
        "UPDATE kept SET text=''",
        "UPDATE kept SET text=replace(hex(zeroblob(300)),'0','a')",
        "UPDATE kept SET text=CAST(x'61620063' AS TEXT)",
        "UPDATE kept SET model=x'00'",
        "UPDATE kept SET dataset=replace(hex(zeroblob(40)),'0','a')",
        "PRAGMA user_version=2",
        "PRAGMA application_id=7",
        "DROP TABLE kept",
    };
    struct err e = {0};
    struct named_appearance *k = NULL, *other = NULL;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        kit_ok(named_appearance_open(state_dir, &k, &e), e);
        put_row(k, "a", "p1.jpg", ERR_OK);
        named_appearance_close(&k);
        sql(bad[i]);
        kit_fails(named_appearance_open(state_dir, &k, &e), ERR_FORMAT, e, "appearances.sqlite");
        assert_null(k);
        kit_fails(named_appearance_check(state_dir, &e), ERR_FORMAT, e, "appearances.sqlite");
        kit_rmdir(state_dir);
    }
    kit_ok(file_mkdir(state_dir, &e), e);
    kit_ok(file_write(state_file, "not a database, but long enough for its head", 44, &e), e);
    kit_fails(named_appearance_open(state_dir, &k, &e), ERR_FORMAT, e, "damaged");
    kit_ok(file_write(state_file, "", 0, &e), e); /* SQLite would begin anew, without a word */
    kit_fails(named_appearance_open(state_dir, &k, &e), ERR_FORMAT, e, "it is empty");
    kit_rmdir(state_dir);

    kit_ok(named_appearance_open(state_dir, &k, &e), e);
    kit_fails(named_appearance_open(state_dir, &other, &e), ERR_BUSY, e, "another server");
    kit_ok(named_appearance_check(state_dir, &e), e);
    named_appearance_close(&k);
    sql("WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i+1 FROM n WHERE i<1000) INSERT INTO "
        "kept SELECT 'toy', 'n'||i, 'p1.jpg', zeroblob(16) FROM n");
    kit_ok(named_appearance_open(state_dir, &k, &e), e);
    put_row(k, "n7", "p2.jpg", ERR_OK); /* one that is there */
    put_row(k, "more", "p2.jpg", ERR_LIMIT);
    named_appearance_close(&k);
    start();
    assert_int_equal(change("PUT", PATH, "", BLEND), 507);
    assert_int_equal(change("DELETE", "/d/toy/appearances/n1", "", NULL), 204);
    assert_int_equal(change("PUT", PATH, "", BLEND), 201);
    server_stop(&t.server);
    kit_ok(named_appearance_open(state_dir, &k, &e), e);
    struct named_appearance_table *all = named_appearance_now(k);
    assert_int_equal(all->n, 1000);
    assert_string_equal(named_appearance_find(all, "toy", "n7")->text, "p2.jpg");
    assert_null(named_appearance_find(all, "toy", "n1"));
    assert_null(named_appearance_find(all, "toy", "more"));
    named_appearance_drop(&all);
    named_appearance_close(&k);
}

/* A database that is not ours is as it was, whatever its journal. */
static void test_files_of_others_are_left_alone(void **state)
{
    static const char *const theirs[] = {
        "CREATE TABLE x(y); PRAGMA application_id=7",
        "PRAGMA journal_mode=WAL; CREATE TABLE x(y); PRAGMA user_version=3",
    };
    struct err e = {0};
    struct named_appearance *k = NULL;
    struct buf was = {0}, is = {0};
    kit_ok(file_mkdir(state_dir, &e), e);
    for (size_t i = 0; i < sizeof theirs / sizeof *theirs; i++) {
        sql(theirs[i]);
        kit_ok(file_read(state_file, 0, &was, &e), e);
        kit_fails(named_appearance_open(state_dir, &k, &e), ERR_FORMAT, e, "another program");
        kit_ok(file_read(state_file, 0, &is, &e), e);
        assert_int_equal(is.size, was.size);
        assert_memory_equal(is.data, was.data, was.size);
        assert_int_equal(unlink(state_file), 0);
        was.size = is.size = 0;
    }
    buf_free(&was);
    buf_free(&is);
    assert_int_equal(rmdir(state_dir), 0);
}

/* A first start on a disk that is full after so many bytes leaves nothing: a later one begins. */
static void test_a_first_start_that_fails_leaves_nothing(void **state)
{
    enum { ROOM_MAX = 1 << 20, STEP = 512 };
    struct err e = {0};
    struct named_appearance *k = NULL;
    struct rlimit was, small;
    size_t failures = 0;
    kit_ok(file_mkdir(state_dir, &e), e);
    signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &was);
    for (rlim_t room = 0; room < ROOM_MAX; room += STEP, failures++) {
        small = (struct rlimit){room, was.rlim_max};
        setrlimit(RLIMIT_FSIZE, &small);
        const enum err_code rc = named_appearance_open(state_dir, &k, &e);
        setrlimit(RLIMIT_FSIZE, &was);
        if (!rc)
            break;
        assert_int_equal(rc, ERR_IO);
        assert_int_equal(rmdir(state_dir), 0);
        kit_ok(file_mkdir(state_dir, &e), e);
    }
    assert_true(failures > 4);
    put_row(k, "a", "p1.jpg", ERR_OK);
    named_appearance_close(&k);
}

/* The child of the next test: names, one after the other, each said when it is on the disk; every
 * third of them is forgotten again. */
static void write_for_ever(int fd, unsigned first)
{
    struct named_appearance *k = NULL;
    const struct named_appearance_condition when = {0};
    if (named_appearance_open(state_dir, &k, NULL))
        _exit(1);
    for (unsigned i = first;; i++) {
        struct named_appearance_row row = {.ds = "toy"};
        bool created;
        snprintf(row.name, sizeof row.name, "n%u", i % 300);
        snprintf(row.text, sizeof row.text, "p%u.jpg", i);
        if (named_appearance_put(k, &row, &when, &created, NULL) ||
            (i % 3 == 0 && named_appearance_remove(k, "toy", row.name, &when, NULL)) ||
            write(fd, &i, sizeof i) != sizeof i)
            _exit(1);
    }
}

static void test_a_killed_process_loses_nothing_that_it_said(void **state)
{
    enum { KILLS = 20 };
    unsigned next = 0;
    char want[300][TARGET_APPEARANCE_MAX] = {{0}};
    struct err e = {0};
    for (int round = 0; round < KILLS; round++) {
        int pipes[2], status;
        unsigned i;
        assert_int_equal(pipe(pipes), 0);
        pid_t child = fork();
        assert_true(child >= 0);
        if (!child)
            write_for_ever(pipes[1], next);
        close(pipes[1]);
        assert_int_equal(read(pipes[0], &i, sizeof i), sizeof i); /* it is under way */
        const struct timespec nap = {.tv_nsec =
                                         1000000 + (long)(rng_unit(3, 0, (uint64_t)round) * 2e7)};
        for (bool killed = false;; killed = true) {
            snprintf(want[i % 300], sizeof want[0], "p%u.jpg", i);
            if (i % 3 == 0)
                want[i % 300][0] = '\0';
            next = i + 1;
            if (!killed) {
                nanosleep(&nap, NULL);
                kill(child, SIGKILL);
            }
            if (read(pipes[0], &i, sizeof i) != sizeof i)
                break;
        }
        close(pipes[0]);
        assert_int_equal(waitpid(child, &status, 0), child);
        assert_true(WIFSIGNALED(status));
        struct named_appearance *k = NULL;
        kit_ok(named_appearance_open(state_dir, &k, &e), e);
        struct named_appearance_table *all = named_appearance_now(k);
        char under_way[TARGET_APPEARANCE_MAX];
        snprintf(under_way, sizeof under_way, "p%u.jpg", next);
        for (unsigned n = 0; n < 300; n++) {
            char name[16];
            snprintf(name, sizeof name, "n%u", n);
            const struct named_appearance_row *row = named_appearance_find(all, "toy", name);
            const char *is = row ? row->text : "";
            if (strcmp(is, want[n]) != 0 &&
                !(n == next % 300 && (!strcmp(is, under_way) || (next % 3 == 0 && !*is))))
                fail_msg("round %d: %s is '%s', want '%s'", round, name, is, want[n]);
            snprintf(want[n], sizeof want[n], "%s", is);
        }
        named_appearance_drop(&all);
        named_appearance_close(&k);
    }
    assert_true(next > KILLS);
    print_message("names: %d kills, %u changes, none lost\n", KILLS, next);
}

int main(void)
{
#define TEST(f) cmocka_unit_test_setup_teardown(f, setup_lit, teardown)
    const struct CMUnitTest tests[] = {
        TEST(test_a_name_is_kept_over_restarts_and_reloads),
        TEST(test_names_change_are_copied_and_forgotten),
        TEST(test_conditions),
        TEST(test_a_name_is_what_it_stands_for_and_never_immutable),
        TEST(test_names_are_listed),
        TEST(test_names_outlive_the_network_or_say_that_they_do_not),
        TEST(test_what_is_refused),
        TEST(test_who_may),
        TEST(test_files_of_others_and_limits),
        TEST(test_files_of_others_are_left_alone),
        TEST(test_a_first_start_that_fails_leaves_nothing),
        TEST(test_a_killed_process_loses_nothing_that_it_said),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
