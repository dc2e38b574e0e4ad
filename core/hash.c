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
