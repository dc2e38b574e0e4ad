/* A hash table of live bodies, without references of its own. A body whose last reference is
 * dropped removes itself (body.gone) before it is freed. In between, live_bodies_get may still find
 * it without references. It takes a reference only if there is one already, under the lock that the
 * body needs for its removal.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/live_bodies.h"

#include <assert.h>
#include <pthread.h>

enum { LIVE_BODIES_BUCKETS = 4096 };

struct live_bodies {
    size_t limit;
    _Atomic size_t bytes, reserved;
    pthread_mutex_t lock; /* of the table, and of live_bodies_next and flight in bodies */
    struct body *bucket[LIVE_BODIES_BUCKETS];
};

enum err_code live_bodies_open(size_t limit_bytes, struct live_bodies **out, struct err *e)
{
    struct live_bodies *f = mem_array(1, sizeof *f);
    *out = f;
    if (!f)
        return err_set(e, ERR_MEM, "bodies in flight: out of memory");
    f->limit = limit_bytes;
    pthread_mutex_init(&f->lock, NULL);
    return ERR_OK;
}

void live_bodies_close(struct live_bodies **out)
{
    struct live_bodies *f = *out;
    *out = NULL;
    if (!f)
        return;
    assert(!atomic_load(&f->bytes));
    pthread_mutex_destroy(&f->lock);
    mem_free(f);
}

static void live_bodies_gone(struct body *b)
{
    struct live_bodies *f = b->live_bodies;
    pthread_mutex_lock(&f->lock);
    struct body **p = &f->bucket[b->id.lo % LIVE_BODIES_BUCKETS];
    while (*p != b)
        p = &(*p)->live_bodies_next;
    *p = b->live_bodies_next;
    pthread_mutex_unlock(&f->lock);
    atomic_fetch_sub(&f->bytes, body_cost(b));
}

struct body *live_bodies_get(struct live_bodies *f, struct hash128 id)
{
    struct body *found = NULL;
    pthread_mutex_lock(&f->lock);
    for (struct body *b = f->bucket[id.lo % LIVE_BODIES_BUCKETS]; b && !found;
         b = b->live_bodies_next)
        if (b->id.lo == id.lo && b->id.hi == id.hi && body_revive(b))
            found = b;
    pthread_mutex_unlock(&f->lock);
    return found;
}

void live_bodies_add(struct live_bodies *f, struct hash128 id, struct body *b)
{
    b->id = id;
    b->live_bodies = f;
    b->gone = live_bodies_gone;
    atomic_fetch_add(&f->bytes, body_cost(b));
    pthread_mutex_lock(&f->lock);
    b->live_bodies_next = f->bucket[id.lo % LIVE_BODIES_BUCKETS];
    f->bucket[id.lo % LIVE_BODIES_BUCKETS] = b;
    pthread_mutex_unlock(&f->lock);
}

enum err_code live_bodies_reserve(struct live_bodies *f, size_t bytes, size_t cached, struct err *e)
{
    size_t others = atomic_fetch_add(&f->reserved, bytes), alive = atomic_load(&f->bytes);
    size_t held = others + (alive > cached ? alive - cached : 0);
    if (!held || held + bytes <= f->limit)
        return ERR_OK;
    live_bodies_release(f, bytes);
    return err_set(e, ERR_BUSY,
                   "the answers on their way to slow readers leave no memory for another one");
}

void live_bodies_release(struct live_bodies *f, size_t bytes)
{
    atomic_fetch_sub(&f->reserved, bytes);
}

size_t live_bodies_held(const struct live_bodies *f, size_t cached)
{
    size_t alive = atomic_load(&f->bytes);
    return atomic_load(&f->reserved) + (alive > cached ? alive - cached : 0);
}

size_t live_bodies_limit(const struct live_bodies *f)
{
    return f->limit;
}

size_t live_bodies_bytes(const struct live_bodies *f)
{
    return atomic_load(&f->bytes);
}
