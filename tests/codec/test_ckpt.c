/* Checkpoints: what goes in comes out, bit for bit; anything else is one clear error.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/ckpt.h"
#include "tests/codec/torture.h"
#include "tests/kit.h"

#include <stdio.h>
#include <string.h>

#include <jansson.h>

struct fixture {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct gauss g;
    json_t *meta;
    float moments[33];
    struct ckpt_blob blobs[3];
};

static void fixture_make(struct fixture *f, size_t n, uint32_t embed_len)
{
    struct err e = {0};
    *f = (struct fixture){0};
    kit_tmpdir(f->dir);
    kit_ok(file_join(f->path, f->dir, "level1.ckpt", &e), e);
    kit_gauss(5, n, 30.0, 2, embed_len, &f->g);
    f->g.origin_enu_m[0] = 1234.5678901234567;
    f->g.antialiased = true;
    f->meta = json_pack("{s:i, s:f, s:s}", "level", 1, "lr", 1.6e-4, "scene", "toy");
    for (int i = 0; i < 33; i++)
        f->moments[i] = (float)i * 0.5f;
    f->blobs[0] = (struct ckpt_blob){"adam", f->moments, sizeof f->moments};
    f->blobs[1] = (struct ckpt_blob){"empty", NULL, 0};
    f->blobs[2] = (struct ckpt_blob){"odd", "seven!", 7};
}

static void fixture_free(struct fixture *f)
{
    json_decref(f->meta);
    gauss_free(&f->g);
    kit_rmdir(f->dir);
}

static void assert_same_gauss(const struct gauss *a, const struct gauss *b)
{
    assert_int_equal(a->n, b->n);
    assert_int_equal(a->sh_degree, b->sh_degree);
    assert_int_equal(a->embed_len, b->embed_len);
    assert_int_equal(a->antialiased, b->antialiased);
    assert_memory_equal(a->origin_enu_m, b->origin_enu_m, sizeof a->origin_enu_m);
    if (!a->n)
        return;
    assert_memory_equal(a->mean_m, b->mean_m, a->n * 12);
    assert_memory_equal(a->scale_log, b->scale_log, a->n * 12);
    assert_memory_equal(a->quat_wxyz, b->quat_wxyz, a->n * 16);
    assert_memory_equal(a->opacity_logit, b->opacity_logit, a->n * 4);
    assert_memory_equal(a->sh, b->sh, a->n * gauss_sh_count(a->sh_degree) * 12);
    if (a->embed_len)
        assert_memory_equal(a->embed, b->embed, a->n * a->embed_len * 4);
}

static void round_trip_is_exact_and_blobs_are_aligned(void **state)
{
    for (size_t n = 0; n <= 1000; n += 500) {
        struct fixture f;
        struct err e = {0};
        fixture_make(&f, n, n == 500 ? 16 : 0);
        kit_ok(ckpt_write(f.path, f.meta, &f.g, f.blobs, 3, &e), e);
        struct ckpt c;
        kit_ok(ckpt_read(f.path, &c, &e), e);
        assert_same_gauss(&f.g, &c.g);
        assert_true(json_equal(c.meta, f.meta));
        assert_int_equal(c.n_blobs, 3);
        const struct ckpt_blob *b = ckpt_find(&c, "adam");
        assert_non_null(b);
        assert_int_equal((uintptr_t)b->data % 64, 0);
        assert_int_equal(b->size_bytes, sizeof f.moments);
        assert_memory_equal(b->data, f.moments, sizeof f.moments);
        assert_string_equal(ckpt_find(&c, "odd")->data, "seven!");
        assert_int_equal(ckpt_find(&c, "empty")->size_bytes, 0);
        assert_null(ckpt_find(&c, "#meta")); /* sections of its own are not blobs */
        ckpt_free(&c);
        ckpt_free(&c);
        fixture_free(&f);
    }
}

/* Read them as the file at `user`. */
static enum err_code decode_file(const void *user, const void *bytes, size_t n,
                                 const struct codec_limits *lim, struct err *e)
{
    struct ckpt c;
    struct err why = {0};
    (void)lim;
    kit_ok(file_write(user, bytes, n, &why), why);
    enum err_code rc = ckpt_read(user, &c, e);
    if (rc)
        assert_true(!c.meta && !c.g.block);
    ckpt_free(&c);
    return rc;
}

static void every_cut_and_every_flipped_byte_is_noticed(void **state)
{
    struct fixture f;
    struct err e = {0};
    struct buf whole = {0};
    struct ckpt c;
    fixture_make(&f, 5, 0);
    kit_ok(ckpt_write(f.path, f.meta, &f.g, f.blobs, 3, &e), e);
    kit_ok(file_read(f.path, 0, &whole, &e), e);
    const struct torture torture = {.name = f.path, .decode = decode_file, .user = f.path};
    torture_cuts(&torture, &whole, 61);
    size_t noticed = 0, tried = 0;
    for (size_t at = 0; at < whole.size; at += 7, tried++) {
        whole.data[at] ^= 0x40;
        kit_ok(file_write(f.path, whole.data, whole.size, &e), e);
        enum err_code rc = ckpt_read(f.path, &c, &e);
        assert_true(!rc || rc == ERR_FORMAT);
        noticed += rc == ERR_FORMAT;
        if (!rc) /* only padding may change unnoticed, and then nothing was harmed */
            assert_same_gauss(&f.g, &c.g);
        ckpt_free(&c);
        whole.data[at] ^= 0x40;
    }
    assert_true(noticed > tried / 2);
    whole.data[whole.size - 1] ^= 1;
    kit_ok(file_write(f.path, whole.data, whole.size, &e), e);
    kit_fails(ckpt_read(f.path, &c, &e), ERR_FORMAT, e, "section 'odd'");
    buf_free(&whole);
    fixture_free(&f);
}

/* Rows of a container, from where `user` has them. */
static enum err_code give_rows(void *user, enum ckpt_field field, size_t first, size_t n,
                               float *out, struct err *e)
{
    const struct gauss *g = user;
    const struct {
        const float *from;
        size_t width;
    } a[] = {{g->mean_m, 3},        {g->scale_log, 3}, {g->quat_wxyz, 4},
             {g->opacity_logit, 1}, {g->sh, 3},        {g->embed, g->embed_len}};
    if (field == CKPT_QUAT && first > 0 && g->antialiased)
        return err_set(e, ERR_DEVICE, "the rows are gone");
    memcpy(out, a[field].from + first * a[field].width, n * a[field].width * sizeof *out);
    return ERR_OK;
}

/* A blob that is written and read in pieces: a byte of the last that has changed is noticed. */
static void large_blobs_go_in_pieces(void **state)
{
    enum { BYTES = (9 << 20) + 77 };
    struct err e = {0};
    struct fixture f;
    struct ckpt_rows *r = NULL;
    struct gauss none = {.n = 0};
    uint8_t *large = mem_array(BYTES, 2), *back = large + BYTES;
    assert_non_null(large);
    fixture_make(&f, 1, 0);
    for (size_t i = 0; i < BYTES; i++)
        large[i] = (uint8_t)(i * 2654435761U >> 13);
    const struct ckpt_blob blob = {.name = "large", .data = large, .size_bytes = BYTES};
    kit_ok(ckpt_write(f.path, f.meta, &none, &blob, 1, &e), e);
    kit_ok(ckpt_rows_open(f.path, &r, &e), e);
    kit_ok(ckpt_rows_blob_to(r, "large", back, BYTES, &e), e);
    assert_memory_equal(large, back, BYTES);
    FILE *file = fopen(f.path, "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, -1, SEEK_END), 0);
    fputc(large[BYTES - 1] ^ 1, file);
    fclose(file);
    kit_fails(ckpt_rows_blob_to(r, "large", back, BYTES, &e), ERR_FORMAT, e, "'large'");
    ckpt_rows_close(&r);
    mem_free(large);
    fixture_free(&f);
}

/* Arrays that are asked for in slices make the same file; without harmonics the quaternions are
 * the widest of them. */
static void slices_make_the_same_file(void **state)
{
    enum { ROWS = 10001 }; /* more than one slice, and no whole number of them */
    struct err e = {0};
    struct gauss g = {0}, like;
    struct buf whole = {0}, sliced = {0};
    struct ckpt_rows *r = NULL;
    struct fixture f;
    float moments[33];
    fixture_make(&f, 1, 0);
    kit_gauss(6, ROWS, 30.0, 0, 0, &g);
    kit_ok(ckpt_write(f.path, f.meta, &g, f.blobs, 3, &e), e);
    kit_ok(file_read(f.path, 0, &whole, &e), e);
    like = (struct gauss){.n = g.n, .antialiased = g.antialiased};
    memcpy(like.origin_enu_m, g.origin_enu_m, sizeof like.origin_enu_m);
    struct ckpt_source from = {.like = &like, .rows = give_rows, .user = &g};
    kit_ok(ckpt_write_from(f.path, f.meta, &from, f.blobs, 3, &e), e);
    kit_ok(file_read(f.path, 0, &sliced, &e), e);
    assert_int_equal(whole.size, sliced.size);
    assert_memory_equal(whole.data, sliced.data, whole.size);
    /* A source that fails leaves the file that was there. */
    g.antialiased = true;
    kit_fails(ckpt_write_from(f.path, f.meta, &from, NULL, 0, &e), ERR_DEVICE, e, "rows are gone");
    kit_ok(ckpt_rows_open(f.path, &r, &e), e);
    assert_int_equal(ckpt_rows_like(r)->n, ROWS);
    assert_true(ckpt_rows_has(r, "odd") && !ckpt_rows_has(r, "even"));
    json_t *meta;
    kit_ok(ckpt_rows_meta(r, &meta, &e), e);
    assert_true(json_equal(meta, f.meta));
    json_decref(meta);
    kit_ok(ckpt_rows_blob_to(r, "adam", moments, sizeof moments, &e), e);
    assert_memory_equal(moments, f.moments, sizeof moments);
    kit_fails(ckpt_rows_blob_to(r, "adam", moments, 8, &e), ERR_FORMAT, e, "8 bytes");
    kit_fails(ckpt_rows_blob_to(r, "even", moments, 8, &e), ERR_FORMAT, e, "'even'");
    ckpt_rows_close(&r);
    buf_free(&whole);
    buf_free(&sliced);
    gauss_free(&g);
    fixture_free(&f);
}

static void foreign_files_are_refused_by_name(void **state)
{
    struct fixture f;
    struct err e = {0};
    struct ckpt c;
    fixture_make(&f, 1, 0);
    kit_fails(ckpt_read(f.path, &c, &e), ERR_NOENT, e, "level1.ckpt");
    kit_ok(file_write(f.path, "ply\nformat ascii 1.0\n", 21, &e), e);
    kit_fails(ckpt_read(f.path, &c, &e), ERR_FORMAT, e, "not a checkpoint");
    fixture_free(&f);
}

static void a_failed_write_leaves_the_old_file_alone(void **state)
{
    struct fixture f;
    struct err e = {0};
    struct ckpt c;
    fixture_make(&f, 20, 0);
    kit_ok(ckpt_write(f.path, f.meta, &f.g, NULL, 0, &e), e);
    struct ckpt_blob twice[2] = {{"a", "x", 1}, {"a", "y", 1}};
    kit_fails(ckpt_write(f.path, f.meta, &f.g, twice, 2, &e), ERR_ARG, e, "two blobs named 'a'");
    struct ckpt_blob own[1] = {{"#meta", "x", 1}};
    kit_fails(ckpt_write(f.path, f.meta, &f.g, own, 1, &e), ERR_ARG, e, "no valid name");
    json_t *list = json_array();
    kit_fails(ckpt_write(f.path, list, &f.g, NULL, 0, &e), ERR_ARG, e, "object");
    json_decref(list);
    kit_fails(ckpt_write("/nonexistent-folder/x.ckpt", f.meta, &f.g, NULL, 0, &e), ERR_IO, e,
              "/nonexistent-folder/x.ckpt");
    kit_ok(ckpt_read(f.path, &c, &e), e);
    assert_int_equal(c.g.n, 20);
    ckpt_free(&c);
    fixture_free(&f);
}

static void running_out_of_memory_is_an_error_and_nothing_leaks(void **state)
{
    struct fixture f;
    struct ckpt c = {0};
    struct err e = {0};
    fixture_make(&f, 3, 0);
    kit_ok(ckpt_write(f.path, f.meta, &f.g, f.blobs, 3, &e), e);
    kit_out_of_memory((ckpt_free(&c), ckpt_read(f.path, &c, &e)), 2, e);
    kit_out_of_memory(ckpt_write(f.path, f.meta, &f.g, f.blobs, 3, &e), 1, e);
    ckpt_free(&c);
    fixture_free(&f);
}

/* Slices put together are the whole, and opening finds what reading the whole would find. */
static void slices_are_the_whole(void **state)
{
    struct fixture f;
    struct err e = {0};
    struct ckpt_rows *r = NULL;
    struct buf file = {0};
    fixture_make(&f, 1000, 4);
    kit_ok(ckpt_write(f.path, f.meta, &f.g, f.blobs, 3, &e), e);
    kit_ok(ckpt_rows_open(f.path, &r, &e), e);
    assert_int_equal(ckpt_rows_count(r), 1000);
    for (size_t from = 0; from < 1000; from += 300) {
        struct gauss part, want = f.g;
        size_t n = from + 300 < 1000 ? 300 : 1000 - from;
        kit_ok(ckpt_rows_read(r, from, n, &part, &e), e);
        want.n = n;
        want.mean_m += 3 * from;
        want.scale_log += 3 * from;
        want.quat_wxyz += 4 * from;
        want.opacity_logit += from;
        want.sh += 3 * gauss_sh_count(want.sh_degree) * from;
        want.embed += want.embed_len * from;
        assert_same_gauss(&part, &want);
        gauss_free(&part);
    }
    struct gauss none;
    kit_fails(ckpt_rows_read(r, 900, 101, &none, &e), ERR_ARG, e, "rows 900 to 1001 of 1000");
    ckpt_rows_close(&r);
    ckpt_rows_close(&r);
    kit_ok(file_read(f.path, 0, &file, &e), e);
    for (size_t at = 3; at < file.size; at += 997) { /* blobs are another reader's */
        file.data[at] ^= 0x20;
        kit_ok(file_write(f.path, file.data, file.size, &e), e);
        struct ckpt c;
        enum err_code whole = ckpt_read(f.path, &c, &e), rows = ckpt_rows_open(f.path, &r, &e);
        assert_true(rows == ERR_OK || whole != ERR_OK);
        assert_true(rows != ERR_OK || at > file.size - 200 || whole == ERR_OK);
        ckpt_free(&c);
        ckpt_rows_close(&r);
        file.data[at] ^= 0x20;
    }
    kit_ok(file_write(f.path, file.data, file.size / 2, &e), e);
    kit_fails(ckpt_rows_open(f.path, &r, &e), ERR_FORMAT, e, "truncated");
    buf_free(&file);
    fixture_free(&f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(round_trip_is_exact_and_blobs_are_aligned),
        cmocka_unit_test(every_cut_and_every_flipped_byte_is_noticed),
        cmocka_unit_test(foreign_files_are_refused_by_name),
        cmocka_unit_test(a_failed_write_leaves_the_old_file_alone),
        cmocka_unit_test(slices_are_the_whole),
        cmocka_unit_test(slices_make_the_same_file),
        cmocka_unit_test(large_blobs_go_in_pieces),
        cmocka_unit_test(running_out_of_memory_is_an_error_and_nothing_leaks),
    };
    return cmocka_run_group_tests_name("ckpt", tests, NULL, NULL);
}
