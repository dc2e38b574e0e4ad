/* Radix sort by 64-bit keys, lowest digit first. It is stable, takes time linear in the number of
 * rows, and gives the same order on every machine. Digits that are equal in all rows are skipped.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SORT_H
#define CORE_SORT_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

struct sort_item {
    uint64_t key;
    uint32_t row;
};

/* Sorts by key, ascending and stable. `scratch` has room for n items. The result is in `items`. */
void sort_items(struct sort_item *items, struct sort_item *scratch, size_t n);
/* Sorts words by their upper 32 bits, ascending and stable. The lower 32 bits are free for the
 * caller. A word takes half the memory of a struct sort_item. `scratch` has room for n words. */
void sort_words(uint64_t *words, uint64_t *scratch, size_t n);
/* Sorts values, ascending, without other memory: -0 before 0, NaN first or last by its sign. */
void sort_doubles(double *v, size_t n);
/* The median. For an even n it is the mean of the middle two, for n = 0 it is 0. It sorts v. */
double sort_median(double *v, size_t n);
/* The k-th smallest of x[n], k < n. It changes the order of x. If x has NaN, it may return any
 * value. */
float sort_select(float *x, size_t n, size_t k);
/* A key that grows with x, for negative numbers and infinities too. */
static inline uint64_t sort_key_float(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits ^ (bits >> 31 ? UINT32_MAX : UINT32_C(0x80000000));
}
/* Spreads the low 21 bits of x, with two zero bits after each: one axis of a Morton code. */
uint64_t sort_spread3(uint64_t x);

/* Position of the cell (x, y, z) along a Hilbert curve through a cube of 2^21 cells an edge. Cells
 * that follow each other on the curve share a face. Compact Hilbert indices, Hamilton (2006), as an
 * automaton. */
enum { SORT_HILBERT_STATES = 24 };
struct sort_hilbert { /* [state][octant]: position of the octant, and the state inside it */
    uint8_t place[SORT_HILBERT_STATES][8], next[SORT_HILBERT_STATES][8];
};
void sort_hilbert_init(struct sort_hilbert *h);
uint64_t sort_hilbert_key(const struct sort_hilbert *h, const uint32_t cell[3]);

#endif
