/* Requests by libcurl: addresses, one request, checks of the answer, repetition.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/range.h"

#include <curl/curl.h>
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>

enum {
    RANGE_REDIRECTS = 3,
    RANGE_CONNECT_MS = 5000,
    RANGE_SLOW_BYTES = 4096, /* a second, over RANGE_SLOW_S: the answer is given up */
    RANGE_SLOW_S = 2,
    RANGE_OTHER_BODY = 65536, /* bytes of another answer that are read to keep the connection */
    RANGE_WAIT_MIN_MS = 50,   /* before the first repetition */
    RANGE_WAIT_MAX_MS = 2000
};
static const uint64_t RANGE_OBJECT_MAX = (uint64_t)1 << 46;

struct range {
    CURL *curl;
    char url[RANGE_URL_MAX], shown[RANGE_URL_MAX];
    char sign[96];              /* for CURLOPT_AWS_SIGV4; "": requests are not signed */
    const char *user, *pass;    /* of the environment */
    struct curl_slist *headers; /* of every request */
    char why[CURL_ERROR_SIZE];
};

struct range_answer { /* what has come of one answer */
    CURL *curl;
    struct range_object object;
    uint64_t first, last; /* Content-Range; first > last: none */
    bool coded;           /* Content-Encoding */
    double retry_s;       /* Retry-After; 0: none */
    uint8_t *out;
    size_t room, got, other;
};

static _Atomic uint64_t range_count;

uint64_t range_requests(void)
{
    return atomic_load(&range_count);
}

/* ---- addresses ---- */

static const char s3_scheme[] = "s3://";

bool range_is_url(const char *path)
{
    return !strncasecmp(path, "http://", 7) || !strncasecmp(path, "https://", 8) ||
           !strncasecmp(path, s3_scheme, 5);
}

void range_show(const char *url, char out[RANGE_URL_MAX])
{
    const char *host = strstr(url, "://");
    host = host ? host + 3 : url;
    const size_t n = strcspn(host, "?#"), authority = strcspn(host, "/?#");
    const char *from = host;
    for (const char *p = host; p < host + authority; p++)
        if (*p == '@')
            from = p + 1;
    snprintf(out, RANGE_URL_MAX, "%.*s%.*s", (int)(host - url), url, (int)(host + n - from), from);
}

static void range_global(void)
{
    (void)curl_global_init(CURL_GLOBAL_DEFAULT);
}

static const char *range_env(const char *name, const char *other)
{
    const char *v = getenv(name);
    if ((!v || !*v) && other)
        v = getenv(other);
    return v && *v ? v : NULL;
}

/* Bytes of a key as they stand in a path; the signature is over the same text. */
static void range_add_key(struct buf *b, const char *key)
{
    for (const char *p = key; *p; p++)
        if ((*p >= 'a' && *p <= 'z') || (*p >= 'A' && *p <= 'Z') || (*p >= '0' && *p <= '9') ||
            strchr("/-._~", *p))
            buf_u8(b, (unsigned char)*p);
        else
            buf_printf(b, "%%%02X", (unsigned char)*p);
}

static bool range_bucket_ok(const char *name, size_t n)
{
    bool ok = n >= 3 && n <= 63;
    for (size_t i = 0; i < n; i++)
        ok = ok && ((name[i] >= 'a' && name[i] <= 'z') || (name[i] >= '0' && name[i] <= '9') ||
                    (i && (name[i] == '-' || name[i] == '.')));
    return ok;
}

/* s3://bucket/key: at Amazon, or at AWS_ENDPOINT_URL with the bucket in the path. */
static enum err_code range_use_s3(struct range *r, const char *url, struct err *e)
{
    const char *bucket = url + 5, *key = strchr(bucket, '/');
    const size_t n = key ? (size_t)(key - bucket) : 0;
    if (!key || !key[1] || !range_bucket_ok(bucket, n))
        return err_set(e, ERR_ARG, "%s: s3://BUCKET/KEY is expected", r->shown);
    const char *region = range_env("AWS_REGION", "AWS_DEFAULT_REGION"),
               *endpoint = range_env("AWS_ENDPOINT_URL", NULL),
               *token = range_env("AWS_SESSION_TOKEN", NULL);
    region = region ? region : "us-east-1";
    r->user = range_env("AWS_ACCESS_KEY_ID", NULL);
    r->pass = range_env("AWS_SECRET_ACCESS_KEY", NULL);
    if (!r->user != !r->pass)
        return err_set(e, ERR_ARG,
                       "%s: set both AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or none of them",
                       r->shown);
    if (strspn(region, "abcdefghijklmnopqrstuvwxyz0123456789-") != strlen(region) ||
        strlen(region) > 40)
        return err_set(e, ERR_ARG, "%s: AWS_REGION is '%.40s': no region", r->shown, region);
    if (endpoint && (!range_is_url(endpoint) || !strncasecmp(endpoint, s3_scheme, 5)))
        return err_set(e, ERR_ARG, "%s: AWS_ENDPOINT_URL is '%.80s': https://HOST is expected",
                       r->shown, endpoint);
    struct buf b = {0};
    if (endpoint)
        buf_printf(&b, "%.*s/%.*s",
                   (int)(strlen(endpoint) - (endpoint[strlen(endpoint) - 1] == '/')), endpoint,
                   (int)n, bucket);
    else if (memchr(bucket, '.', n)) /* the certificate's * is one label */
        buf_printf(&b, "https://s3.%s.amazonaws.com/%.*s", region, (int)n, bucket);
    else
        buf_printf(&b, "https://%.*s.s3.%s.amazonaws.com", (int)n, bucket, region);
    range_add_key(&b, key);
    buf_u8(&b, 0);
    enum err_code rc = buf_check(&b, e);
    if (!rc && b.size > sizeof r->url)
        rc = err_set(e, ERR_LIMIT, "%.80s...: the address is too long", r->shown);
    if (!rc)
        memcpy(r->url, b.data, b.size);
    buf_free(&b);
    if (rc || !r->user)
        return rc;
    snprintf(r->sign, sizeof r->sign, "aws:amz:%s:s3", region);
    char line[2048];
    r->headers = curl_slist_append(r->headers, "x-amz-content-sha256: UNSIGNED-PAYLOAD");
    if (token && snprintf(line, sizeof line, "x-amz-security-token: %s", token) < (int)sizeof line)
        r->headers = curl_slist_append(r->headers, line);
    return r->headers ? ERR_OK : err_set(e, ERR_MEM, "%s: out of memory", r->shown);
}

static enum err_code range_use(struct range *r, const char *url, struct err *e)
{
    range_show(url, r->shown);
    if (strlen(url) >= RANGE_URL_MAX)
        return err_set(e, ERR_LIMIT, "%.80s...: an address of more than %d bytes", r->shown,
                       RANGE_URL_MAX - 1);
    for (const char *p = url; *p; p++)
        if ((unsigned char)*p < ' ' || *p == 127)
            return err_set(e, ERR_ARG, "the address has control characters");
    if (!strncasecmp(url, s3_scheme, 5))
        return range_use_s3(r, url, e);
    CURLU *u = curl_url();
    const CURLUcode code = u ? curl_url_set(u, CURLUPART_URL, url, 0) : CURLUE_OUT_OF_MEMORY;
    curl_url_cleanup(u);
    if (code == CURLUE_OUT_OF_MEMORY)
        return err_set(e, ERR_MEM, "%s: out of memory", r->shown);
    if (code)
        return err_set(e, ERR_ARG, "%s: no address: %s", r->shown, curl_url_strerror(code));
    memcpy(r->url, url, strlen(url) + 1);
    return ERR_OK;
}

/* ---- an answer ---- */

/* The tag is sent back in a request: nothing else may get into it. */
static bool range_tag_ok(const char *t)
{
    t += !strncmp(t, "W/", 2) ? 2 : 0;
    const size_t n = strlen(t);
    bool ok = n >= 2 && t[0] == '"' && t[n - 1] == '"';
    for (size_t i = 1; ok && i + 1 < n; i++)
        ok = (unsigned char)t[i] > ' ' && t[i] != '"' && t[i] != 127;
    return ok;
}

static void range_read_span(const char *v, struct range_answer *a)
{
    char *end = NULL;
    a->first = 1;
    a->last = 0;
    if (strncasecmp(v, "bytes ", 6) || v[6] < '0' || v[6] > '9')
        return;
    const uint64_t first = strtoull(v + 6, &end, 10);
    if (*end != '-' || end[1] < '0' || end[1] > '9')
        return;
    const uint64_t last = strtoull(end + 1, &end, 10);
    if (*end != '/' || end[1] < '0' || end[1] > '9')
        return;
    const uint64_t total = strtoull(end + 1, &end, 10);
    if (*end || total > RANGE_OBJECT_MAX || last >= total)
        return;
    a->first = first;
    a->last = last;
    a->object.size_bytes = total;
}

static size_t range_head(char *line, size_t size, size_t n, void *user)
{
    struct range_answer *a = user;
    char text[256];
    if (size * n >= sizeof text)
        return size * n; /* none of those that are read */
    memcpy(text, line, size * n);
    text[size * n] = '\0';
    text[strcspn(text, "\r\n")] = '\0';
    const char *v = strchr(text, ':');
    if (!strncmp(text, "HTTP/", 5)) { /* after a redirection there is another head */
        a->object = (struct range_object){0};
        a->first = 1;
        a->last = 0;
        a->coded = false;
        a->retry_s = 0;
    }
    if (!v)
        return size * n;
    const size_t key = (size_t)(v - text);
    v += 1 + strspn(v + 1, " \t");
    if (key == 4 && !strncasecmp(text, "etag", key) && strlen(v) < RANGE_TAG_MAX && range_tag_ok(v))
        snprintf(a->object.etag, sizeof a->object.etag, "%s", v);
    else if (key == 13 && !strncasecmp(text, "last-modified", key) && strlen(v) < RANGE_DATE_MAX)
        snprintf(a->object.modified, sizeof a->object.modified, "%s", v);
    else if (key == 13 && !strncasecmp(text, "content-range", key))
        range_read_span(v, a);
    else if (key == 16 && !strncasecmp(text, "content-encoding", key))
        a->coded = strcasecmp(v, "identity") != 0;
    else if (key == 11 && !strncasecmp(text, "retry-after", key))
        a->retry_s = fmin(fmax(strtod(v, NULL), 0), 60);
    return size * n;
}

static size_t range_body(char *bytes, size_t size, size_t n, void *user)
{
    struct range_answer *a = user;
    long status = 0;
    n *= size;
    curl_easy_getinfo(a->curl, CURLINFO_RESPONSE_CODE, &status);
    if (status != 206) {
        a->other += n;
        return (status == 200 && a->room) || a->other > RANGE_OTHER_BODY ? 0 : n;
    }
    if (a->coded || n > a->room - a->got)
        return 0;
    memcpy(a->out + a->got, bytes, n);
    a->got += n;
    return n;
}

/* ---- one request ---- */

enum err_code range_open(const char *url, struct range **out, struct err *e)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, range_global);
    struct range *r = mem_array(1, sizeof *r);
    *out = r;
    if (!r)
        return err_set(e, ERR_MEM, "out of memory for a connection");
    enum err_code rc = range_use(r, url, e);
    if (!rc && !(r->curl = curl_easy_init()))
        rc = err_set(e, ERR_MEM, "%s: out of memory", r->shown);
    if (rc)
        range_close(out);
    return rc;
}

void range_close(struct range **out)
{
    struct range *r = *out;
    *out = NULL;
    if (!r)
        return;
    curl_easy_cleanup(r->curl);
    curl_slist_free_all(r->headers);
    mem_free(r);
}

/* The address may lead to another one, but never from TLS to none. */
static void range_usual(struct range *r, struct range_answer *a, double left_s)
{
    CURL *c = r->curl;
    const bool tls = !strncasecmp(r->url, "https:", 6);
    const char *roots = range_env("SSL_CERT_FILE", NULL);
    const long left_ms = (long)fmax(1, left_s * 1e3);
    curl_easy_reset(c); /* keeps its connections */
    curl_easy_setopt(c, CURLOPT_URL, r->url);
    curl_easy_setopt(c, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(c, CURLOPT_REDIR_PROTOCOLS_STR, tls ? "https" : "http,https");
    curl_easy_setopt(c, CURLOPT_FOLLOWLOCATION, r->sign[0] ? 0L : 1L);
    curl_easy_setopt(c, CURLOPT_MAXREDIRS, (long)RANGE_REDIRECTS);
    curl_easy_setopt(c, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(c, CURLOPT_USERAGENT, "citysplat/" CITYSPLAT_VERSION);
    curl_easy_setopt(c, CURLOPT_CONNECTTIMEOUT_MS,
                     left_ms < RANGE_CONNECT_MS ? left_ms : (long)RANGE_CONNECT_MS);
    curl_easy_setopt(c, CURLOPT_TIMEOUT_MS, left_ms);
    curl_easy_setopt(c, CURLOPT_LOW_SPEED_LIMIT, (long)RANGE_SLOW_BYTES);
    curl_easy_setopt(c, CURLOPT_LOW_SPEED_TIME, (long)RANGE_SLOW_S);
    curl_easy_setopt(c, CURLOPT_BUFFERSIZE, 262144L);
    curl_easy_setopt(c, CURLOPT_ERRORBUFFER, r->why);
    curl_easy_setopt(c, CURLOPT_HEADERFUNCTION, range_head);
    curl_easy_setopt(c, CURLOPT_HEADERDATA, a);
    curl_easy_setopt(c, CURLOPT_WRITEFUNCTION, range_body);
    curl_easy_setopt(c, CURLOPT_WRITEDATA, a);
    if (roots)
        curl_easy_setopt(c, CURLOPT_CAINFO, roots);
    if (r->sign[0]) {
        curl_easy_setopt(c, CURLOPT_AWS_SIGV4, r->sign);
        curl_easy_setopt(c, CURLOPT_USERNAME, r->user);
        curl_easy_setopt(c, CURLOPT_PASSWORD, r->pass);
    }
}

/* Headers of this request: those of every one, and the condition. NULL: out of memory. */
static struct curl_slist *range_headers(const struct range *r, const struct range_object *o,
                                        bool check)
{
    char line[RANGE_TAG_MAX + 32];
    struct curl_slist *all = curl_slist_append(NULL, "Accept-Encoding: identity");
    for (const struct curl_slist *h = r->headers; all && h; h = h->next)
        all = curl_slist_append(all, h->data);
    if (o->etag[0] && (check || o->etag[0] != 'W')) {
        snprintf(line, sizeof line, "%s: %s", check ? "If-None-Match" : "If-Match", o->etag);
        all = all ? curl_slist_append(all, line) : NULL;
    } else if (o->modified[0]) {
        snprintf(line, sizeof line, "%s: %s", check ? "If-Modified-Since" : "If-Unmodified-Since",
                 o->modified);
        all = all ? curl_slist_append(all, line) : NULL;
    }
    return all;
}

static bool range_same(const struct range_object *a, const struct range_object *b)
{
    return a->size_bytes == b->size_bytes &&
           (a->etag[0] ? !strcmp(a->etag, b->etag) : !strcmp(a->modified, b->modified));
}

/* What a complete 206 must be. */
static enum err_code range_judge_part(const struct range *r, struct range_object *o, uint64_t at,
                                      size_t n, const struct range_answer *a, struct err *e)
{
    if (a->coded)
        return err_set(e, ERR_FORMAT, "%s: its server sends it compressed: turn that off for it",
                       r->shown);
    if (a->first > a->last)
        return err_set(e, ERR_FORMAT, "%s: an answer 206 without a usable Content-Range", r->shown);
    if (!a->object.etag[0] && !a->object.modified[0])
        return err_set(e, ERR_FORMAT,
                       "%s: its server sends neither ETag nor Last-Modified, so a change would not "
                       "be noticed: turn one of them on",
                       r->shown);
    if (o->size_bytes && !range_same(o, &a->object))
        return err_set(e, ERR_DATA, "%s: it was replaced at its server", r->shown);
    const uint64_t total = a->object.size_bytes, end = at + n < total ? at + n : total;
    if (a->first != at || a->last + 1 != end || a->got != end - at)
        return err_set(
            e, ERR_BUSY,
            "%s: bytes %llu to %llu were asked for, and %zu came, said to be %llu to %llu",
            r->shown, (unsigned long long)at, (unsigned long long)(at + n - 1), a->got,
            (unsigned long long)a->first, (unsigned long long)a->last);
    *o = a->object;
    return ERR_OK;
}

/* A status that no kind of request expects. */
static enum err_code range_judge_other(const struct range *r, long status, struct err *e)
{
    if (status == 401 || status == 403)
        return err_set(e, ERR_IO, "%s: status %ld: it may not be read: %s", r->shown, status,
                       r->sign[0]
                           ? "check the keys, AWS_REGION and the rights of the bucket"
                           : "allow it at the server; for a bucket set AWS_ACCESS_KEY_ID and "
                             "AWS_SECRET_ACCESS_KEY");
    if (status == 408 || status == 425 || status == 429 || status >= 500)
        return err_set(e, ERR_BUSY, "%s: status %ld", r->shown, status);
    return err_set(e, ERR_IO, "%s: status %ld: it cannot be read", r->shown, status);
}

static enum err_code range_judge_status(const struct range *r, const struct range_object *o,
                                        long status, bool check, struct err *e)
{
    if (status == 304 && check)
        return ERR_OK;
    if (status == 412 || (status == 416 && o->size_bytes))
        return err_set(e, ERR_DATA, "%s: it was replaced at its server", r->shown);
    if (status == 200)
        return err_set(e, ERR_FORMAT,
                       "%s: its server ignores Range and sends the whole object: serve it from one "
                       "that answers range requests (nginx, Apache, S3)",
                       r->shown);
    if (status == 404 || status == 410)
        return err_set(e, ERR_NOENT, "%s: status %ld: there is no such object: check the address",
                       r->shown, status);
    if (status == 416)
        return err_set(e, ERR_FORMAT, "%s: it is empty", r->shown);
    return range_judge_other(r, status, e);
}

/* Failures of the connection pass, but not those of address and certificate. */
static enum err_code range_judge_code(const struct range *r, CURLcode code, struct err *e)
{
    const char *why = r->why[0] ? r->why : curl_easy_strerror(code);
    if (code == CURLE_OUT_OF_MEMORY)
        return err_set(e, ERR_MEM, "%s: out of memory", r->shown);
    if (code == CURLE_PEER_FAILED_VERIFICATION || code == CURLE_SSL_CACERT_BADFILE ||
        code == CURLE_TOO_MANY_REDIRECTS || code == CURLE_UNSUPPORTED_PROTOCOL ||
        code == CURLE_URL_MALFORMAT)
        return err_set(e, ERR_IO, "%s: %s", r->shown, why);
    return err_set(e, ERR_BUSY, "%s: %s", r->shown, why);
}

/* Sends the request that was set up. `headers` are freed. */
static enum err_code range_perform(struct range *r, struct curl_slist *headers, long *status,
                                   struct err *e)
{
    curl_easy_setopt(r->curl, CURLOPT_HTTPHEADER, headers);
    atomic_fetch_add(&range_count, 1);
    const CURLcode code = curl_easy_perform(r->curl);
    curl_easy_getinfo(r->curl, CURLINFO_RESPONSE_CODE, status);
    curl_slist_free_all(headers);
    const bool left = code == CURLE_WRITE_ERROR; /* by range_body */
    return code && !left ? range_judge_code(r, code, e) : ERR_OK;
}

struct range_ask {
    uint64_t at;
    size_t n;
    uint8_t *out;
    bool check;
};

static enum err_code range_once(struct range *r, struct range_object *o, const struct range_ask *q,
                                struct range_answer *a, double left_s, struct err *e)
{
    char span[64];
    *a = (struct range_answer){.curl = r->curl, .out = q->out, .room = q->n, .first = 1};
    r->why[0] = '\0';
    range_usual(r, a, left_s);
    struct curl_slist *headers = range_headers(r, o, q->check);
    if (!headers)
        return err_set(e, ERR_MEM, "%s: out of memory", r->shown);
    snprintf(span, sizeof span, "%llu-%llu", (unsigned long long)q->at,
             (unsigned long long)(q->at + q->n - 1));
    curl_easy_setopt(r->curl, CURLOPT_RANGE, span);
    long status = 0;
    enum err_code rc = range_perform(r, headers, &status, e);
    if (rc)
        return rc;
    return status == 206 ? range_judge_part(r, o, q->at, q->n, a, e)
                         : range_judge_status(r, o, status, q->check, e);
}

static void range_sleep(double s)
{
    const struct timespec t = {.tv_sec = (time_t)s, .tv_nsec = (long)(fmod(s, 1) * 1e9)};
    (void)nanosleep(&t, NULL);
}

/* Each wait is twice the one before, and random in its second half, so that servers do not come
 * back together. */
static enum err_code range_ask(struct range *r, struct range_object *o, const struct range_ask *q,
                               size_t *got, double until_s, struct err *e)
{
    struct err own = {0};
    struct range_answer a;
    const double start_s = clock_s();
    e = e ? e : &own;
    for (unsigned tries = 0;; tries++) {
        const enum err_code rc = range_once(r, o, q, &a, until_s - clock_s(), e);
        if (got)
            *got = a.got;
        if (rc != ERR_BUSY)
            return rc;
        double wait_s = fmin(RANGE_WAIT_MAX_MS, ldexp(RANGE_WAIT_MIN_MS, (int)(tries & 15))) / 1e3;
        wait_s *= 0.5 + 0.5 * rng_unit((uint64_t)(start_s * 1e6), q->at, tries);
        wait_s = fmax(wait_s, a.retry_s);
        if (clock_s() + wait_s >= until_s || signals_stopping())
            return err_add(e, "%u requests in %.1f s did not succeed, the last", tries + 1,
                           clock_s() - start_s);
        log_debug("remote", "repeated after_ms=%.0f: %s", wait_s * 1e3, e->msg);
        range_sleep(wait_s);
    }
}

enum err_code range_get(struct range *r, struct range_object *o, uint64_t at, size_t n,
                        // NOLINTNEXTLINE(readability-non-const-parameter): range_ask writes to it
                        uint8_t *out, size_t *got, double until_s, struct err *e)
{
    const struct range_ask q = {.at = at, .n = n, .out = out};
    return range_ask(r, o, &q, got, until_s, e);
}

enum err_code range_check(struct range *r, const struct range_object *o, double until_s,
                          struct err *e)
{
    uint8_t byte;
    struct range_object same = *o;
    const struct range_ask q = {.n = 1, .out = &byte, .check = true};
    return range_ask(r, &same, &q, NULL, until_s, e);
}
