/* XMP of drones: reading it from files, also hostile ones; which altitudes ingest uses; and the
 * tilt of the frame against gimbals, on a procedural city.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "scene/ingest/ingest.h"
#include "tests/scene/city_kit.h"

#define DEG 57.29577951308232
#define TAKE_OFF_M 283.4 /* of the drone, as EXIF counts */
#define ODD_M 50.0       /* from the sea to the ellipsoid */

static struct arena config_texts;
static char city[FILE_PATH_MAX];
static const struct geo_origin *city_origin(const json_t *truth)
{
    static struct geo_origin o;
    struct err e = {0};
    const json_t *at = json_object_get(truth, "origin");
    kit_ok(jsonc_num(at, "lon_deg", &o.lon_deg, &e), e);
    kit_ok(jsonc_num(at, "lat_deg", &o.lat_deg, &e), e);
    kit_ok(jsonc_num(at, "h_m", &o.h_m, &e), e);
    return &o;
}

/* ---- attributes ---- */

struct pair {
    const char *name, *text;
};

static bool look_up(const void *user, const char *name, char *text, size_t room)
{
    for (const struct pair *p = user; p->name; p++)
        if (!strcmp(p->name, name))
            return snprintf(text, room, "%s", p->text) < (int)room;
    return false;
}

static void attributes_are_read(void **state)
{
    static const struct pair
        dji[] = {{"drone-dji:RelativeAltitude", "+60.10"},
                 {"drone-dji:AbsoluteAltitude", "+123.45"},
                 {"drone-dji:GimbalPitchDegree", "-90.00"},
                 {"drone-dji:GimbalRollDegree", "+180.00"},
                 {"drone-dji:RtkFlag", "16"},
                 {NULL, NULL}},
        tilted[] = {{"drone-parrot:CameraPitchDegree", "-30"},
                    {"drone-parrot:CameraRollDegree", "10"},
                    {"Camera:VerticalCS", "Ellipsoidal"},
                    {NULL, NULL}},
        /* 0 is straight down, so this one looks 30 degrees below the horizon */
        body[] = {{"Camera:Pitch", "60"}, {"Camera:Roll", "0"}, {NULL, NULL}},
        hostile[] = {{"drone-dji:RelativeAltitude", "nan"},
                     {"drone-dji:AbsoluteAltitude", "1e999"},
                     {"drone-autel:AbsoluteAltitude", "-99999"},
                     {"drone-dji:GimbalPitchDegree", "-90 degrees"},
                     {"drone-dji:GimbalRollDegree", ""},
                     {"Camera:Pitch", "0x"},
                     {"Camera:Roll", "inf"},
                     {"drone-dji:RtkFlag", "fifty"},
                     {"drone-dji:AltitudeType", "Rtk"},
                     {NULL, NULL}};
    struct drone_meta m;
    drone_read(look_up, dji, &m);
    assert_true(m.has_relative && m.has_absolute && m.has_up && !m.ellipsoidal);
    assert_true(fabs(m.relative_m - 60.1) < 1e-9 && fabs(m.absolute_m - 123.45) < 1e-9);
    assert_true(fabs(m.up_cam[2] + 1) < 1e-9); /* behind the camera, whatever the roll */
    drone_read(look_up, tilted, &m);
    assert_true(m.ellipsoidal && !m.has_relative && !m.has_absolute);
    /* Rolled clockwise, up leans to the left of the picture. */
    assert_true(fabs(m.up_cam[0] + sin(10 / DEG) * cos(30 / DEG)) < 1e-9);
    assert_true(fabs(m.up_cam[1] + cos(10 / DEG) * cos(30 / DEG)) < 1e-9);
    assert_true(fabs(m.up_cam[2] + sin(30 / DEG)) < 1e-9);
    drone_read(look_up, body, &m);
    assert_true(m.has_up && fabs(m.up_cam[0]) < 1e-9);
    assert_true(fabs(m.up_cam[1] + cos(30 / DEG)) < 1e-9);
    assert_true(fabs(m.up_cam[2] + sin(30 / DEG)) < 1e-9);
    drone_read(look_up, hostile, &m);
    assert_true(!m.has_relative && !m.has_absolute && !m.has_up && !m.ellipsoidal);
}

/* ---- files ---- */

/* A copy of a JPEG with a packet of XMP. */
static void put_xmp(const char *from, const char *to, const char *xmp)
{
    static const char name[] = "http://ns.adobe.com/xap/1.0/"; /* with its NUL */
    struct buf in = {0}, out = {0};
    struct err e = {0};
    size_t n = sizeof name + strlen(xmp) + 2;
    assert_true(n <= 65535);
    kit_ok(file_read(from, 0, &in, &e), e);
    buf_add(&out, in.data, 2);
    buf_u16(&out, 0xe1ff);
    buf_u8(&out, (unsigned)(n >> 8));
    buf_u8(&out, (unsigned)(n & 255));
    buf_add(&out, name, sizeof name);
    buf_add(&out, xmp, strlen(xmp));
    buf_add(&out, in.data + 2, in.size - 2);
    kit_ok(buf_check(&out, &e), e);
    kit_ok(file_write(to, out.data, out.size, &e), e);
    buf_free(&in);
    buf_free(&out);
}

#define XMP_HEAD                                                                                   \
    "<?xpacket begin=\"\" id=\"W5M0MpCehiHzreSzNTczkc9d\"?><x:xmpmeta xmlns:x=\"adobe:ns:meta/\">" \
    "<rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\"><rdf:Description "         \
    "rdf:about=\"\" xmlns:drone-dji=\"http://www.dji.com/drone-dji/1.0/\" "                        \
    "xmlns:Camera=\"http://pix4d.com/camera/1.0/\" "
#define XMP_TAIL "</rdf:Description></rdf:RDF></x:xmpmeta><?xpacket end=\"w\"?>"

static void first_photo(char out[FILE_PATH_MAX])
{
    struct err e = {0};
    struct arena a = {0};
    char dir[FILE_PATH_MAX], **names;
    size_t n;
    kit_ok(file_join(dir, city, "images", &e), e);
    kit_ok(file_list(dir, NULL, &a, &names, &n, &e), e);
    assert_true(n > 0);
    kit_ok(file_join(out, dir, names[0], &e), e);
    arena_free(&a);
}

static void files_are_read(void **state)
{
    static const char *const broken[] = {
        "",
        "<",
        XMP_HEAD,
        XMP_HEAD "drone-dji:RelativeAltitude=\"12",
        XMP_HEAD "drone-dji:RelativeAltitude=\"&#x0;&bogus;\">" XMP_TAIL,
        XMP_HEAD "drone-dji:RelativeAltitude=\"1e9\" drone-dji:GimbalPitchDegree=\"-1000\" "
                 "drone-dji:GimbalRollDegree=\"0\">" XMP_TAIL,
        XMP_HEAD "><drone-dji:RelativeAltitude><rdf:Seq><rdf:li>4</rdf:li><rdf:li>x</rdf:li>"
                 "</rdf:Seq></drone-dji:RelativeAltitude>" XMP_TAIL};
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    struct image_gps gps, plain;
    struct drone_meta m;
    struct err e = {0};
    first_photo(from);
    kit_ok(file_join(to, kit_tmp, "xmp.jpg", &e), e);
    kit_ok(image_read_info(from, NULL, NULL, &plain, &m, &e), e);
    assert_true(!m.has_relative && !m.has_up);
    put_xmp(from, to,
            XMP_HEAD "drone-dji:RelativeAltitude=\"+1060.123\" drone-dji:AltitudeType=\"RtkAlt\" "
                     "drone-dji:RtkFlag=\"34\" "
                     "drone-dji:AbsoluteAltitude=\"+1345.678\"><Camera:Pitch>0.5</Camera:Pitch>"
                     "<Camera:Roll>0</Camera:Roll>" XMP_TAIL);
    kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e);
    assert_true(m.has_relative && m.has_absolute && m.ellipsoidal && m.has_up);
    assert_true(fabs(m.relative_m - 1060.123) < 1e-3 && fabs(m.absolute_m - 1345.678) < 1e-3);
    assert_true(fabs(acos(-m.up_cam[2]) * DEG - 0.5) < 1e-4);
    assert_true(gps.has_position && gps.lat_deg == plain.lat_deg && gps.alt_m == plain.alt_m);
    for (size_t i = 0; i < sizeof broken / sizeof *broken; i++) {
        put_xmp(from, to, broken[i]);
        kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e); /* a photograph all the same */
        assert_true(!m.has_up && !(m.has_relative && fabs(m.relative_m) > 20000));
        assert_true(gps.has_position && gps.alt_m == plain.alt_m);
    }
    char *deep = mem_array(65000, 1);
    assert_non_null(deep);
    for (size_t k = 0; k < 64000; k += 4) /* <a><a><a> ... */
        memcpy(deep + k, "<a> ", 4);      // NOLINT(bugprone-not-null-terminated-result)
    put_xmp(from, to, deep);
    kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e);
    assert_false(m.has_up);
    mem_free(deep);
}

/* ---- a city ---- */

enum exif { AS_IT_IS, MIRRORED, ZERO, ABSENT, ABOVE_TAKE_OFF, APART };
struct flight {
    enum exif exif;                 /* what EXIF's altitude is made */
    bool flat;                      /* the absolute altitude is above take-off too */
    double barometer_m, absolute_m; /* errors of what is written; NAN: not written */
    double jump_m;                  /* of the barometer, from the middle of the flight on */
    double tilt_deg;                /* of all gimbals, to the east; NAN: not written */
    double wobble_deg;              /* of each */
    bool rtk;
    int odd;    /* every such photograph, or the last ones if < 0, lost RTK, or alone has it */
    bool alike; /* theirs are RTK's altitudes all the same, without the flag */
};

static bool is_odd(const struct flight *f, size_t i, size_t n)
{
    return f->odd > 0 ? i % (size_t)f->odd == 0 : i + (size_t)-f->odd >= n;
}

/* XMP of the photograph that truly is `p`: as text. */
static void write_xmp(const struct flight *f, const json_t *p, size_t i, size_t n, double origin_h,
                      struct buf *out)
{
    struct err e = {0};
    double center[3], m[16], up[3], tilt = f->tilt_deg / DEG;
    const bool odd = is_odd(f, i, n);
    kit_ok(jsonc_nums(p, "center_enu_m", 3, center, &e), e);
    kit_ok(jsonc_nums(p, "world_to_camera", 16, m, &e), e);
    buf_printf(out, XMP_HEAD);
    if (isfinite(f->barometer_m))
        buf_printf(out, "drone-dji:RelativeAltitude=\"%+.2f\" ",
                   origin_h + center[2] - TAKE_OFF_M + (2 * i < n ? 0 : f->jump_m) +
                       f->barometer_m * rng_normal(5, 0, i));
    if (isfinite(f->absolute_m))
        buf_printf(out, "drone-dji:AbsoluteAltitude=\"%+.3f\" ",
                   origin_h + center[2] - (f->flat ? TAKE_OFF_M : 0) +
                       (!odd || f->alike ? 0
                        : f->rtk         ? -ODD_M
                                         : ODD_M) +
                       f->absolute_m * rng_normal(5, 1, i));
    if (f->rtk != odd)
        buf_printf(out, "drone-dji:RtkFlag=\"50\" drone-dji:AltitudeType=\"RtkAlt\" ");
    else if (odd)
        buf_printf(out, "drone-dji:RtkFlag=\"0\" drone-dji:AltitudeType=\"GpsFusionAlt\" ");
    if (isfinite(f->tilt_deg)) {
        const double lean[3] = {sin(tilt) + f->wobble_deg / DEG * rng_normal(5, 2, i),
                                f->wobble_deg / DEG * rng_normal(5, 3, i), cos(tilt)};
        for (int r = 0; r < 3; r++)
            up[r] = m[4 * r] * lean[0] + m[4 * r + 1] * lean[1] + m[4 * r + 2] * lean[2];
        double len = sqrt(up[0] * up[0] + up[1] * up[1] + up[2] * up[2]);
        buf_printf(out,
                   "drone-dji:GimbalPitchDegree=\"%+.2f\" drone-dji:GimbalRollDegree=\"%+.2f\"",
                   DEG * asin(up[2] / len), DEG * atan2(-up[0], -up[1]));
    }
    buf_printf(out, ">" XMP_TAIL);
}

/* Rewrites EXIF's altitude. */
static void write_exif(const struct flight *f, const char *path)
{
    struct err e = {0};
    struct buf b = {0};
    struct image_gps gps;
    struct drone_meta m;
    kit_ok(file_read(path, 0, &b, &e), e);
    kit_ok(image_read_info(path, NULL, NULL, &gps, &m, &e), e);
    gps.has_altitude = f->exif != ABSENT;
    gps.alt_m = f->exif == MIRRORED         ? -gps.alt_m
                : f->exif == ZERO           ? 0
                : f->exif == ABOVE_TAKE_OFF ? m.relative_m
                                            : gps.alt_m + ODD_M;
    kit_ok(exif_insert(&b, &gps, &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

/* A folder of the city's photographs with such XMP. */
static void write_flight(const struct flight *f, const json_t *truth, const char *images)
{
    struct err e = {0};
    char path[FILE_PATH_MAX], from[FILE_PATH_MAX], text[128];
    const json_t *list = json_object_get(truth, "photographs");
    size_t n = json_array_size(list);
    kit_ok(file_mkdir(images, &e), e);
    for (size_t i = 0; i < n; i++) {
        const json_t *p = json_array_get(list, i);
        struct buf xmp = {0};
        snprintf(text, sizeof text, "images/%s", json_string_value(json_object_get(p, "name")));
        kit_ok(file_join(from, city, text, &e), e);
        kit_ok(file_join(path, images, text + 7, &e), e);
        char *slash = strrchr(path, '/');
        *slash = '\0';
        kit_ok(file_mkdir(path, &e), e); /* names have folders */
        *slash = '/';
        write_xmp(f, p, i, n, city_origin(truth)->h_m, &xmp);
        kit_ok(buf_check(&xmp, &e), e);
        put_xmp(from, path, (const char *)xmp.data);
        if (f->exif && (f->exif != APART || !f->odd || is_odd(f, i, n)))
            write_exif(f, path);
        buf_free(&xmp);
    }
}

/* How much higher the scene has its cameras than they are, as a plane over the city: the similarity
 * is exact but for that, so its up tells the tilt. */
static void lift_of(const struct scene *s, const json_t *truth, double *up_m, double *tilt_deg)
{
    struct err e = {0};
    const json_t *list = json_object_get(truth, "photographs"), *each;
    double sum = 0, up[3] = {0};
    for (size_t i = 0; i < s->n_images; i++) {
        const struct camera *c = &s->images[i].cam;
        const json_t *p = NULL;
        double at[3], lon, lat, h, is[3], m[16];
        size_t k;
        json_array_foreach(list, k,
                           each) if (!strcmp(json_string_value(json_object_get(each, "name")),
                                             s->images[i].name)) p = each;
        assert_non_null(p);
        kit_ok(jsonc_nums(p, "center_enu_m", 3, is, &e), e);
        kit_ok(jsonc_nums(p, "world_to_camera", 16, m, &e), e);
        camera_center(c, at);
        kit_ok(geo_from_enu(&s->origin, at, &lon, &lat, &h, &e), e);
        sum += h - city_origin(truth)->h_m - is[2];
        for (int r = 0; r < 3; r++) /* true up, in the camera's axes, in the scene's */
            for (int a = 0; a < 3; a++)
                up[a] += c->rot[3 * r + a] * m[4 * r + 2];
    }
    *up_m = sum / (double)s->n_images;
    *tilt_deg = DEG * atan2(hypot(up[0], up[1]), up[2]);
}

/* Ingest the city with such XMP; the report and the scene's error in height: its median cameras'
 * height off, and how it is tilted, degrees. */
static void ingest_flight(const char *name, const struct flight *f, double offset_m, bool exif,
                          json_t **report, double *up_m, double *tilt_deg)
{
    struct err e = {0};
    struct ingest_config cfg;
    struct scene s;
    char images[FILE_PATH_MAX], path[FILE_PATH_MAX], out[FILE_PATH_MAX], text[128];
    json_t *truth;
    kit_ok(file_join(path, city, "truth/truth.json", &e), e);
    kit_ok(jsonc_read(path, &truth, &e), e);
    snprintf(text, sizeof text, "%s-images", name);
    kit_ok(file_join(images, kit_tmp, text, &e), e);
    write_flight(f, truth, images);
    kit_ok(options_defaults(ingest_options(), &cfg, &config_texts, &e), e);
    kit_ok(file_join(out, kit_tmp, name, &e), e);
    cfg.output = out;
    cfg.geoid_offset_m = offset_m;
    cfg.altitude = exif;
    cfg.exposure = false;
    kit_ok(ingest_run(images, city, &cfg, &e), e);
    kit_ok(scene_read(out, &s, &e), e);
    kit_ok(file_join(path, out, "report.json", &e), e);
    kit_ok(jsonc_read(path, report, &e), e);
    lift_of(&s, truth, up_m, tilt_deg);
    scene_free(&s);
    json_decref(truth);
}

static double number(const json_t *o, const char *a, const char *b)
{
    return json_number_value(json_object_get(json_object_get(o, a), b));
}

static void barometers_keep_the_level(void **state)
{
    const struct flight f = {.barometer_m = 0.1,
                             .absolute_m = (double)NAN,
                             .tilt_deg = (double)NAN},
                        jumps = {.barometer_m = 0.1,
                                 .absolute_m = (double)NAN,
                                 .jump_m = 30,
                                 .tilt_deg = (double)NAN};
    json_t *r;
    double up_m, tilt, exif_up_m, exif_tilt;
    ingest_flight("exif", &f, 0, true, &r, &exif_up_m, &exif_tilt);
    assert_true(number(r, "altitudes", "exif") > 30 && number(r, "altitudes", "barometer") == 0);
    json_decref(r);
    ingest_flight("barometer", &f, 0, false, &r, &up_m, &tilt);
    printf("drone: EXIF's altitudes: %.2f m off, tilted by %.3f deg; the barometer's: %.2f m, %.3f "
           "deg\n",
           exif_up_m, exif_tilt, up_m, tilt);
    assert_true(number(r, "altitudes", "barometer") > 30 && number(r, "altitudes", "exif") == 0);
    assert_true(number(r, "georeferencing", "sigma_vertical_m") < 0.7);
    assert_true(tilt < 0.5 * exif_tilt && fabs(up_m) < 1.5);
    assert_true(json_is_null(json_object_get(r, "gimbals")));
    json_decref(r);
    log_set_level(LOG_ERROR);
    ingest_flight("jumps", &jumps, 0, false, &r, &up_m, &tilt);
    log_set_level(LOG_WARN);
    assert_true(number(r, "altitudes", "exif") > 30 && number(r, "altitudes", "barometer") == 0);
    assert_true(fabs(up_m - exif_up_m) < 1e-6 && fabs(tilt - exif_tilt) < 1e-6);
    json_decref(r);
}

/* RTK counts from the ellipsoid: --geoid-offset-m, which is for EXIF's, leaves it alone. */
static void rtk_counts_from_the_ellipsoid(void **state)
{
    const struct flight f = {
        .barometer_m = 0.1, .absolute_m = 0.02, .tilt_deg = (double)NAN, .rtk = true};
    json_t *r;
    double up_m, tilt;
    ingest_flight("rtk", &f, 40, false, &r, &up_m, &tilt);
    printf("drone: RTK's altitudes: %.3f m off, tilted by %.3f deg\n", up_m, tilt);
    assert_true(number(r, "altitudes", "rtk") > 30);
    assert_true(fabs(up_m) < 0.05 && tilt < 0.1);
    json_decref(r);
    ingest_flight("rtk-exif", &f, 40, true, &r, &up_m, &tilt);
    assert_true(fabs(up_m - 40) < 1.5);
    json_decref(r);
}

static const struct {
    const char *name, *altitudes, *heights;
    struct flight flight;
    double tolerance_m;
} rtk_cases[] = {
    {"rtk-lost", "rtk", "ellipsoid", {.rtk = true, .odd = 5, .barometer_m = 0.1}, 0.05},
    {"rtk-lost-third", "rtk", "ellipsoid", {.rtk = true, .odd = 3, .barometer_m = 0.1}, 0.05},
    {"rtk-lost-end", "rtk", "ellipsoid", {.rtk = true, .odd = -15, .barometer_m = 0.1}, 0.05},
    {"rtk-unflagged",
     "rtk",
     "ellipsoid",
     {.rtk = true, .odd = 3, .alike = true, .barometer_m = 0.1},
     0.05},
    {"rtk-found", "exif", "sea-exif", {.exif = APART, .odd = 3, .barometer_m = (double)NAN}, 1.5},
    {"rtk-found-end",
     "exif",
     "sea-exif",
     {.exif = APART, .odd = -15, .barometer_m = (double)NAN},
     1.5},
    {"rtk-found-xmp",
     "xmp",
     "sea-exif",
     {.exif = ABSENT, .odd = 3, .barometer_m = (double)NAN},
     0.05},
    {"rtk-found-barometer",
     "barometer",
     "sea-exif",
     {.exif = APART, .odd = 3, .barometer_m = 0.1},
     1.5},
};

/* RTK comes and goes: photographs whose altitude has another reference than the others' stay, their
 * altitude does not count, and the frame is that of the others. */
static void rtk_comes_and_goes(void **state)
{
    log_set_level(LOG_ERROR);
    for (size_t c = 0; c < sizeof rtk_cases / sizeof *rtk_cases; c++) {
        struct flight f = rtk_cases[c].flight;
        json_t *r;
        double up_m, tilt;
        /* the barometer gives all an altitude, or shows that theirs are RTK's */
        const bool level = (!f.rtk && isfinite(f.barometer_m)) || f.alike;
        size_t i, n, count = 0;
        const json_t *photo;
        f.tilt_deg = (double)NAN;
        f.absolute_m = 0.02;
        ingest_flight(rtk_cases[c].name, &f, 0, false, &r, &up_m, &tilt);
        const json_t *photos = json_object_get(r, "photos");
        n = json_array_size(photos);
        json_array_foreach(photos, i, photo)
        {
            const bool counts = !is_odd(&f, i, n) || level;
            count += counts;
            assert_true(json_is_true(json_object_get(photo, "kept")));
            assert_int_equal(json_integer_value(json_object_get(photo, "flight")), 1);
            assert_int_equal(json_is_number(json_object_get(photo, "residual_m")), counts);
        }
        assert_true(n > 30 && number(r, "altitudes", rtk_cases[c].altitudes) == (double)count);
        assert_true((double)count == json_number_value(json_object_get(r, "with_gps")));
        assert_string_equal(json_string_value(json_object_get(r, "heights")), rtk_cases[c].heights);
        printf("drone: %s: %.2f m off, tilted by %.3f deg\n", rtk_cases[c].name, up_m, tilt);
        assert_true(fabs(up_m) < rtk_cases[c].tolerance_m && tilt < 1);
        json_decref(r);
    }
    log_set_level(LOG_WARN);
}

/* Which altitudes are believed: the table of ingest_drone.c. */
static void altitudes_are_believed_by_a_table(void **state)
{
    static const struct {
        const char *name;
        struct flight flight;
        const char *altitudes, *heights;
        double up_m, tolerance_m;
    } cases[] = {
        {"mirrored", {.exif = MIRRORED, .barometer_m = 0.1}, "barometer", "sea-exif", 0, 0.2},
        {"zero", {.exif = ZERO, .barometer_m = 0.1}, "barometer", "sea-exif", 0, 0.2},
        {"absent", {.exif = ABSENT, .barometer_m = (double)NAN}, "xmp", "sea-exif", 0, 0.2},
        /* two that are both plausible: EXIF's count, which is said */
        {"apart", {.exif = APART, .barometer_m = (double)NAN}, "exif", "sea-exif", 50, 2},
        /* EXIF's above take-off, XMP's not */
        {"low-exif", {.exif = ABOVE_TAKE_OFF, .barometer_m = 0}, "barometer", "sea-exif", 0, 2},
        /* heights above take-off alone */
        {"flat",
         {.exif = ABSENT, .flat = true, .barometer_m = 0},
         "takeoff",
         "takeoff",
         -TAKE_OFF_M,
         0.2},
        {"zero-flat",
         {.exif = ZERO, .flat = true, .barometer_m = 0},
         "takeoff",
         "takeoff",
         -TAKE_OFF_M,
         0.2},
        {"low",
         {.exif = ABSENT, .absolute_m = (double)NAN, .barometer_m = 0.1},
         "takeoff",
         "takeoff",
         -TAKE_OFF_M,
         0.5},
        /* XMP's absolute altitude is above take-off, EXIF's is not */
        {"low-xmp", {.flat = true, .barometer_m = 0}, "barometer", "sea-exif", 0, 2},
        /* nothing but zeros */
        {"nothing",
         {.exif = ZERO, .absolute_m = (double)NAN, .barometer_m = (double)NAN},
         "none",
         "unknown",
         (double)NAN,
         0},
    };
    log_set_level(LOG_ERROR);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct flight f = cases[i].flight;
        json_t *r;
        double up_m, tilt;
        f.tilt_deg = (double)NAN;
        ingest_flight(cases[i].name, &f, 0, false, &r, &up_m, &tilt);
        const char *heights = json_string_value(json_object_get(r, "heights"));
        printf("drone: %s: %.2f m off, heights %s\n", cases[i].name, up_m, heights);
        assert_string_equal(heights, cases[i].heights);
        assert_true(number(r, "altitudes", cases[i].altitudes) > 30);
        assert_true(!isfinite(cases[i].up_m) || fabs(up_m - cases[i].up_m) < cases[i].tolerance_m);
        json_decref(r);
    }
    log_set_level(LOG_WARN);
}

/* One value in every form that a packet may have it in. */
static void packets_have_many_forms(void **state)
{
#define RDF "<rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">"
#define DJI "xmlns:d=\"http://www.dji.com/drone-dji/1.0/\""
    static const char *const forms[] = {
        RDF "<rdf:Description " DJI " d:RelativeAltitude='+12.5' d:GpsLatitude='47.5' "
            "d:GpsLongtitude='7.25'/></rdf:RDF>",
        RDF "<rdf:Description " DJI "><d:RelativeAltitude>\n +12.5 </d:RelativeAltitude>"
            "<d:GpsLatitude>47.5</d:GpsLatitude><d:GpsLongtitude>7.25</d:GpsLongtitude>"
            "</rdf:Description></rdf:RDF>",
        RDF "<rdf:Description " DJI "><d:RelativeAltitude rdf:parseType='Resource'><rdf:value>12.5"
            "</rdf:value></d:RelativeAltitude></rdf:Description><rdf:Description " DJI " "
            "d:GpsLatitude='+47.5' d:GpsLongitude='+7.25'/></rdf:RDF>",
        "\xef\xbb\xbf" RDF "<rdf:Description xmlns='http://www.dji.com/drone-dji/1.0/'>"
        "<RelativeAltitude>12.5</RelativeAltitude><GpsLatitude>47.5</GpsLatitude>"
        "<GpsLongitude>7.25</GpsLongitude></rdf:Description></rdf:RDF>\n\n  ",
        RDF "<rdf:Description " DJI " d:RelativeAltitude='12.5' d:Latitude='47.5' "
            "d:Longitude='7.25'/></rdf:RDF>",
        RDF "<rdf:Description xmlns:s='https://www.skydio.com/drone-skydio/1.0/' "
            "s:RelativeAltitude='12.5'><s:Latitude>47.5</s:Latitude><s:Longitude>7.25</s:Longitude>"
            "</rdf:Description></rdf:RDF>",
        /* not declared; EXIF's own position; rubbish behind the packet */
        RDF "<rdf:Description drone-dji:RelativeAltitude='12.5' "
            "xmlns:e='http://ns.adobe.com/exif/1.0/' e:GPSLatitude='47,30.0N' "
            "e:GPSLongitude='7,15,0.0E'/></rdf:RDF><damaged",
        /* no XML: an ampersand, an attribute that stands twice, a letter of Latin-1, a charset that
         * is not known; and numbers as some write them */
        RDF "<rdf:Description " DJI " d:A='x&y' d:RelativeAltitude='12,5' d:GpsLatitude='47.5' "
            "d:GpsLongtitude='7.25'/></rdf:RDF>",
        RDF "<rdf:Description " DJI " d:A='1' d:A='1' d:RelativeAltitude='12.50 m' "
            "d:GpsLatitude='47.5' d:GpsLongtitude='7.25'/></rdf:RDF>",
        RDF "<rdf:Description " DJI " d:A='\xe9' d:relativealtitude='25/2' d:gpslatitude='47.5' "
            "d:GpsLongtitude='7.25'/></rdf:RDF>",
        "<?xml version='1.0' encoding='windows-1252'?>" RDF "<rdf:Description " DJI ">"
        "<d:RelativeAltitude> 12.5</d:RelativeAltitude><d:GpsLatitude>47.5</d:GpsLatitude>"
        "<d:GpsLongtitude>7.25</d:GpsLongtitude></rdf:Description></rdf:RDF>",
    };
    struct err e = {0};
    struct image_gps gps;
    struct drone_meta m;
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX], side[FILE_PATH_MAX];
    first_photo(from);
    kit_ok(file_join(to, kit_tmp, "form.jpg", &e), e);
    for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
        put_xmp(from, to, forms[i]);
        kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e);
        if (!m.has_relative || m.relative_m != 12.5 || !m.has_position || m.lat_deg != 47.5 ||
            m.lon_deg != 7.25)
            fail_msg("form %zu: %d %g, %d %g %g", i, m.has_relative, m.relative_m, m.has_position,
                     m.lat_deg, m.lon_deg);
    }
    /* A sidecar stands in for what the photograph has not; what it has comes first. */
    static const char *const sidecars[] = {"side.xmp", "side.jpg.XMP", "SIDE.Xmp"};
    kit_ok(file_join(to, kit_tmp, "side.jpg", &e), e);
    for (size_t i = 0; i < 3; i++) {
        kit_ok(file_join(side, kit_tmp, sidecars[i], &e), e);
        put_xmp(from, to, RDF "</rdf:RDF>");
        kit_ok(file_write(side, forms[i], strlen(forms[i]), &e), e);
        kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e);
        assert_true(m.has_relative && m.relative_m == 12.5 && m.lon_deg == 7.25);
        put_xmp(from, to, RDF "<rdf:Description " DJI " d:RelativeAltitude='99'/></rdf:RDF>");
        kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e);
        assert_true(m.relative_m == 99);
        assert_int_equal(remove(side), 0);
    }
    /* A document type could declare entities of any size. */
    put_xmp(from, to,
            "<!DOCTYPE a [<!ENTITY h '12.5'>]>" RDF "<rdf:Description " DJI
            " d:RelativeAltitude='&h;'/></rdf:RDF>");
    kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e);
    assert_false(m.has_relative);
}

/* EXIF that does not say the hemisphere, and XMP that does. */
static void xmp_tells_the_hemisphere(void **state)
{
    static const uint8_t letter[] = {1, 0, 2, 0, 2, 0, 0, 0, 'N'}; /* GPSLatitudeRef */
    struct err e = {0};
    struct buf b = {0};
    struct image_gps north, south;
    struct drone_meta m;
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    size_t n = 0;
    (void)state;
    first_photo(from);
    kit_ok(file_join(to, kit_tmp, "south.jpg", &e), e);
    kit_ok(image_read_info(from, NULL, NULL, &north, &m, &e), e);
    put_xmp(from, to,
            RDF "<rdf:Description " DJI " d:GpsLatitude='-47.5' d:GpsLongitude='7.5'/></rdf:RDF>");
    kit_ok(file_read(to, 0, &b, &e), e);
    for (size_t i = 0; i + sizeof letter < b.size; i++)
        if (!memcmp(b.data + i, letter, sizeof letter)) {
            b.data[i + sizeof letter - 1] = 0;
            n++;
        }
    assert_int_equal(n, 1);
    kit_ok(file_write(to, b.data, b.size, &e), e);
    buf_free(&b);
    kit_ok(image_read_info(to, NULL, NULL, &south, &m, &e), e);
    assert_true(south.has_position && south.no_letter);
    assert_true(south.lat_deg == -north.lat_deg && south.lon_deg == north.lon_deg);
}

/* Skydio's angles are members of structures, of which several have members of one name. */
static void structures_have_members(void **state)
{
#define SKYDIO RDF "<rdf:Description xmlns:s='https://www.skydio.com/drone-skydio/1.0/'"
    static const char *const forms[] = {
        SKYDIO "><s:VehicleOrientationNED s:Roll='1' s:Pitch='2' s:Yaw='3'/>"
               "<s:CameraOrientationNED s:Roll='10' s:Pitch='-30' s:Yaw='70'/></rdf:Description>"
               "</rdf:RDF>",
        SKYDIO "><s:VehicleOrientationNED rdf:parseType='Resource'><s:Roll>1</s:Roll><s:Pitch>2"
               "</s:Pitch></s:VehicleOrientationNED><s:CameraOrientationNED "
               "rdf:parseType='Resource'><s:Roll>10</s:Roll><s:Pitch>-30</s:Pitch>"
               "</s:CameraOrientationNED></rdf:Description></rdf:RDF>",
        SKYDIO "><s:CameraOrientationNED><rdf:Description s:Roll='10'><s:Pitch>-30</s:Pitch>"
               "</rdf:Description></s:CameraOrientationNED></rdf:Description></rdf:RDF>"};
    struct err e = {0};
    struct image_gps gps;
    struct drone_meta m;
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX];
    (void)state;
    first_photo(from);
    kit_ok(file_join(to, kit_tmp, "members.jpg", &e), e);
    for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
        put_xmp(from, to, forms[i]);
        kit_ok(image_read_info(to, NULL, NULL, &gps, &m, &e), e);
        const double want[3] = {-sin(10 / DEG) * cos(30 / DEG), -cos(10 / DEG) * cos(30 / DEG),
                                -0.5};
        assert_true(m.has_up);
        for (size_t k = 0; k < 3; k++)
            assert_true(fabs(m.up_cam[k] - want[k]) < 1e-12);
    }
}

static void gimbals_tell_the_tilt(void **state)
{
    const struct flight f = {.barometer_m = (double)NAN,
                             .absolute_m = (double)NAN,
                             .tilt_deg = 0,
                             .wobble_deg = 0.3},
                        off = {.barometer_m = 0.1,
                               .absolute_m = (double)NAN,
                               .tilt_deg = 5,
                               .wobble_deg = 0.3},
                        wild = {.barometer_m = (double)NAN,
                                .absolute_m = (double)NAN,
                                .tilt_deg = 0,
                                .wobble_deg = 40};
    json_t *r;
    double up_m, tilt;
    ingest_flight("gimbal", &f, 0, false, &r, &up_m, &tilt);
    printf("drone: gimbals off by 0.3 deg each, GPS by 1.5 m: tilted by %.3f deg, %.3f said\n",
           tilt, DEG * number(r, "gimbals", "tilt_rad"));
    assert_true(number(r, "gimbals", "used") > 30);
    assert_true(fabs(DEG * number(r, "gimbals", "tilt_rad") - tilt) < 0.2);
    assert_true(DEG * number(r, "gimbals", "spread_rad") > 0.1 &&
                DEG * number(r, "gimbals", "spread_rad") < 0.8);
    json_decref(r);
    /* Gimbals that all lean by 5 degrees to the east: GPS and barometer win, and it is said. */
    log_set_level(LOG_ERROR);
    ingest_flight("leaning", &off, 0, false, &r, &up_m, &tilt);
    printf("drone: gimbals leaning by 5 deg: tilted by %.3f deg, %.3f said\n", tilt,
           DEG * number(r, "gimbals", "tilt_rad"));
    assert_true(tilt < 1 && fabs(DEG * number(r, "gimbals", "east_rad") - 5) < 1);
    assert_true(fabs(DEG * number(r, "gimbals", "north_rad")) < 0.5);
    json_decref(r);
    ingest_flight("wild", &wild, 0, false, &r, &up_m, &tilt);
    log_set_level(LOG_WARN);
    assert_true(json_is_null(json_object_get(r, "gimbals")));
    json_decref(r);
}

static int setup(void **state)
{
    struct synth_config c;
    struct err e = {0};
    kit_tmp_make(state);
    kit_ok(file_join(city, kit_tmp, "city", &e), e);
    city_kit_config(&c, &config_texts, city, 48);
    c.gps_sigma_m = 1.5;
    c.gps_outlier_share = 0;
    kit_ok(synth_run(&c, &e), e);
    return 0;
}

static int teardown(void **state)
{
    arena_free(&config_texts);
    return kit_tmp_remove(state);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(attributes_are_read),
        cmocka_unit_test(files_are_read),
        cmocka_unit_test(barometers_keep_the_level),
        cmocka_unit_test(rtk_counts_from_the_ellipsoid),
        cmocka_unit_test(rtk_comes_and_goes),
        cmocka_unit_test(gimbals_tell_the_tilt),
        cmocka_unit_test(altitudes_are_believed_by_a_table),
        cmocka_unit_test(packets_have_many_forms),
        cmocka_unit_test(structures_have_members),
        cmocka_unit_test(xmp_tells_the_hemisphere),
    };
    return cmocka_run_group_tests_name("drone", tests, setup, teardown);
}
