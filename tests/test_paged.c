/* Files that stand in for memory, and a model's arrays in them: content stays the same whatever
 * leaves memory, and what leaves is what was not listed for longest.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <dirent.h>
#include <string.h>

#include "core/layout.h"
#include "render/permute.h"
#include "train/paged.h"

enum { PLANES = 59, GROUPS = 3000, ROWS = GROUPS * LAYOUT_LANES - 5, SEED = 3 };
enum { GROUP_FLOATS = PLANES * LAYOUT_LANES, GROUP_BYTES = GROUP_FLOATS * 4 };

static size_t names_in(const char *dir)
{
    size_t n = 0;
    DIR *d = opendir(dir);
    assert_non_null(d);
    for (const struct dirent *f; (f = readdir(d));)
        n += strcmp(f->d_name, ".") && strcmp(f->d_name, "..");
    closedir(d);
    return n;
}

/* ---- one file ---- */

static void a_file_has_no_name_and_keeps_its_bytes(void **state)
{
    (void)state;
    struct err e = {0};
    struct scratch s;
    char dir[FILE_PATH_MAX];
    const size_t n = 8u << 20;
    kit_tmpdir(dir);
    kit_ok(scratch_open(dir, n, &s, &e), e);
    assert_int_equal(names_in(dir), 0);
    for (size_t i = 0; i < n; i++) {
        assert_int_equal(s.at[i], 0);
        s.at[i] = (uint8_t)(i * 31 >> 8);
    }
    assert_int_equal(scratch_held_bytes(&s), n);
    scratch_flush(&s, 0, n);
    scratch_drop(&s, 100, n - 100); /* not the pages at both ends */
    if (!scratch_is_memory(dir))
        assert_in_range(scratch_held_bytes(&s), 1, n / 2);
    scratch_fetch(&s, 0, n / 2);
    for (size_t i = 0; i < n; i++)
        if (s.at[i] != (uint8_t)(i * 31 >> 8))
            fail_msg("byte %zu has changed", i);
    kit_ok(scratch_zero(&s, &e), e);
    for (size_t i = 0; i < n; i += 97)
        assert_int_equal(s.at[i], 0);
    scratch_close(&s);
    scratch_close(&s);
    kit_rmdir(dir);
}

static void a_full_disk_is_an_error_at_once(void **state)
{
    (void)state;
    struct err e = {0};
    struct scratch s;
    char dir[FILE_PATH_MAX], none[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_fails(scratch_open(dir, (size_t)1 << 50, &s, &e), ERR_IO, e, "no room for a file of");
    assert_int_equal(names_in(dir), 0);
    kit_ok(file_join(none, dir, "none", &e), e);
    kit_fails(scratch_open(none, 4096, &s, &e), ERR_IO, e, "cannot make a file");
    scratch_close(&s);
    kit_rmdir(dir);
}

/* ---- arrays ---- */

struct arrays {
    char dir[FILE_PATH_MAX];
    struct dev dev;
    struct paged p;
    cl_mem mem[PAGED_ARRAYS];
};

static float value_of(size_t array, size_t i)
{
    return (float)(array * 1000003 + i);
}

/* The device has GROUPS groups in all arrays, of which so many may be in memory. */
static void arrays_open(struct arrays *a, size_t most)
{
    struct err e = {0};
    cl_mem *at[PAGED_ARRAYS];
    float *value = mem_array(GROUPS, GROUP_BYTES);
    assert_non_null(value);
    *a = (struct arrays){0};
    kit_tmpdir(a->dir);
    kit_ok(dev_open("cpu", &a->dev, &e), e);
    a->p.dir = a->dir;
    a->p.most_bytes = most * PAGED_ARRAYS * GROUP_BYTES;
    for (size_t k = 0; k < PAGED_ARRAYS; k++)
        at[k] = &a->mem[k];
    kit_ok(paged_open(&a->p, &a->dev, GROUPS, PLANES, at, &e), e);
    for (size_t k = 0; k < PAGED_ARRAYS; k++) {
        for (size_t i = 0; i < (size_t)GROUPS * GROUP_FLOATS; i++)
            value[i] = value_of(k, i);
        kit_ok(dev_write(&a->dev, a->mem[k], 0, (size_t)GROUPS * GROUP_BYTES, value, &e), e);
    }
    mem_free(value);
    paged_drop_all(&a->p);
}

static void arrays_close(struct arrays *a)
{
    for (size_t k = 0; k < PAGED_ARRAYS; k++)
        dev_release(&a->mem[k]);
    paged_close(&a->p);
    assert_true(a->p.dir && a->p.most_bytes); /* it can be opened again */
    dev_close(&a->dev);
    assert_int_equal(names_in(a->dir), 0);
    kit_rmdir(a->dir);
}

static void arrays_expect(struct arrays *a, size_t k, const float *want, size_t groups)
{
    struct err e = {0};
    float *got = mem_array(groups, GROUP_BYTES);
    assert_non_null(got);
    kit_ok(dev_read(&a->dev, a->mem[k], 0, groups * GROUP_BYTES, got, &e), e);
    for (size_t i = 0; i < groups * GROUP_FLOATS; i++)
        if (got[i] != (want ? want[i] : value_of(k, i)))
            fail_msg("array %zu: value %zu is %g", k, i, (double)got[i]);
    mem_free(got);
}

static size_t held_groups(const struct paged *p)
{
    size_t bytes = 0;
    for (size_t k = 0; k < PAGED_ARRAYS; k++)
        bytes += scratch_held_bytes(&p->file[k]);
    return bytes / (PAGED_ARRAYS * GROUP_BYTES);
}

static void what_was_not_listed_for_longest_leaves(void **state)
{
    (void)state;
    enum { MOST = 800, LISTED = 300, STEPS = 24, STRIDE = 137 };
    struct arrays a;
    uint32_t list[LISTED];
    arrays_open(&a, MOST);
    assert_int_equal(a.p.n_held, 0);
    for (size_t step = 0; step < STEPS; step++) {
        size_t from = step * STRIDE % (GROUPS - LISTED);
        for (size_t i = 0; i < LISTED; i++)
            list[i] = (uint32_t)(from + i);
        paged_listed(&a.p, list, LISTED);
        for (size_t i = 0; i < LISTED; i++) { /* what a step does */
            float *x = (float *)(void *)a.p.file[1].at + (from + i) * GROUP_FLOATS;
            assert_true(x[5] == value_of(1, (from + i) * GROUP_FLOATS + 5));
            x[0] += 0.0f;
            assert_int_equal(a.p.seen[from + i], step + 1);
        }
        assert_in_range(a.p.n_held, LISTED, MOST);
        if (!scratch_is_memory(a.dir)) /* runs are read with the pages about them */
            assert_in_range(held_groups(&a.p), LISTED / 2, MOST + MOST / 4);
    }
    assert_true(a.p.fetched > MOST && a.p.dropped > MOST);
    assert_int_equal(a.p.fetched - a.p.dropped, a.p.n_held);
    for (size_t i = 0; i < LISTED; i++) /* more in a step than may be held is held nevertheless */
        list[i] = (uint32_t)(i * (GROUPS / LISTED));
    a.p.most_bytes = PAGED_ARRAYS * GROUP_BYTES;
    paged_listed(&a.p, list, LISTED);
    assert_int_equal(a.p.n_held, LISTED);
    paged_passed(&a.p, 0, GROUPS);
    assert_int_equal(a.p.n_held, 0);
    for (size_t k = 0; k < PAGED_ARRAYS; k++)
        arrays_expect(&a, k, NULL, GROUPS);
    arrays_close(&a);
}

static void rows_move_as_they_do_in_memory(void **state)
{
    (void)state;
    enum { MORE = ROWS + 5003, ROOM = (MORE + LAYOUT_LANES - 1) / LAYOUT_LANES + 7 };
    struct err e = {0};
    struct arrays a;
    uint32_t *source = mem_array(MORE, sizeof *source);
    float *from = mem_array(GROUPS, GROUP_BYTES), *to = mem_array(ROOM, GROUP_BYTES);
    assert_true(source && from && to);
    arrays_open(&a, 100);
    for (size_t d = 0; d < MORE; d++) { /* neighbours, and every ninth is new */
        size_t at = d * ROWS / MORE + (size_t)(20.0 * rng_unit(SEED, 1, d));
        source[d] = (uint32_t)(at < ROWS ? at : ROWS - 1) | (d % 9 ? 0 : PERMUTE_NEW);
    }
    const struct permutation r = {source, MORE, ROWS, PLANES};
    for (size_t k = 0; k < PAGED_ARRAYS; k++) {
        for (size_t i = 0; i < (size_t)GROUPS * GROUP_FLOATS; i++)
            from[i] = value_of(k, i);
        memset(to, 0, (size_t)ROOM * GROUP_BYTES);
        kit_ok(permute_move(&r, k > 0, from, to, &e), e);
        kit_ok(paged_move(&a.p, k, &r, ROOM, &a.mem[k], &e), e);
        arrays_expect(&a, k, to, ROOM);
    }
    kit_ok(paged_moved(&a.p, ROOM, &e), e);
    assert_true(a.p.n_groups == ROOM && a.p.file[1].n_bytes == (size_t)ROOM * GROUP_BYTES);
    kit_ok(paged_zero(&a.p, 1, &e), e);
    memset(from, 0, (size_t)GROUPS * GROUP_BYTES);
    arrays_expect(&a, 1, from, GROUPS);
    for (size_t i = 0; i < (size_t)GROUPS * GROUP_FLOATS; i++)
        from[i] = value_of(0, i);
    memset(to, 0, (size_t)ROOM * GROUP_BYTES);
    kit_ok(permute_move(&r, false, from, to, &e), e);
    arrays_expect(&a, 0, to, ROOM); /* the other array is as it was */
    arrays_close(&a);
    mem_free(source);
    mem_free(from);
    mem_free(to);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_file_has_no_name_and_keeps_its_bytes),
        cmocka_unit_test(a_full_disk_is_an_error_at_once),
        cmocka_unit_test(what_was_not_listed_for_longest_leaves),
        cmocka_unit_test(rows_move_as_they_do_in_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
