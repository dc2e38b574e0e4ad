/* Tables of named appearances: see kept_table.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/kept_table.h"

#include <stdlib.h>
#include <string.h>

#include "server/param.h"
#include "server/text.h"

static int kept_table_compare(const void *pa, const void *pb)
{
    const struct kept_row *a = pa, *b = pb;
    int order = strcmp(a->ds, b->ds);
    return order ? order : strcmp(a->name, b->name);
}

struct kept_table *kept_table_alloc(size_t n)
{
    struct kept_table *t = mem_array(1, sizeof *t);
    if (!t)
        return NULL;
    atomic_init(&t->refs, 1);
    t->row = mem_array(n ? n : 1, sizeof *t->row);
    if (!t->row) {
        mem_free(t);
        return NULL;
    }
    return t;
}

struct kept_table *kept_ref(struct kept_table *t)
{
    if (t)
        atomic_fetch_add(&t->refs, 1);
    return t;
}

void kept_drop(struct kept_table **out)
{
    struct kept_table *t = *out;
    *out = NULL;
    if (!t || atomic_fetch_sub(&t->refs, 1) != 1)
        return;
    mem_free(t->row);
    mem_free(t);
}

/* Where a name is, or would be put. */
static size_t kept_table_place(const struct kept_table *t, const char *ds, const char *name)
{
    size_t lo = 0, hi = t->n;
    while (lo < hi) {
        const size_t mid = lo + (hi - lo) / 2;
        int order = strcmp(t->row[mid].ds, ds);
        if (!order)
            order = strcmp(t->row[mid].name, name);
        if (order < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

const struct kept_row *kept_find(const struct kept_table *t, const char *ds, const char *name)
{
    if (!t)
        return NULL;
    const size_t at = kept_table_place(t, ds, name);
    const bool is = at < t->n && !strcmp(t->row[at].ds, ds) && !strcmp(t->row[at].name, name);
    return is ? &t->row[at] : NULL;
}

size_t kept_of(const struct kept_table *t, const char *ds, const struct kept_row **first)
{
    size_t n = 0;
    if (!t)
        return 0;
    const size_t at = kept_table_place(t, ds, "");
    while (at + n < t->n && !strcmp(t->row[at + n].ds, ds))
        n++;
    *first = t->row + at;
    return n;
}

static struct hash128 kept_table_row_hash(const struct kept_row *row)
{
    const struct {
        struct hash128 text, model;
    } is = {hash_bytes(row->text, strlen(row->text)), row->model};
    return hash_bytes(&is, sizeof is);
}

struct hash128 kept_hash(const struct kept_table *t, const char *ds)
{
    const struct kept_row *row = NULL;
    const size_t n = kept_of(t, ds, &row);
    struct hash128 all = {0};
    for (size_t i = 0; i < n; i++) {
        const struct hash128 part[3] = {all, hash_bytes(row[i].name, strlen(row[i].name)),
                                        kept_table_row_hash(&row[i])};
        all = hash_bytes(part, sizeof part);
    }
    return all;
}

void kept_etag(const struct kept_row *row, char out[BODY_ETAG_SIZE])
{
    body_etag(kept_table_row_hash(row), out);
}

void kept_table_sort(struct kept_table *t)
{
    qsort(t->row, t->n, sizeof *t->row, kept_table_compare);
}

struct kept_table *kept_table_change(const struct kept_table *t, const char *ds, const char *name,
                                     const struct kept_row *row)
{
    const size_t at = kept_table_place(t, ds, name), replaces = kept_find(t, ds, name) != NULL,
                 after = at + replaces;
    struct kept_table *out = kept_table_alloc(t->n + 1);
    if (!out)
        return NULL;
    memcpy(out->row, t->row, at * sizeof *t->row);
    if (row)
        out->row[at] = *row;
    memcpy(out->row + at + (row != NULL), t->row + after, (t->n - after) * sizeof *t->row);
    out->n = t->n - replaces + (row != NULL);
    return out;
}

bool kept_table_row_ok(const struct kept_row *row)
{
    return row->ds[0] && row->text[0] && text_is_utf8(row->ds) && text_is_utf8(row->text) &&
           param_is_kept_name(row->name);
}
