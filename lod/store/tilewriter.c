/* Writes finished tiles in order from a ring of payloads: see tilewriter.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/tilewriter.h"

#include <pthread.h>

#include "core/base.h"
#include "core/splat/gauss.h"
#include "lod/store/store.h"

struct tilewriter_slot {
    bool full;
    struct store_entry tile;
    struct buf payload;
};

struct tilewriter {
    struct store *store;
    size_t n, next; /* next: the first that is not written */
    bool failed;
    struct tilewriter_slot slot[TILEWRITER_AHEAD];
    pthread_mutex_t lock;
    pthread_cond_t moved;
    struct progress progress;
};

enum err_code tilewriter_open(struct store *s, size_t n, struct tilewriter **out, struct err *e)
{
    struct tilewriter *w = mem_array(1, sizeof *w);
    *out = w;
    if (!w)
        return err_set(e, ERR_MEM, "out of memory");
    w->store = s;
    w->n = n;
    pthread_mutex_init(&w->lock, NULL);
    pthread_cond_init(&w->moved, NULL);
    progress_start(&w->progress, "tile: writing", n);
    return ERR_OK;
}

void tilewriter_close(struct tilewriter **wp)
{
    struct tilewriter *w = *wp;
    if (!w)
        return;
    progress_end(&w->progress, NULL);
    for (size_t i = 0; i < TILEWRITER_AHEAD; i++)
        buf_free(&w->slot[i].payload);
    pthread_cond_destroy(&w->moved);
    pthread_mutex_destroy(&w->lock);
    mem_free(w);
    *wp = NULL;
}

/* Write what is next, as far as it goes; the lock is held. */
static enum err_code tilewriter_drain(struct tilewriter *w, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (;;) {
        struct tilewriter_slot *s = &w->slot[w->next % TILEWRITER_AHEAD];
        if (rc || !s->full)
            break;
        rc = store_add(w->store, &s->tile, &s->payload, e);
        buf_free(&s->payload);
        s->full = false;
        w->next++;
        progress_step(&w->progress, w->next, NULL);
    }
    w->failed = w->failed || rc;
    pthread_cond_broadcast(&w->moved);
    return rc;
}

enum err_code tilewriter_put(struct tilewriter *w, size_t i, struct store_entry *t,
                             const struct gauss *g, struct err *e)
{
    struct buf payload = {0};
    enum err_code rc = store_encode(w->store, t, g, &payload, e);
    if (rc) {
        buf_free(&payload);
        return rc;
    }
    pthread_mutex_lock(&w->lock);
    while (!w->failed && i >= w->next + TILEWRITER_AHEAD)
        pthread_cond_wait(&w->moved, &w->lock);
    if (w->failed) {
        rc = err_set(e, ERR_CANCEL, "another tile failed");
    } else {
        struct tilewriter_slot *s = &w->slot[i % TILEWRITER_AHEAD];
        s->full = true;
        s->tile = *t;
        s->payload = payload;
        payload = (struct buf){0};
        rc = tilewriter_drain(w, e);
    }
    pthread_mutex_unlock(&w->lock);
    buf_free(&payload);
    return rc;
}

void tilewriter_fail(struct tilewriter *w)
{
    pthread_mutex_lock(&w->lock);
    w->failed = true;
    pthread_cond_broadcast(&w->moved);
    pthread_mutex_unlock(&w->lock);
}
