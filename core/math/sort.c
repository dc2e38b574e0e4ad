/* Radix sort, 11 bits a pass: see sort.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/math/sort.h"

#include <string.h>

enum { SORT_BITS = 11, SORT_BINS = 1 << SORT_BITS, SORT_FEW = 48 };

static void sort_insertion(struct sort_item *items, size_t n)
{
    for (size_t i = 1; i < n; i++) {
        struct sort_item x = items[i];
        size_t at = i;
        for (; at > 0 && items[at - 1].key > x.key; at--)
            items[at] = items[at - 1];
        items[at] = x;
    }
}

/* Where each digit's items begin, from how many there are. */
static void sort_offsets(uint32_t count[SORT_BINS])
{
    uint32_t sum = 0;
    for (size_t b = 0; b < SORT_BINS; b++) {
        uint32_t n = count[b];
        count[b] = sum;
        sum += n;
    }
}

static void sort_pass(const struct sort_item *from, struct sort_item *to, size_t n, unsigned shift)
{
    size_t at[SORT_BINS] = {0}, sum = 0;
    for (size_t i = 0; i < n; i++)
        at[from[i].key >> shift & (SORT_BINS - 1)]++;
    for (size_t b = 0; b < SORT_BINS; b++) {
        size_t count = at[b];
        at[b] = sum;
        sum += count;
    }
    for (size_t i = 0; i < n; i++)
        to[at[from[i].key >> shift & (SORT_BINS - 1)]++] = from[i];
}

void sort_items(struct sort_item *items, struct sort_item *scratch, size_t n)
{
    if (n <= SORT_FEW) {
        sort_insertion(items, n);
        return;
    }
    uint64_t differ = 0;
    for (size_t i = 1; i < n; i++)
        differ |= items[i].key ^ items[0].key;
    struct sort_item *from = items, *to = scratch;
    for (unsigned shift = 0; shift < 64; shift += SORT_BITS) {
        if (!(differ >> shift & (SORT_BINS - 1)))
            continue;
        sort_pass(from, to, n, shift);
        struct sort_item *swap = from;
        from = to;
        to = swap;
    }
    if (from != items)
        memcpy(items, from, n * sizeof *items);
}

/* Three digits of the upper half: all are counted in one pass. */
void sort_words(uint64_t *words, uint64_t *scratch, size_t n)
{
    enum { DIGITS = 3, LOW = 32 };
    uint32_t at[DIGITS][SORT_BINS] = {{0}};
    for (size_t i = 0; i < n; i++)
        for (unsigned d = 0; d < DIGITS; d++)
            at[d][words[i] >> (LOW + SORT_BITS * d) & (SORT_BINS - 1)]++;
    uint64_t *from = words, *to = scratch;
    for (unsigned d = 0; d < DIGITS && n > 0; d++) {
        unsigned shift = LOW + SORT_BITS * d;
        if (at[d][words[0] >> shift & (SORT_BINS - 1)] == n)
            continue; /* all alike */
        sort_offsets(at[d]);
        for (size_t i = 0; i < n; i++)
            to[at[d][from[i] >> shift & (SORT_BINS - 1)]++] = from[i];
        uint64_t *swap = from;
        from = to;
        to = swap;
    }
    if (from != words)
        memcpy(words, from, n * sizeof *words);
}

/* Bits that grow with x as an unsigned number, and back. */
static uint64_t sort_key_double(uint64_t bits)
{
    return bits ^ (bits >> 63 ? UINT64_MAX : UINT64_C(1) << 63);
}

static uint64_t sort_double_of_key(uint64_t key)
{
    return key ^ (key >> 63 ? UINT64_C(1) << 63 : UINT64_MAX);
}

/* While they are sorted, the doubles' memory holds keys. */
static uint64_t sort_get(const double *v)
{
    uint64_t key;
    memcpy(&key, v, sizeof key);
    return key;
}

static void sort_put(double *v, uint64_t key)
{
    memcpy(v, &key, sizeof key);
}

static void sort_few_keys(double *v, size_t n)
{
    for (size_t i = 1; i < n; i++) {
        const uint64_t x = sort_get(v + i);
        size_t at = i;
        for (; at > 0 && sort_get(v + at - 1) > x; at--)
            sort_put(v + at, sort_get(v + at - 1));
        sort_put(v + at, x);
    }
}

/* In place, highest digit first ("American flag", McIlroy and others 1993): each key is swapped
 * into its bin until the bins are full, then each bin is sorted by the next digit. */
static void sort_keys(double *v, size_t n, unsigned shift)
{
    enum { BITS = 8, BINS = 1 << BITS };
    size_t next[BINS], end[BINS] = {0}, sum = 0;
    if (n <= SORT_FEW) {
        sort_few_keys(v, n);
        return;
    }
    for (size_t i = 0; i < n; i++)
        end[sort_get(v + i) >> shift & (BINS - 1)]++;
    for (size_t b = 0; b < BINS; b++) {
        next[b] = sum;
        sum += end[b];
        end[b] = sum;
    }
    for (size_t b = 0; b < BINS; b++)
        while (next[b] < end[b]) {
            uint64_t key = sort_get(v + next[b]);
            size_t to = key >> shift & (BINS - 1);
            for (; to != b; to = key >> shift & (BINS - 1)) {
                const uint64_t other = sort_get(v + next[to]);
                sort_put(v + next[to]++, key);
                key = other;
            }
            sort_put(v + next[b]++, key);
        }
    for (size_t b = 0; shift && b < BINS; b++) {
        const size_t from = b ? end[b - 1] : 0;
        if (end[b] - from > 1)
            sort_keys(v + from, end[b] - from, shift - BITS);
    }
}

void sort_doubles(double *v, size_t n)
{
    for (size_t i = 0; i < n; i++)
        sort_put(v + i, sort_key_double(sort_get(v + i)));
    sort_keys(v, n, 56);
    for (size_t i = 0; i < n; i++)
        sort_put(v + i, sort_double_of_key(sort_get(v + i)));
}

double sort_median(double *v, size_t n)
{
    if (!n)
        return 0;
    sort_doubles(v, n);
    return n % 2 ? v[n / 2] : 0.5 * (v[n / 2 - 1] + v[n / 2]);
}

/* Hoare's selection, about the median of three. */
float sort_select(float *x, size_t n, size_t k)
{
    size_t lo = 0, hi = n - 1;
    while (lo < hi) {
        float a = x[lo], b = x[lo + (hi - lo) / 2], c = x[hi];
        float least = a < b ? a : b, most = a < b ? b : a;
        float pivot = c < least ? least : c > most ? most : c;
        size_t i = lo, j = hi;
        for (;; i++, j--) { /* a median is never alone at the end, so j ends below hi */
            while (x[i] < pivot)
                i++;
            while (x[j] > pivot)
                j--;
            if (i >= j)
                break;
            float t = x[i];
            x[i] = x[j];
            x[j] = t;
        }
        if (k <= j)
            hi = j;
        else
            lo = j + 1;
    }
    return x[k];
}

uint64_t sort_spread3(uint64_t x)
{
    x &= 0x1fffff;
    x = (x | x << 32) & UINT64_C(0x1f00000000ffff);
    x = (x | x << 16) & UINT64_C(0x1f0000ff0000ff);
    x = (x | x << 8) & UINT64_C(0x100f00f00f00f00f);
    x = (x | x << 4) & UINT64_C(0x10c30c30c30c30c3);
    return (x | x << 2) & UINT64_C(0x1249249249249249);
}

static unsigned sort_hilbert_rotate(unsigned x, unsigned left)
{
    left %= 3;
    return (x << left | x >> (3 - left)) & 7;
}

/* Ones at the end of x. */
static unsigned sort_hilbert_ones(unsigned x)
{
    unsigned n = 0;
    while (x >> n & 1)
        n++;
    return n;
}

/* A state is where the curve enters a cube (a corner, e) and along which axis it leaves (d). */
void sort_hilbert_init(struct sort_hilbert *h)
{
    for (unsigned state = 0; state < SORT_HILBERT_STATES; state++)
        for (unsigned octant = 0; octant < 8; octant++) {
            unsigned e = state / 3, d = state % 3;
            unsigned gray = sort_hilbert_rotate(octant ^ e, 3 - (d + 1) % 3);
            unsigned w = gray ^ gray >> 1 ^ gray >> 2, even = w ? (w - 1) & ~1u : 0;
            unsigned enter = even ^ even >> 1;
            unsigned axis = w == 0 ? 0 : sort_hilbert_ones(w & 1 ? w : w - 1) % 3;
            h->place[state][octant] = (uint8_t)w;
            h->next[state][octant] =
                (uint8_t)((e ^ sort_hilbert_rotate(enter, d + 1)) * 3 + (d + axis + 1) % 3);
        }
}

uint64_t sort_hilbert_key(const struct sort_hilbert *h, const uint32_t cell[3])
{
    uint64_t key = 0;
    unsigned state = 0;
    for (int bit = 20; bit >= 0; bit--) {
        unsigned octant =
            (cell[0] >> bit & 1) | (cell[1] >> bit & 1) << 1 | (cell[2] >> bit & 1) << 2;
        key = key << 3 | h->place[state][octant];
        state = h->next[state][octant];
    }
    return key;
}
