/* Lists of ground control points that are written and read again, and marking: places that are
 * expected in photographs with distortion, residuals, files, and who else changed them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "ingest/ingest.h"
#include "ingest/marking.h"
#include "tests/kit.h"

static char tmp[FILE_PATH_MAX];

static int setup(void **state)
{
    (void)state;
    kit_tmpdir(tmp);
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    kit_rmdir(tmp);
    return 0;
}

static void put(const char *name, const char *text, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(path, tmp, name, &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
}

static void write_list(const struct gcp_list *l, enum gcp_form form, const char *name,
                       char path[FILE_PATH_MAX])
{
    struct err e = {0};
    struct buf b = {0};
    kit_ok(gcp_write(l, form, &b, &e), e);
    buf_u8(&b, 0);
    put(name, (const char *)b.data, path);
    buf_free(&b);
}

/* ---- forms ---- */

static void points_come_without_marks(void **state)
{
    static const char *const texts[] = {
        "name,easting,northing,h,sigma_xy\nnorth,634676.125,485344.5,112.25,0.03\nsouth,1,2,3\n",
        "EPSG:2180\n634676.125 485344.5 112.25 north\n1 2 3 4.5 6 a.jpg south\n",
        "# EPSG:2180\nid;x;y;z;u;v;image\nnorth;634676.125;485344.5;112.25\nsouth;1;2;3;4;6;a.j\n"};
    char path[FILE_PATH_MAX];
    (void)state;
    for (size_t i = 0; i < 3; i++) {
        struct err e = {0};
        struct gcp_list l;
        put("points.txt", texts[i], path);
        kit_ok(gcp_read_points(path, &l, &e), e);
        assert_true(l.n == 2 && l.n_marks == (i > 0) && l.epsg == (i ? 2180 : 0));
        assert_string_equal(l.gcps[0].name, "north");
        assert_true(l.gcps[0].at[0] == 634676.125 && l.gcps[0].at[2] == 112.25);
        assert_true(l.gcps[0].sigma_m[0] == (i ? 0 : 0.03));
        gcp_free(&l);
        if (i != 1)
            kit_fails(gcp_read(path, &l, &e), ERR_FORMAT, e,
                      i ? "line 3: field 5" : "column for px");
    }
}

static void bad_points_are_refused_by_line(void **state)
{
    static const struct {
        const char *text, *says;
    } bad[] = {{"name,x,y\na,1,2\n", "no column for z"},
               {"EPSG:2180\n1 2 north\n", "line 2: field 3"},
               {"EPSG:2180\n1 2,5 3 north\n", "line 2: '2,5' has a decimal comma"},
               {"name,x,y,z\na,1,2,3\na,1,2,4\n", "line 3: ground control point a lies at"},
               {"name,x,y,z\na,1,2,3,4,5\n", "line 2: 6 fields"}};
    char path[FILE_PATH_MAX];
    (void)state;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct err e = {0};
        struct gcp_list l;
        put("bad.txt", bad[i].text, path);
        kit_fails(gcp_read_points(path, &l, &e), ERR_FORMAT, e, bad[i].says);
    }
}

static void lists_are_read_as_they_were_written(void **state)
{
    char path[FILE_PATH_MAX];
    (void)state;
    for (int form = GCP_FORM_ODM; form <= GCP_FORM_CSV; form++) {
        struct err e = {0};
        struct gcp_list a, b;
        put("all.csv",
            "# EPSG:25832+7837\nname,x,y,z,px,py,image,accuracy_xy,accuracy_z,accuracy_px\n"
            "p1,634676.1234567,5485344.000001,-0.1,1024.5,3.125,b/DJI_1.JPG,0.01,0.02,0.3\n"
            "p1,634676.1234567,5485344.000001,-0.1,7,8,DJI_2.JPG,0.01,0.02,\n"
            "alone,1,2,3,,,,,,\nlast,1e3,2,0.3333333333333333,0,0,c.jpg,,,\n",
            path);
        kit_ok(gcp_read_points(path, &a, &e), e);
        write_list(&a, (enum gcp_form)form, "again", path);
        kit_ok(gcp_read(path, &b, &e), e); /* as ingest reads it */
        assert_true(b.epsg == 25832 && b.heights_epsg == 7837 && b.n == 2 && b.n_marks == 3);
        assert_memory_equal(a.gcps[0].at, b.gcps[0].at, sizeof a.gcps[0].at);
        assert_memory_equal(a.gcps[2].at, b.gcps[1].at, sizeof a.gcps[2].at);
        for (size_t k = 0; k < 3; k++) {
            assert_string_equal(a.marks[k].image, b.marks[k].image);
            assert_true(a.marks[k].x_px == b.marks[k].x_px && a.marks[k].y_px == b.marks[k].y_px);
            assert_true(form == GCP_FORM_ODM || a.marks[k].sigma_px == b.marks[k].sigma_px);
        }
        assert_true(b.gcps[0].sigma_m[1] == (form == GCP_FORM_ODM ? 0 : 0.02));
        snprintf(a.gcps[1].name, sizeof a.gcps[1].name, "by the%s church",
                 form == GCP_FORM_ODM ? "" : ",");
        struct buf out = {0};
        kit_fails(gcp_write(&a, (enum gcp_form)form, &out, &e), ERR_DATA, e, "church");
        a.epsg = 0;
        kit_fails(gcp_write(&a, (enum gcp_form)form, &out, &e), ERR_DATA, e, "not known");
        buf_free(&out);
        gcp_free(&a);
        gcp_free(&b);
    }
}

/* ---- a survey: six cameras above level ground, 100 m high, that look down ---- */

enum { PHOTOS = 6, POINTS = 5 };
static const struct geo_origin origin = {8.5, 50.1, 100};
static const double places[POINTS][3] = {
    {10, 12, 0}, {-15, 8, 2}, {4, -14, 5}, {-8, -6, 1}, {900, 0, 0}};

static const struct lens lens = {.model = LENS_OPENCV,
                                 .width_px = 2000,
                                 .height_px = 1500,
                                 .params = {1600, 1600, 1000, 750, -0.08, 0.02, 0.001, -0.001}};

/* x_cam = rot (x - center), z down; in a picture x is east. */
static void camera_of(size_t i, double center[3], double rot[9])
{
    static const double down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1};
    const double at[3] = {30 * (double)(i % 3) - 30, 20 * (double)(i / 3) - 10, 100};
    memcpy(center, at, sizeof at);
    memcpy(rot, down, sizeof down);
}

static void make_survey(struct ingest_survey *s, bool placed)
{
    *s = (struct ingest_survey){.n = PHOTOS, .placed = placed, .origin = origin};
    s->sim = (struct sim3){.scale = 1, .rot = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    s->model.n_images = PHOTOS;
    s->model.n_cameras = 1;
    s->model.images = arena_get(&s->model.arena, PHOTOS, sizeof *s->model.images);
    s->model.cameras = arena_get(&s->model.arena, 1, sizeof *s->model.cameras);
    s->photos = mem_array(PHOTOS, sizeof *s->photos);
    s->model.cameras->lens = lens;
    for (size_t i = 0; i < PHOTOS; i++) {
        char name[32];
        snprintf(name, sizeof name, "%s/DJI_%zu.JPG", i % 2 ? "b" : "a", i / 2);
        s->model.images[i].name = arena_text(&s->model.arena, name);
        s->photos[i] = (struct ingest_survey_photo){
            .file = mem_text(name), .width_px = 4000, .height_px = 3000}; /* twice COLMAP's */
        s->photos[i].view.image = &s->model.images[i];
        s->photos[i].view.lens = &s->model.cameras->lens;
        camera_of(i, s->photos[i].view.center, s->photos[i].view.rot);
    }
}

/* Pixel of the file; false: outside. */
static bool seen(size_t point, size_t photo, double px[2])
{
    double c[3], r[9];
    camera_of(photo, c, r);
    const double *p = places[point], z = c[2] - p[2];
    lens_distort(&lens, (p[0] - c[0]) / z, (c[1] - p[1]) / z, &px[0], &px[1]);
    px[0] *= 2;
    px[1] *= 2;
    return fabs(p[0] - c[0]) < z && px[0] > 0 && px[1] > 0 && px[0] < 4000 && px[1] < 3000;
}

/* raised_m: heights of the list count from elsewhere. */
static void open_desk(struct marking **m, const char *output, bool placed, double raised_m)
{
    struct err e = {0};
    struct ingest_survey s;
    struct gcp_list l = {.epsg = GCP_LONLAT};
    const struct marking_config cfg = {
        .output = output, .px_scale = 1, .mark_px = 0.5, .sigma_m = 0.02};
    make_survey(&s, placed);
    for (size_t i = 0; i < POINTS; i++) {
        struct gcp g = {0};
        snprintf(g.name, sizeof g.name, "p%zu", i);
        kit_ok(geo_from_enu(&origin, places[i], &g.file[0], &g.file[1], &g.file[2], &e), e);
        g.file[2] += raised_m;
        kit_ok(gcp_add_point("list", &l, &g, &e), e);
    }
    kit_ok(marking_open(&cfg, &s, &l, m, &e), e);
}

static void mark_in(struct marking *m, size_t point, size_t n, double off_px)
{
    size_t done = 0;
    for (size_t i = 0; i < PHOTOS && done < n; i++) {
        struct err e = {0};
        double px[2];
        if (!seen(point, i, px))
            continue;
        px[0] += ++done == n ? off_px : 0;
        kit_ok(marking_set(m, point, i, px, &e), e);
    }
    assert_true(done == n);
}

/* Largest distance of where a point is expected from where it is. */
static double worst_expected(const struct marking *m, size_t point)
{
    struct marking_spot spots[PHOTOS];
    double px[2], worst = 0;
    const size_t n = marking_spots(m, point, spots);
    assert_true(n > 0);
    for (size_t i = 0; i < n; i++)
        if (spots[i].expected && seen(point, spots[i].photo, px))
            worst = fmax(worst,
                         hypot(px[0] - spots[i].expected_px[0], px[1] - spots[i].expected_px[1]));
    return worst;
}

static void places_are_expected_through_the_lens(void **state)
{
    struct marking *m;
    struct marking_spot spots[PHOTOS];
    char path[FILE_PATH_MAX];
    struct err e = {0};
    (void)state;
    kit_ok(file_join(path, tmp, "expected.txt", &e), e);
    open_desk(&m, path, true, 0);
    for (size_t i = 0; i < 4; i++)
        assert_true(worst_expected(m, i) < 0.02);
    assert_true(marking_spots(m, 4, spots) == 0); /* polynomials would lead it back into pictures */
    size_t n = marking_spots(m, 0, spots);
    for (size_t i = 1; i < n; i++)
        assert_true(spots[i].middle >= spots[i - 1].middle);
    marking_close(&m);
    open_desk(&m, path, true, 20); /* another surface: off, until one point is marked */
    assert_true(worst_expected(m, 1) > 30);
    mark_in(m, 0, 2, 0);
    assert_true(worst_expected(m, 0) < 0.02 && worst_expected(m, 1) < 0.2);
    marking_close(&m);
    open_desk(&m, path, false, 0); /* without GPS: all photographs, until three points are marked */
    assert_true(marking_spots(m, 3, spots) == PHOTOS);
    assert_true(marking_point(m, 3).source == MARKING_NOWHERE);
    for (size_t i = 0; i < 3; i++)
        mark_in(m, i, 3, 0);
    assert_true(marking_point(m, 3).source == MARKING_FRAME && worst_expected(m, 3) < 0.5);
    marking_close(&m);
}

static void a_wrong_mark_and_a_wrong_point_show(void **state)
{
    struct marking *m;
    struct marking_spot spots[PHOTOS];
    char path[FILE_PATH_MAX];
    struct err e = {0};
    size_t bad = 0;
    (void)state;
    kit_ok(file_join(path, tmp, "wrong.csv", &e), e);
    open_desk(&m, path, true, 0);
    mark_in(m, 0, 4, 30);
    size_t n = marking_spots(m, 0, spots);
    for (size_t i = 0; i < n; i++) {
        bad += spots[i].suspect;
        assert_true(!spots[i].marked || (spots[i].suspect ? fabs(spots[i].residual_px - 30) < 0.05
                                                          : spots[i].residual_px < 0.01));
    }
    struct marking_point p = marking_point(m, 0);
    assert_true(bad == 1 && p.marks == 4 && p.suspects == 1 && fabs(p.worst_px - 30) < 0.05);
    marking_close(&m);
}

static void changes_are_in_the_file(void **state)
{
    static const double outside[2] = {4001, 3}, at[2] = {2468.2, 1000.6};
    struct marking *m;
    struct gcp_list l;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    (void)state;
    kit_ok(file_join(path, tmp, "file.txt", &e), e);
    open_desk(&m, path, true, 0);
    kit_ok(marking_set(m, 1, 2, at, &e), e);
    kit_ok(marking_set(m, 0, 3, at, &e), e);
    assert_true(marking_revision(m) == 2);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_true(l.n == 2 && l.n_marks == 2);
    assert_string_equal(l.marks[0].image, "b/DJI_1.JPG"); /* a/DJI_1.JPG has the same name */
    assert_true(l.marks[0].x_px == 1234.1 && l.marks[0].y_px == 500.3); /* COLMAP's pixels */
    gcp_free(&l);
    kit_fails(marking_set(m, 1, 2, outside, &e), ERR_ARG, e, "outside of a/DJI_1.JPG");
    kit_ok(marking_set(m, 1, 2, NULL, &e), e);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_true(l.n_marks == 1);
    gcp_free(&l);
    put("file.txt", "EPSG:4326\n", path); /* somebody else */
    kit_fails(marking_set(m, 1, 2, at, &e), ERR_BUSY, e, "changed by another program");
    assert_true(marking_list(m)->n_marks == 1 && marking_revision(m) == 3);
    marking_close(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_come_without_marks),
        cmocka_unit_test(bad_points_are_refused_by_line),
        cmocka_unit_test(lists_are_read_as_they_were_written),
        cmocka_unit_test(places_are_expected_through_the_lens),
        cmocka_unit_test(a_wrong_mark_and_a_wrong_point_show),
        cmocka_unit_test(changes_are_in_the_file),
    };
    return cmocka_run_group_tests_name("marking", tests, setup, teardown);
}
