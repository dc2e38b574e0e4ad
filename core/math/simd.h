/* Wider vectors for loops, where the processor has them. The choice is made when the program is
 * loaded.
 *
 * SIMD_WIDE before a function compiles it twice: for any processor of the architecture, and for
 * x86-64-v3 (AVX2 and half floats in hardware). Both give the same bits, because sums are not
 * reordered and multiply-adds are not fused (-ffp-contract=off). Helpers gain only if they are
 * inlined into such a function. Builds with sanitizers, and with clang before 18, have the first
 * version alone: sanitizers fail with functions chosen at load time, and older clang does not link
 * them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SIMD_H
#define CORE_SIMD_H

#include <limits.h> /* defines __GLIBC__ */

#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) ||                         \
    __has_feature(memory_sanitizer)
#define SIMD_NO_WIDE
#endif
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SIMD_NO_WIDE
#endif

/* clang before 18 names the chosen function NAME.ifunc, but other files refer to NAME. */
#if defined(__clang__) && __clang_major__ < 18
#define SIMD_NO_WIDE
#endif

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GLIBC__) && !defined(SIMD_NO_WIDE)
#define SIMD_WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define SIMD_WIDE
#endif
/* Prefetches bytes that are needed soon, where the hardware cannot foresee it. */
#define SIMD_SOON(p) __builtin_prefetch(p, 0, 2)
#define SIMD_INLINE static inline __attribute__((always_inline))

#endif
