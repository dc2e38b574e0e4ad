/* Encoded results in memory, limited in bytes. There are sixteen shards. Each is a hash table with
 * two LRU lists (segmented LRU: Karedla, Love, Wherry 1994). A new entry is on probation, and a
 * second hit protects it. When more than four fifths are protected, the oldest fall back on
 * probation. One scan of the city therefore cannot push out popular tiles. Bodies are counted, so
 * an evicted one lives until it is sent. A shard has one mutex, held for a few pointer operations;
 * bodies are dropped after it is released.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/cache.h"

#include <pthread.h>
#include <string.h>

enum { SHARDS = 16, BUCKETS_MIN = 64 };

struct entry {
    struct hash128 key;
    struct body *body;
    struct entry *bucket_next;
    struct entry *newer, *older; /* in its list */
    size_t cost;
    bool protected;
};
struct list {
    struct entry *newest, *oldest;
    size_t cost;
};
struct shard { /* everything by `lock` */
    pthread_mutex_t lock;
    struct entry **bucket;
    size_t n_buckets, n;
    struct list probation, protected;
    uint64_t hits, misses, evictions;
};
struct cache {
    size_t shard_limit;
    _Atomic size_t bytes;
    struct shard shard[SHARDS];
};

static void cache_list_remove(struct list *l, struct entry *x)
{
    *(x->newer ? &x->newer->older : &l->newest) = x->older;
    *(x->older ? &x->older->newer : &l->oldest) = x->newer;
    x->newer = x->older = NULL;
    l->cost -= x->cost;
}

static void cache_list_add(struct list *l, struct entry *x)
{
    x->older = l->newest;
    x->newer = NULL;
    *(l->newest ? &l->newest->newer : &l->oldest) = x;
    l->newest = x;
    l->cost += x->cost;
}

static struct entry **cache_bucket_find(struct shard *s, struct hash128 key)
{
    struct entry **p = &s->bucket[key.lo & (s->n_buckets - 1)];
    while (*p && ((*p)->key.lo != key.lo || (*p)->key.hi != key.hi))
        p = &(*p)->bucket_next;
    return p;
}

/* Twice the buckets when entries outnumber them; staying small is allowed when memory is short. */
static void cache_bucket_grow(struct shard *s)
{
    size_t n = s->n_buckets * 2;
    struct entry **bigger = mem_array(n, sizeof(struct entry *));
    if (!bigger)
        return;
    for (size_t i = 0; i < s->n_buckets; i++)
        for (struct entry *x = s->bucket[i], *next; x; x = next) {
            next = x->bucket_next;
            x->bucket_next = bigger[x->key.lo & (n - 1)];
            bigger[x->key.lo & (n - 1)] = x;
        }
    mem_free(s->bucket);
    s->bucket = bigger;
    s->n_buckets = n;
}

enum err_code cache_open(size_t limit_bytes, struct cache **out, struct err *e)
{
    struct cache *c = mem_array(1, sizeof *c);
    *out = c;
    if (!c)
        return err_set(e, ERR_MEM, "cache of %zu MB: its table: out of memory", limit_bytes >> 20);
    c->shard_limit = limit_bytes / SHARDS;
    for (int i = 0; i < SHARDS; i++) {
        struct shard *s = &c->shard[i];
        pthread_mutex_init(&s->lock, NULL);
        s->n_buckets = BUCKETS_MIN;
        s->bucket = mem_array(BUCKETS_MIN, sizeof(struct entry *));
        if (!s->bucket) {
            cache_close(out);
            return err_set(e, ERR_MEM, "cache of %zu MB: part %d of its table: out of memory",
                           limit_bytes >> 20, i);
        }
    }
    return ERR_OK;
}

static void cache_list_free(struct list *l)
{
    for (struct entry *x = l->newest, *older; x; x = older) {
        older = x->older;
        body_drop(&x->body);
        mem_free(x);
    }
}

void cache_close(struct cache **out)
{
    struct cache *c = *out;
    *out = NULL;
    if (!c)
        return;
    for (int i = 0; i < SHARDS && c->shard[i].bucket; i++) {
        cache_list_free(&c->shard[i].probation);
        cache_list_free(&c->shard[i].protected);
        mem_free(c->shard[i].bucket);
        pthread_mutex_destroy(&c->shard[i].lock);
    }
    mem_free(c);
}

/* The other half of the key chooses the shard, so shards and buckets are independent. */
static struct shard *cache_shard_of(struct cache *c, struct hash128 key)
{
    return &c->shard[key.hi >> 60];
}

struct body *cache_get(struct cache *c, struct hash128 key, bool *again)
{
    struct shard *s = cache_shard_of(c, key);
    struct body *body = NULL;
    pthread_mutex_lock(&s->lock);
    struct entry *x = *cache_bucket_find(s, key);
    if (x) {
        s->hits++;
        if (again)
            *again = !x->protected;
        cache_list_remove(x->protected ? &s->protected : &s->probation, x);
        x->protected = true;
        cache_list_add(&s->protected, x);
        while (s->protected.cost > c->shard_limit / 5 * 4 && s->protected.oldest != x) {
            struct entry *fall = s->protected.oldest;
            cache_list_remove(&s->protected, fall);
            fall->protected = false;
            cache_list_add(&s->probation, fall);
        }
        body = body_ref(x->body);
    } else {
        s->misses++;
    }
    pthread_mutex_unlock(&s->lock);
    return body;
}

/* Take x out of the shard and put it in front of the caller's list of things to free. */
static void cache_shard_remove(struct shard *s, struct entry *x, struct entry **freed)
{
    *cache_bucket_find(s, x->key) = x->bucket_next;
    cache_list_remove(x->protected ? &s->protected : &s->probation, x);
    s->n--;
    x->bucket_next = *freed;
    *freed = x;
}

/* What was taken out. Not under the lock. */
static void cache_free_list(struct cache *c, struct entry *freed)
{
    size_t cost = 0;
    for (struct entry *next; freed; freed = next) {
        next = freed->bucket_next;
        cost += freed->cost;
        body_drop(&freed->body);
        mem_free(freed);
    }
    atomic_fetch_sub(&c->bytes, cost);
}

void cache_put(struct cache *c, struct hash128 key, struct body *b)
{
    struct shard *s = cache_shard_of(c, key);
    size_t cost = body_cost(b);
    struct entry *x = cost > c->shard_limit ? NULL : mem_array(1, sizeof *x);
    if (!x)
        return;
    x->key = key;
    x->body = body_ref(b);
    x->cost = cost;
    struct entry *freed = NULL;
    pthread_mutex_lock(&s->lock);
    struct entry *old = *cache_bucket_find(s, key);
    if (old)
        cache_shard_remove(s, old, &freed);
    while (s->probation.cost + s->protected.cost + cost > c->shard_limit) {
        struct entry *victim = s->probation.oldest ? s->probation.oldest : s->protected.oldest;
        cache_shard_remove(s, victim, &freed);
        s->evictions++;
    }
    if (s->n >= s->n_buckets)
        cache_bucket_grow(s);
    struct entry **p = &s->bucket[key.lo & (s->n_buckets - 1)];
    x->bucket_next = *p;
    *p = x;
    s->n++;
    cache_list_add(&s->probation, x);
    atomic_fetch_add(&c->bytes, cost);
    pthread_mutex_unlock(&s->lock);
    cache_free_list(c, freed);
}

/* The oldest of one shard, as long as that gives something. Bytes. */
static size_t cache_shard_yield(struct shard *s, size_t bytes, struct entry **freed)
{
    size_t got = 0;
    while (got < bytes) {
        struct entry *victim = s->probation.oldest ? s->probation.oldest : s->protected.oldest;
        if (!victim)
            break;
        got += victim->cost;
        cache_shard_remove(s, victim, freed);
        s->evictions++;
    }
    return got;
}

size_t cache_yield(struct cache *c, size_t bytes)
{
    size_t got = 0;
    /* A part of each shard, and what is missing then of any. */
    for (int k = 0; k < 2 * SHARDS && got < bytes; k++) {
        struct shard *s = &c->shard[k % SHARDS];
        struct entry *freed = NULL;
        if (pthread_mutex_trylock(&s->lock))
            continue;
        got += cache_shard_yield(s, k < SHARDS ? bytes / SHARDS + 1 : bytes - got, &freed);
        pthread_mutex_unlock(&s->lock);
        cache_free_list(c, freed);
    }
    return got;
}

size_t cache_bytes(const struct cache *c)
{
    return atomic_load(&c->bytes);
}

void cache_count(struct cache *c, struct cache_stats *out)
{
    memset(out, 0, sizeof *out);
    for (int i = 0; i < SHARDS; i++) {
        struct shard *s = &c->shard[i];
        pthread_mutex_lock(&s->lock);
        out->hits += s->hits;
        out->misses += s->misses;
        out->evictions += s->evictions;
        out->entries += s->n;
        out->bytes += s->probation.cost + s->protected.cost;
        pthread_mutex_unlock(&s->lock);
    }
}
