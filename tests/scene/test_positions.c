/* Positions of photographs from files of receivers, with accuracies as weights; and the reference
 * of heights, from input to products.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/geo/geo.h"
#include "core/geo/gtx.h"
#include "scene/control/positions.h"
#include "scene/control/table.h"
#include "scene/control/wkt.h"
#include "scene/ingest/ingest.h"
#include "survey/crs.h"
#include "tests/scene/city_kit.h"

static char tmp[FILE_PATH_MAX], city[FILE_PATH_MAX], images[FILE_PATH_MAX];
static struct arena texts;
static struct scene truth; /* the city as GPS without errors places it */
enum { PHOTOS = 32 };
/* Half of the positions are right to 2 cm, half to 2 m and say so. */
static const double fine_m = 0.02, coarse_m = 2;

static void put(const char *name, const char *text, char path[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(path, tmp, name, &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
}

static void make_city(const char *name, double gps_sigma_m, char dir[FILE_PATH_MAX])
{
    struct err e = {0};
    struct synth_config c;
    kit_ok(file_join(dir, tmp, name, &e), e);
    city_kit_config(&c, &texts, dir, PHOTOS);
    c.gps_sigma_m = gps_sigma_m;
    kit_ok(synth_run(&c, &e), e);
}

static int setup(void **state)
{
    struct err e = {0};
    struct ingest_config c;
    char dir[FILE_PATH_MAX];
    kit_tmpdir(tmp);
    make_city("exact", 0, city);
    kit_ok(options_defaults(ingest_options(), &c, &texts, &e), e);
    kit_ok(file_join(dir, tmp, "truth", &e), e);
    kit_ok(file_join(images, city, "images", &e), e);
    c.output = dir;
    c.exposure = false;
    kit_ok(ingest_run(images, city, &c, &e), e);
    kit_ok(scene_read(dir, &truth, &e), e);
    assert_string_equal(truth.heights, "sea-exif");
    make_city("city", 3, city);
    return 0;
}

static int teardown(void **state)
{
    scene_free(&truth);
    arena_free(&texts);
    kit_rmdir(tmp);
    return 0;
}

/* Where photograph i was, with an error. */
static void place(size_t i, double sigma_m, double at[3])
{
    struct err e = {0};
    double c[3], lon, lat, h;
    camera_center(&truth.images[i].cam, c);
    for (size_t k = 0; k < 3; k++)
        c[k] += sigma_m * rng_normal(3, k, i);
    kit_ok(geo_from_enu(&truth.origin, c, &lon, &lat, &h, &e), e);
    at[0] = lon;
    at[1] = lat;
    at[2] = h;
}

static int ingest(const char *options, struct buf *out)
{
    struct buf text = {0};
    int rc = kit_run(out ? out : &text,
                     "cd '%s' && '%s' ingest city/images city -o out --overwrite --no-exposure %s",
                     tmp, kit_program(), options);
    if (!out && rc)
        printf("%s", (const char *)text.data);
    buf_free(&text);
    return rc;
}

/* Root mean square distance of the cameras from the truth, in plan and in height; what the heights
 * of the scene count from. */
static void off(double rms_m[2], char heights[HEIGHTS_MAX])
{
    struct err e = {0};
    struct scene s;
    char dir[FILE_PATH_MAX];
    kit_ok(file_join(dir, tmp, "out", &e), e);
    kit_ok(scene_read(dir, &s, &e), e);
    assert_int_equal(s.n_images, truth.n_images);
    rms_m[0] = rms_m[1] = 0;
    for (size_t i = 0; i < s.n_images; i++) {
        double a[3], b[3], lon, lat, h;
        camera_center(&s.images[i].cam, a);
        kit_ok(geo_from_enu(&s.origin, a, &lon, &lat, &h, &e), e);
        kit_ok(geo_to_enu(&truth.origin, lon, lat, h, a, &e), e);
        camera_center(&truth.images[i].cam, b);
        rms_m[0] += ((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])) / PHOTOS;
        rms_m[1] += (a[2] - b[2]) * (a[2] - b[2]) / PHOTOS;
    }
    rms_m[0] = sqrt(rms_m[0]);
    rms_m[1] = sqrt(rms_m[1]);
    snprintf(heights, HEIGHTS_MAX, "%s", s.heights);
    scene_free(&s);
}

/* A list whose second half errs by metres: accuracies make the first half count. */
static void accuracies_weigh(void **state)
{
    struct buf with = {0}, without = {0}, utm = {0}, said = {0};
    struct err e = {0};
    struct crs *crs;
    char path[FILE_PATH_MAX], heights[HEIGHTS_MAX];
    double alike[2], weighed[2], flat[2], national[2], degrees[2];
    kit_ok(crs_open(32632, &crs, &e), e);
    buf_printf(&with, "Label,Longitude,Latitude,Ellipsoidal height,Accuracy horizontal (m),"
                      "Accuracy vertical (m)\n");
    buf_printf(&without, "image;lat;lon;h\n");
    buf_printf(&utm, "photo,x,y,z,accuracy\n");
    for (size_t i = 0; i < PHOTOS; i++) {
        double at[3], sigma = i % 2 ? coarse_m : fine_m;
        const char *name = truth.images[i].name;
        place(i, sigma, at);
        buf_printf(&with, "%s,%.10f,%.10f,%.4f,%g,%g\n", name, at[0], at[1], at[2], sigma, sigma);
        buf_printf(&without, "%s;%.10f;%.10f;%.4f\n", name, at[1], at[0], at[2]);
        kit_ok(crs_project(crs, 1, &at[0], &at[1], &e), e);
        buf_printf(&utm, "%s,%.4f,%.4f,%.4f,%g\n", name, at[0], at[1], at[2], sigma);
    }
    crs_close(&crs);
    buf_u8(&with, 0);
    buf_u8(&without, 0);
    buf_u8(&utm, 0);
    put("with.csv", (const char *)with.data, path);
    put("without.csv", (const char *)without.data, path);
    put("utm.csv", (const char *)utm.data, path);
    buf_free(&with);
    buf_free(&without);
    buf_free(&utm);
    assert_int_equal(ingest("--positions without.csv", NULL), 0);
    off(alike, heights);
    assert_string_equal(heights, "unknown");
    assert_int_equal(ingest("--positions with.csv", NULL), 0);
    off(weighed, heights);
    assert_string_equal(heights, "ellipsoid");
    assert_int_equal(ingest("--positions utm.csv --positions-epsg 32632 --heights EPSG:5773", NULL),
                     0);
    off(flat, heights);
    assert_string_equal(heights, "EPSG:5773");
    assert_int_equal(ingest("--positions utm.csv --positions-epsg 5555", NULL), 0);
    off(national, heights);
    assert_string_equal(heights, "EPSG:5783");
    assert_int_equal(ingest("--positions with.csv --positions-epsg 32632", &said), 2);
    kit_expect_text((const char *)said.data, "looks like longitude and latitude", __FILE__,
                    __LINE__);
    buf_free(&said);
    assert_int_equal(ingest("--positions with.csv --positions-epsg 4258", NULL), 0);
    off(degrees, heights);
    assert_string_equal(heights, "ellipsoid");
    printf("positions: cameras off by %.3f m in plan, %.3f in height; by accuracies %.3f, %.3f; in "
           "UTM %.3f, %.3f\n",
           alike[0], alike[1], weighed[0], weighed[1], flat[0], flat[1]);
    assert_true(weighed[0] < 0.1 * alike[0] && weighed[0] < fine_m);
    assert_true(weighed[1] < 0.2 * alike[1] && weighed[1] < 2 * fine_m);
    assert_true(flat[0] < 2 * fine_m && flat[1] < 2 * fine_m);
    assert_true(national[0] < 2 * fine_m && national[1] < 2 * fine_m);
    assert_true(degrees[0] < 2 * fine_m && degrees[1] < 2 * fine_m);
}

/* DJI's file names photographs by number. */
static void dji_numbers_photographs(void **state)
{
    struct buf b = {0}, out = {0};
    char path[FILE_PATH_MAX], heights[HEIGHTS_MAX];
    double rms[2];
    for (size_t i = 0; i < PHOTOS; i++) {
        const char *digits = truth.images[i].name + strcspn(truth.images[i].name, "0123456789");
        double at[3];
        place(i, fine_m, at);
        for (const char *p = digits; *p; p++) /* the last group */
            digits = *p >= '0' && *p <= '9' && (p[-1] < '0' || p[-1] > '9') ? p : digits;
        buf_printf(&b,
                   "%d\t%.6f\t[2158]\t   -33,N\t     7,E\t   144,V\t%.9f,Lat\t%.9f,Lon\t%.3f,Ellh\t"
                   "%.6f, %.6f, %.6f\t50,Q\n",
                   atoi(digits), 394224.15 + 2 * (double)i, at[1], at[0], at[2], fine_m, fine_m,
                   2 * fine_m);
    }
    buf_u8(&b, 0);
    put("100_0001_Timestamp.MRK", (const char *)b.data, path);
    buf_free(&b);
    int rc = ingest("--positions 100_0001_Timestamp.MRK", &out);
    if (rc)
        fail_msg("%s", (const char *)out.data);
    buf_free(&out);
    off(rms, heights);
    printf("positions: .MRK: cameras off by %.3f m in plan, %.3f in height\n", rms[0], rms[1]);
    assert_string_equal(heights, "ellipsoid");
    assert_true(rms[0] < fine_m && rms[1] < 2 * fine_m);
}

/* Names of DJI end in a waypoint, a lens or what the pilot wrote; the number follows the time. */
static void dji_names_have_a_number_after_the_time(void **state)
{
    static const struct {
        const char *name;
        size_t line;
    } rows[] = {{"DJI_20230501100027_0003_V_Waypoint1.JPG", 2},
                {"a/DJI_20230501100029_0001_W_Waypoint2.JPG", 0},
                {"DJI_20230501100031_0002.JPG", 1},
                {"DJI_20230501100033_0004_roof2.JPG", 3},
                {"DJI_0005.JPG", 4}};
    enum { N = sizeof rows / sizeof *rows };
    struct position_photo photos[N] = {{0}};
    struct positions p;
    struct err e = {0};
    struct buf b = {0};
    char path[FILE_PATH_MAX];
    for (int i = 0; i < N; i++) {
        photos[i].name = rows[i].name;
        buf_printf(&b,
                   "%d\t%d.5\t[2158]\t0,N\t0,E\t0,V\t47.5,Lat\t7.5,Lon\t300,Ellh\t1, 1, 1\t50,Q\n",
                   i + 1, 394224 + i);
    }
    buf_u8(&b, 0);
    put("waypoints_Timestamp.MRK", (const char *)b.data, path);
    buf_free(&b);
    kit_ok(positions_read(path, &p, &e), e);
    kit_ok(positions_match(&p, photos, N, &e), e);
    for (size_t i = 0; i < N; i++)
        assert_int_equal(photos[i].position, rows[i].line);
    positions_free(&p);
}

/* Events have times, photographs have times of another clock: the difference is found; GPS of EXIF
 * decides between shifts by one interval. */
static void events_are_matched_by_time(void **state)
{
    enum { N = 20 };
    struct positions p;
    struct position_photo photos[N] = {{0}};
    struct err e = {0};
    struct buf b = {0}, week = {0};
    char path[FILE_PATH_MAX], names[N][16];
    buf_printf(&b, "%% program   : RTKLIB\n%% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float)\n"
                   "%%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) "
                   "sdne(m) sdeu(m) sdun(m) age(s) ratio\n");
    for (int i = 0; i < N + 3; i++) { /* three events before the first photograph */
        buf_printf(&b, "2024/06/01 10:%02d:%06.3f %.9f %.9f %.4f 1 12 0.01 0.02 0.03 0 0 0 0 9\n",
                   i / 10, 6 * (i % 10) + 0.417, 47.5 + 1e-4 * i, 7.5, 350.0 + i);
        buf_printf(&week, "2316 %.3f %.9f 7.5 %.4f 1 12 0.01 0.02 0.03\n", 554400 + 6 * i + 0.417,
                   47.5 + 1e-4 * i, 350.0 + i);
    }
    buf_u8(&b, 0);
    buf_u8(&week, 0);
    for (int i = 0; i < N; i++) { /* two hours east, 23 s slow, half seconds lost */
        int s = 10 * 3600 + 6 * (i + 3) + 7200 - 23;
        char time[32];
        snprintf(time, sizeof time, "2024:06:01 %02d:%02d:%02d", s / 3600, s / 60 % 60, s % 60);
        snprintf(names[i], sizeof names[i], "p%d.jpg", i);
        photos[i] = (struct position_photo){.name = names[i],
                                            .time_s = positions_time(time),
                                            .has_gps = true,
                                            .lon_deg = 7.5 + 2e-5,
                                            .lat_deg = 47.5 + 1e-4 * (i + 3) - 1e-5};
    }
    put("flight_events.pos", (const char *)b.data, path);
    kit_ok(positions_read(path, &p, &e), e);
    assert_int_equal(p.n, N + 3);
    assert_string_equal(p.heights, "ellipsoid");
    assert_true(fabs(p.list[4].sigma_m[0] - sqrt(0.00025)) < 1e-9 && p.list[4].sigma_m[1] == 0.03);
    kit_ok(positions_match(&p, photos, N, &e), e);
    for (size_t i = 0; i < N; i++)
        assert_int_equal(photos[i].position, i + 3);
    double first = p.list[0].time_s;
    positions_free(&p);
    for (size_t k = 0; k < 2; k++) { /* as a spreadsheet saves it */
        for (char *text = (char *)b.data; *text; text++)
            *text = *text == (k ? ',' : ' ') ? (k ? ';' : ',') : *text;
        put("separated.pos", (const char *)b.data, path);
        kit_ok(positions_read(path, &p, &e), e);
        assert_true(p.n == N + 3 && p.list[0].time_s == first && p.list[0].at[2] == 350);
        positions_free(&p);
    }
    put("week.pos", (const char *)week.data, path);
    kit_ok(positions_read(path, &p, &e), e);
    assert_true(fabs(p.list[0].time_s - first) < 1e-3); /* 2024-06-01 is in week 2316 */
    for (size_t i = 0; i < N; i++)                      /* another flight */
        photos[i].time_s += (double)(i * i) * 3;
    kit_fails(positions_match(&p, photos, N, &e), ERR_DATA, e, "no difference of clocks");
    positions_free(&p);
    buf_free(&b);
    buf_free(&week);
}

/* Tables as other programs export them, and what they call coordinate systems. */
static void tables_of_other_programs_are_read(void **state)
{
    static const struct {
        const char *text;
        int epsg;
        double lon, lat, h;
        size_t left_out;
    } tables[] = {
        {"# CoordinateSystem: GEOGCS[\"WGS 84\",AUTHORITY[\"EPSG\",\"4326\"]]\n"
         "#Label,X/Longitude,Y/Latitude,Z/Altitude,Yaw\nA.jpg,7.5,47.5,300,0\nB.jpg,,,,\n",
         4326, 7.5, 47.5, 300, 1},
        {"# CoordinateSystem: EPSG:25832\r\n#Label,X/Easting,Y/Northing,Z/Altitude\r\n"
         "A.jpg,7.5,47.5,300\r\n",
         25832, 7.5, 47.5, 300, 0},
        {"\xef\xbb\xbfimagename,latitude [decimal degrees],longitude [decimal degrees],"
         "altitude [meter],accuracy vertical [meter]\nA.jpg,47.5,7.5,300,0.1\nB.jpg,0,0,0,0.1\n",
         4326, 7.5, 47.5, 300, 1},
        {"# one\n// two\n\n\"Image\";\"Lon\";\"Lat\";\"Height\"\n\"A, 1.jpg\";7.5;47.5;300\n"
         "B.jpg;nan;nan;nan\n",
         4326, 7.5, 47.5, 300, 1},
        {"Image;Lon;Lat;Height\nA.jpg;7,5;47,5;300,00\n", 4326, 7.5, 47.5, 300, 0},
        {"Image\tLat\tLon\tHeight\nA 1,2.jpg\t47,5\t7,5\t3e2\n", 4326, 7.5, 47.5, 300, 0},
        {"\"Image\";\"Lon\";\"Lat\";\"H\"\n\"A.jpg\";\"7,5\";\"+47,50\";\"300\"\n", 4326, 7.5, 47.5,
         300, 0},
        {"\"image\",\"lon\",\"lat\",\"z\"\n\"A, 1.jpg\",\"7.5\",\"47.5\",\"300\"\n", 4326, 7.5,
         47.5, 300, 0},
        /* OpenDroneMap's geo.txt */
        {"EPSG:4326\nA.jpg 7.5 47.5 300\n", 4326, 7.5, 47.5, 300, 0},
        {"WGS84 UTM 32N\nA 1.jpg\t7.5\t47.5\t300\t0\t0\t0\t0.05\t0.1\n", 32632, 7.5, 47.5, 300, 0},
        {"+proj=utm +zone=32 +datum=WGS84\nA.jpg,7.5,47.5,300\n", 32632, 7.5, 47.5, 300, 0},
        {"+proj=lcc +lat_1=49 +lat_2=44\nA.jpg 7.5 47.5 300\n", 0, 7.5, 47.5, 300, 0},
        /* RealityCapture, ExifTool, Emlid; blanks; commas in the names of columns */
        {"Name,Lat,Long,Alt\nA.jpg,47.5,7.5,300\n", 4326, 7.5, 47.5, 300, 0},
        {"SourceFile,GPSLatitude,GPSLongitude,GPSAltitude\n./A.jpg,47.5,7.5,300\n", 4326, 7.5, 47.5,
         300, 0},
        {"Name,Longitude,Latitude,Ellipsoidal height,Lateral RMS,Elevation RMS\n"
         "A.jpg,7.5,47.5,300,0.01,0.02\n",
         4326, 7.5, 47.5, 300, 0},
        {"image lon lat height\nA.jpg  7.5 47.5 300\n", 4326, 7.5, 47.5, 300, 0},
        {"Image;Lon (deg, WGS84);Lat (deg, WGS84);Height (m)\nA.jpg;7.5;47.5;300\n", 4326, 7.5,
         47.5, 300, 0},
        /* heights that stand for unknown; no-break spaces; typographic minus */
        {"image,lon,lat,height\nA.jpg,7.5,47.5,300\nB.jpg,7.5,47.5,nan\nC.jpg,7.5,47.5,-9999\n"
         "D.jpg,7.5,47.5,\n",
         4326, 7.5, 47.5, 300, 3},
        {"image,lon,lat,height\nA.jpg,\xe2\x88\x92"
         "7.5,\xc2\xa0"
         "47.5,300\n",
         4326, -7.5, 47.5, 300, 0},
        /* doubled quotation marks; a spreadsheet's own first line */
        {"note,image,lon,lat,height\n\"a \"\"b, c\"\" d\",\"A \"\"1\"\".jpg\",7.5,\"47.5\",300\n",
         4326, 7.5, 47.5, 300, 0},
        {"sep=;\r\nimage;lon;lat;height\r\nA.jpg;7,5;47,5;300,0\r\n", 4326, 7.5, 47.5, 300, 0},
        /* of two columns of a kind the first counts, and says what it is */
        {"image,easting,northing,height,longitude,latitude\nA.jpg,7.5,47.5,300,8,48\n", 0, 7.5,
         47.5, 300, 0},
        /* photographs that are switched off; accuracies that stand for unknown, or are no limit */
        {"#Label,Enable,X/Longitude,Y/Latitude,Z/"
         "Altitude\nB.jpg,0,8,48,900\nA.jpg,1,7.5,47.5,300\n",
         4326, 7.5, 47.5, 300, 0},
        {"image,lon,lat,height,accuracy_xy,accuracy_z\nA.jpg,7.5,47.5,300,-1,N/A\n", 4326, 7.5,
         47.5, 300, 0},
        {"image,lon,lat,height,accuracy_xy,accuracy_z\nA.jpg,7.5,47.5,300,nan,\n", 4326, 7.5, 47.5,
         300, 0},
        {"EPSG:4979\nA.jpg 7.5 47.5 300\n", 4326, 7.5, 47.5, 300, 0},
        /* ExifTool's columns of directions, by -n and in words; degrees, minutes, seconds */
        {"SourceFile,GPSLatitude,GPSLatitudeRef,GPSLongitude,GPSLongitudeRef,GPSAltitude,"
         "GPSAltitudeRef\nA.jpg,47.5,S,7.5,W,300,1\n",
         4326, -7.5, -47.5, -300, 0},
        {"SourceFile,GPSLatitudeRef,GPSLatitude,GPSLongitudeRef,GPSLongitude,GPSAltitudeRef,"
         "GPSAltitude\nA.jpg,South,-47.5,East,7.5,Above Sea Level,300\n",
         4326, 7.5, -47.5, 300, 0},
        {"SourceFile,GPSLatitude,GPSLongitude,GPSAltitude\nA.jpg,\"47 deg 30' 0.00\"\" N\","
         "\"7 deg 30' 0.00\"\" W\",300 m Above Sea Level\n",
         4326, -7.5, 47.5, 300, 0},
        {"Photo name;Lon;Lat;Height\nA.jpg;7\u00b030\u20320.0\u2033E;47:30:00 s;3 m below sea "
         "level\n",
         4326, 7.5, -47.5, -3, 0},
        {"image,lon,lat,height\nA.jpg,7.5E,-47 30',300 m\n", 4326, 7.5, -47.5, 300, 0},
        /* columns of such names that say something else */
        {"image,lon,lon_ref,lat,lat_ref,alt,alt_ref\nA.jpg,7.5,WGS84,47.5,SWEREF99,300,120.5\n",
         4326, 7.5, 47.5, 300, 0},
        /* WingtraHub: a blank behind the # */
        {"# image name,latitude [decimal degrees],longitude [decimal degrees],altitude [meter],"
         "yaw [degrees]\nA.jpg,47.5,7.5,300,0\n",
         4326, 7.5, 47.5, 300, 0},
    };
    static const struct {
        const char *text, *heights;
        double sigma_m;
    } told[] = {
        {"image,lon,lat,altitude,ellipsoidal_height\nA.jpg,7.5,47.5,300,350\n", "unknown", 0},
        {"image,lon,lat,ellipsoidal_height,altitude\nA.jpg,7.5,47.5,300,350\n", "ellipsoid", 0},
        {"EPSG:4979\nA.jpg 7.5 47.5 300\n", "ellipsoid", 0},
        {"Filename,Longitude (deg),Latitude (deg),Height above ellipsoid (m),Std East (m),"
         "Std North (m),Std Up (m)\nA.jpg,7.5,47.5,300,3,3,3\n",
         "ellipsoid", 3},
        {"Photo,Latitude,Longitude,Ell Height (m)\nA.jpg,47.5,7.5,300\n", "ellipsoid", 0},
        {"image,lon,lat,height,sigma\nA.jpg,7.5,47.5,300,1e30\n", "unknown", 1e4},
        {"image,lon,lat,height,sigma\nA.jpg,7.5,47.5,300,inf\n", "unknown", 1e4},
        {"image,lon,lat,height,sigma\nA.jpg,7.5,47.5,300,-\n", "unknown", 0}};
    static const struct {
        const char *text, *says;
    } wrong[] = {
        {"EPSG:4326\nA.jpg 7.5 47.5\n", "line 2: z (or height) is missing"},
        {"image,lon,lat,height\nA.jpg,7.5,,300\n", "line 2: y (or lat) is missing"},
        {"image,lon,lat,height\nA.jpg,7.5N,47.5E,300\n", "decimal degrees that are negative"},
        {"image,lon,lat,height\nA.jpg,7.5.3,47.5,300\n", "'7.5.3', is no number"},
        {"image,lon,lat,height\nA.jpg,7.5,47 61 0,300\n", "'47 61 0', is no number"},
        {"image,lon,lat,height\nA.jpg,7.5 47.5,47.5,300\n", "'7.5 47.5', is no number"},
        {"image,lon,lat,height\nA.jpg,7 47,47.5,300\n", "'7 47', is no number"},
        {"image,lon,lat,height\nA.jpg,7.5,8 30 15 e,300\n", "'8 30 15 e', is no number"},
        {"image,lon,lat,height\nA.jpg,7.5,47.5,300 ft\n", "'300 ft', is no number: write metres"},
        {"EPSG:25832\nA.jpg 7.5E 47.5 300\n", "'7.5E', is no number"},
        {"image,lon,lat,height,sigma\nA.jpg,7.5,47.5,300,good\n", "'good', is no number"}};
    static const struct {
        const char *text;
        int epsg;
    } systems[] = {
        {"OGC:CRS84", 4326},
        {"urn:ogc:def:crs:OGC:1.3:CRS84", 4326},
        {"EPSG:32632", 32632},
        {"epsg 32632", 32632},
        {"EPSG::25832", 25832},
        {"urn:ogc:def:crs:EPSG::25832", 25832},
        {"WGS84 UTM 32N", 32632},
        {"wgs 84 / utm zone 23s", 32723},
        {"ETRS89 / UTM zone 33N", 25833},
        {"NAD83 / UTM zone 10N", 26910},
        {"+proj=utm +zone=32 +ellps=WGS84 +datum=WGS84 +units=m +no_defs", 32632},
        {"+proj=utm +zone=23 +south +datum=WGS84 +units=m +no_defs", 32723},
        {"+proj=utm +zone=32 +ellps=GRS80 +units=m", 25832},
        {"+proj=longlat +datum=WGS84 +no_defs +type=crs", 4326},
        {"WGS84", 4326},
        {"+proj=utm +zone=32 +ellps=bessel", 0},
        {"+proj=utm +zone=32 +datum=WGS84 +units=us-ft", 0},
        {"ED50 / UTM zone 32N", 0},
        {"WGS84 UTM 61N", 0},
        {"WGS 1984 UTM Zone 32N", 32632},
        {"WGS 72 / UTM zone 32N", 0},
        {"WGS84 UTM 99999999999N", 0},
        {"+proj=utm +zone=32 +datum=WGS84 +towgs84=0,0,0,0,0,0,0", 32632},
        {"+proj=utm +zone=32 +ellps=WGS84 +towgs84=0.0,0,0 +no_defs", 32632},
        {"+proj=utm +zone=33 +datum=ETRS89", 25833},
        {"+proj=utm +zone=10 +ellps=GRS80 +datum=NAD83", 26910},
        {"+proj=utm +zone=32 +ellps=intl +towgs84=-87,-98,-121,0,0,0,0", 0},
        {"+proj=utm +zone=32 +ellps=intl +towgs84=0,0,0", 0},
        {"+proj=utm +zone=32 +ellps=GRS80 +towgs84=0,0,1", 0},
        {"+proj=utm +zone=32 +towgs84=0,0,0", 0},
        {"+proj=utm +zone=32 +datum=WGS84 +ellps=bessel", 0},
        {"+proj=utm +zone=32 +datum=WGS72", 0},
        {"+proj=utm +zone=32 +datum=WGS84 +units=km", 0},
        {"+proj=pipeline +step +proj=utm +zone=32 +ellps=WGS84", 0},
        {"+proj=longlat +ellps=GRS80 +no_defs", 4326},
        {"+proj=longlat +ellps=WGS84 +towgs84=0,0,0", 4326},
        {"+proj=longlat +ellps=bessel +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7", 0},
        {"+proj=longlat +datum=WGS84 +pm=paris", 0},
        {"urn:ogc:def:crs:EPSG:9.8.1:25832", 25832},
        {"EPSG:25832+EPSG:none", 0},
        {"EPSG:25832 +north first", 25832},
        {"EPSG:99999999999", 0},
        {"EPSG:25832+99999999999", 0},
        {"EPSG:-32632", 0},
        {"32632", 32632},
        {"12", 0},
        {"http://www.opengis.net/def/crs/EPSG/0/32632", 32632},
        {"PROJCS[\"WGS 84 / UTM zone 32N\",GEOGCS[\"WGS 84\"]]", 32632},
        {"PROJCS[\"Gauss-Krueger\",GEOGCS[\"WGS 84 UTM 32N\"]]", 0},
        {"x y z", 0}};
    static const char *const pairs[] = {"urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::7837",
                                        "urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG:9.8:7837",
                                        "EPSG:25832+7837", "EPSG:25832 + 7837",
                                        "EPSG:25832+EPSG:7837"};
    static const char feet[] = "image,lon,lat,altitude [ft]\nA.jpg,7.5,47.5,984\n";
    struct positions p;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    log_set_level(LOG_ERROR);
    for (size_t i = 0; i < sizeof tables / sizeof *tables; i++) {
        put("other.csv", tables[i].text, path);
        kit_ok(positions_read(path, &p, &e), e);
        if (p.n != 1 || p.epsg != tables[i].epsg || p.list[0].at[0] != tables[i].lon ||
            p.list[0].at[1] != tables[i].lat || p.list[0].at[2] != tables[i].h ||
            p.n_left_out != tables[i].left_out || !strchr("A.", p.list[0].image[0]) ||
            !strstr(p.list[0].image, ".jpg"))
            fail_msg("table %zu: n=%zu epsg=%d left out %zu, '%s'", i, p.n, p.epsg, p.n_left_out,
                     p.list[0].image);
        positions_free(&p);
    }
    for (size_t i = 0; i < sizeof told / sizeof *told; i++) {
        put("told.csv", told[i].text, path);
        kit_ok(positions_read(path, &p, &e), e);
        if (strcmp(p.heights, told[i].heights) || p.list[0].at[2] != 300 ||
            p.list[0].sigma_m[0] != told[i].sigma_m || p.list[0].sigma_m[1] != told[i].sigma_m)
            fail_msg("'%s': %s, %g", told[i].text, p.heights, p.list[0].sigma_m[0]);
        positions_free(&p);
    }
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        put("wrong.csv", wrong[i].text, path);
        kit_fails(positions_read(path, &p, &e), ERR_FORMAT, e, wrong[i].says);
    }
    log_set_level(LOG_WARN);
    put("feet.csv", feet, path);
    kit_fails(positions_read(path, &p, &e), ERR_FORMAT, e, "altitude [ft]");
    for (size_t i = 0; i < sizeof systems / sizeof *systems; i++) {
        int epsg, heights;
        if (wkt_system(systems[i].text, &epsg, &heights) != (systems[i].epsg > 0) ||
            epsg != systems[i].epsg || heights)
            fail_msg("'%s' is %d+%d, not %d", systems[i].text, epsg, heights, systems[i].epsg);
    }
    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++) {
        int epsg, heights;
        if (!wkt_system(pairs[i], &epsg, &heights) || epsg != 25832 || heights != 7837)
            fail_msg("'%s' is %d+%d", pairs[i], epsg, heights);
    }
    for (int pad = 0; pad < 4000; pad += 40) { /* a text that is too long never loses its end */
        char text[4096];
        int epsg, heights;
        snprintf(text, sizeof text, "+proj=utm +zone=23 +datum=WGS84 %*s +south", pad, "");
        assert_true(wkt_system(text, &epsg, &heights) == (epsg == 32723));
        assert_true(epsg == 32723 || (pad > 160 && epsg == 0));
    }
}

/* UTF-16 of either order, with a mark or without, also beyond the first 65,536 characters. A NUL
 * byte in other text is an error, and no end of it. */
static void tables_in_utf16_are_read(void **state)
{
    static const char ascii[] = "image,lon,lat,height\n%.jpg,7.5,47.5,300\n";
    static const uint16_t letter[] = {0xd83d, 0xde00}; /* in the place of % */
    struct positions p;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    kit_ok(file_join(path, tmp, "wide.csv", &e), e);
    for (unsigned form = 0; form < 4; form++) {
        const bool big = form & 1, mark = form & 2;
        struct buf b = {0};
        for (size_t i = 0; i < sizeof ascii - 1 + mark; i++) {
            const char c = mark && !i ? '\0' : ascii[i - mark];
            for (size_t k = 0; k < (c == '%' ? 2 : 1); k++) {
                const unsigned v = mark && !i ? 0xfeff : c == '%' ? letter[k] : (unsigned char)c;
                buf_u8(&b, big ? v >> 8 : v & 255);
                buf_u8(&b, big ? v & 255 : v >> 8);
            }
        }
        kit_ok(file_write(path, b.data, b.size, &e), e);
        buf_free(&b);
        kit_ok(positions_read(path, &p, &e), e);
        assert_string_equal(p.list[0].image, "\xf0\x9f\x98\x80.jpg");
        assert_true(p.n == 1 && p.list[0].at[1] == 47.5);
        positions_free(&p);
    }
    kit_ok(file_write(path, "image,lon,lat,height\na\0b", 24, &e), e);
    kit_fails(positions_read(path, &p, &e), ERR_FORMAT, e, "holds a NUL byte");
}

/* Three digits after the only comma may be thousands; what is not told is certain. */
static void a_comma_that_may_separate_thousands_is_told(void **state)
{
    static const struct {
        const char *line, *read;
        bool thousands;
    } row[] = {
        {"p1;634,676;5,5", "p1;634.676;5.5", true},
        {"p1;-12,345;5,5", "p1;-12.345;5.5", true},
        {"p1;0,125;5,5", "p1;0.125;5.5", false},
        {"p1;634676,125;5,5", "p1;634676.125;5.5", false},
        {"p1;634,6760;5,55", "p1;634.6760;5.55", false},
        {"p1;634,676.5;5.5", "p1;634,676.5;5.5", false}, /* no number: refused by who reads it */
    };
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        struct table t = {.path = "list.csv", .line = i + 1};
        char line[64];
        snprintf(line, sizeof line, "%s", row[i].line);
        table_decimal_points(&t, line);
        assert_string_equal(line, row[i].read);
        assert_int_equal(t.thousands, row[i].thousands);
    }
}

static void nonsense_is_refused(void **state)
{
    static const struct {
        const char *name, *text, *says;
    } bad[] = {
        {"a.csv", "image,lon,lat\n", "no column for z"},
        {"b.csv", "image,lon,lat,z\na.jpg,7,48\n", "line 2: z (or height) is missing"},
        {"c.csv", "image,lon,lat,z\na.jpg,7,5,47,5,300\n", "decimal commas"},
        {"d.csv", "image;lon;lat;z\na.jpg;7,5,1;47.5;300\n", "decimal point"},
        {"e.csv", "image,lon,lat,z\n", "no positions"},
        {"o.csv", "image,lon,lat,z,accuracy\na.jpg,7.5,47.5,300,\"0,025\"\n", "decimal point"},
        {"k.txt", "EPSG:25832\na.jpg 634 676.5 5 123 456.78 300\n",
         "line 2: '634 676.5' has a thousands separator: write it without"},
        {"l.csv", "image,x,y,z\na.jpg,634676.5,5 123 456.78,300\n",
         "'5 123 456.78', is no number: write it without thousands separators"},
        {"m.csv",
         "image;x;y;z\na.jpg;634676.5;5\xe2\x80\x99"
         "123\xe2\x80\x99"
         "456.7;300\n",
         "without thousands separators"},
        {"n.csv", "image,x,y,z\na.jpg,634,676.5,5,123,456.7,300\n", "thousands separators? Write"},
        {"f.pos", "% x-ecef(m)\n2024/06/01 10:00:00 1 2 3 1 1 1 1 1\n", "out-solformat llh"},
        {"g.pos", "2024/06/01 10:00:00 47.5\n", "expected is time"},
        {"h.MRK", "1 2 [3] 1,N 1,E 1,V 95.0,Lat 7.0,Lon 300,Ellh 1,1,1 50,Q\n", "(DJI)"},
        {"j.MRK", "1 inf [3] 1,N 1,E 1,V 47.0,Lat 7.0,Lon 300,Ellh 1,1,1 50,Q\n", "(DJI)"},
        {"i.csv", "", "no positions"},
    };
    struct positions p;
    struct err e = {0};
    struct buf out = {0};
    char path[FILE_PATH_MAX];
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        put(bad[i].name, bad[i].text, path);
        enum err_code rc = positions_read(path, &p, &e);
        if (rc != ERR_FORMAT && rc != ERR_DATA)
            fail_msg("%s: %s", bad[i].name, kit_err(rc));
        kit_expect_text(e.msg, bad[i].says, __FILE__, __LINE__);
    }
    put("none.csv", "image,lon,lat,z\nnobody.jpg,7,47,300\n", path);
    assert_int_equal(ingest("--positions none.csv", &out), 1);
    kit_expect_text((const char *)out.data, "none of 1 positions is of one", __FILE__, __LINE__);
    buf_free(&out);
    assert_int_equal(ingest("--heights sea", &out), 2);
    buf_free(&out);
    assert_int_equal(ingest("--geoid egm96 --geoid-offset-m 40", &out), 2);
    kit_expect_text((const char *)out.data, "give one", __FILE__, __LINE__);
    buf_free(&out);
}

/* ---- what heights count from ---- */

static void a_geoid_makes_heights_ellipsoidal(void **state)
{
    struct err e = {0};
    struct geoid *g;
    struct buf out = {0};
    char path[FILE_PATH_MAX], heights[HEIGHTS_MAX];
    double rms[2];
    kit_ok(file_join(path, tmp, "COUNTRY.GTX", &e), e);
    kit_gtx(path, 46, 6);
    kit_ok(geoid_open(path, &g, &e), e);
    geoid_close(&g);
    kit_ok(file_join(path, tmp, "country.gtx", &e), e);
    kit_gtx(path, 46, 6);
    kit_ok(geoid_open(path, &g, &e), e);
    assert_true(fabs(geoid_above(g, 7.5, 47.25) - 46.5) < 1e-6);
    assert_true(fabs(geoid_above(g, 9.0, 48.0) - 48) < 1e-6 && isnan(geoid_above(g, 9.5, 47)));
    assert_string_equal(geoid_name(g), "country");
    geoid_close(&g);
    assert_int_equal(ingest("", &out), 0);
    kit_expect_text((const char *)out.data, "count from sea level by EXIF", __FILE__, __LINE__);
    buf_free(&out);
    off(rms, heights);
    assert_string_equal(heights, "sea-exif");
    double plain = rms[1];
    assert_int_equal(ingest("--geoid country.gtx", &out), 0);
    kit_expect_text((const char *)out.data, "count from the WGS 84 ellipsoid", __FILE__, __LINE__);
    buf_free(&out);
    off(rms, heights);
    assert_string_equal(heights, "ellipsoid");
    assert_true(fabs(rms[1] - (45 + truth.origin.lon_deg - 6)) < 3 * plain + 0.5);
    put("truncated.gtx", "no grid", path);
    kit_fails(geoid_open(path, &g, &e), ERR_FORMAT, e, "too short");
    if (gtx_find("egm96_15.gtx", path)) { /* as PROJ's cct has it */
        kit_ok(geoid_open("egm96", &g, &e), e);
        assert_true(fabs(geoid_above(g, 7.5733, 47.5584) - 48.8782) < 0.001);
        geoid_close(&g);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(accuracies_weigh),
        cmocka_unit_test(dji_numbers_photographs),
        cmocka_unit_test(dji_names_have_a_number_after_the_time),
        cmocka_unit_test(events_are_matched_by_time),
        cmocka_unit_test(tables_of_other_programs_are_read),
        cmocka_unit_test(tables_in_utf16_are_read),
        cmocka_unit_test(a_comma_that_may_separate_thousands_is_told),
        cmocka_unit_test(nonsense_is_refused),
        cmocka_unit_test(a_geoid_makes_heights_ellipsoidal),
    };
    return cmocka_run_group_tests_name("positions", tests, setup, teardown);
}
