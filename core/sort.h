/* Sorting by 64-bit keys in time linear in the number of rows: least significant digit first, so it
 * is stable and the same on every machine. Digits that are equal in all rows cost one look.
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

/* Ascending by key, equal keys in the order they came. `scratch` has room for n items; the result
 * is in `items`. */
void sort_items(struct sort_item *items, struct sort_item *scratch, size_t n);
/* Ascending by the upper half of each word, a key, and by where it stands among equals. Half the
 * size of items, and in the lower half whatever belongs to the key. `scratch` as above. */
void sort_words(uint64_t *words, uint64_t *scratch, size_t n);
/* Ascending by value. */
void sort_doubles(double *v, size_t n);
/* The median, of an even number the mean of the middle two, of none 0; v is sorted. */
double sort_median(double *v, size_t n);
/* The k-th smallest of x[n] by value, k < n; x is put into another order. Among NaN, any of x. */
float sort_select(float *x, size_t n, size_t k);
/* A key that ascends with x, negative numbers and infinities included. */
static inline uint64_t sort_key_float(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits ^ (bits >> 31 ? UINT32_MAX : UINT32_C(0x80000000));
}
/* Spread the low 21 bits of x so that two zero bits follow each: a third of a Morton code. */
uint64_t sort_spread3(uint64_t x);

/* Place along Hilbert's curve through a cube of 2^21 cells an edge, of the cell (x, y, z):
 * neighbours along the curve share a face. Compact Hilbert indices, Hamilton (2006), as an
 * automaton. */
enum { SORT_HILBERT_STATES = 24 };
struct sort_hilbert { /* [state][octant]: place of the octant among eight, state within it */
    uint8_t place[SORT_HILBERT_STATES][8], next[SORT_HILBERT_STATES][8];
};
void sort_hilbert_init(struct sort_hilbert *h);
uint64_t sort_hilbert_key(const struct sort_hilbert *h, const uint32_t cell[3]);

#endif
