/* Geo-registration against that of COLMAP: `colmap model_aligner` with the same GPS positions, into
 * ECEF by its own geodesy. With exact GPS both must give the same similarity. With noise and
 * outliers ours must not be farther from the truth than COLMAP's robust one. caliterra (real
 * photographs, poor GPS) must stand upright; differences are printed. Skipped if COLMAP is not
 * installed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/scene/city_kit.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "core/geo/geo.h"
#include "scene/control/sim3.h"
#include "scene/ingest/ingest.h"

static struct arena texts;

static void join(char *out, const char *a, const char *b)
{
    struct err e = {0};
    kit_ok(file_join(out, a, b, &e), e);
}

/* Photographs whose truth and GPS are known. 32 of 80 x 60 px: only poses matter here. */
static void city_make(const char *dir, double gps_sigma_m, double outlier_share)
{
    struct err e = {0};
    struct synth_config c;
    city_kit_config(&c, &texts, dir, 32);
    c.overwrite = true;
    c.gps_sigma_m = gps_sigma_m;
    c.gps_outlier_share = outlier_share;
    kit_ok(synth_run(&c, &e), e);
}

static void scene_make(const char *images, const char *sparse, const char *name, struct scene *out)
{
    struct err e = {0};
    struct ingest_config c;
    char dir[FILE_PATH_MAX];
    kit_ok(options_defaults(ingest_options(), &c, &texts, &e), e);
    join(dir, kit_tmp, name);
    c.output = dir;
    c.max_edge_px = 64; /* pixels are not looked at */
    c.overwrite = true;
    kit_ok(ingest_run(images, sparse, &c, &e), e);
    kit_ok(scene_read(dir, out, &e), e);
}

/* Degrees of "(30) (12) (22.3)", as GDAL prints EXIF. */
static double degrees(const char *text, const char *half)
{
    double part[3];
    if (!text || sscanf(text, "(%lf) (%lf) (%lf)", &part[0], &part[1], &part[2]) != 3)
        fail_msg("not an angle: %s", text ? text : "none");
    double deg = part[0] + part[1] / 60 + part[2] / 3600;
    return half && (*half == 'S' || *half == 'W') ? -deg : deg;
}

/* A line a photograph for model_aligner: name, latitude, longitude, altitude, by GDAL's reading of
 * EXIF and not ours. flat_m: altitude of all; NAN: each its own. */
static void positions_write(const char *images, const struct colmap_model *m, double flat_m,
                            const char *path)
{
    struct buf lines = {0};
    struct err e = {0};
    for (size_t i = 0; i < m->n_images; i++) {
        struct buf said = {0};
        assert_int_equal(kit_run(&said, "gdalinfo -json '%s/%s'", images, m->images[i].name), 0);
        json_t *o = json_loadb((const char *)said.data, said.size, 0, NULL),
               *exif = json_object_get(json_object_get(o, "metadata"), "");
        const char *text[5];
        static const char *const keys[5] = {"EXIF_GPSLatitude", "EXIF_GPSLatitudeRef",
                                            "EXIF_GPSLongitude", "EXIF_GPSLongitudeRef",
                                            "EXIF_GPSAltitude"};
        double alt = 0;
        for (size_t k = 0; k < 5; k++)
            text[k] = json_string_value(json_object_get(exif, keys[k]));
        if (!text[4] || sscanf(text[4], "(%lf)", &alt) != 1)
            fail_msg("%s: GDAL reads no altitude", m->images[i].name);
        buf_printf(&lines, "%s %.12f %.12f %.6f\n", m->images[i].name, degrees(text[0], text[1]),
                   degrees(text[2], text[3]), isnan(flat_m) ? alt : flat_m);
        json_decref(o);
        buf_free(&said);
    }
    kit_ok(buf_check(&lines, &e), e);
    kit_ok(file_write(path, lines.data, lines.size, &e), e);
    buf_free(&lines);
}

static void center_of(const struct colmap_image *image, double out[3])
{
    double rot[9];
    camera_quat_to_rot(image->quat_wxyz, rot);
    for (int a = 0; a < 3; a++)
        out[a] = -(rot[a] * image->trans[0] + rot[3 + a] * image->trans[1] +
                   rot[6 + a] * image->trans[2]);
}

/* Options of COLMAP's alignment. 3.10 and later have one estimator, a robust one: its result is the
 * least squares over what it keeps: all, if the error is large. */
static void robust_options(double error_m, char out[96])
{
    struct buf said = {0};
    const char *old = "--robust_alignment ";
    kit_run(&said, "QT_QPA_PLATFORM=offscreen colmap model_aligner --help");
    if (strstr((const char *)said.data, old)) /* kit_run ends it with NUL */
        snprintf(out, 96, "%s%d --robust_alignment_max_error %g", old, error_m > 0,
                 error_m > 0 ? error_m : 1);
    else
        snprintf(out, 96, "--alignment_max_error %g", error_m > 0 ? error_m : 1e4);
    buf_free(&said);
}

/* COLMAP's similarity from the model's frame into ECEF. error_m 0: least squares over all. */
static void aligner_run(const char *sparse, const struct colmap_model *m, const char *positions,
                        double error_m, struct sim3 *out)
{
    struct buf said = {0};
    struct err e = {0};
    struct colmap_model aligned;
    char dir[FILE_PATH_MAX], robust[96];
    double(*x)[3] = mem_array(m->n_images, sizeof *x), (*y)[3] = mem_array(m->n_images, sizeof *y);
    double up[3] = {0, 0, 1};
    assert_true(x && y);
    join(dir, kit_tmp, "aligned");
    robust_options(error_m, robust);
    if (kit_run(&said,
                "rm -rf '%s' && mkdir '%s' && QT_QPA_PLATFORM=offscreen colmap model_aligner "
                "--input_path '%s' --output_path '%s' --ref_images_path '%s' --ref_is_gps 1 "
                "--alignment_type ecef %s",
                dir, dir, sparse, dir, positions, robust))
        fail_msg("%.*s", (int)said.size, (const char *)said.data);
    buf_free(&said);
    kit_ok(colmap_read(dir, &aligned, &e), e);
    assert_int_equal(aligned.n_images, m->n_images);
    for (size_t i = 0; i < m->n_images; i++) {
        assert_string_equal(aligned.images[i].name, m->images[i].name);
        center_of(&m->images[i], x[i]);
        center_of(&aligned.images[i], y[i]);
    }
    for (int turn = 0; turn < 12; turn++) { /* up, which must turn to +z, is what turns there */
        assert_true(sim3_from_pairs((const double(*)[3])x, (const double(*)[3])y, NULL, m->n_images,
                                    up, out));
        memcpy(up, out->rot + 6, sizeof up);
    }
    for (size_t i = 0; i < m->n_images; i++) { /* it is one */
        double at[3], off = 0;
        sim3_apply(out, x[i], at);
        for (int a = 0; a < 3; a++)
            off = hypot(off, at[a] - y[i][a]);
        if (!(off < 1e-4)) /* doubles at 6.4e6 m, through quaternions and back */
            fail_msg("%s is %.6f m from a similarity", m->images[i].name, off);
    }
    colmap_free(&aligned);
    mem_free(x);
    mem_free(y);
}

/* Ours, into ECEF as well. */
static void sim_of_scene(const struct scene *s, struct sim3 *out)
{
    struct err e = {0};
    double m[16];
    kit_ok(geo_enu_to_ecef(&s->origin, m, &e), e);
    *out = (struct sim3){.scale = s->scale};
    for (int a = 0; a < 3; a++) {
        out->trans[a] = m[12 + a];
        for (int b = 0; b < 3; b++) {
            out->trans[a] += m[4 * b + a] * s->trans[b];
            for (int k = 0; k < 3; k++)
                out->rot[3 * a + b] += m[4 * k + a] * s->rot[3 * k + b];
        }
    }
}

struct apart {
    double scale, turn_rad, mean_m, most_m; /* of a over b, between them, of the cameras */
    double level_m, up_m;                   /* of the mean camera */
};
static struct apart sims_compare(const struct colmap_model *m, const struct sim3 *a,
                                 const struct sim3 *b)
{
    struct apart r = {.scale = a->scale / b->scale};
    double trace = 0, mean[3] = {0}, place[3] = {0};
    for (int k = 0; k < 9; k++)
        trace += a->rot[k] * b->rot[k];
    double half = fmin(fmax(0.5 * (trace - 1), -1), 1), skew = 0;
    for (int i = 0; i < 3; i++) /* small angles: by the sine */
        for (int j = 0; j < i; j++) {
            double d = 0;
            for (int k = 0; k < 3; k++)
                d += a->rot[3 * i + k] * b->rot[3 * j + k] - a->rot[3 * j + k] * b->rot[3 * i + k];
            skew += 0.25 * d * d;
        }
    r.turn_rad = half > 0.9 ? asin(fmin(sqrt(skew), 1)) : acos(half);
    for (size_t i = 0; i < m->n_images; i++) {
        double x[3], p[3], q[3], d = 0;
        center_of(&m->images[i], x);
        sim3_apply(a, x, p);
        sim3_apply(b, x, q);
        for (int k = 0; k < 3; k++) {
            d = hypot(d, p[k] - q[k]);
            mean[k] += (p[k] - q[k]) / (double)m->n_images;
            place[k] += q[k] / (double)m->n_images;
        }
        r.mean_m += d / (double)m->n_images;
        r.most_m = fmax(r.most_m, d);
    }
    double r_m = sqrt(place[0] * place[0] + place[1] * place[1] + place[2] * place[2]), all = 0;
    for (int k = 0; k < 3; k++) {
        r.up_m += mean[k] * place[k] / r_m;
        all = hypot(all, mean[k]);
    }
    r.level_m = sqrt(fmax(0, all * all - r.up_m * r.up_m));
    return r;
}

/* How far cameras look from straight down, on average, degrees. */
static double lean_deg(const struct colmap_model *m, const struct sim3 *s,
                       const struct geo_origin *o)
{
    struct err e = {0};
    double up[16], sum = 0;
    kit_ok(geo_enu_to_ecef(o, up, &e), e);
    for (size_t i = 0; i < m->n_images; i++) {
        double rot[9], down = 0;
        camera_quat_to_rot(m->images[i].quat_wxyz, rot);
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++)
                down -= up[8 + a] * s->rot[3 * a + b] * rot[6 + b];
        sum += acos(fmin(fmax(down, -1), 1)) * 180 / M_PI / (double)m->n_images;
    }
    return sum;
}

static void tell(const char *what, const struct apart *r)
{
    printf("aligner %s: scale %+.2g %%, turned %.2g mrad, cameras %.2g m on average, %.2g m at "
           "most; the middle %.2g m in plan, %+.2g m in height\n",
           what, 100 * (r->scale - 1), 1000 * r->turn_rad, r->mean_m, r->most_m, r->level_m,
           r->up_m);
}

static void needs_colmap(void)
{
    struct buf out = {0};
    bool found = kit_run(&out, "command -v colmap && colmap help") == 0;
    buf_free(&out);
    if (found)
        return;
    print_message("skipped: no colmap (Debian's package of that name has it)\n");
    skip();
}

struct survey { /* a COLMAP model, ours and theirs, and where the truth is */
    char images[FILE_PATH_MAX], sparse[FILE_PATH_MAX], positions[FILE_PATH_MAX];
    struct colmap_model model;
    struct scene scene;
};

static void survey_open(struct survey *s, const char *dir)
{
    struct err e = {0};
    join(s->images, dir, "images");
    join(s->sparse, dir, "sparse/0");
    join(s->positions, kit_tmp, "positions.txt");
    kit_ok(colmap_read(s->sparse, &s->model, &e), e);
    scene_make(s->images, s->sparse, "scene", &s->scene);
    positions_write(s->images, &s->model, (double)NAN, s->positions);
}

static void survey_close(struct survey *s)
{
    colmap_free(&s->model);
    scene_free(&s->scene);
}

/* No errors: two programs, two fits, two geodesies, one result. */
static void exact_gps_gives_one_similarity(void **state)
{
    struct survey s;
    struct sim3 ours, theirs;
    char dir[FILE_PATH_MAX];
    needs_colmap();
    join(dir, kit_tmp, "exact");
    city_make(dir, 0, 0);
    survey_open(&s, dir);
    sim_of_scene(&s.scene, &ours);
    aligner_run(s.sparse, &s.model, s.positions, 0, &theirs);
    struct apart r = sims_compare(&s.model, &ours, &theirs);
    tell("of exact GPS", &r);
    /* EXIF rounds positions to millimetres, and the two weigh photographs differently. */
    assert_true(fabs(r.scale - 1) < 2e-5 && r.turn_rad < 5e-5 && r.most_m < 3e-3);
    survey_close(&s);
}

/* Noise of 1.5 m and every tenth position 40 m off and more: against the truth, which the same city
 * with exact GPS has. */
static void bad_gps_leaves_ours_nearer(void **state)
{
    struct survey exact, bad;
    struct sim3 truth, ours, theirs;
    char dir[FILE_PATH_MAX];
    needs_colmap();
    join(dir, kit_tmp, "exact");
    city_make(dir, 0, 0);
    survey_open(&exact, dir);
    sim_of_scene(&exact.scene, &truth);
    join(dir, kit_tmp, "bad");
    city_make(dir, 1.5, 0.1);
    survey_open(&bad, dir);
    sim_of_scene(&bad.scene, &ours);
    aligner_run(bad.sparse, &bad.model, bad.positions, 5, &theirs);
    struct apart of_ours = sims_compare(&bad.model, &ours, &truth),
                 of_theirs = sims_compare(&bad.model, &theirs, &truth),
                 between = sims_compare(&bad.model, &ours, &theirs);
    tell("of bad GPS, ours from the truth", &of_ours);
    tell("of bad GPS, COLMAP's from the truth", &of_theirs);
    tell("of bad GPS, ours from COLMAP's", &between);
    assert_true(of_ours.mean_m < 1.5); /* 1.5 m an axis over 29 photographs, and seven unknowns */
    assert_true(of_ours.mean_m < 1.1 * of_theirs.mean_m);
    survey_close(&exact);
    survey_close(&bad);
}

/* Photographs that look straight down, GPS whose altitude climbs by 114 m over a flight of 141 x
 * 103 m: who believes it tilts the city by 40 degrees. With one altitude for all, COLMAP's least
 * squares see what ours do with the altitudes as they are. */
static void caliterra_stands_upright(void **state)
{
    struct survey s;
    struct sim3 ours, plain, robust, flat;
    const char *dir = getenv("CITYSPLAT_CALITERRA");
    char path[FILE_PATH_MAX];
    needs_colmap();
    dir = dir ? dir : "../shared/data/caliterra";
    join(path, dir, "images");
    if (!file_is_dir(path)) {
        print_message("skipped: no photographs at %s (set CITYSPLAT_CALITERRA)\n", path);
        skip();
    }
    survey_open(&s, dir);
    sim_of_scene(&s.scene, &ours);
    aligner_run(s.sparse, &s.model, s.positions, 0, &plain);
    aligner_run(s.sparse, &s.model, s.positions, 30, &robust);
    positions_write(s.images, &s.model, 400, s.positions);
    aligner_run(s.sparse, &s.model, s.positions, 0, &flat);
    struct apart a = sims_compare(&s.model, &ours, &plain),
                 b = sims_compare(&s.model, &ours, &robust),
                 c = sims_compare(&s.model, &ours, &flat);
    tell("of caliterra, ours from COLMAP's least squares", &a);
    tell("of caliterra, ours from COLMAP's robust fit", &b);
    tell("of caliterra, ours from COLMAP's with one altitude for all", &c);
    double lean[4] = {
        lean_deg(&s.model, &ours, &s.scene.origin), lean_deg(&s.model, &plain, &s.scene.origin),
        lean_deg(&s.model, &robust, &s.scene.origin), lean_deg(&s.model, &flat, &s.scene.origin)};
    printf("aligner of caliterra: cameras look %.1f degrees from straight down; by COLMAP's %.1f, "
           "robust %.1f, with one altitude for all %.1f\n",
           lean[0], lean[1], lean[2], lean[3]);
    assert_true(lean[0] < 6 && lean[0] < lean[1] && lean[0] < lean[2]);
    assert_true(fabs(c.scale - 1) < 0.05 && c.level_m < 1);
    survey_close(&s);
}

static int teardown(void **state)
{
    arena_free(&texts);
    return kit_tmp_remove(state);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(exact_gps_gives_one_similarity),
        cmocka_unit_test(bad_gps_leaves_ours_nearer),
        cmocka_unit_test(caliterra_stands_upright),
    };
    return cmocka_run_group_tests_name("aligner", tests, kit_tmp_make, teardown);
}
