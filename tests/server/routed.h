/* Requests to routes as function calls: services over a small city, and jobs that the test runs
 * itself.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_ROUTED_H
#define TESTS_ROUTED_H

#include "lod/store/store.h"
#include "tests/server/served.h"

#include <jansson.h>

static struct {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], web[FILE_PATH_MAX], rev[13];
    struct arena arena;
    struct server_config cfg;
    struct services s;
    struct picture *picture; /* never starts: no view is drawn */
} t;

static inline enum err_code no_run(void *user, const struct job *j, void *work, size_t worker,
                                   struct body **out, struct err *e)
{
    (void)user, (void)j, (void)work, (void)worker, (void)out;
    return err_set(e, ERR_INTERNAL, "the test runs jobs itself");
}

static inline int setup(void **state)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_tmpdir(t.dir);
    kit_ok(file_join(t.path, t.dir, "toy.tiles", &e), e);
    served_city(t.path, "toy", 50);
    kit_ok(file_join(t.web, t.dir, "web", &e), e);
    kit_ok(file_join(path, t.web, "assets", &e), e);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(file_join(path, t.web, "index.html", &e), e);
    kit_ok(file_write(path, "<!doctype html><title>viewer</title>", 36, &e), e);
    kit_ok(file_join(path, t.web, "use.html", &e), e);
    kit_ok(file_write(path, "<p>{ds} of {host}: {tile}.spz, {nothing}", 40, &e), e);
    kit_ok(file_join(path, t.web, "viewer.js", &e), e);
    kit_ok(file_write(path, "export {}", 9, &e), e);
    kit_ok(file_join(path, t.web, "assets/logo-big.svg", &e), e);
    kit_ok(file_write(path, "<svg/>", 6, &e), e);
    kit_ok(file_join(path, t.web, "assets/index-D3adBeef.js", &e), e);
    char script[2000];
    memset(script, ';', sizeof script);
    kit_ok(file_write(path, script, sizeof script, &e), e);
    kit_ok(file_join(path, t.web, "assets/index-D3adBeef.js.br", &e), e);
    kit_ok(file_write(path, script, 100, &e), e); /* its content does not matter */
    kit_ok(file_join(path, t.web, "assets/index-D3adBeef.js.gz", &e), e);
    kit_ok(file_write(path, script, 100, &e), e);
    served_config(&t.cfg, &t.arena);
    kit_ok(services_open(&t.s, &t.cfg, NULL, ROUTES, ROUTES_COUNT, &e), e);
    t.s.url = "http://127.0.0.1:8080/";
    const char *paths[] = {t.path};
    t.s.catalog = served_catalog(paths, 1, &served_stores, NULL);
    kit_ok(static_load(t.web, &t.s.web, &e), e);
    const struct job_config jobs = {.queue_limit = {1, 1, 1}, .run = no_run, .drop = work_drop};
    kit_ok(job_open(&jobs, &t.s.jobs, &e), e);
    memcpy(t.rev, t.s.catalog->ds[0]->meta.revision, sizeof t.rev);
    return 0;
}

static inline int teardown(void **state)
{
    services_free(&t.s);
    arena_free(&t.arena);
    kit_rmdir(t.dir);
    return 0;
}

/* Replaces "REV" in text by the revision, "REV+" by revision and edition of tiles, "KEY15" etc. by
 * the tile at the origin. */
static inline const char *expand(const char *text, char *out, size_t room)
{
    size_t n = 0;
    while (*text && n + 40 < room) {
        struct key k;
        if (!strncmp(text, "REV", 3)) {
            n += (size_t)snprintf(out + n, room - n, "%s", t.rev);
            text += 3;
            if (*text == '+') {
                n += (size_t)snprintf(out + n, room - n, "-%s", t.s.catalog->ds[0]->edition);
                text++;
            }
        } else if (!strncmp(text, "KEY", 3)) {
            k = served_key((uint8_t)((text[3] - '0') * 10 + text[4] - '0'));
            n += (size_t)snprintf(out + n, room - n, "%u/%u/%u", k.z, k.x, k.y);
            text += 5;
        } else {
            out[n++] = *text++;
        }
    }
    out[n] = 0;
    return out;
}

struct ask { /* a request, in short */
    enum method method;
    const char *target, *accept, *accept_encoding, *if_none_match, *if_range, *range, *body,
        *if_modified_since, *if_unmodified_since, *if_match, *host;
    bool prefetch;
};

static char last_target[4096];

/* Answers a request. If it needs a job, the work is done here as a worker would do it. */
static inline struct response answer(const struct ask *a)
{
    struct request r = {
        .method = a->method,
        .target = expand(a->target, last_target, sizeof last_target),
        .accept = a->accept,
        .host = a->host,
        .accept_encoding = a->accept_encoding,
        .if_none_match = a->if_none_match,
        .if_range = a->if_range,
        .range = a->range,
        .if_modified_since = a->if_modified_since,
        .if_unmodified_since = a->if_unmodified_since,
        .if_match = a->if_match,
        .body = a->body,
        .body_size = a->body ? strlen(a->body) : 0,
        .prefetch = a->prefetch,
        .own_host = "localhost",
    };
    r.target_size = strlen(r.target);
    struct response out;
    dispatch_answer(&t.s, &r, &out);
    if (out.work && strcmp(out.work->kind->noun, "picture") != 0) {
        struct err e = {0};
        struct work *w = out.work;
        struct job_result result = {.end = JOB_OK};
        out.work = NULL;
        result.code = work_run(&t.s, NULL, w, 0, &result.body, &e);
        if (result.code != ERR_OK) {
            result.end = JOB_ERROR;
            snprintf(result.msg, sizeof result.msg, "%.200s", e.msg);
        }
        const bool rows = !strcmp(w->kind->noun, "list of tiles") ||
                          !strcmp(w->kind->noun, "TileJSON"); /* their room is that of the rows */
        assert_true(!result.body || !rows || result.body->size <= work_room(w) - WORK_ROOM_HEAD);
        work_drop(NULL, w);
        dispatch_finish(&t.s, &r, &result, &out);
    }
    return out;
}

static inline struct response get(const char *target)
{
    return answer(&(struct ask){.target = target});
}

/* Returns whether the answer's body contains a text. Bodies have no NUL at their end. */
static inline bool says(const struct response *r, const char *text)
{
    size_t n = strlen(text);
    for (size_t i = 0; i + n <= r->size; i++)
        if (!memcmp(r->data + i, text, n))
            return true;
    return false;
}

static inline void expect(const char *what, const char *got, const char *want)
{
    if (strcmp(got ? got : "", want ? want : "") != 0)
        fail_msg("%s: %s is '%s', want '%s'", last_target, what, got ? got : "", want ? want : "");
}

static inline json_t *json_of(const struct response *r)
{
    json_error_t je;
    json_t *o = json_loadb((const char *)r->data, r->size, JSON_REJECT_DUPLICATES, &je);
    if (!o)
        fail_msg("%s: not JSON: %s line %d", last_target, je.text, je.line);
    return o;
}

#define IMMUTABLE "public, max-age=31536000, immutable"
#define MOVING "public, max-age=60, stale-while-revalidate=600, stale-if-error=86400"

#endif
