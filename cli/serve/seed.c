/* citysplat seed: requests every tile of a prefetch list, most important first, so that the cache
 * or CDN in front of a server has them early. The server makes the list
 * (server/documents/prefetch_list.c). An answer must have the entity tag that the list names. It
 * uses libcurl.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <curl/curl.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "cli/base/cli.h"

enum {
    SEED_CONNECTIONS_MAX = 64,
    SEED_WAIT_MS = 50,         /* for the network, at most */
    SEED_TIMEOUT_S = 120,      /* of one answer */
    SEED_TRIES = 5,            /* of a tile before it counts as failed */
    SEED_PAUSE_MAX_S = 60,     /* that a server may ask for */
    SEED_NAMED_MAX = 5,        /* failures that are told one by one */
    SEED_LIST_MAX = 256 << 20, /* bytes of a page of the list */
    SEED_PAGES_MAX = 10000
};

struct seed_options {
#define OPT OPTIONS_MEMBER
#include "cli/serve/seed.def"
};

static const struct options_def seed_defs[] = {
#define OPT(...) OPTIONS_ROW(struct seed_options, __VA_ARGS__)
#include "cli/serve/seed.def"
};

static const struct options_spec seed_spec = {
    .command = "seed",
    .usage = "citysplat seed URL [options]",
    .about =
        "Fills a cache or CDN. Requests the tiles of a prefetch list, most important first, and "
        "checks their tags. URL is a dataset (https://cdn.example/d/city), or its prefetch list, "
        "with an area, zooms, and for=cesium, three or viewer, or a format f. Without for and f it "
        "requests what all three ask for.",
    .example = "citysplat seed https://cdn.example/d/city --rate 50\n"
               "citysplat seed 'https://cdn.example/d/city/seed.ndjson?z=12-16&for=viewer'",
    .defs = seed_defs,
    .n_defs = sizeof seed_defs / sizeof *seed_defs,
    .min_args = 1,
    .max_args = 1};

struct seed_tile {
    char *url, *etag; /* in the arena */
    int tries;
    double not_before_s;
};

struct seed_get { /* one request on its way */
    CURL *curl;
    struct seed_tile *tile; /* NULL: free */
    uint64_t bytes;
    char etag[160];
    double age_s, retry_s; /* from the answer's head; -1: not said */
};

struct seed_run {
    const struct seed_options *o;
    struct seed_tile *tile; /* [room] */
    size_t n, room, done, failed, cached, busy;
    uint64_t bytes;
    struct seed_get get[SEED_CONNECTIONS_MAX];
    CURLM *multi;
    struct curl_slist *headers;
};

/* ---- the list ---- */

static size_t seed_keep(char *bytes, size_t size, size_t n, void *user)
{
    struct buf *b = user;
    if (b->size + n * size > SEED_LIST_MAX)
        return 0;
    buf_add(b, bytes, n * size);
    return b->failed ? 0 : n * size;
}

/* Redirections are followed, within http and https. */
static void seed_usual(CURL *curl, const struct seed_run *r)
{
    curl_easy_setopt(curl, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(curl, CURLOPT_FOLLOWLOCATION, 1L);
    curl_easy_setopt(curl, CURLOPT_MAXREDIRS, 5L);
    curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(curl, CURLOPT_TIMEOUT, (long)SEED_TIMEOUT_S);
    curl_easy_setopt(curl, CURLOPT_USERAGENT, "citysplat/" CITYSPLAT_VERSION);
    curl_easy_setopt(curl, CURLOPT_HTTPHEADER, r->headers);
}

/* base: where the list came from in the end, which its addresses are relative to. */
static enum err_code seed_fetch_list(const struct seed_run *r, const char *url, struct buf *list,
                                     char **base, struct arena *a, struct err *e)
{
    CURL *curl = curl_easy_init();
    char why[CURL_ERROR_SIZE] = "";
    long status = 0;
    char *at = NULL;
    if (!curl)
        return err_set(e, ERR_MEM, "seed: out of memory");
    seed_usual(curl, r);
    curl_easy_setopt(curl, CURLOPT_URL, url);
    curl_easy_setopt(curl, CURLOPT_ERRORBUFFER, why);
    curl_easy_setopt(curl, CURLOPT_ACCEPT_ENCODING, "");
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, seed_keep);
    curl_easy_setopt(curl, CURLOPT_WRITEDATA, list);
    CURLcode code = curl_easy_perform(curl);
    curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &status);
    curl_easy_getinfo(curl, CURLINFO_EFFECTIVE_URL, &at);
    *base = arena_text(a, at ? at : url);
    curl_easy_cleanup(curl);
    if (code)
        return err_set(e, ERR_IO, "%s: %s", url, why[0] ? why : curl_easy_strerror(code));
    if (status != 200)
        return err_set(e, ERR_IO, "%s: status %ld: is it a dataset of citysplat serve?", url,
                       status);
    return *base ? ERR_OK : err_set(e, ERR_MEM, "seed: out of memory");
}

static enum err_code seed_join(const char *base, const char *relative, char **out, struct arena *a,
                               struct err *e)
{
    CURLU *u = curl_url();
    char *text = NULL;
    enum err_code rc = u ? ERR_OK : err_set(e, ERR_MEM, "seed: out of memory");
    if (!rc &&
        (curl_url_set(u, CURLUPART_URL, base, 0) || curl_url_set(u, CURLUPART_URL, relative, 0) ||
         curl_url_get(u, CURLUPART_URL, &text, 0)))
        rc = err_set(e, ERR_FORMAT, "%s: no address: %s", base, relative);
    if (!rc && !(*out = arena_text(a, text)))
        rc = err_set(e, ERR_MEM, "seed: out of memory");
    curl_free(text);
    curl_url_cleanup(u);
    return rc;
}

static struct seed_tile *seed_add(struct seed_run *r)
{
    struct seed_tile *more = mem_room(r->tile, r->n, &r->room, 1024, sizeof *more);
    if (!more)
        return NULL;
    r->tile = more;
    return &r->tile[r->n++];
}

/* A line: a tile, or where the list goes on. */
static enum err_code seed_parse_line(struct seed_run *r, const char *base, const json_t *o,
                                     size_t number, char **next, struct arena *a, struct err *e)
{
    const char *url = json_string_value(json_object_get(o, "url"));
    const char *etag = json_string_value(json_object_get(o, "etag"));
    const char *more = json_string_value(json_object_get(o, "next"));
    if (more)
        return seed_join(base, more, next, a, e);
    if (!url || !etag)
        return err_set(e, ERR_FORMAT, "%s: line %zu: no tile with an url and an etag", base,
                       number);
    struct seed_tile *t = seed_add(r);
    if (!t)
        return err_set(e, ERR_MEM, "seed: out of memory");
    enum err_code rc = seed_join(base, url, &t->url, a, e);
    if (!rc && !(t->etag = arena_text(a, etag)))
        rc = err_set(e, ERR_MEM, "seed: out of memory");
    return rc;
}

/* *next: the address of the next page; NULL: this is the last one. */
static enum err_code seed_parse(struct seed_run *r, const char *base, struct buf *list, char **next,
                                struct arena *a, struct err *e)
{
    size_t number = 0;
    enum err_code rc = ERR_OK;
    char *p = (char *)list->data, *stop = p + list->size, *end;
    *next = NULL;
    for (; !rc && p < stop && (end = memchr(p, '\n', (size_t)(stop - p))); p = end + 1) {
        json_t *o = json_loadb(p, (size_t)(end - p), 0, NULL);
        rc = seed_parse_line(r, base, o, ++number, next, a, e);
        json_decref(o);
    }
    return rc;
}

/* All pages of the list. */
static enum err_code seed_list(struct seed_run *r, char *url, struct arena *a, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t pages = 0; !rc && url; pages++) {
        struct buf list = {0};
        char *base = NULL, *next = NULL;
        size_t before = r->n;
        if (pages > SEED_PAGES_MAX)
            return err_set(e, ERR_LIMIT, "%s: a list of more than %d pages", url, SEED_PAGES_MAX);
        rc = seed_fetch_list(r, url, &list, &base, a, e);
        if (!rc)
            rc = seed_parse(r, base, &list, &next, a, e);
        if (!rc && next && r->n == before)
            rc = err_set(e, ERR_FORMAT, "%s: a page without tiles goes on", base);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
        buf_free(&list);
        url = next;
    }
    return rc;
}

/* A dataset's address is that of its list without the end. Without a client (for) or a form (f),
 * the list has what all clients ask for. */
static char *seed_address(const char *given, struct arena *a)
{
    const size_t n = strcspn(given, "?");
    const char *query = given + n;
    const bool list = strstr(given, "seed.ndjson"),
               said = strstr(query, "?f=") || strstr(query, "&f=") || strstr(query, "for=");
    return arena_printf(a, "%.*s%s%s%s%s", (int)n, given,
                        list || (n && given[n - 1] == '/') ? "" : "/", list ? "" : "seed.ndjson",
                        query,
                        said     ? ""
                        : *query ? "&for=all"
                                 : "?for=all");
}

/* ---- the tiles ---- */

/* NOLINTNEXTLINE(readability-non-const-parameter): libcurl's type */
static size_t seed_count(char *bytes, size_t size, size_t n, void *user)
{
    struct seed_get *g = user;
    (void)bytes;
    g->bytes += n * size;
    return n * size;
}

static size_t seed_head(char *line, size_t size, size_t n, void *user)
{
    struct seed_get *g = user;
    char text[200];
    snprintf(text, sizeof text, "%.*s", (int)(n * size), line);
    text[strcspn(text, "\r\n")] = 0;
    if (!strncasecmp(text, "etag:", 5))
        snprintf(g->etag, sizeof g->etag, "%.*s", (int)sizeof g->etag - 1,
                 text + 5 + strspn(text + 5, " "));
    else if (!strncasecmp(text, "age:", 4))
        g->age_s = atof(text + 4);
    else if (!strncasecmp(text, "retry-after:", 12))
        g->retry_s = atof(text + 12);
    else if (!strncasecmp(text, "HTTP/", 5)) { /* of another answer: a redirection */
        g->etag[0] = 0;
        g->age_s = g->retry_s = -1;
    }
    return n * size;
}

static enum err_code seed_ask(struct seed_run *r, struct seed_get *g, struct seed_tile *t,
                              struct err *e)
{
    if (!g->curl && !(g->curl = curl_easy_init()))
        return err_set(e, ERR_MEM, "seed: out of memory");
    g->tile = t;
    g->bytes = 0;
    t->tries++;
    r->busy++;
    seed_usual(g->curl, r);
    curl_easy_setopt(g->curl, CURLOPT_URL, t->url);
    curl_easy_setopt(g->curl, CURLOPT_WRITEFUNCTION, seed_count);
    curl_easy_setopt(g->curl, CURLOPT_WRITEDATA, g);
    curl_easy_setopt(g->curl, CURLOPT_HEADERFUNCTION, seed_head);
    curl_easy_setopt(g->curl, CURLOPT_HEADERDATA, g);
    curl_easy_setopt(g->curl, CURLOPT_PRIVATE, g);
    return curl_multi_add_handle(r->multi, g->curl) ? err_set(e, ERR_MEM, "seed: out of memory")
                                                    : ERR_OK;
}

/* A cache may have made a tag weak. */
static bool seed_same_tag(const char *got, const char *want)
{
    return !strcmp(got + (strncmp(got, "W/", 2) ? 0 : 2), want);
}

static void seed_fail(struct seed_run *r, const struct seed_tile *t, const char *why)
{
    if (r->failed++ < SEED_NAMED_MAX)
        log_error("seed", "failed url=%s tries=%d why=\"%s\"", t->url, t->tries, why);
    r->done++;
}

/* What is worth another try: no answer, and 429, 502, 503 and 504. */
static void seed_finish(struct seed_run *r, struct seed_get *g, CURLcode code)
{
    struct seed_tile *t = g->tile;
    long status = 0;
    char why[96];
    curl_easy_getinfo(g->curl, CURLINFO_RESPONSE_CODE, &status);
    curl_multi_remove_handle(r->multi, g->curl);
    g->tile = NULL;
    r->busy--;
    const bool again = code || status == 429 || status == 502 || status == 503 || status == 504;
    if (again && t->tries < SEED_TRIES) {
        double pause_s = g->retry_s > 0 ? g->retry_s : 0.5 * t->tries;
        t->not_before_s = clock_s() + (pause_s < SEED_PAUSE_MAX_S ? pause_s : SEED_PAUSE_MAX_S);
        return;
    }
    snprintf(why, sizeof why, "status %ld", status);
    if (code || status != 200)
        seed_fail(r, t, code ? curl_easy_strerror(code) : why);
    else if (!seed_same_tag(g->etag, t->etag))
        seed_fail(r, t, "another ETag than the list has: an old copy, or another server");
    else {
        r->done++;
        r->bytes += g->bytes;
        r->cached += g->age_s >= 0;
    }
}

/* The next tile that nobody asks for and that may be asked for: first those not yet tried. */
static struct seed_tile *seed_next(struct seed_run *r, size_t *next, size_t *again, double now_s)
{
    if (*next < r->n)
        return &r->tile[(*next)++];
    for (size_t k = 0; k < r->n; k++) {
        struct seed_tile *t = &r->tile[*again];
        *again = (*again + 1) % r->n;
        if (t->not_before_s > 0 && t->not_before_s <= now_s) {
            t->not_before_s = 0;
            return t;
        }
    }
    return NULL;
}

static enum err_code seed_run(struct seed_run *r, struct err *e)
{
    struct progress p;
    size_t next = 0, again = 0;
    double due_s = clock_s();
    enum err_code rc = ERR_OK;
    progress_start(&p, "seed", r->n);
    while (!rc && r->done < r->n) {
        const double now_s = clock_s();
        int running, left;
        for (int k = 0; !rc && k < r->o->connections && now_s >= due_s; k++) {
            struct seed_tile *t = r->get[k].tile ? NULL : seed_next(r, &next, &again, now_s);
            if (t) {
                rc = seed_ask(r, &r->get[k], t, e);
                due_s = (due_s > now_s - 1 ? due_s : now_s) + 1 / r->o->rate;
            }
        }
        if (!rc && (curl_multi_perform(r->multi, &running) ||
                    curl_multi_poll(r->multi, NULL, 0, SEED_WAIT_MS, NULL)))
            rc = err_set(e, ERR_IO, "seed: libcurl gave up");
        for (CURLMsg *m; !rc && (m = curl_multi_info_read(r->multi, &left));) {
            char *g = NULL;
            CURLcode code = m->data.result;
            curl_easy_getinfo(m->easy_handle, CURLINFO_PRIVATE, &g);
            seed_finish(r, (struct seed_get *)(void *)g, code);
        }
        progress_step(&p, r->done, NULL);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped after %zu of %zu tiles", r->done, r->n);
    }
    progress_end(&p, NULL);
    return rc;
}

static enum err_code seed_open(struct seed_run *r, struct err *e)
{
    if (curl_global_init(CURL_GLOBAL_DEFAULT))
        return err_set(e, ERR_INTERNAL, "seed: libcurl does not start");
    r->multi = curl_multi_init();
    r->headers = curl_slist_append(NULL, "Sec-Purpose: prefetch"); /* behind people's requests */
    return r->multi && r->headers ? ERR_OK : err_set(e, ERR_MEM, "seed: out of memory");
}

static void seed_close(struct seed_run *r)
{
    for (size_t k = 0; k < SEED_CONNECTIONS_MAX; k++) {
        if (r->get[k].tile)
            curl_multi_remove_handle(r->multi, r->get[k].curl);
        curl_easy_cleanup(r->get[k].curl);
    }
    curl_multi_cleanup(r->multi);
    curl_slist_free_all(r->headers);
    curl_global_cleanup();
}

enum err_code cli_seed(int argc, char **argv, struct err *e)
{
    struct seed_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct seed_run r = {.o = &o};
    char *url = NULL;
    enum err_code rc = options_parse(&seed_spec, argc, argv, &o, &args, &arena, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    const double start_s = clock_s();
    url = seed_address(args.arg[0], &arena);
    rc = url ? seed_open(&r, e) : err_set(e, ERR_MEM, "seed: out of memory");
    if (!rc)
        rc = seed_list(&r, url, &arena, e);
    if (!rc)
        rc = seed_run(&r, e);
    if (!rc)
        printf("%zu tiles, %.1f MB in %.1f s, %zu failed, %zu were in a cache before\n",
               r.n - r.failed, (double)r.bytes / 1e6, clock_s() - start_s, r.failed, r.cached);
    if (!rc && r.failed)
        rc = err_set(e, ERR_IO, "seed: %zu of %zu tiles failed", r.failed, r.n);
    seed_close(&r);
out:
    mem_free(r.tile);
    arena_free(&arena);
    return rc;
}
