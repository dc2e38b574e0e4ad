/* The access log: one line a request, gathered in memory and written ten times a second by the
 * watching thread, because a write(2) a request costs more than answering from memory does. When a
 * burst fills the buffer, lines are dropped and counted; answers never wait for the log.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access.h"

#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

enum { ACCESS_BYTES = 1 << 20, ACCESS_ROOM = 6000, ACCESS_TEXT = 2200 };

struct access { /* two halves: threads fill one while the other is written */
    enum access_format format;
    pthread_mutex_t lock, flushing;
    char *fill, *spare; /* by lock; spare also by flushing */
    size_t n;           /* by lock */
    uint64_t dropped;   /* by lock */
};

enum err_code access_open(enum access_format format, struct access **out, struct err *e)
{
    struct access *a = mem_array(1, sizeof *a);
    *out = a;
    if (!a)
        return err_set(e, ERR_MEM, "access log: its state: out of memory");
    a->format = format;
    pthread_mutex_init(&a->lock, NULL);
    pthread_mutex_init(&a->flushing, NULL);
    a->fill = mem_array(ACCESS_BYTES, 1);
    a->spare = mem_array(ACCESS_BYTES, 1);
    if (a->fill && a->spare)
        return ERR_OK;
    access_close(out);
    return err_set(e, ERR_MEM, "access log: two buffers of %d kB: out of memory",
                   ACCESS_BYTES >> 10);
}

/* As log_quote, "-" for what is not there. */
static const char *access_quote(const char *text, char *out, size_t room)
{
    log_quote(text && *text ? text : "-", out, room);
    return out;
}

static size_t access_text(const struct access_line *x, char *line, size_t room)
{
    unsigned long us = (unsigned long)(x->seconds * 1e6);
    return log_compose(line, room, LOG_INFO, "http",
                       "%s %s status=%d bytes=%llu ms=%lu.%02lu cache=%s id=%s client=%s",
                       x->method, x->target, x->status, (unsigned long long)x->bytes, us / 1000,
                       us / 10 % 100, x->cache ? x->cache : "-", x->id, x->client);
}

static size_t access_json(const struct access_line *x, char *line, size_t room)
{
    char now[32], target[ACCESS_TEXT], agent[300];
    log_now(now);
    int n = snprintf(line, room,
                     "{\"ts\":\"%s\",\"level\":\"info\",\"module\":\"http\",\"method\":\"%s\","
                     "\"route\":\"%s\",\"target\":\"%s\",\"status\":%d,\"bytes\":%llu,"
                     "\"dur_us\":%.0f,\"job_us\":%.0f,\"cache\":\"%s\",\"client\":\"%s\","
                     "\"id\":\"%s\",\"agent\":\"%s\"}\n",
                     now, x->method, x->route, access_quote(x->target, target, sizeof target),
                     x->status, (unsigned long long)x->bytes, x->seconds * 1e6,
                     x->job_s > 0 ? x->job_s * 1e6 : 0, x->cache ? x->cache : "-", x->client, x->id,
                     access_quote(x->agent, agent, sizeof agent));
    return n > 0 && (size_t)n < room ? (size_t)n : 0;
}

/* Quotes and control bytes in what clients send are escaped, or they could end the field. */
static size_t access_combined(const struct access_line *x, char *line, size_t room)
{
    char now[40], target[ACCESS_TEXT], agent[300], referer[300];
    time_t at = time(NULL);
    struct tm utc;
    gmtime_r(&at, &utc);
    strftime(now, sizeof now, "%d/%b/%Y:%H:%M:%S +0000", &utc);
    int n =
        snprintf(line, room, "%s - - [%s] \"%s %s HTTP/1.1\" %d %llu \"%s\" \"%s\"\n", x->client,
                 now, x->method, access_quote(x->target, target, sizeof target), x->status,
                 (unsigned long long)x->bytes, access_quote(x->referer, referer, sizeof referer),
                 access_quote(x->agent, agent, sizeof agent));
    return n > 0 && (size_t)n < room ? (size_t)n : 0;
}

void access_add(struct access *a, const struct access_line *x)
{
    char line[ACCESS_ROOM];
    size_t n = a->format == ACCESS_COMBINED ? access_combined(x, line, sizeof line)
               : log_is_json()              ? access_json(x, line, sizeof line)
                                            : access_text(x, line, sizeof line);
    pthread_mutex_lock(&a->lock);
    if (a->n + n <= ACCESS_BYTES) {
        memcpy(a->fill + a->n, line, n);
        a->n += n;
    } else {
        a->dropped++;
    }
    pthread_mutex_unlock(&a->lock);
}

void access_flush(struct access *a)
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

void access_close(struct access **out)
{
    struct access *a = *out;
    *out = NULL;
    if (!a)
        return;
    if (a->fill && a->spare)
        access_flush(a);
    pthread_mutex_destroy(&a->lock);
    pthread_mutex_destroy(&a->flushing);
    mem_free(a->fill);
    mem_free(a->spare);
    mem_free(a);
}
