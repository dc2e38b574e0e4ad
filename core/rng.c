/* Random numbers as a function of (seed, stream, index). There is no state, so results do not
 * depend on the order of calls. Each input is mixed in by the finaliser of SplitMix64 (Steele, Lea,
 * Flood: Fast Splittable Pseudorandom Number Generators, 2014; constants of Stafford's variant 13).
 * It is a bijection with full avalanche.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "core/base.h"

static uint64_t rng_mix(uint64_t x)
{
    x ^= x >> 30;
    x *= UINT64_C(0xbf58476d1ce4e5b9);
    x ^= x >> 27;
    x *= UINT64_C(0x94d049bb133111eb);
    x ^= x >> 31;
    return x;
}

uint64_t rng_u64(uint64_t seed, uint64_t stream, uint64_t index)
{
    const uint64_t golden = UINT64_C(0x9e3779b97f4a7c15);
    uint64_t h = rng_mix(seed + golden);
    h = rng_mix(h + stream * golden + golden);
    return rng_mix(h + index * golden + golden);
}

double rng_unit(uint64_t seed, uint64_t stream, uint64_t index)
{
    return (double)(rng_u64(seed, stream, index) >> 11) * 0x1p-53;
}

double rng_normal(uint64_t seed, uint64_t stream, uint64_t index)
{
    const double two_pi = 6.283185307179586;
    double u = 1.0 - rng_unit(seed, stream, 2 * index); /* (0, 1] */
    double v = rng_unit(seed, stream, 2 * index + 1);
    return sqrt(-2.0 * log(u)) * cos(two_pi * v);
}
