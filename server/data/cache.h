/* Encoded results in memory: a segmented LRU in 16 shards, limited in bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CACHE_H
#define SERVER_CACHE_H

#include "server/base/body.h"

struct cache;
struct cache_stats {
    uint64_t hits, misses, evictions, entries, bytes;
};
enum err_code cache_open(size_t limit_bytes, struct cache **out, struct err *e) ERR_USE;
void cache_close(struct cache **c);
/* Returns a reference to the body, or NULL. *again (may be NULL): it is protected from now on. Any
 * thread. */
struct body *cache_get(struct cache *c, struct hash128 key, bool *again);
/* Adds a body, and takes a reference. A body larger than a shard's budget is not kept. A newer body
 * replaces an older one. */
void cache_put(struct cache *c, struct hash128 key, struct body *b);
/* Drops the oldest entries until they are at least `bytes`, or all. It does not allocate and does
 * not wait: shards that another thread is using are left alone. Returns the bytes that were
 * dropped. Any thread. */
size_t cache_yield(struct cache *c, size_t bytes);
/* Memory of all its bodies (body_cost). Lock-free. */
size_t cache_bytes(const struct cache *c);
void cache_count(struct cache *c, struct cache_stats *out);

#endif
