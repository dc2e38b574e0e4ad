/* A tile store on disk, for tests that read or write one: a folder, the path of a store in it, the
 * objects that most tests open, a store with one level, and a damaged tile.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_STORE_KIT_H
#define TESTS_STORE_KIT_H

#include "tests/kit.h"

#include <string.h>

#include "lod/make/pyramid.h"
#include "lod/store/store.h"
#include "render/render.h"

struct store_fixture {
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX]; /* path: dir/city.tiles, not made yet */
    struct store *s;                              /* closed by store_fixture_teardown */
    struct dev dev; /* this and the next: opened by store_fixture_draw */
    struct render *render;
};

static inline void store_fixture_make(struct store_fixture *f)
{
    struct err e = {0};
    kit_tmpdir(f->dir);
    kit_ok(file_join(f->path, f->dir, "city.tiles", &e), e);
}

static inline void store_fixture_draw(struct store_fixture *f)
{
    struct err e = {0};
    kit_ok(dev_open(NULL, &f->dev, &e), e);
    kit_ok(render_open(&f->dev, &f->render, &e), e);
}

static inline void store_fixture_drop(struct store_fixture *f)
{
    store_close(&f->s);
    render_close(&f->render);
    dev_close(&f->dev);
    kit_rmdir(f->dir);
}

/* For cmocka: *state is the fixture. */
static inline int store_fixture_setup(void **state)
{
    struct store_fixture *f = mem_array(1, sizeof *f);
    assert_non_null(f);
    store_fixture_make(f);
    *state = f;
    return 0;
}

static inline int store_fixture_teardown(void **state)
{
    struct store_fixture *f = *state;
    store_fixture_drop(f);
    mem_free(f);
    return 0;
}

/* Writes a pyramid with one level, the third, to `path`. blob may be NULL. */
static inline void store_fixture_level(const char *path, const struct geo_origin *origin,
                                       const struct gauss *g, const struct pyramid_config *cfg,
                                       const struct store_blob *blob)
{
    struct err e = {0};
    const struct pyramid_level level = {.g = g, .level = 3};
    kit_ok(pyramid_build(origin, &level, 1, cfg, blob, blob != NULL, path, NULL, &e), e);
}

/* Copies a store to `to` (may be the same path), with one bit changed in the stored bytes of a
 * tile, as a failing disk would. */
static inline void store_fixture_damage(const char *path, struct key k, const char *to)
{
    struct err e = {0};
    struct store *s = NULL;
    struct buf payload = {0}, file = {0};
    enum { PROBE = 48, AT = 200 };
    kit_ok(store_open(path, &s, &e), e);
    kit_ok(store_read(s, k, &payload, &e), e);
    store_close(&s);
    kit_ok(file_read(path, 0, &file, &e), e);
    assert_true(payload.size > AT + PROBE);
    /* lies within one page of the database with high probability */
    const uint8_t *probe = payload.data + AT;
    size_t at = 0;
    while (at + PROBE <= file.size && memcmp(file.data + at, probe, PROBE) != 0)
        at++;
    assert_true(at + PROBE <= file.size);
    file.data[at + PROBE / 2] ^= 4;
    kit_ok(file_write(to, file.data, file.size, &e), e);
    buf_free(&payload);
    buf_free(&file);
}

#endif
