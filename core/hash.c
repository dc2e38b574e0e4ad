/* Content hashes: XXH3-128 by libxxhash.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include <xxhash.h>

#include "core/base.h"

struct hash128 hash_bytes(const void *bytes, size_t n)
{
    XXH128_hash_t h = XXH3_128bits(bytes, n);
    return (struct hash128){.lo = h.low64, .hi = h.high64};
}

void hash_text(struct hash128 h, char out[33])
{
    snprintf(out, 33, "%016llx%016llx", (unsigned long long)h.hi, (unsigned long long)h.lo);
}

/* XXH3's state under our name: a struct of that library never shows in a header of ours. */
struct hash_state *hash_begin(void)
{
    XXH3_state_t *x = XXH3_createState();
    if (x)
        XXH3_128bits_reset(x);
    return (struct hash_state *)x;
}

void hash_add(struct hash_state *s, const void *bytes, size_t n)
{
    if (s && n)
        XXH3_128bits_update((XXH3_state_t *)s, bytes, n);
}

struct hash128 hash_end(struct hash_state *s)
{
    if (!s)
        return (struct hash128){0};
    XXH128_hash_t h = XXH3_128bits_digest((XXH3_state_t *)s);
    XXH3_freeState((XXH3_state_t *)s);
    return (struct hash128){.lo = h.low64, .hi = h.high64};
}
