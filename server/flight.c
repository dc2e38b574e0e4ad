/* A hash table of live bodies, without references of its own. A body whose last reference is
 * dropped removes itself (body.gone) before it is freed. In between, flight_get may still find it
 * without references. It takes a reference only if there is one already, under the lock that the
 * body needs for its removal.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/flight.h"

#include <assert.h>
#include <pthread.h>

enum { FLIGHT_BUCKETS = 4096 };

struct flight {
    size_t limit;
    _Atomic size_t bytes, reserved;
    pthread_mutex_t lock; /* of the table, and of flight_next and flight in bodies */
    struct body *bucket[FLIGHT_BUCKETS];
};

enum err_code flight_open(size_t limit_bytes, struct flight **out, struct err *e)
{
    struct flight *f = mem_array(1, sizeof *f);
    *out = f;
    if (!f)
        return err_set(e, ERR_MEM, "bodies in flight: out of memory");
    f->limit = limit_bytes;
    pthread_mutex_init(&f->lock, NULL);
    return ERR_OK;
}

void flight_close(struct flight **out)
{
    struct flight *f = *out;
    *out = NULL;
    if (!f)
        return;
    assert(!atomic_load(&f->bytes));
    pthread_mutex_destroy(&f->lock);
    mem_free(f);
}

static void flight_gone(struct body *b)
{
    struct flight *f = b->flight;
    pthread_mutex_lock(&f->lock);
    struct body **p = &f->bucket[b->id.lo % FLIGHT_BUCKETS];
    while (*p != b)
        p = &(*p)->flight_next;
    *p = b->flight_next;
    pthread_mutex_unlock(&f->lock);
    atomic_fetch_sub(&f->bytes, body_cost(b));
}

struct body *flight_get(struct flight *f, struct hash128 id)
{
    struct body *found = NULL;
    pthread_mutex_lock(&f->lock);
    for (struct body *b = f->bucket[id.lo % FLIGHT_BUCKETS]; b && !found; b = b->flight_next)
        if (b->id.lo == id.lo && b->id.hi == id.hi && body_revive(b))
            found = b;
    pthread_mutex_unlock(&f->lock);
    return found;
}

void flight_add(struct flight *f, struct hash128 id, struct body *b)
{
    b->id = id;
    b->flight = f;
    b->gone = flight_gone;
    atomic_fetch_add(&f->bytes, body_cost(b));
    pthread_mutex_lock(&f->lock);
    b->flight_next = f->bucket[id.lo % FLIGHT_BUCKETS];
    f->bucket[id.lo % FLIGHT_BUCKETS] = b;
    pthread_mutex_unlock(&f->lock);
}

enum err_code flight_reserve(struct flight *f, size_t bytes, size_t cached, struct err *e)
{
    size_t others = atomic_fetch_add(&f->reserved, bytes), alive = atomic_load(&f->bytes);
    size_t held = others + (alive > cached ? alive - cached : 0);
    if (!held || held + bytes <= f->limit)
        return ERR_OK;
    flight_release(f, bytes);
    return err_set(e, ERR_BUSY,
                   "the answers on their way to slow readers leave no memory for another one");
}

void flight_release(struct flight *f, size_t bytes)
{
    atomic_fetch_sub(&f->reserved, bytes);
}

size_t flight_held(const struct flight *f, size_t cached)
{
    size_t alive = atomic_load(&f->bytes);
    return atomic_load(&f->reserved) + (alive > cached ? alive - cached : 0);
}

size_t flight_limit(const struct flight *f)
{
    return f->limit;
}

size_t flight_bytes(const struct flight *f)
{
    return atomic_load(&f->bytes);
}
