/* Mistakes in ground control: those that people make in lists of control points, one at a time, in
 * the list of a synthetic survey. Each must be named. If one point or one mark is wrong, check
 * points must be as accurate as without it. And predicted errors must equal real ones, over many
 * surveys. One piece, because all cases change the one list of the one survey that is made here.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "scene/control/gcp_fit.h"
#include "scene/control/gcp_read.h"
#include "scene/ingest/ingest.h"
#include "survey/crs.h"
#include "tests/scene/city_kit.h"

enum { PLACES = 14, CONTROL = 10, MARKS = 8, ROWS = PLACES * MARKS, SURVEYS = 60, EPSG = 32632 };
/* Photographs of 1600 x 1200 px, 5 cm on the ground; only poses and GPS of theirs matter here. */
static const double scale = 20, survey_m = 0.02, mark_px = 0.5;
/* With one of the mistakes in it a survey may be so much worse at its check points. */
static const double worse_most = 1.3;
/* Predicted over true error: with 60 surveys the ratio is known to about 5 %. */
static const double ratio_least = 0.8, ratio_most = 1.25;

static const double places[PLACES][3] = {{-30, -28, 2}, {31, -25, 0}, {28, 33, 5},  {-29, 30, 1},
                                         {2, -3, 9},    {14, 12, 0},  {-15, 10, 3}, {10, -18, 0},
                                         {-2, 31, 1},   {0, -30, 2},  {22, 5, 6},   {-8, -20, 1},
                                         {-20, -5, 2},  {5, 25, 0}};

static char tmp[FILE_PATH_MAX], city[FILE_PATH_MAX];
static struct arena texts;
static struct scene by_gps; /* the city as GPS without errors places it */

struct row {
    double x, y, z, px, py;
    char image[128], name[16];
};

/* ---- a survey ---- */

static void make_city(const char *name, double gps_sigma_m)
{
    struct err e = {0};
    struct synth_config c;
    char dir[FILE_PATH_MAX];
    kit_ok(file_join(dir, tmp, name, &e), e);
    city_kit_config(&c, &texts, dir, 32);
    c.gps_sigma_m = gps_sigma_m;
    kit_ok(synth_run(&c, &e), e);
}

static int setup(void **state)
{
    struct err e = {0};
    struct ingest_config c;
    char dir[FILE_PATH_MAX], images[FILE_PATH_MAX];
    kit_tmpdir(tmp);
    make_city("exact", 0);
    make_city("city", 2);
    kit_ok(file_join(city, tmp, "exact", &e), e);
    kit_ok(file_join(images, city, "images", &e), e);
    kit_ok(options_defaults(ingest_options(), &c, &texts, &e), e);
    kit_ok(file_join(dir, tmp, "by-gps", &e), e);
    c.output = dir;
    c.exposure = false;
    kit_ok(ingest_run(images, city, &c, &e), e);
    kit_ok(scene_read(dir, &by_gps, &e), e);
    return 0;
}

static int teardown(void **state)
{
    scene_free(&by_gps);
    arena_free(&texts);
    kit_rmdir(tmp);
    return 0;
}

/* All places with errors of survey and marks, in a projection; check points are exact. */
static size_t survey(uint64_t seed, int epsg, struct row out[ROWS])
{
    struct err e = {0};
    struct crs *crs = NULL;
    size_t n = 0;
    if (epsg)
        kit_ok(crs_open(epsg, &crs, &e), e);
    for (size_t i = 0; i < PLACES; i++) {
        double at[3], lon, lat, h, px[2];
        size_t marks = 0;
        for (size_t k = 0; k < 3; k++)
            at[k] = places[i][k] + (i < CONTROL) * survey_m * rng_normal(seed, k, i);
        kit_ok(geo_from_enu(&by_gps.origin, at, &lon, &lat, &h, &e), e);
        if (crs)
            kit_ok(crs_project(crs, 1, &lon, &lat, &e), e);
        for (size_t k = 0; k < by_gps.n_images && marks < MARKS; k++) {
            struct row *r = &out[n];
            if (!city_kit_sees(&by_gps.images[k].cam, places[i], 2, px))
                continue;
            *r = (struct row){.x = lon, .y = lat, .z = h};
            r->px = px[0] * scale + mark_px * rng_normal(seed, 100 + i, 2 * k);
            r->py = px[1] * scale + mark_px * rng_normal(seed, 100 + i, 2 * k + 1);
            snprintf(r->image, sizeof r->image, "%s", by_gps.images[k].name);
            snprintf(r->name, sizeof r->name, "p%zu", i);
            marks++;
            n++;
        }
        assert_true(marks >= 4);
    }
    crs_close(&crs);
    return n;
}

/* ---- mistakes ---- */

static struct row *first_of(struct row *r, size_t n, const char *name)
{
    for (size_t i = 0; i < n; i++)
        if (!strcmp(r[i].name, name))
            return &r[i];
    fail_msg("no point %s", name);
    return NULL;
}

static void shift(struct row *r, size_t n, const char *name, double x, double y, double z)
{
    for (size_t i = 0; i < n; i++)
        if (!name || !strcmp(r[i].name, name)) {
            r[i].x += x;
            r[i].y += y;
            r[i].z += z;
        }
}

static void swap_axes(struct row *r, size_t n, const char *name)
{
    for (size_t i = 0; i < n; i++)
        if (!name || !strcmp(r[i].name, name)) {
            double x = r[i].x;
            r[i].x = r[i].y;
            r[i].y = x;
        }
}

static void stretch(struct row *r, size_t n, double plan, double height)
{
    for (size_t i = 0; i < n; i++) {
        r[i].x *= plan;
        r[i].y *= plan;
        r[i].z *= height;
    }
}

static void swapped(struct row *r, size_t n)
{
    swap_axes(r, n, NULL);
}
static void feet(struct row *r, size_t n)
{
    stretch(r, n, 1 / 0.3048, 1 / 0.3048);
}
static void feet_up(struct row *r, size_t n)
{
    stretch(r, n, 1, 1 / 0.3048);
}
static void us_feet(struct row *r, size_t n)
{
    stretch(r, n, 3937.0 / 1200, 3937.0 / 1200);
}
static void sign_lost(struct row *r, size_t n)
{
    for (size_t i = 0; i < n; i++)
        r[i].x = -r[i].x;
}
static void zone_before(struct row *r, size_t n)
{
    shift(r, n, NULL, 32e6, 0, 0);
}
static void millimetres(struct row *r, size_t n)
{
    stretch(r, n, 1000, 1);
}
static void sea_level(struct row *r, size_t n)
{
    shift(r, n, NULL, 0, 0, -47.8);
}
static void elsewhere(struct row *r, size_t n)
{
    shift(r, n, NULL, 70e3, 70e3, 0);
}
static void metre_off(struct row *r, size_t n)
{
    shift(r, n, "p3", 0.8, -0.6, 0);
}
static void eight_off(struct row *r, size_t n)
{
    shift(r, n, "p1", 0, 8, 0);
}
static void metre_up(struct row *r, size_t n)
{
    shift(r, n, "p4", 0, 0, 1);
}
static void digit(struct row *r, size_t n)
{
    shift(r, n, "p6", 0, 100, 0);
}
static void check_off(struct row *r, size_t n)
{
    shift(r, n, "p11", 1, 0, 0);
}
static void one_swapped(struct row *r, size_t n)
{
    swap_axes(r, n, "p2");
}
static void one_in_feet(struct row *r, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!strcmp(r[i].name, "p5"))
            r[i].z /= 0.3048;
}
static void copied(struct row *r, size_t n)
{
    const struct row p7 = *first_of(r, n, "p7"), p0 = *first_of(r, n, "p0");
    shift(r, n, "p0", p7.x - p0.x, p7.y - p0.y, p7.z - p0.z);
}
static void exchanged(struct row *r, size_t n)
{
    const struct row a = *first_of(r, n, "p2"), b = *first_of(r, n, "p5");
    shift(r, n, "p2", b.x - a.x, b.y - a.y, b.z - a.z);
    shift(r, n, "p5", a.x - b.x, a.y - b.y, a.z - b.z);
}
static void mark_off(struct row *r, size_t n)
{
    struct row *m = first_of(r, n, "p3") + 2;
    m->px += m->px > 800 ? -24 : 24;
    m->py += m->py > 600 ? -18 : 18;
}
static void mark_swapped(struct row *r, size_t n)
{
    struct row *m = first_of(r, n, "p6");
    while (m->px > 1150 || fabs(m->px - m->py) < 100)
        m++;
    assert_string_equal(m->name, "p6");
    double x = m->px;
    m->px = m->py;
    m->py = x;
}
/* The mark of another photograph, which has the point elsewhere. */
static void mark_elsewhere(struct row *r, size_t n)
{
    struct row *m = first_of(r, n, "p7");
    m[1].px = m[3].px;
    m[1].py = m[3].py;
    assert_true(hypot(m[0].px - m[1].px, m[0].py - m[1].py) > 20);
}
static void same_name(struct row *r, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (!strcmp(r[i].name, "p4"))
            snprintf(r[i].name, sizeof r[i].name, "p3");
}
static void mark_twice(struct row *r, size_t n)
{
    struct row *m = first_of(r, n, "p5");
    memcpy(m[1].image, m[0].image, sizeof m[1].image);
}

enum form { FORM_ODM, FORM_CSV, FORM_COMMA_X, FORM_COMMA_PX, FORM_COMMA_CSV, FORM_COMMA_EXCEL };

static void number(struct buf *b, double v, bool comma, const char *after)
{
    char text[40];
    snprintf(text, sizeof text, "%.9f", v);
    if (comma)
        *strchr(text, '.') = ',';
    buf_printf(b, "%s%s", text, after);
}

static void list_write(const struct row *r, size_t n, const char *head, enum form form,
                       char path[FILE_PATH_MAX])
{
    struct err e = {0};
    struct buf b = {0};
    bool csv = form == FORM_CSV || form >= FORM_COMMA_CSV;
    const char *by = form == FORM_COMMA_EXCEL ? ";" : csv ? "," : " ";
    if (csv)
        buf_printf(&b, "x%sy%sz%spx%spy%simage%sname\n", by, by, by, by, by, by);
    else
        buf_printf(&b, "%s\n", head);
    for (size_t i = 0; i < n; i++) {
        bool all = form == FORM_COMMA_EXCEL || (form == FORM_COMMA_CSV && i == 20);
        number(&b, r[i].x, all || (form == FORM_COMMA_X && i == 20), by);
        number(&b, r[i].y, all, by);
        number(&b, r[i].z, all, by);
        number(&b, r[i].px, all || (form == FORM_COMMA_PX && i == 20), by);
        number(&b, r[i].py, all, by);
        buf_printf(&b, "%s%s%s\n", r[i].image, by, r[i].name);
    }
    kit_ok(buf_check(&b, &e), e);
    kit_ok(file_join(path, tmp, csv ? "list.csv" : "gcp_list.txt", &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

/* ---- through the program ---- */

static double told(const char *a, const char *b)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    json_t *o;
    kit_ok(file_join(path, tmp, "out/report.json", &e), e);
    kit_ok(jsonc_read(path, &o, &e), e);
    const json_t *v = json_object_get(json_object_get(o, "ground_control"), a);
    v = b ? json_object_get(v, b) : v;
    double x = json_is_number(v) ? json_number_value(v) : (double)NAN;
    json_decref(o);
    return x;
}

static int run(const char *list, const char *options, struct buf *out)
{
    return kit_run(out,
                   "cd '%s' && '%s' ingest city/images city -o out --overwrite --no-exposure --gcp "
                   "'%s' --gcp-scale %g --check p10,p11,p12,p13 %s",
                   tmp, kit_program(), list, scale, options);
}

static double check_rmse(void)
{
    return hypot(told("check", "rmse_plan_m"), told("check", "rmse_height_m"));
}

struct mistake {
    const char *name;
    void (*make)(struct row *r, size_t n);
    int epsg;         /* that the coordinates are in; 0: longitude and latitude */
    const char *head; /* and what the list says */
    enum form form;
    const char *options;
    int exit;
    const char *says[3];
    bool check; /* check points must lie as well as without the mistake */
};

static const struct mistake mistakes[] = {
    {"zone 33 for 32",
     NULL,
     EPSG,
     "EPSG:32633",
     FORM_ODM,
     "",
     1,
     {"km from where GPS has the photographs", "the zone: EPSG:32632"},
     false},
    {"south for north",
     NULL,
     EPSG,
     "WGS84 UTM 32S",
     FORM_ODM,
     "",
     1,
     {"km from where GPS", "the hemisphere: EPSG:32632"},
     false},
    {"x and y swapped",
     swapped,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     1,
     {"x and y are swapped"},
     false},
    {"latitude first", swapped, 0, "EPSG:4326", FORM_ODM, "", 1, {"x and y are swapped"}, false},
    {"latitude first of ETRS89",
     swapped,
     0,
     "EPSG:4258",
     FORM_ODM,
     "",
     1,
     {"x and y are swapped"},
     false},
    {"metres as degrees",
     NULL,
     EPSG,
     "EPSG:4258",
     FORM_ODM,
     "",
     2,
     {"is no longitude and latitude: name the coordinate system"},
     false},
    {"degrees as metres",
     NULL,
     0,
     "EPSG:32632",
     FORM_ODM,
     "",
     2,
     {"looks like longitude and latitude, and EPSG:32632 counts metres"},
     false},
    {"heights of two systems",
     NULL,
     25832,
     "EPSG:5555+7837",
     FORM_ODM,
     "",
     2,
     {"EPSG:5555 has heights of EPSG:5783, and EPSG:7837 is named", "EPSG:25832"},
     false},
    {"heights in feet of a code",
     NULL,
     EPSG,
     "EPSG:32632+6360",
     FORM_ODM,
     "",
     2,
     {"NAVD88 height (ftUS)", "no system of heights in metres"},
     false},
    {"feet", feet, EPSG, "EPSG:32632", FORM_ODM, "", 1, {"coordinates are in feet"}, false},
    {"US survey feet",
     us_feet,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     1,
     {"km from where GPS", "in feet, international or US survey"},
     false},
    {"a sign of longitudes",
     sign_lost,
     0,
     "EPSG:4326",
     FORM_ODM,
     "",
     1,
     {"km from where GPS", "western longitudes lost their sign"},
     false},
    {"zone before the eastings",
     zone_before,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     2,
     {"line 2: ground control point p0", "do the eastings begin with the number of the zone"},
     false},
    {"millimetres",
     millimetres,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     2,
     {"line 2: ground control point p0", "it does not reach the place", "millimetres"},
     false},
    {"another survey",
     elsewhere,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     1,
     {"99.0 km from", "another survey"},
     false},
    {"heights in feet",
     feet_up,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"in height from GPS", "heights are in feet"},
     false},
    {"ED50 as WGS 84",
     NULL,
     23032,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"m in plan", "EPSG:23032 (zone 32, ED50) fits"},
     true},
    {"heights of the sea",
     sea_level,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"-4", "the vertical datum"},
     true},
    {"a decimal comma",
     NULL,
     EPSG,
     "EPSG:32632",
     FORM_COMMA_X,
     "",
     1,
     {"gcp_list.txt: line 22:", "has a decimal comma"},
     false},
    {"a decimal comma in a mark",
     NULL,
     EPSG,
     "EPSG:32632",
     FORM_COMMA_PX,
     "",
     1,
     {"line 22:", "has a decimal comma"},
     false},
    {"decimal commas in CSV",
     NULL,
     EPSG,
     "",
     FORM_COMMA_CSV,
     "--gcp-epsg 32632",
     1,
     {"line 22: 12 fields", "decimal commas"},
     false},
    {"decimal commas and semicolons",
     NULL,
     EPSG,
     "",
     FORM_COMMA_EXCEL,
     "--gcp-epsg 32632",
     0,
     {"line 2: decimal commas are read as points", "control: RMSE"},
     false},
    {"one name for two points",
     same_name,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     1,
     {"ground control point p3 lies at", "before"},
     false},
    {"two marks in a photograph",
     mark_twice,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     1,
     {"both mark ground control point p5 in"},
     false},
    {"marks of large photographs",
     NULL,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "--gcp-scale 1",
     1,
     {"lies outside of", "--gcp-scale"},
     false},
    {"a point 1 m off",
     metre_off,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: control point p3", "m off in plan"},
     true},
    {"a point 8 m off",
     eight_off,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: control point p1"},
     true},
    {"a point 1 m high",
     metre_up,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: control point p4"},
     true},
    {"a digit", digit, EPSG, "EPSG:32632", FORM_ODM, "", 0, {"suspect: control point p6"}, true},
    {"a check point 1 m off",
     check_off,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: check point p11"},
     false},
    {"one point swapped",
     one_swapped,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: ground control point p2", "x and y are swapped"},
     true},
    {"one height in feet",
     one_in_feet,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: control point p5", "height is in feet"},
     true},
    {"a line copied",
     copied,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: control point p0", "has the coordinates of p7"},
     true},
    {"two names exchanged",
     exchanged,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: control point p2", "it and p5 have each other's name"},
     true},
    {"a mark 30 px off",
     mark_off,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: mark of p3 in"},
     true},
    {"column and row swapped",
     mark_swapped,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: mark of p6 in"},
     true},
    {"a mark of another photograph",
     mark_elsewhere,
     EPSG,
     "EPSG:32632",
     FORM_ODM,
     "",
     0,
     {"suspect: mark of p7 in"},
     true},
};
enum { MISTAKES = sizeof mistakes / sizeof *mistakes };

static size_t expect(const struct mistake *m, int rc, int exit, const struct buf *out)
{
    const char *text = (const char *)out->data, *lacks = rc == exit ? NULL : "the exit status";
    for (size_t k = 0; k < 3 && m->says[k]; k++)
        if (!strstr(text, m->says[k]))
            lacks = m->says[k];
    if (lacks)
        printf("%s: exit %d, expected %d; lacks '%s':\n%s", m->name, rc, exit, lacks, text);
    return lacks != NULL;
}

static void mistakes_are_named(void **state)
{
    static struct row r[ROWS];
    struct buf out = {0};
    char list[FILE_PATH_MAX];
    list_write(r, survey(1, EPSG, r), "EPSG:32632", FORM_ODM, list);
    assert_int_equal(run(list, "", &out), 0);
    if (strstr((const char *)out.data, "suspect") || strstr((const char *)out.data, "likely"))
        fail_msg("nothing is wrong here:\n%s", (const char *)out.data);
    buf_free(&out);
    double clean = check_rmse();
    size_t wrong = 0;
    printf("control: check points without mistakes %.4f m\n", clean);
    for (size_t i = 0; i < MISTAKES; i++) {
        const struct mistake *m = &mistakes[i];
        size_t n = survey(1, m->epsg, r);
        if (m->make)
            m->make(r, n);
        list_write(r, n, m->head, m->form, list);
        int rc = run(list, m->options, &out);
        wrong += expect(m, rc, m->exit, &out);
        buf_free(&out);
        if (!m->check || rc)
            continue;
        double reweighed = check_rmse();
        rc = run(list, "--suspects drop", &out);
        wrong += expect(m, rc, 0, &out);
        buf_free(&out);
        double dropped = check_rmse();
        printf("control: %-30s check points %.4f m reweighed, %.4f dropped\n", m->name, reweighed,
               dropped);
        wrong += !(reweighed < worse_most * clean) || !(dropped < worse_most * clean);
    }
    assert_int_equal(wrong, 0);
}

/* Degrees of any datum, and codes of plane and heights in one. */
static void systems_with_degrees_and_heights_are_read(void **state)
{
    static const struct {
        int epsg; /* 0: degrees */
        const char *head, *heights;
    } lists[] = {
        {0, "EPSG:4258", "unknown"},           {0, "EPSG:4269", "unknown"},
        {0, "EPSG:4979", "ellipsoid"},         {0, "EPSG:4937", "ellipsoid"},
        {0, "EPSG:9518", "EPSG:3855"},         {0, "EPSG:4258+7837", "EPSG:7837"},
        {25832, "EPSG:5555", "EPSG:5783"},     {25832, "EPSG:25832 + EPSG:7837", "EPSG:7837"},
        {25832, "EPSG:5555+5783", "EPSG:5783"}};
    static struct row r[ROWS];
    struct err e = {0};
    struct buf out = {0};
    struct scene s;
    char list[FILE_PATH_MAX], dir[FILE_PATH_MAX];
    kit_ok(file_join(dir, tmp, "out", &e), e);
    for (size_t i = 0; i < sizeof lists / sizeof *lists; i++) {
        list_write(r, survey(1, lists[i].epsg, r), lists[i].head, FORM_ODM, list);
        int rc = run(list, "", &out);
        buf_u8(&out, 0);
        if (rc)
            fail_msg("%s: %s", lists[i].head, (const char *)out.data);
        buf_free(&out);
        kit_ok(scene_read(dir, &s, &e), e);
        if (strcmp(s.heights, lists[i].heights) || !(check_rmse() < 0.1))
            fail_msg("%s: heights %s, check points %.4f m", lists[i].head, s.heights, check_rmse());
        scene_free(&s);
    }
}

/* What the robust fit is for: with all points alike, one that is 8 m off spoils everything. */
static void keeping_a_mistake_costs(void **state)
{
    static struct row r[ROWS];
    struct buf out = {0};
    char list[FILE_PATH_MAX];
    size_t n = survey(1, EPSG, r);
    eight_off(r, n);
    list_write(r, n, "EPSG:32632", FORM_ODM, list);
    assert_int_equal(run(list, "--suspects keep", &out), 0);
    kit_expect_text((const char *)out.data, "counts all the same", __FILE__, __LINE__);
    buf_free(&out);
    printf("control: a point 8 m off, kept: check points %.4f m\n", check_rmse());
    assert_true(check_rmse() > 0.5);
}

/* Two points fit whatever they are: nobody may read that as accuracy. */
static void two_points_are_no_rmse(void **state)
{
    static struct row r[ROWS];
    struct buf out = {0};
    char list[FILE_PATH_MAX];
    size_t n = survey(1, EPSG, r), kept = 0;
    for (size_t i = 0; i < n; i++)
        if (!strcmp(r[i].name, "p0") || !strcmp(r[i].name, "p2") || !strcmp(r[i].name, "p10"))
            r[kept++] = r[i];
    list_write(r, kept, "EPSG:32632", FORM_ODM, list);
    assert_int_equal(kit_run(&out,
                             "cd '%s' && '%s' ingest city/images city -o out --overwrite --gcp "
                             "'%s' --gcp-scale %g --check p10 && '%s' report out -o r.html && cat "
                             "r.html",
                             tmp, kit_program(), list, scale, kit_program()),
                     0);
    kit_expect_text((const char *)out.data, "2 points fit by themselves: no RMSE", __FILE__,
                    __LINE__);
    if (strstr((const char *)out.data, "0.000 m"))
        fail_msg("0.000 m is said of two points");
    buf_free(&out);
    assert_true(told("control", "points") == 2 && isnan(told("control", "rmse_plan_m")));
    assert_true(isfinite(told("check", "rmse_plan_m")));
}

/* ---- predicted errors ---- */

struct sums {
    double frame[2], frame_true[2], check[2], check_true[2];
};

/* Fit one survey, and add what it predicts and what it does. */
static void add_survey(const struct colmap_model *m, const struct gcp_view *views, uint64_t seed,
                       struct sums *s)
{
    static struct row r[ROWS];
    struct err e = {0};
    struct gcp_list l;
    struct gcp_fit f;
    const struct gcp_fit_config cfg = {
        .px_scale = scale, .sigma_m = survey_m, .mark_px = mark_px, .suspects = GCP_REWEIGH};
    const double up[3] = {0};
    char list[FILE_PATH_MAX];
    list_write(r, survey(seed, 0, r), "EPSG:4326", FORM_ODM, list);
    kit_ok(gcp_read(list, &l, &e), e);
    kit_ok(gcp_keep_out(&l, "p10,p11,p12,p13", &e), e);
    for (size_t i = CONTROL; i < PLACES; i++) /* the survey of these is exact */
        l.gcps[i].sigma_m[0] = l.gcps[i].sigma_m[1] = 1e-4;
    kit_ok(gcp_fit_make(&l, m, views, m->n_images, &cfg, up, &f, &e), e);
    for (size_t k = 0; k < 2; k++) {
        s->frame[k] += f.frame_m[k] * f.frame_m[k];
        s->check[k] += f.check_expected_m[k] * f.check_expected_m[k];
        s->check_true[k] += f.check_m[k] * f.check_m[k];
    }
    for (size_t i = 0; i < PLACES; i++) {
        double x[3] = {0}, at[3], lon, lat, h, d[3];
        for (size_t a = 0; a < 3; a++) /* the place in COLMAP's frame */
            for (size_t b = 0; b < 3; b++)
                x[a] += by_gps.rot[3 * b + a] * (places[i][b] - by_gps.trans[b]) / by_gps.scale;
        sim3_apply(&f.sim, x, at);
        kit_ok(geo_from_enu(&f.frame, at, &lon, &lat, &h, &e), e);
        kit_ok(geo_to_enu(&by_gps.origin, lon, lat, h, d, &e), e);
        for (size_t k = 0; k < 3; k++)
            s->frame_true[k == 2] += (d[k] - places[i][k]) * (d[k] - places[i][k]) / PLACES;
    }
    gcp_fit_free(&f);
    gcp_free(&l);
}

static void predicted_errors_are_true(void **state)
{
    struct err e = {0};
    struct colmap_model m;
    struct sums s = {{0}, {0}, {0}, {0}};
    kit_ok(colmap_read(city, &m, &e), e);
    struct gcp_view *views = mem_array(m.n_images, sizeof *views);
    for (size_t i = 0; i < m.n_images; i++) {
        struct gcp_view *v = &views[i];
        *v = (struct gcp_view){.image = &m.images[i], .lens = &m.cameras[m.images[i].camera].lens};
        camera_quat_to_rot(m.images[i].quat_wxyz, v->rot);
        for (size_t a = 0; a < 3; a++)
            for (size_t b = 0; b < 3; b++)
                v->center[a] -= v->rot[3 * b + a] * m.images[i].trans[b];
    }
    for (uint64_t seed = 1; seed <= SURVEYS; seed++)
        add_survey(&m, views, seed, &s);
    mem_free(views);
    colmap_free(&m);
    for (size_t k = 0; k < 2; k++) {
        double frame = sqrt(s.frame[k] / s.frame_true[k]),
               check = sqrt(s.check[k] / s.check_true[k]);
        printf("control: %s: the frame is off by %.4f m, predicted %.4f (%.2f); check points by "
               "%.4f, expected %.4f (%.2f)\n",
               k ? "height" : "plan", sqrt(s.frame_true[k] / SURVEYS), sqrt(s.frame[k] / SURVEYS),
               frame, sqrt(s.check_true[k] / SURVEYS), sqrt(s.check[k] / SURVEYS), check);
        assert_true(frame > ratio_least && frame < ratio_most);
        assert_true(check > ratio_least && check < ratio_most);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(mistakes_are_named),
        cmocka_unit_test(systems_with_degrees_and_heights_are_read),
        cmocka_unit_test(keeping_a_mistake_costs),
        cmocka_unit_test(two_points_are_no_rmse),
        cmocka_unit_test(predicted_errors_are_true),
    };
    return cmocka_run_group_tests_name("control", tests, setup, teardown);
}
