/* The access log: one line a request, collected in memory and written ten times a second by the
 * watching thread. A write(2) for each request would cost more than an answer from memory. When a
 * burst fills the buffer, lines are dropped and counted. Answers never wait for the log.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/access_log.h"

#include <pthread.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

enum {
    ACCESS_LOG_BYTES = 1 << 20,
    ACCESS_LOG_ROOM = 6000,
    ACCESS_LOG_TEXT = 2200,
    ACCESS_LOG_AGENT = 300
};

struct access_log { /* two halves: threads fill one while the other is written */
    enum access_format format;
    bool muted; /* the log is of warnings alone (-q) */
    pthread_mutex_t lock, flushing;
    char *fill, *spare; /* by lock; spare also by flushing */
    size_t n;           /* by lock */
    uint64_t dropped;   /* by lock */
};

enum err_code access_log_open(enum access_format format, struct access_log **out, struct err *e)
{
    struct access_log *a = mem_array(1, sizeof *a);
    *out = a;
    if (!a)
        return err_set(e, ERR_MEM, "access log: its state: out of memory");
    char probe[64];
    a->format = format;
    a->muted = !log_compose(probe, sizeof probe, LOG_INFO, "http", "-");
    pthread_mutex_init(&a->lock, NULL);
    pthread_mutex_init(&a->flushing, NULL);
    a->fill = mem_array(ACCESS_LOG_BYTES, 1);
    a->spare = mem_array(ACCESS_LOG_BYTES, 1);
    if (a->fill && a->spare)
        return ERR_OK;
    access_log_close(out);
    return err_set(e, ERR_MEM, "access log: two buffers of %d kB: out of memory",
                   ACCESS_LOG_BYTES >> 10);
}

/* ---- a line ---- */

/* Written without printf, which took half of the time of a tile from memory. There is room for all
 * that has a bound; what clients send is cut. */
struct access_log_out {
    char *p, *end;
};

static void access_log_put_most(struct access_log_out *o, const char *text, size_t most)
{
    size_t n = strlen(text), room = (size_t)(o->end - o->p);
    n = n < most ? n : most;
    n = n < room ? n : room;
    memcpy(o->p, text, n);
    o->p += n;
}

static void access_log_put(struct access_log_out *o, const char *text)
{
    access_log_put_most(o, text, SIZE_MAX);
}

/* In decimal, with zeros in front up to `digits`. */
static void access_log_put_number(struct access_log_out *o, uint64_t v, int digits)
{
    char text[24], *p = text + sizeof text - 1;
    *p = '\0';
    for (int n = 0; v || n < digits; n++, v /= 10)
        *--p = (char)('0' + v % 10);
    access_log_put(o, p);
}

/* In hundredths: 12.34 */
static void access_log_put_hundredths(struct access_log_out *o, uint64_t v)
{
    access_log_put_number(o, v / 100, 1);
    access_log_put(o, ".");
    access_log_put_number(o, v % 100, 2);
}

/* Quotes and control bytes in what clients send are escaped, or they could end the field; "-" for
 * what is not there. */
static void access_log_put_quoted(struct access_log_out *o, const char *text, size_t most)
{
    size_t room = (size_t)(o->end - o->p);
    o->p += log_quote(text && *text ? text : "-", o->p, most < room ? most : room);
}

static void access_log_text(const struct access_log_line *x, struct access_log_out *o)
{
    access_log_put_hundredths(o, (uint64_t)(clock_s() * 100 + 0.5));
    access_log_put(o, " info http ");
    access_log_put(o, x->method);
    access_log_put(o, " ");
    access_log_put_most(o, x->target, ACCESS_LOG_TEXT);
    access_log_put(o, " status=");
    access_log_put_number(o, (uint64_t)x->status, 1);
    access_log_put(o, " bytes=");
    access_log_put_number(o, x->bytes, 1);
    access_log_put(o, " ms=");
    access_log_put_hundredths(o, (uint64_t)(x->seconds * 1e5));
    access_log_put(o, " cache=");
    access_log_put(o, x->cache ? x->cache : "-");
    access_log_put(o, " id=");
    access_log_put(o, x->id);
    access_log_put(o, " client=");
    access_log_put(o, x->client);
    access_log_put(o, "\n");
}

static void access_log_json(const struct access_log_line *x, struct access_log_out *o)
{
    char now[32];
    log_now(now);
    access_log_put(o, "{\"ts\":\"");
    access_log_put(o, now);
    access_log_put(o, "\",\"level\":\"info\",\"module\":\"http\",\"method\":\"");
    access_log_put(o, x->method);
    access_log_put(o, "\",\"route\":\"");
    access_log_put(o, x->route);
    access_log_put(o, "\",\"target\":\"");
    access_log_put_quoted(o, x->target, ACCESS_LOG_TEXT);
    access_log_put(o, "\",\"status\":");
    access_log_put_number(o, (uint64_t)x->status, 1);
    access_log_put(o, ",\"bytes\":");
    access_log_put_number(o, x->bytes, 1);
    access_log_put(o, ",\"dur_us\":");
    access_log_put_number(o, (uint64_t)(x->seconds * 1e6 + 0.5), 1);
    access_log_put(o, ",\"job_us\":");
    access_log_put_number(o, x->job_s > 0 ? (uint64_t)(x->job_s * 1e6 + 0.5) : 0, 1);
    access_log_put(o, ",\"cache\":\"");
    access_log_put(o, x->cache ? x->cache : "-");
    access_log_put(o, "\",\"client\":\"");
    access_log_put(o, x->client);
    access_log_put(o, "\",\"id\":\"");
    access_log_put(o, x->id);
    access_log_put(o, "\",\"agent\":\"");
    access_log_put_quoted(o, x->agent, ACCESS_LOG_AGENT);
    access_log_put(o, "\"}\n");
}

static void access_log_combined(const struct access_log_line *x, struct access_log_out *o)
{
    char now[40];
    time_t at = time(NULL);
    struct tm utc;
    gmtime_r(&at, &utc);
    strftime(now, sizeof now, "%d/%b/%Y:%H:%M:%S +0000", &utc);
    access_log_put(o, x->client);
    access_log_put(o, " - - [");
    access_log_put(o, now);
    access_log_put(o, "] \"");
    access_log_put(o, x->method);
    access_log_put(o, " ");
    access_log_put_quoted(o, x->target, ACCESS_LOG_TEXT);
    access_log_put(o, " HTTP/1.1\" ");
    access_log_put_number(o, (uint64_t)x->status, 1);
    access_log_put(o, " ");
    access_log_put_number(o, x->bytes, 1);
    access_log_put(o, " \"");
    access_log_put_quoted(o, x->referer, ACCESS_LOG_AGENT);
    access_log_put(o, "\" \"");
    access_log_put_quoted(o, x->agent, ACCESS_LOG_AGENT);
    access_log_put(o, "\"\n");
}

/* ---- the interface ---- */

void access_log_add(struct access_log *a, const struct access_log_line *x)
{
    char line[ACCESS_LOG_ROOM];
    struct access_log_out o = {line, line + sizeof line};
    if (a->format == ACCESS_LOG_COMBINED || log_is_json() || !a->muted)
        access_log_put(&o, log_priority(LOG_INFO));
    if (a->format == ACCESS_LOG_COMBINED)
        access_log_combined(x, &o);
    else if (log_is_json())
        access_log_json(x, &o);
    else if (!a->muted)
        access_log_text(x, &o);
    const size_t n = (size_t)(o.p - line);
    pthread_mutex_lock(&a->lock);
    if (a->n + n <= ACCESS_LOG_BYTES) {
        memcpy(a->fill + a->n, line, n);
        a->n += n;
    } else {
        a->dropped++;
    }
    pthread_mutex_unlock(&a->lock);
}

void access_log_flush(struct access_log *a)
{
    pthread_mutex_lock(&a->flushing);
    pthread_mutex_lock(&a->lock);
    char *full = a->fill;
    size_t n = a->n;
    uint64_t dropped = a->dropped;
    a->fill = a->spare;
    a->spare = full;
    a->n = 0;
    a->dropped = 0;
    pthread_mutex_unlock(&a->lock);
    log_write(full, n);
    if (dropped)
        log_warn("http", "access log dropped lines=%llu", (unsigned long long)dropped);
    pthread_mutex_unlock(&a->flushing);
}

void access_log_close(struct access_log **out)
{
    struct access_log *a = *out;
    *out = NULL;
    if (!a)
        return;
    if (a->fill && a->spare)
        access_log_flush(a);
    pthread_mutex_destroy(&a->lock);
    pthread_mutex_destroy(&a->flushing);
    mem_free(a->fill);
    mem_free(a->spare);
    mem_free(a);
}
