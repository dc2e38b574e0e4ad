/* Lists of ground control points that are written and read again, and marking: places that are
 * expected in photographs with distortion, residuals, files, and who else changed them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "scene/control/gcp_read.h"
#include "scene/control/table.h"
#include "scene/control/wkt.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/marking.h"
#include "tests/kit.h"

static char tmp[FILE_PATH_MAX];

static int setup(void **state)
{
    kit_tmpdir(tmp);
    return 0;
}

static int teardown(void **state)
{
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
        kit_ok(gcp_keep_out(&a, "alone,last", &e), e);
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
        assert_true(!b.gcps[0].check && b.gcps[1].check);
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

/* ---- Metashape ---- */

#define WKT_UTM                                                                                    \
    "PROJCS[\"ETRS89 / UTM zone 32N\",GEOGCS[\"ETRS89\",DATUM[\"x]\",SPHEROID[\"GRS "              \
    "1980\",6378137,298.25,AUTHORITY[\"EPSG\",\"7019\"]],AUTHORITY[\"EPSG\",\"6258\"]],"           \
    "AUTHORITY[\"EPSG\",\"4258\"]],PROJECTION[\"Transverse_Mercator\"],AUTHORITY[\"EPSG\","        \
    "\"25832\"]]"
#define WKT_COMPOUND                                                                               \
    "COMPD_CS[\"ETRS89 / UTM 32N + DHHN2016\"," WKT_UTM                                            \
    ",VERT_CS[\"DHHN2016\",VERT_DATUM[\"y\",2005,AUTHORITY[\"EPSG\",\"1170\"]],AUTHORITY["         \
    "\"EPSG\",\"7837\"]],AUTHORITY[\"EPSG\",\"1\"]]"

static void systems_are_known_by_their_text(void **state)
{
    static const struct {
        const char *wkt;
        bool known;
        int epsg, heights;
    } all[] = {
        {WKT_UTM, true, 25832, 0},
        {WKT_COMPOUND, true, 25832, 7837},
        {"GEOGCS[\"WGS 84\",AUTHORITY[\"EPSG\",\"4326\"]]", true, 4326, 0},
        {"PROJCRS[\"WGS 84 / UTM zone 32N\", BASEGEOGCRS[\"WGS 84\",ID[\"EPSG\",4326]], "
         "ID[\"EPSG\", 32632]]",
         true, 32632, 0},
        {"PROJCS[\"home-made\",GEOGCS[\"WGS 84\",AUTHORITY[\"EPSG\",\"4326\"]]]", true, 0, 0},
        {"PROJCS[\"a\",AUTHORITY[\"ESRI\",\"102100\"]]", true, 0, 0},
        {"PROJCS[\"a\",AUTHORITY[\"EPSG\",\"99999999999\"]]", true, 0, 0}, /* over 32 bits */
        {"PROJCS[\"a\",AUTHORITY[\"EPSG\",\"4294992128\"]]", true, 0, 0},  /* 2^32 + 24832 */
        {"PROJCS[\"a\",AUTHORITY[\"EPSG\",\"-25832\"]]", true, 0, 0},
        {"PROJCS[\"a\",AUTHORITY[\"EPSG\"],UNIT[\"m\",1]]", true, 0, 0},
        {"LOCAL_CS[\"Local Coordinates (m)\"]", true, 0, 0},
        {"PROJCS[", true, 0, 0},
        {"PROJCS", false, 0, 0},
        {"WGS84 UTM 32N", false, 0, 0},
        {"", false, 0, 0}};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        int epsg, heights;
        assert_true(wkt_epsg(all[i].wkt, &epsg, &heights) == all[i].known);
        assert_int_equal(epsg, all[i].epsg);
        assert_int_equal(heights, all[i].heights);
    }
}

static const char markers[] =
    "\xef\xbb\xbf<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
    "<document version=\"1.2.0\">\n"
    "  <!-- <chunk> of before -->\n"
    "  <chunk label=\"Chunk &gt; 1\" enabled=\"true\">\n"
    "    <sensors next_id=\"1\"><sensor id=\"0\" label=\"FC\" type=\"frame\"><resolution "
    "width=\"4000\" height=\"3000\"/></sensor></sensors>\n"
    "    <cameras next_id=\"9\">\n"
    "      <camera id=\"0\" sensor_id=\"0\" label=\"DJI_1\"><reference x=\"1\" y=\"2\" z=\"3\"/>"
    "</camera>\n"
    "      <group id=\"0\"><camera id=\"7\" label=\"b/DJI &#228;&amp;2.JPG\"/></group>\n"
    "    </cameras>\n"
    "    <markers next_id=\"4\">\n"
    "      <marker id=\"3\" label=\"point 1\">\n"
    "        <reference x=\"634676.125\" y=\"5485344.5\" z=\"112.25\" sxy=\"0.03\" sz='0.05' "
    "enabled=\"true\"/>\n"
    "      </marker>\n"
    "      <marker id=\"1\" label=\"off\"><reference x=\"1\" y=\"2\" z=\"3\" enabled=\"false\"/>"
    "</marker>\n"
    "      <marker id=\"0\" label=\"nowhere\"><reference enabled=\"true\"/></marker>\n"
    "    </markers>\n"
    "    <frames next_id=\"1\"><frame id=\"0\"><markers>\n"
    "      <marker marker_id=\"3\">\n"
    "        <location camera_id=\"0\" pinned=\"true\" x=\"1024.5\" y=\"3.125\"/>\n"
    "        <location camera_id=\"7\" pinned=\"1\" x=\"7\" y=\"8\"/>\n"
    "      </marker>\n"
    "      <marker marker_id=\"1\"><location camera_id=\"7\" pinned=\"true\" x=\"5\" y=\"6\"/>"
    "<location camera_id=\"0\" pinned=\"false\" x=\"5\" y=\"6\"/></marker>\n"
    "      <marker marker_id=\"0\"><location camera_id=\"7\" pinned=\"true\" x=\"5\" y=\"6\"/>"
    "</marker>\n"
    "    </markers></frame><frame id=\"1\"><markers><marker marker_id=\"3\"><location "
    "camera_id=\"0\" x=\"9\" y=\"9\"/></marker></markers></frame></frames>\n"
    "    <reference>COMPD_CS[&quot;a&quot;,PROJCS[&quot;b&quot;,AUTHORITY[&quot;EPSG&quot;,"
    "&quot;25832&quot;]],VERT_CS[&quot;c&quot;,AUTHORITY[&quot;EPSG&quot;,&quot;7837&quot;]]]"
    "</reference>\n"
    "  </chunk>\n</document>\n";

static void expect_markers(const struct gcp_list *l)
{
    assert_true(l->n == 2 && l->n_marks == 3 && l->epsg == 25832 && l->heights_epsg == 7837);
    assert_string_equal(l->gcps[0].name, "point 1");
    assert_true(l->gcps[0].at[0] == 634676.125 && l->gcps[0].at[2] == 112.25);
    assert_true(l->gcps[0].sigma_m[0] == 0.03 && l->gcps[0].sigma_m[1] == 0.05);
    assert_true(!l->gcps[0].check && l->gcps[1].check && l->gcps[1].at[1] == 2);
    assert_string_equal(l->marks[0].image, "DJI_1");
    assert_string_equal(l->marks[1].image, "b/DJI \xc3\xa4&2.JPG");
    assert_true(l->marks[0].x_px == 1024.5 && l->marks[0].y_px == 3.125);
    assert_true(l->marks[2].gcp == 1 && l->marks[2].x_px == 5);
}

static void markers_of_metashape_are_read_and_written(void **state)
{
    struct err e = {0};
    struct gcp_list a, b;
    char path[FILE_PATH_MAX];
    put("markers.xml", markers, path);
    kit_ok(gcp_read(path, &a, &e), e);
    expect_markers(&a);
    struct buf out = {0};
    kit_fails(gcp_write(&a, GCP_FORM_XML, &out, &e), ERR_DATA, e, "no text");
    buf_free(&out);
    a.wkt = mem_text(WKT_COMPOUND);
    write_list(&a, GCP_FORM_XML, "again.xml", path);
    kit_ok(gcp_read(path, &b, &e), e);
    expect_markers(&b);
    gcp_free(&b);
    a.epsg = GCP_LONLAT; /* with heights of its own text */
    mem_free(a.wkt);
    a.wkt = mem_text("COMPD_CS[\"a\",GEOGCS[\"b\",AUTHORITY[\"EPSG\",\"4326\"]],VERT_CS[\"c\","
                     "AUTHORITY[\"EPSG\",\"5773\"]]]");
    write_list(&a, GCP_FORM_XML, "again.xml", path);
    kit_ok(gcp_read(path, &b, &e), e);
    assert_true(b.epsg == GCP_LONLAT && b.heights_epsg == 5773);
    gcp_free(&a);
    gcp_free(&b);
}

static void bad_markers_are_refused_by_line(void **state)
{
    static const struct {
        const char *in, *out, *says;
    } bad[] = {{"</group>", "", "line 9: mismatched tag"},
               {"</document>\n", "", "no element found"},
               {"camera_id=\"0\" pinned=\"true\"", "camera_id=\"5\"",
                "line 19: there is no camera of id 5"},
               {"x=\"1024.5\"", "x=\"1024,5\"", "line 19: a place in a photograph has no"},
               {"camera id=\"0\"", "camera ", "line 7: a camera or marker has no id"},
               {"<chunk label", "<chunk/><chunk label", "a second chunk"},
               {"<document", "<!DOCTYPE a [<!ENTITY b \"c\">]><document", "document types"},
               {"label=\"point 1\">", "label=\"point 1\"", "line 12: not well-formed"},
               {"of before -->", "of before", "unclosed token"},
               {"label=\"off\"", "label=\"point 1\"", "point 1 lies at"},
               {"<marker id=\"3\" label=\"point 1\">",
                "<marker id=\"3\" label=\"0123456789012345678901"
                "234567890123456789012345678901234567890123456789\">",
                "has over 63 bytes"},
               {"camera_id=\"7\" pinned=\"1\"", "camera_id=\"0\" pinned=\"1\"", "both mark"},
               {"<markers next_id=\"4\">", "<nothing>", "mismatched tag"}};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct err e = {0};
        struct gcp_list l;
        char path[FILE_PATH_MAX], text[sizeof markers + 256];
        const char *at = strstr(markers, bad[i].in);
        assert_non_null(at);
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - markers), markers, bad[i].out,
                 at + strlen(bad[i].in));
        put("bad.xml", text, path);
        kit_fails(gcp_read(path, &l, &e), ERR_FORMAT, e, bad[i].says);
    }
    for (size_t n = 4; n < sizeof markers - 16; n += 7) { /* cut anywhere */
        struct gcp_list l;
        char path[FILE_PATH_MAX], text[sizeof markers];
        snprintf(text, sizeof text, "%.*s", (int)n, markers);
        put("cut.xml", text, path);
        assert_true(gcp_read(path, &l, NULL) != ERR_OK);
    }
}

static void tables_of_metashape_are_read(void **state)
{
    static const char points[] =
        "# CoordinateSystem: " WKT_UTM "\n"
        "#Label,X/Easting,Y/Northing,Z/Altitude,Accuracy_X/Y_(m),Accuracy_Z_(m),Error_(m),X_error\n"
        "point 1,634676.125,5485344.5,112.25,0.03,0.05,0.1,0.1\n"
        "point 2,634776.125,5485444.5,113,,,,\n"
        "not surveyed,,,,,,,\n"
        "# Total Error,,,,,,0.1,0.1\n";
    static const char *const marks[] = {
        "marker,camera,x,y\npoint 2,DJI_1,1024.5,3.125\npoint 1,b/DJI_2.JPG,7,8\nnot "
        "surveyed,DJI_1,1,1\n",
        "image_name,gcp_name,image_u,image_v\nDJI_1,point 2,1024.5,3.125\nb/DJI_2.JPG,point "
        "1,7,8\n"};
    for (size_t i = 0; i < 2; i++) {
        struct err e = {0};
        struct gcp_list l;
        char a[FILE_PATH_MAX], b[FILE_PATH_MAX], both[2 * FILE_PATH_MAX];
        put("points.csv", points, a);
        put("marks.csv", marks[i], b);
        snprintf(both, sizeof both, "%s,%s", a, b);
        kit_ok(gcp_read(both, &l, &e), e);
        assert_true(l.n == 2 && l.n_marks == 2 && l.epsg == 25832);
        assert_true(l.gcps[0].at[0] == 634676.125 && l.gcps[0].sigma_m[0] == 0.03);
        assert_true(l.gcps[0].sigma_m[1] == 0.05 && l.gcps[1].sigma_m[0] == 0);
        assert_true(l.marks[0].gcp == 1 && l.marks[0].x_px == 1024.5 && l.marks[1].gcp == 0);
        assert_string_equal(l.marks[0].image, "DJI_1");
        gcp_free(&l);
        kit_fails(gcp_read(b, &l, &e), ERR_FORMAT, e, "has marks and no coordinates");
        kit_fails(gcp_read(a, &l, &e), ERR_FORMAT, e, "no column for px");
    }
}

static void labels_without_endings_are_photographs(void **state)
{
    static const struct {
        const char *photo, *listed;
        bool alike;
    } all[] = {{"b/DJI_0001.JPG", "DJI_0001", true},
               {"b/DJI_0001.JPG", "b\\dji_0001", true},
               {"b/DJI_0001.JPG", "c/DJI_0001", false},
               {"b/DJI_0001.JPG", "JI_0001", false},
               {"DJI_0001.JPG", "DJI_0001.JPG", true},
               {"DJI_0001.JPG", "DJI_0001.TIF", false},
               {"DJI_0001.JPG", "DJI_0001.", false},
               {"DJI_0001", "DJI_0001.JPG", false},
               {"a.b/DJI_0001.JPG", "DJI_0001", true},
               {".JPG", "", false},
               /* one character and two for a letter with a mark, whichever has which */
               {"Stra\u00dfe/K\u00f6ln_1.jpg", "Stra\u00dfe/Ko\u0308ln_1.jpg", true},
               {"e\u0301te\u0301\\3.png", "\u00e9t\u00e9/3.PNG", true},
               {"\u30ac1.jpg", "\u30ab\u30991", true},
               {"\u0439/a.jpg", "A.jpg", true},
               {"Ko\u0308ln_1.jpg", "Koln_1.jpg", false},
               {"\u6d4b1.jpg", "\u8bd51.jpg", false},
               {"S\u00f6/1.jpg", "S\u00fc/1.jpg", false},
               {"\u0421\u0435\u0432/1.jpg", "\u0417\u0430\u043f/1.jpg", false},
               {"o\u0308/1.jpg", "u\u0308/1.jpg", false},
               {"K\u00f6ln_1.jpg", "K\u00f6ln_2.jpg", false}};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        assert_true((table_alike(all[i].photo, all[i].listed) > 0) == all[i].alike);
    assert_true(table_alike("DJI_1.JPG", "DJI_1.JPG") > table_alike("DJI_1.JPG", "DJI_1"));
    /* what is written alike comes before what is meant alike */
    assert_true(table_alike("\u00f6.jpg", "\u00f6") > table_alike("\u00f6.jpg", "o\u0308.jpg"));
    assert_true(table_same_path("a/\u00f6.jpg", "A\\o\u0308.JPG"));
    assert_false(table_same_path("a/\u00f6.jpg", "\u00f6.jpg"));

    struct table_renamed renamed = {0};
    table_rename(&renamed, "a/DJI_1.JPG", "DJI_1.JPG");
    table_rename(&renamed, "a/DJI_1.JPG", "DJI_1");
    table_rename(&renamed, "a/DJI_1.JPG", "/home/a/DJI_1.JPG");
    assert_int_equal(renamed.n, 0);
    table_rename(&renamed, "a/DJI_2.JPG", "a\\DJI_2.JPG");
    table_rename(&renamed, "DJI_3.JPG", "dji_3");
    assert_true(renamed.n == 2 && !strcmp(renamed.listed, "a\\DJI_2.JPG"));
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

/* For Metashape, which labels photographs without their endings. */
static void marks_are_in_a_file_for_metashape(void **state)
{
    static const double at[2] = {2468.2, 1000.6};
    struct marking *m;
    struct gcp_list l;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, tmp, "file.xml", &e), e);
    open_desk(&m, path, true, 0);
    kit_ok(marking_set(m, 0, 3, at, &e), e);
    kit_ok(marking_set(m, 1, 3, at, &e), e);
    kit_ok(gcp_read(path, &l, &e), e);
    assert_true(l.n == POINTS && l.n_marks == 2 && l.epsg == GCP_LONLAT);
    assert_string_equal(l.marks[0].image, "b/DJI_1");
    assert_true(l.marks[1].gcp == 1 && l.marks[1].x_px == 1234.1);
    gcp_free(&l);
    marking_close(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_come_without_marks),
        cmocka_unit_test(bad_points_are_refused_by_line),
        cmocka_unit_test(lists_are_read_as_they_were_written),
        cmocka_unit_test(systems_are_known_by_their_text),
        cmocka_unit_test(markers_of_metashape_are_read_and_written),
        cmocka_unit_test(bad_markers_are_refused_by_line),
        cmocka_unit_test(tables_of_metashape_are_read),
        cmocka_unit_test(labels_without_endings_are_photographs),
        cmocka_unit_test(places_are_expected_through_the_lens),
        cmocka_unit_test(a_wrong_mark_and_a_wrong_point_show),
        cmocka_unit_test(changes_are_in_the_file),
        cmocka_unit_test(marks_are_in_a_file_for_metashape),
    };
    return cmocka_run_group_tests_name("marking", tests, setup, teardown);
}
