/* Arrays in files: what is in memory, and what leaves it.
 *
 * A group of degree 3 is 3.8 kB in each array, so a page of memory holds about one. What a step is
 * about to touch is read ahead in runs of groups. What leaves memory is written first, all runs
 * before any is waited for.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/paged.h"

#include <string.h>

#include "core/base.h"
#include "render/permute.h"

enum {
    PAGED_GAP = 8,     /* groups between two listed ones that are read with them */
    PAGED_AGES = 1024, /* older than this many steps is all the same */
    PAGED_ROOM = 8     /* a part of so many is freed beyond what is needed at once */
};

uint64_t paged_disk_bytes(size_t n, uint32_t planes)
{
    return (uint64_t)(PAGED_ARRAYS + 1) * layout_floats(n, planes) * sizeof(float);
}

void paged_close(struct paged *s)
{
    for (size_t k = 0; k < PAGED_ARRAYS; k++)
        scratch_close(&s->file[k]);
    scratch_close(&s->spare);
    mem_free(s->seen);
    *s = (struct paged){.dir = s->dir, .most_bytes = s->most_bytes};
}

/* Nothing is known to be in memory, of n_groups from now on. */
static enum err_code paged_forget(struct paged *s, size_t n_groups, struct err *e)
{
    if (n_groups != s->n_groups) {
        mem_free(s->seen);
        s->seen = mem_array(n_groups, sizeof *s->seen);
        s->n_groups = s->seen ? n_groups : 0;
    } else {
        memset(s->seen, 0, n_groups * sizeof *s->seen);
    }
    s->n_held = s->walked = 0;
    s->clock = 0;
    return s->seen ? ERR_OK
                   : err_set(e, ERR_MEM, "out of memory for %zu groups of Gaussians", n_groups);
}

enum err_code paged_open(struct paged *s, struct dev *dev, size_t n_groups, uint32_t planes,
                         cl_mem *const arrays[PAGED_ARRAYS], struct err *e)
{
    s->dev = dev;
    s->group_bytes = (size_t)planes * LAYOUT_LANES * sizeof(float);
    enum err_code rc = paged_forget(s, n_groups, e);
    for (size_t k = 0; !rc && k < PAGED_ARRAYS; k++) {
        rc = scratch_open(s->dir, n_groups * s->group_bytes, &s->file[k], e);
        if (!rc)
            rc = dev_buffer_over(dev, s->file[k].at, s->file[k].n_bytes, arrays[k], e);
    }
    return rc ? err_add(e, "--memory") : ERR_OK;
}

enum err_code paged_zero(struct paged *s, size_t nth, struct err *e)
{
    enum err_code rc = dev_finish(s->dev, e);
    return rc ? rc : scratch_zero(&s->file[nth], e);
}

/* ---- what is in memory ---- */

static void paged_stream(struct paged *s, bool on)
{
    for (size_t k = 0; s->streams != on && k < PAGED_ARRAYS; k++)
        scratch_stream(&s->file[k], on);
    s->streams = on;
}

static void paged_each(const struct paged *s,
                       void (*fn)(const struct scratch *file, size_t from, size_t to), size_t from,
                       size_t to)
{
    for (size_t k = 0; k < PAGED_ARRAYS; k++)
        fn(&s->file[k], from * s->group_bytes, to * s->group_bytes);
}

/* Calls fn for the runs of groups in memory that were seen before `since`. Groups that are not in
 * memory do not end a run. Returns how many in memory these are. */
static size_t paged_runs(struct paged *s, uint32_t since,
                         void (*fn)(const struct scratch *file, size_t from, size_t to))
{
    size_t n = 0;
    for (size_t i = 0; i < s->n_groups;) {
        size_t from = i, held = 0;
        for (; i < s->n_groups && s->seen[i] < since; i++)
            held += s->seen[i] != 0;
        if (held)
            paged_each(s, fn, from, i);
        n += held;
        i += i < s->n_groups;
    }
    return n;
}

/* Those that were not seen for longest leave memory, until there is room for `n` groups. What the
 * present step has listed stays. */
static void paged_make_room(struct paged *s, size_t n)
{
    const size_t most = s->most_bytes / (PAGED_ARRAYS * s->group_bytes);
    size_t by_age[PAGED_AGES] = {0}, kept = 0, age = 0;
    if (s->n_held + n <= most)
        return;
    const size_t want = most - most / PAGED_ROOM, room = want > n ? want - n : 0;
    for (size_t i = 0; i < s->n_groups; i++)
        if (s->seen[i]) {
            size_t old = s->clock - s->seen[i];
            by_age[old < PAGED_AGES ? old : PAGED_AGES - 1]++;
        }
    for (kept = by_age[0]; age + 1 < PAGED_AGES && kept + by_age[age + 1] <= room; age++)
        kept += by_age[age + 1];
    const uint32_t since = s->clock > age ? s->clock - (uint32_t)age : 1;
    if (kept == s->n_held)
        return;
    (void)paged_runs(s, since, scratch_flush);
    const size_t gone = paged_runs(s, since, scratch_drop);
    for (size_t i = 0; i < s->n_groups; i++)
        if (s->seen[i] < since)
            s->seen[i] = 0;
    s->n_held -= gone;
    s->dropped += gone;
}

/* Reads [from, to) ahead, what of it is not in memory. */
static void paged_fetch(struct paged *s, size_t from, size_t to)
{
    while (from < to) {
        size_t first = from;
        for (; from < to && !s->seen[from]; from++)
            s->seen[from] = s->clock;
        if (from > first) {
            paged_each(s, scratch_fetch, first, from);
            s->n_held += from - first;
            s->fetched += from - first;
        }
        for (; from < to && s->seen[from]; from++)
            ;
    }
}

void paged_listed(void *user, const uint32_t *groups, size_t n)
{
    struct paged *s = user;
    size_t missing = 0;
    paged_stream(s, false);
    s->clock++;
    for (size_t i = 0; i < n; i++) {
        missing += !s->seen[groups[i]];
        s->seen[groups[i]] = s->seen[groups[i]] ? s->clock : 0;
    }
    paged_make_room(s, missing);
    for (size_t i = 0; i < n;) {
        size_t from = groups[i];
        for (i++; i < n && groups[i] - groups[i - 1] <= PAGED_GAP; i++)
            ;
        paged_fetch(s, from, (size_t)groups[i - 1] + 1);
    }
}

void paged_passed(void *user, size_t from, size_t to)
{
    struct paged *s = user;
    paged_stream(s, true);
    paged_each(s, scratch_flush, from, to);
    paged_each(s, scratch_drop, from > PAGED_PART ? from - PAGED_PART : 0, from);
    if (to < s->n_groups && to - from == PAGED_PART)
        return;
    paged_drop_all(s); /* the last part */
}

/* Those of [from, to) that no step holds leave memory. */
static void paged_drop_passed(struct paged *s, size_t n_arrays, size_t from, size_t to)
{
    for (size_t i = from; i < to; i++) {
        from = i;
        for (; i < to && !s->seen[i]; i++)
            ;
        for (size_t k = 0; i > from && k < n_arrays; k++)
            scratch_drop(&s->file[k], from * s->group_bytes, i * s->group_bytes);
    }
}

/* Written at once, and waited for when the next part has been passed. */
void paged_walked(struct paged *s, bool all, size_t from, size_t to)
{
    const size_t n_arrays = all ? PAGED_ARRAYS : 1;
    paged_stream(s, true);
    if (from < s->walked)
        s->walked = from; /* a walk begins */
    for (size_t k = 0; k < n_arrays; k++)
        scratch_flush(&s->file[k], from * s->group_bytes, to * s->group_bytes);
    paged_drop_passed(s, n_arrays, s->walked, from);
    s->walked = from;
}

void paged_drop_all(struct paged *s)
{
    paged_each(s, scratch_flush, 0, s->n_groups);
    paged_each(s, scratch_drop, 0, s->n_groups);
    memset(s->seen, 0, s->n_groups * sizeof *s->seen);
    s->dropped += s->n_held;
    s->n_held = 0;
}

/* ---- moving rows ---- */

/* The lowest old row that new rows of [from, end) come from, as a group. */
static size_t paged_lowest(const struct permutation *r, size_t from, size_t end)
{
    size_t low = r->n_old;
    for (size_t d = from; d < end; d++)
        low = (r->source[d] & ~PERMUTE_NEW) < low ? r->source[d] & ~PERMUTE_NEW : low;
    return low / LAYOUT_LANES;
}

/* Old and new rows follow the same curve, so both files are read and written from start to end. */
static enum err_code paged_copy(struct paged *s, size_t nth, const struct permutation *r,
                                const float *from, float *to, struct err *e)
{
    const size_t part = (size_t)PAGED_PART * LAYOUT_LANES, part_bytes = PAGED_PART * s->group_bytes;
    size_t done = 0;
    enum err_code rc = ERR_OK;
    for (size_t d = 0; !rc && d < r->n; d += part) {
        const size_t end = r->n - d < part ? r->n : d + part,
                     at = d / LAYOUT_LANES * s->group_bytes;
        const size_t low = paged_lowest(r, d, end);
        rc = permute_part(r, nth > 0, d, end, from, to, e);
        scratch_flush(&s->spare, at, at + part_bytes);
        if (at)
            scratch_drop(&s->spare, at - part_bytes, at);
        if (low > done) {
            scratch_drop(&s->file[nth], done * s->group_bytes, low * s->group_bytes);
            done = low;
        }
    }
    return rc;
}

enum err_code paged_move(struct paged *s, size_t nth, const struct permutation *r, size_t n_groups,
                         cl_mem *array, struct err *e)
{
    const size_t bytes = n_groups * s->group_bytes;
    struct err why = {0};
    cl_mem moved = NULL;
    void *from = NULL, *to = NULL;
    enum err_code rc = ERR_OK, done;
    paged_stream(s, true);
    if (s->spare.n_bytes != bytes) {
        scratch_close(&s->spare);
        rc = scratch_open(s->dir, bytes, &s->spare, e);
    }
    if (!rc)
        rc = dev_buffer_over(s->dev, s->spare.at, bytes, &moved, e);
    if (!rc)
        rc = dev_map(s->dev, *array, CL_MAP_READ, s->file[nth].n_bytes, &from, e);
    if (!rc)
        rc = dev_map(s->dev, moved, CL_MAP_WRITE, bytes, &to, e);
    if (!rc)
        rc = paged_copy(s, nth, r, from, to, e);
    done = dev_unmap(s->dev, *array, &from, &why);
    if (!done && moved)
        done = dev_unmap(s->dev, moved, &to, &why);
    if (!done)
        done = dev_finish(s->dev, &why);
    if (!rc && done)
        rc = err_set(e, done, "%s", why.msg);
    if (rc) {
        dev_release(&moved);
        return err_add(e, "--memory");
    }
    dev_release(array);
    *array = moved;
    struct scratch old = s->file[nth];
    s->file[nth] = s->spare;
    s->spare = old;
    return scratch_zero(&s->spare, e); /* what was there is never written */
}

enum err_code paged_moved(struct paged *s, size_t n_groups, struct err *e)
{
    enum err_code rc = paged_forget(s, n_groups, e);
    if (!rc)
        paged_drop_all(s);
    return rc;
}
