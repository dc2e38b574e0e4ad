/* COLMAP models: binary and text read the same, hostile bytes are named and never crash.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "tests/codec/torture.h"
#include "tests/kit.h"

enum { N_CAMERAS = 2, N_IMAGES = 5, N_POINTS = 12 };
static const char *const parts[] = {"cameras", "images", "points3D"};

/* Readers would take it before the text. */
static void remove_binary(const char *dir)
{
    for (int part = 0; part < 3; part++) {
        char path[FILE_PATH_MAX + 32];
        snprintf(path, sizeof path, "%s/%s.bin", dir, parts[part]);
        assert_int_equal(remove(path), 0);
    }
}

/* A consistent model: image i sees point p when (i + p) % 3 is not 0, plus one observation without
 * a point. Ids are sparse; point 0 exists, since 0 is a valid id. */
static void make_model(struct colmap_model *m)
{
    struct arena *a = &m->arena;
    m->n_cameras = N_CAMERAS;
    m->cameras = arena_get(a, N_CAMERAS, sizeof *m->cameras);
    m->cameras[0] = (struct colmap_camera){
        .id = 3, .lens = {LENS_OPENCV, 640, 480, {500, 501, 320, 240, -0.1, 0.02, 0.001, 0.002}}};
    m->cameras[1] =
        (struct colmap_camera){.id = 8, .lens = {LENS_SIMPLE_PINHOLE, 320, 240, {250, 160, 120}}};
    m->n_images = N_IMAGES;
    m->images = arena_get(a, N_IMAGES, sizeof *m->images);
    m->n_points = N_POINTS;
    m->points = arena_get(a, N_POINTS, sizeof *m->points);
    m->tracks = arena_get(a, N_POINTS * N_IMAGES, sizeof *m->tracks);
    for (size_t i = 0; i < N_IMAGES; i++) {
        struct colmap_image *im = &m->images[i];
        im->id = (uint32_t)(2 * i + 1);
        double q[4] = {1, 0.1 * (double)i, -0.2, 0.05}, n = sqrt(1 + q[1] * q[1] + 0.04 + 0.0025);
        for (int k = 0; k < 4; k++)
            im->quat_wxyz[k] = q[k] / n;
        im->trans[0] = 0.5 * (double)i;
        im->trans[2] = 3;
        im->camera = i % 2;
        im->name = arena_printf(a, "flight 1/IMG_%zu.jpg", i);
        im->obs = arena_get(a, N_POINTS + 1, sizeof *im->obs);
        im->obs[im->n_obs++] = (struct colmap_observation){1.5, 2.5, -1};
    }
    for (size_t p = 0; p < N_POINTS; p++) {
        struct colmap_point *pt = &m->points[p];
        *pt = (struct colmap_point){.id = p * p,
                                    .xyz = {0.1 * (double)p, -1, 2},
                                    .rgb = {1, (uint8_t)p, 255},
                                    .error_px = 0.25 * (double)p,
                                    .track = m->n_tracks};
        for (size_t i = 0; i < N_IMAGES; i++) {
            if ((i + p) % 3 == 0)
                continue;
            struct colmap_image *im = &m->images[i];
            m->tracks[m->n_tracks++] =
                (struct colmap_track_element){(uint32_t)i, (uint32_t)im->n_obs};
            im->obs[im->n_obs++] =
                (struct colmap_observation){10.25 * (double)p, 3 * (double)i, (int64_t)p};
            pt->n_track++;
        }
    }
}

static void expect_equal(const struct colmap_model *a, const struct colmap_model *b)
{
    assert_int_equal(a->n_cameras, b->n_cameras);
    assert_int_equal(a->n_images, b->n_images);
    assert_int_equal(a->n_points, b->n_points);
    assert_int_equal(a->n_tracks, b->n_tracks);
    for (size_t i = 0; i < a->n_cameras; i++) {
        assert_int_equal(a->cameras[i].id, b->cameras[i].id);
        const struct lens *x = &a->cameras[i].lens, *y = &b->cameras[i].lens; /* has padding */
        assert_int_equal(x->model, y->model);
        assert_int_equal(x->width_px, y->width_px);
        assert_int_equal(x->height_px, y->height_px);
        assert_memory_equal(x->params, y->params, sizeof x->params);
    }
    for (size_t i = 0; i < a->n_images; i++) {
        const struct colmap_image *x = &a->images[i], *y = &b->images[i];
        assert_int_equal(x->id, y->id);
        assert_int_equal(x->camera, y->camera);
        assert_string_equal(x->name, y->name);
        assert_memory_equal(x->quat_wxyz, y->quat_wxyz, sizeof x->quat_wxyz);
        assert_memory_equal(x->trans, y->trans, sizeof x->trans);
        assert_int_equal(x->n_obs, y->n_obs);
        assert_memory_equal(x->obs, y->obs, x->n_obs * sizeof *x->obs);
    }
    for (size_t i = 0; i < a->n_points; i++) {
        const struct colmap_point *x = &a->points[i], *y = &b->points[i];
        assert_int_equal(x->id, y->id);
        assert_memory_equal(x->xyz, y->xyz, sizeof x->xyz);
        assert_memory_equal(x->rgb, y->rgb, sizeof x->rgb);
        assert_true(x->error_px == y->error_px);
        assert_int_equal(x->n_track, y->n_track);
        assert_memory_equal(a->tracks + x->track, b->tracks + y->track,
                            x->n_track * sizeof *a->tracks);
    }
}

static void write_text(const char *dir, const struct colmap_model *m)
{
    struct buf b[3] = {{0}};
    for (int i = 0; i < 3; i++)
        buf_printf(&b[i], "# a comment\r\n\n");
    for (size_t i = m->n_cameras; i-- > 0;) { /* not in order of id */
        const struct colmap_camera *c = &m->cameras[i];
        buf_printf(&b[0], "%u %s %u %u", c->id, lens_name(c->lens.model), c->lens.width_px,
                   c->lens.height_px);
        for (size_t k = 0; k < lens_param_count(c->lens.model); k++)
            buf_printf(&b[0], " %.17g", c->lens.params[k]);
        buf_printf(&b[0], "\r\n");
    }
    for (size_t i = m->n_images; i-- > 0;) {
        const struct colmap_image *im = &m->images[i];
        buf_printf(&b[1], "%u", im->id);
        for (int k = 0; k < 7; k++)
            buf_printf(&b[1], " %.17g", k < 4 ? im->quat_wxyz[k] : im->trans[k - 4]);
        buf_printf(&b[1], " %u %s\n", m->cameras[im->camera].id, im->name);
        for (size_t j = 0; j < im->n_obs; j++)
            buf_printf(&b[1], "%s%.17g %.17g %lld", j ? " " : "", im->obs[j].x_px, im->obs[j].y_px,
                       im->obs[j].point < 0 ? -1 : (long long)m->points[im->obs[j].point].id);
        buf_printf(&b[1], "\n");
    }
    for (size_t i = m->n_points; i-- > 0;) {
        const struct colmap_point *p = &m->points[i];
        buf_printf(&b[2], "%llu %.17g %.17g %.17g %u %u %u %.17g", (unsigned long long)p->id,
                   p->xyz[0], p->xyz[1], p->xyz[2], p->rgb[0], p->rgb[1], p->rgb[2], p->error_px);
        for (size_t k = 0; k < p->n_track; k++)
            buf_printf(&b[2], " %u %u", m->images[m->tracks[p->track + k].image].id,
                       m->tracks[p->track + k].obs);
        buf_printf(&b[2], i ? "\n" : ""); /* no line end after the last */
    }
    for (int i = 0; i < 3; i++) {
        char path[FILE_PATH_MAX + 32];
        struct err e = {0};
        snprintf(path, sizeof path, "%s/%s.txt", dir, parts[i]);
        kit_ok(file_write(path, b[i].data, b[i].size, &e), e);
        buf_free(&b[i]);
    }
}

static void test_round_trip(void **state)
{
    char dir[FILE_PATH_MAX], sub[FILE_PATH_MAX + 32];
    struct colmap_model m = {0}, bin = {0}, txt = {0};
    struct err e = {0};
    make_model(&m);
    kit_tmpdir(dir);
    snprintf(sub, sizeof sub, "%s/sparse/0", dir);
    kit_ok(colmap_write_bin(sub, &m, &e), e);
    kit_ok(colmap_read(dir, &bin, &e), e);
    expect_equal(&m, &bin);
    /* Text in the folder itself is found before the binary below it. */
    write_text(dir, &m);
    kit_ok(colmap_read(dir, &txt, &e), e);
    expect_equal(&m, &txt);
    colmap_free(&m);
    colmap_free(&bin);
    colmap_free(&txt);
    colmap_free(&txt);
    kit_rmdir(dir);
}

static void read_part(const char *dir, const char *name, struct buf *out)
{
    char path[FILE_PATH_MAX + 32];
    struct err e = {0};
    snprintf(path, sizeof path, "%s/%s", dir, name);
    kit_ok(file_read(path, 0, out, &e), e);
}

static void put_part(const char *dir, const char *name, const void *bytes, size_t n)
{
    char path[FILE_PATH_MAX + 32];
    snprintf(path, sizeof path, "%s/%s", dir, name);
    FILE *f = fopen(path, "wb"); /* not file_write: thousands of syncs */
    assert_non_null(f);
    assert_int_equal(fwrite(bytes, 1, n, f), n);
    assert_int_equal(fclose(f), 0);
}

struct part { /* one file of a model in `dir` */
    const char *dir, *name;
};

/* Read the model with these bytes as the part. */
static enum err_code decode_part(const void *user, const void *bytes, size_t n,
                                 const struct codec_limits *lim, struct err *e)
{
    const struct part *p = user;
    struct colmap_model out;
    (void)lim;
    put_part(p->dir, p->name, bytes, n);
    enum err_code rc = colmap_read(p->dir, &out, e);
    if (rc)
        assert_null(out.arena.head);
    colmap_free(&out);
    return rc;
}

/* Cut each file at every byte: always an error that names the file, and an empty result. Bytes
 * changed: that, or a model. */
static void test_truncation(void **state)
{
    char dir[FILE_PATH_MAX];
    struct colmap_model m = {0};
    struct err e = {0};
    make_model(&m);
    kit_tmpdir(dir);
    kit_ok(colmap_write_bin(dir, &m, &e), e);
    colmap_free(&m);
    for (int part = 0; part < 3; part++) {
        char name[32];
        struct buf whole = {0};
        snprintf(name, sizeof name, "%s.bin", parts[part]);
        read_part(dir, name, &whole);
        const struct part in = {dir, name};
        const struct torture torture = {.name = name, .decode = decode_part, .user = &in};
        torture_cuts(&torture, &whole, 1);
        torture_flips(&torture, &whole, 0, 5 + (uint64_t)part, whole.size / 3);
        put_part(dir, name, whole.data, whole.size);
        buf_u8(&whole, 0);
        put_part(dir, name, whole.data, whole.size);
        kit_fails(colmap_read(dir, &m, &e), ERR_FORMAT, e, "follow");
        put_part(dir, name, whole.data, whole.size - 1);
        buf_free(&whole);
    }
    kit_ok(colmap_read(dir, &m, &e), e);
    colmap_free(&m);
    kit_rmdir(dir);
}

/* Cut the text files: an error, or (at a line end, inside a number) a smaller sound model; never a
 * crash. */
static void test_cut_texts(void **state)
{
    char dir[FILE_PATH_MAX], txt[FILE_PATH_MAX + 8];
    struct colmap_model m = {0};
    struct err e = {0};
    make_model(&m);
    kit_tmpdir(dir);
    snprintf(txt, sizeof txt, "%s/txt", dir);
    kit_ok(file_mkdir(txt, &e), e);
    write_text(txt, &m);
    colmap_free(&m);
    for (int part = 0; part < 3; part++) {
        char name[32];
        struct buf whole = {0};
        snprintf(name, sizeof name, "%s.txt", parts[part]);
        const struct part in = {txt, name};
        const struct torture torture = {.name = name, .decode = decode_part, .user = &in};
        read_part(txt, name, &whole);
        for (size_t n = (size_t)part; n < whole.size; n += 3) {
            enum err_code rc = torture_decode(&torture, whole.data, n, NULL, &e);
            assert_true(!rc || rc == ERR_FORMAT);
        }
        put_part(txt, name, whole.data, whole.size);
        buf_free(&whole);
    }
    kit_rmdir(dir);
}

static void test_named_errors(void **state)
{
    char dir[FILE_PATH_MAX];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    kit_tmpdir(dir);
    kit_fails(colmap_read(dir, &out, &e), ERR_NOENT, e, "looked for");
    make_model(&m);
    write_text(dir, &m);
    static const struct {
        const char *name, *text, *says;
    } bad[] = {
        {"cameras.txt", "1 FISH 10 10 1 2 3\n", "FISH"},
        {"cameras.txt", "1 PINHOLE 10 10 1 2 3\n", "line 1"},
        {"cameras.txt", "1 PINHOLE 10 10 1 2 3 4 5\n", "only 4"},
        {"cameras.txt", "1 PINHOLE 10 10 -1 2 3 4\n", "focal"},
        {"cameras.txt", "1 PINHOLE 10 10 nan 2 3 4\n", "finite"},
        {"cameras.txt", "3 PINHOLE 9 9 1 2 3 4\n3 PINHOLE 9 9 1 2 3 4\n", "twice"},
        {"cameras.txt", "3 PINHOLE 9 9 1 2 3 4\n", "camera 8"},
        {"images.txt", "1 0 0 0 0 0 0 0 3 a.jpg\n\n", "quaternion"},
        {"images.txt", "1 1 0 0 0 0 0 0 3 a.jpg\n1 2\n", "threes"},
        {"images.txt", "1 1 0 0 0 0 0 0 3 a.jpg\n1 2 -2\n", "observation 0"},
        {"images.txt", "1 1 0 0 0 0 0 0 3 a.jpg", "which images does not hold"},
        {"images.txt", "1 1 0 0 0 0 0 0 3 a.jpg\n\n2 1 0 0 0 0 0 0 3 a.jpg\n\n", "twice"},
        {"images.txt", "1 1 0 0 0 0 0 0 3 a.jpg\n1 2 77777\n", "77777"},
        {"points3D.txt", "0 0 0 0 1 2 300 0\n", "R G B"},
        {"points3D.txt", "0 0 0 0 1 2 3 0 1\n", "IMAGE_ID OBS"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        put_part(dir, bad[i].name, bad[i].text, strlen(bad[i].text));
        kit_fails(colmap_read(dir, &out, &e), ERR_FORMAT, e, bad[i].says);
        write_text(dir, &m);
    }
    /* A point whose track leads to an observation of another point: two models mixed. */
    m.tracks[0].obs = m.tracks[0].obs == 1 ? 2 : 1;
    write_text(dir, &m);
    kit_fails(colmap_read(dir, &out, &e), ERR_FORMAT, e, "of one model");
    m.tracks[0].obs = 5000;
    write_text(dir, &m);
    kit_fails(colmap_read(dir, &out, &e), ERR_FORMAT, e, "5000");
    colmap_free(&m);
    char path[FILE_PATH_MAX + 32];
    snprintf(path, sizeof path, "%s/points3D.txt", dir);
    assert_int_equal(remove(path), 0);
    kit_fails(colmap_read(dir, &out, &e), ERR_NOENT, e, "has no points3D.txt");
    kit_rmdir(dir);
}

/* Poses alone: other programs leave out the lines of observations, and begin with a mark. */
static void test_no_observations(void **state)
{
    static const char images[] =
        "\xef\xbb\xbf# ID, QW...\n1 1 0 0 0 0 0 0 3 001.jpg\n2 1 0 0 0 0 0 0 3 b 2.jpg\n\n"
        "4 1 0 0 0 1 2 3 3 c.jpg";
    char dir[FILE_PATH_MAX];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    make_model(&m);
    kit_tmpdir(dir);
    write_text(dir, &m);
    colmap_free(&m);
    put_part(dir, "images.txt", images, sizeof images - 1);
    put_part(dir, "points3D.txt", "", 0);
    kit_ok(colmap_read(dir, &out, &e), e);
    assert_true(out.n_images == 3 && !out.n_points);
    assert_string_equal(out.images[1].name, "b 2.jpg");
    for (size_t i = 0; i < 3; i++)
        assert_int_equal(out.images[i].n_obs, 0);
    colmap_free(&out);
    kit_rmdir(dir);
}

/* Tracks without observations: pose and lens say where a point lies in a photograph, which does not
 * see what lies behind it. */
static void test_tracks_alone(void **state)
{
    enum { BEHIND = 7 };
    char dir[FILE_PATH_MAX];
    const struct colmap_observation *o;
    double rot[9], at[3];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    make_model(&m);
    m.points[2].error_px = -1;
    m.points[BEHIND].xyz[2] = -40;
    for (size_t i = 0; i < m.n_images; i++)
        m.images[i].n_obs = 0;
    kit_tmpdir(dir);
    log_set_level(LOG_ERROR);
    for (int text = 0; text < 2; text++) {
        if (text)
            write_text(dir, &m);
        else
            kit_ok(colmap_write_bin(dir, &m, &e), e);
        kit_ok(colmap_read(dir, &out, &e), e);
        assert_int_equal(out.n_tracks, m.n_tracks - m.points[BEHIND].n_track);
        for (size_t i = 0; i < out.n_points; i++) {
            const struct colmap_point *p = &out.points[i];
            assert_int_equal(p->n_track, i == BEHIND ? 0 : m.points[i].n_track);
            assert_true(p->error_px == (i == 2 ? 0 : m.points[i].error_px));
            for (size_t k = 0; k < p->n_track; k++) {
                const struct colmap_track_element *t = &out.tracks[p->track + k];
                assert_int_equal(t->image, m.tracks[m.points[i].track + k].image);
                assert_true(t->obs < out.images[t->image].n_obs);
                assert_int_equal(out.images[t->image].obs[t->obs].point, i);
            }
        }
        o = &out.images[1].obs[0]; /* of point 0, which lies at 0, -1, 2 */
        camera_quat_to_rot(m.images[1].quat_wxyz, rot);
        for (int a = 0; a < 3; a++)
            at[a] = 2 * rot[3 * a + 2] - rot[3 * a + 1] + m.images[1].trans[a];
        assert_true(fabs(o->x_px - (250 * at[0] / at[2] + 160)) < 1e-9);
        assert_true(fabs(o->y_px - (250 * at[1] / at[2] + 120)) < 1e-9);
        colmap_free(&out);
        if (!text)
            remove_binary(dir);
    }
    log_set_level(LOG_WARN);
    colmap_free(&m);
    kit_rmdir(dir);
}

/* Observations without tracks, and tracks of observations that name no point: either is enough. */
static void test_one_direction_is_enough(void **state)
{
    char dir[FILE_PATH_MAX];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    for (int tracks = 0; tracks < 2; tracks++) {
        size_t n_track[N_POINTS];
        make_model(&m);
        for (size_t p = 0; p < m.n_points; p++) {
            n_track[p] = m.points[p].n_track;
            m.points[p].n_track = tracks ? n_track[p] : 0;
        }
        for (size_t i = 0; i < m.n_images; i++)
            for (size_t k = 0; tracks && k < m.images[i].n_obs; k++)
                m.images[i].obs[k].point = -1;
        kit_tmpdir(dir);
        kit_ok(colmap_write_bin(dir, &m, &e), e);
        colmap_free(&m);
        kit_ok(colmap_read(dir, &out, &e), e);
        make_model(&m);
        expect_equal(&m, &out);
        colmap_free(&m);
        colmap_free(&out);
        kit_rmdir(dir);
    }
}

/* Points that are nowhere are left out, and nobody sees them. */
static void test_points_that_are_nowhere(void **state)
{
    char dir[FILE_PATH_MAX];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    make_model(&m);
    const uint64_t lost[] = {m.points[1].id, m.points[m.n_points - 1].id};
    size_t seen = 0, want = 0;
    for (size_t i = 0; i < m.n_images; i++)
        for (size_t j = 0; j < m.images[i].n_obs; j++)
            want += m.images[i].obs[j].point >= 0 && m.images[i].obs[j].point != 1 &&
                    m.images[i].obs[j].point != (int64_t)m.n_points - 1;
    m.points[1].xyz[2] = (double)NAN;
    m.points[m.n_points - 1].xyz[0] = (double)INFINITY;
    kit_tmpdir(dir);
    log_set_level(LOG_ERROR);
    for (int text = 0; text < 2; text++) {
        if (text)
            write_text(dir, &m);
        else
            kit_ok(colmap_write_bin(dir, &m, &e), e);
        kit_ok(colmap_read(dir, &out, &e), e);
        assert_int_equal(out.n_points, m.n_points - 2);
        seen = 0;
        for (size_t i = 0; i < out.n_points; i++)
            assert_true(out.points[i].id != lost[0] && out.points[i].id != lost[1]);
        for (size_t i = 0; i < out.n_images; i++)
            for (size_t j = 0; j < out.images[i].n_obs; j++)
                seen += out.images[i].obs[j].point >= 0;
        assert_int_equal(seen, want);
        colmap_free(&out);
        if (!text)
            remove_binary(dir);
    }
    log_set_level(LOG_WARN);
    colmap_free(&m);
    kit_rmdir(dir);
}

/* COLMAP writes -1 for an error that was not computed, other programs NaN. */
static void test_unknown_errors(void **state)
{
    char dir[FILE_PATH_MAX];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    make_model(&m);
    for (size_t t = 0; t < m.n_tracks; t++) { /* 5 px from where the point is */
        const struct colmap_image *im = &m.images[m.tracks[t].image];
        struct colmap_observation *o = &im->obs[m.tracks[t].obs];
        double rot[9], at[3];
        camera_quat_to_rot(im->quat_wxyz, rot);
        for (int a = 0; a < 3; a++) {
            at[a] = im->trans[a];
            for (int b = 0; b < 3; b++)
                at[a] += rot[3 * a + b] * m.points[o->point].xyz[b];
        }
        lens_distort(&m.cameras[im->camera].lens, at[0] / at[2], at[1] / at[2], &o->x_px, &o->y_px);
        o->x_px += 3;
        o->y_px -= 4;
    }
    m.points[2].error_px = -1;
    m.points[3].error_px = (double)NAN;
    m.points[4].error_px = (double)INFINITY;
    kit_tmpdir(dir);
    for (int text = 0; text < 2; text++) {
        if (text)
            write_text(dir, &m);
        else
            kit_ok(colmap_write_bin(dir, &m, &e), e);
        kit_ok(colmap_read(dir, &out, &e), e);
        for (size_t i = 0; i < out.n_points; i++)
            assert_true(fabs(out.points[i].error_px -
                             (i >= 2 && i <= 4 ? 5 : m.points[i].error_px)) < 1e-9);
        colmap_free(&out);
    }
    colmap_free(&m);
    kit_rmdir(dir);
}

/* Models of newer COLMAPs: fisheyes without distortion are read, the others named, and only if a
 * photograph needs them. */
static void test_newer_models(void **state)
{
    static const char last[] = "8 FISHEYE 320 240 250 251 160 120\n";
    static const struct {
        const char *line, *says;
    } foreign[] = {{"3 DIVISION 640 480 500 500 320 240 0.1\n", "image_undistorter"},
                   {"3 EUCM 640 480 500 500 320 240 0.5 1\n", "EUCM is not read"},
                   {"3 EQUIRECTANGULAR 640 480 640 480\n", "panoramas"},
                   {"3 EUCM 640 480 500 500 320 240 0.5\n", "EUCM needs 6"}};
    char dir[FILE_PATH_MAX], text[400];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    make_model(&m);
    kit_tmpdir(dir);
    write_text(dir, &m);
    colmap_free(&m);
    snprintf(text, sizeof text, "3 SIMPLE_FISHEYE 640 480 500 320 240\n%s%s", last,
             "9 SIMPLE_DIVISION 640 480 500 320 240 0.1\n");
    put_part(dir, "cameras.txt", text, strlen(text));
    kit_ok(colmap_read(dir, &out, &e), e);
    assert_int_equal(out.n_cameras, 2);
    double u, v, angle = atan(0.5);
    lens_distort(&out.cameras[0].lens, 0.5, 0, &u, &v);
    assert_true(fabs(u - 320 - 500 * angle) < 1e-9 && fabs(v - 240) < 1e-9);
    lens_distort(&out.cameras[1].lens, 0, 0.5, &u, &v);
    assert_true(fabs(u - 160) < 1e-9 && fabs(v - 120 - 251 * angle) < 1e-9);
    colmap_free(&out);
    for (size_t i = 0; i < sizeof foreign / sizeof *foreign; i++) {
        snprintf(text, sizeof text, "%s%s", foreign[i].line, last);
        put_part(dir, "cameras.txt", text, strlen(text));
        kit_fails(colmap_read(dir, &out, &e), ERR_FORMAT, e, foreign[i].says);
    }
    kit_rmdir(dir);
}

static void test_out_of_memory(void **state)
{
    char dir[FILE_PATH_MAX];
    struct colmap_model m = {0}, out;
    struct err e = {0};
    make_model(&m);
    kit_tmpdir(dir);
    kit_ok(colmap_write_bin(dir, &m, &e), e);
    colmap_free(&m);
    kit_out_of_memory(colmap_read(dir, &out, &e), 3, e);
    colmap_free(&out);
    kit_rmdir(dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip),
        cmocka_unit_test(test_truncation),
        cmocka_unit_test(test_cut_texts),
        cmocka_unit_test(test_named_errors),
        cmocka_unit_test(test_out_of_memory),
        cmocka_unit_test(test_unknown_errors),
        cmocka_unit_test(test_newer_models),
        cmocka_unit_test(test_no_observations),
        cmocka_unit_test(test_tracks_alone),
        cmocka_unit_test(test_one_direction_is_enough),
        cmocka_unit_test(test_points_that_are_nowhere),
    };
    return cmocka_run_group_tests_name("colmap", tests, NULL, NULL);
}
