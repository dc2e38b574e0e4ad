/* Parts of a tile: together they are its rows, the first shows most, and each is a .drc.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/part.h"

#include <math.h>
#include <string.h>

#include "codec/splat/draco.h"
#include "tests/codec/quant_kit.h"
#include "tests/kit.h"

static void make(size_t n, uint32_t embed_len, struct quant *q)
{
    struct gauss g;
    struct err e = {0};
    kit_gauss(n, n, 300, 2, embed_len, &g);
    kit_ok(quant_from_gauss(&g, 2, quant_preset_grid(QUANT_BALANCED), q, &e), e);
    gauss_free(&g);
}

static double shows(const struct quant *q, size_t i)
{
    double s[3];
    for (size_t k = 0; k < 3; k++)
        s[k] = exp(q->scale[3 * i + k] / 16.0);
    return q->alpha[i] * (s[0] * s[1] + s[0] * s[2] + s[1] * s[2]);
}

/* Copies row i of part behind *n rows of all. */
static void put(const struct quant *part, size_t i, struct quant *all, size_t *n)
{
    const size_t sh = 24, len = part->embed_len, at = (*n)++;
    memcpy(all->position + 3 * at, part->position + 3 * i, 12);
    memcpy(all->color + 3 * at, part->color + 3 * i, 3);
    memcpy(all->scale + 3 * at, part->scale + 3 * i, 3);
    memcpy(all->sh + sh * at, part->sh + sh * i, sh);
    memcpy(all->embed + len * at, part->embed + len * i, len);
    all->alpha[at] = part->alpha[i];
    all->rotation[at] = part->rotation[i];
}

static bool same_place(const struct quant *a, size_t i, const struct quant *b, size_t j)
{
    return !memcmp(a->position + 3 * i, b->position + 3 * j, 12);
}

/* Merging both parts row by row, in the order of the tile, gives the tile. */
static void test_parts_are_the_tile(void **state)
{
    static const struct {
        size_t n, first;
    } rows[] = {{4096, 3072}, {4097, 3072}, {5000, 4096}, {9000, 6144}};
    for (size_t k = 0; k < sizeof rows / sizeof *rows; k++) {
        struct quant q, part[PARTS], all;
        struct err e = {0};
        size_t at[PARTS] = {0}, n = 0;
        make(rows[k].n, k & 1 ? 16 : 0, &q);
        for (uint32_t p = 0; p < PARTS; p++)
            kit_ok(part_take(&q, p + 1, &part[p], &e), e);
        assert_int_equal(part_first(q.n), rows[k].first);
        assert_int_equal(part[0].n, rows[k].first);
        assert_int_equal(part[0].n % PART_ROWS, 0);
        assert_int_equal(part[0].rest, part[1].n);
        assert_int_equal(part[1].rest, 0);
        kit_ok(quant_alloc(&all, q.n, q.sh_degree, q.embed_len, &e), e);
        for (size_t i = 0; i < q.n; i++) {
            int p = at[0] < part[0].n && same_place(&part[0], at[0], &q, i) ? 0 : 1;
            assert_true(at[p] < part[p].n);
            put(&part[p], at[p]++, &all, &n);
        }
        all.frac_bits = part[1].frac_bits;
        all.antialiased = part[1].antialiased;
        memcpy(all.embed_min, part[0].embed_min, sizeof all.embed_min);
        memcpy(all.embed_max, part[1].embed_max, sizeof all.embed_max);
        quant_kit_same(&q, &all);
        double least = HUGE_VAL, most = 0.0;
        for (size_t i = 0; i < part[0].n; i++)
            least = fmin(least, shows(&part[0], i));
        for (size_t i = 0; i < part[1].n; i++)
            most = fmax(most, shows(&part[1], i));
        assert_true(least >= most * (1 - 1e-5));
        quant_free(&q);
        quant_free(&all);
        for (int p = 0; p < PARTS; p++)
            quant_free(&part[p]);
    }
}

static void test_few_rows_are_one_part(void **state)
{
    static const size_t counts[] = {0, 1, PART_LEAST - 1};
    for (size_t k = 0; k < 3; k++) {
        struct quant q, part;
        struct err e = {0};
        kit_ok(quant_alloc(&q, counts[k], 1, 0, &e), e);
        kit_ok(part_take(&q, 1, &part, &e), e);
        quant_kit_same(&q, &part);
        assert_int_equal(part.rest, 0);
        quant_free(&part);
        assert_int_equal(part_take(&q, 2, &part, &e), ERR_NOENT);
        assert_null(part.block);
        quant_free(&q);
    }
}

/* Where all weigh the same the first rows are the first part: no machine chooses others. */
static void test_equal_rows(void **state)
{
    struct quant q, part;
    struct err e = {0};
    kit_ok(quant_alloc(&q, 5000, 0, 0, &e), e);
    for (size_t i = 0; i < q.n; i++)
        q.position[3 * i] = (int32_t)i;
    for (uint32_t p = 1; p <= PARTS; p++) {
        kit_ok(part_take(&q, p, &part, &e), e);
        for (size_t i = 0; i < part.n; i++)
            assert_int_equal(part.position[3 * i], i + (p == 1 ? 0 : part_first(q.n)));
        quant_free(&part);
    }
    quant_free(&q);
}

static bool has_text(const struct buf *b, const char *text)
{
    const char *bytes = (const char *)b->data;
    const size_t n = strlen(text);
    for (size_t i = 0; i + n <= b->size; i++)
        if (!memcmp(bytes + i, text, n))
            return true;
    return false;
}

/* Each part is a file of its own, which says what follows to those who ask. */
static void test_a_part_is_a_file(void **state)
{
    struct quant q;
    struct err e = {0};
    make(6000, 16, &q);
    for (uint32_t p = 1; p <= PARTS; p++) {
        struct quant part, back;
        struct buf b = {0};
        kit_ok(part_take(&q, p, &part, &e), e);
        kit_ok(draco_encode(&part, "18/1/2", &b, &e), e);
        kit_ok(draco_decode(b.data, b.size, NULL, &back, &e), e);
        quant_kit_same(&part, &back);
        assert_true(has_text(&b, "rest") == (p == 1));
        buf_free(&b);
        quant_free(&part);
        quant_free(&back);
    }
    quant_free(&q);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_parts_are_the_tile),
        cmocka_unit_test(test_few_rows_are_one_part),
        cmocka_unit_test(test_equal_rows),
        cmocka_unit_test(test_a_part_is_a_file),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
