/* Loops for wider vectors where the machine has them, chosen when the program is loaded.
 *
 * SIMD_WIDE before a function makes two of it: one for any processor of the architecture and one
 * for x86-64-v3 (AVX2 and half floats in hardware). Sums are not reordered and nothing is fused
 * (-ffp-contract=off), so both give the same bits. Helpers that such a function calls must be
 * inlined into it to gain anything. Sanitizers do not go with functions chosen at load time,
 * and clang before 18 does not link them: such builds have the plain functions alone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SIMD_H
#define CORE_SIMD_H

#include <limits.h> /* glibc says here that it is glibc */

#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) ||                         \
    __has_feature(memory_sanitizer)
#define SIMD_NO_WIDE
#endif
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SIMD_NO_WIDE
#endif

/* clang before 18 gives the chosen function the name NAME.ifunc, and other files ask for NAME. */
#if defined(__clang__) && __clang_major__ < 18
#define SIMD_NO_WIDE
#endif

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GLIBC__) && !defined(SIMD_NO_WIDE)
#define SIMD_WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define SIMD_WIDE
#endif
/* Bytes that are needed soon, from places that no prefetcher guesses. */
#define SIMD_SOON(p) __builtin_prefetch(p, 0, 2)
#define SIMD_INLINE static inline __attribute__((always_inline))

#endif
