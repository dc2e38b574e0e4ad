/* The access log: one line a request, gathered in memory and written ten times a second by the
 * watching thread, because a write(2) a request costs more than answering from memory does. When a
 * burst fills the buffer, lines are dropped and counted; answers never wait for the log.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/access.h"

#include <pthread.h>
#include <string.h>

enum { ACCESS_BYTES = 1 << 20, ACCESS_LINE = 512 };

struct access { /* two halves: threads fill one while the other is written */
    pthread_mutex_t lock, flushing;
    char *fill, *spare; /* by lock; spare also by flushing */
    size_t n;           /* by lock */
    uint64_t dropped;   /* by lock */
};

enum err_code access_open(struct access **out, struct err *e)
{
    struct access *a = mem_array(1, sizeof *a);
    *out = a;
    if (!a)
        return err_set(e, ERR_MEM, "access log: out of memory");
    pthread_mutex_init(&a->lock, NULL);
    pthread_mutex_init(&a->flushing, NULL);
    a->fill = mem_array(ACCESS_BYTES, 1);
    a->spare = mem_array(ACCESS_BYTES, 1);
    if (a->fill && a->spare)
        return ERR_OK;
    access_close(out);
    return err_set(e, ERR_MEM, "access log: out of memory");
}

void access_add(struct access *a, const struct access_line *x)
{
    char line[ACCESS_LINE];
    unsigned long us = (unsigned long)(x->seconds * 1e6);
    size_t n = log_compose(line, sizeof line, LOG_INFO, "http",
                           "%s %s status=%d bytes=%llu ms=%lu.%02lu cache=%s", x->method, x->target,
                           x->status, (unsigned long long)x->bytes, us / 1000, us / 10 % 100,
                           x->cache ? x->cache : "-");
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
