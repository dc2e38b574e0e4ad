/* Tables of named appearances: see named_appearance_table.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/named_appearance_table.h"

#include <stdlib.h>
#include <string.h>

#include "server/base/text.h"
#include "server/route/param.h"

static int named_appearance_table_compare(const void *pa, const void *pb)
{
    const struct named_appearance_row *a = pa, *b = pb;
    int order = strcmp(a->ds, b->ds);
    return order ? order : strcmp(a->name, b->name);
}

struct named_appearance_table *named_appearance_table_alloc(size_t n)
{
    struct named_appearance_table *t = mem_array(1, sizeof *t);
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

struct named_appearance_table *named_appearance_ref(struct named_appearance_table *t)
{
    if (t)
        atomic_fetch_add(&t->refs, 1);
    return t;
}

void named_appearance_drop(struct named_appearance_table **out)
{
    struct named_appearance_table *t = *out;
    *out = NULL;
    if (!t || atomic_fetch_sub(&t->refs, 1) != 1)
        return;
    mem_free(t->row);
    mem_free(t);
}

/* Where a name is, or would be put. */
static size_t named_appearance_table_place(const struct named_appearance_table *t, const char *ds,
                                           const char *name)
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

const struct named_appearance_row *named_appearance_find(const struct named_appearance_table *t,
                                                         const char *ds, const char *name)
{
    if (!t)
        return NULL;
    const size_t at = named_appearance_table_place(t, ds, name);
    const bool is = at < t->n && !strcmp(t->row[at].ds, ds) && !strcmp(t->row[at].name, name);
    return is ? &t->row[at] : NULL;
}

size_t named_appearance_of(const struct named_appearance_table *t, const char *ds,
                           const struct named_appearance_row **first)
{
    size_t n = 0;
    if (!t)
        return 0;
    const size_t at = named_appearance_table_place(t, ds, "");
    while (at + n < t->n && !strcmp(t->row[at + n].ds, ds))
        n++;
    *first = t->row + at;
    return n;
}

static struct hash128 named_appearance_table_row_hash(const struct named_appearance_row *row)
{
    const struct {
        struct hash128 text, model;
    } is = {hash_bytes(row->text, strlen(row->text)), row->model};
    return hash_bytes(&is, sizeof is);
}

struct hash128 named_appearance_hash(const struct named_appearance_table *t, const char *ds)
{
    const struct named_appearance_row *row = NULL;
    const size_t n = named_appearance_of(t, ds, &row);
    struct hash128 all = {0};
    for (size_t i = 0; i < n; i++) {
        const struct hash128 part[3] = {all, hash_bytes(row[i].name, strlen(row[i].name)),
                                        named_appearance_table_row_hash(&row[i])};
        all = hash_bytes(part, sizeof part);
    }
    return all;
}

void named_appearance_etag(const struct named_appearance_row *row, char out[BODY_ETAG_SIZE])
{
    body_etag(named_appearance_table_row_hash(row), out);
}

void named_appearance_table_sort(struct named_appearance_table *t)
{
    qsort(t->row, t->n, sizeof *t->row, named_appearance_table_compare);
}

struct named_appearance_table *named_appearance_table_change(const struct named_appearance_table *t,
                                                             const char *ds, const char *name,
                                                             const struct named_appearance_row *row)
{
    const size_t at = named_appearance_table_place(t, ds, name),
                 replaces = named_appearance_find(t, ds, name) != NULL, after = at + replaces;
    struct named_appearance_table *out = named_appearance_table_alloc(t->n + 1);
    if (!out)
        return NULL;
    memcpy(out->row, t->row, at * sizeof *t->row);
    if (row)
        out->row[at] = *row;
    memcpy(out->row + at + (row != NULL), t->row + after, (t->n - after) * sizeof *t->row);
    out->n = t->n - replaces + (row != NULL);
    return out;
}

bool named_appearance_table_row_ok(const struct named_appearance_row *row)
{
    return row->ds[0] && row->text[0] && text_is_utf8(row->ds) && text_is_utf8(row->text) &&
           param_is_kept_name(row->name);
}
