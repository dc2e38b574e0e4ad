/* Projects of OpenDroneMap, written from the procedural city's exact poses: the same cameras come
 * out, broken files are refused by name.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/odm.h"
#include "codec/scene/scene.h"
#include "core/geo/geo.h"
#include "tests/scene/city_kit.h"

enum { PHOTOS = 32 };
static const double tol_pose = 1e-6; /* m, and of rotation matrices; text has 17 digits */
static const double tol_ray = 1e-6, tol_px = 1e-6;
static const double tol_scene_m = 1e-3; /* a similarity fitted to places of 1e-7 m by text */
static struct arena texts;

struct city { /* exact poses and points, east-north-up */
    struct synth_config cfg;
    struct synth_photo photos[PHOTOS];
    struct colmap_model model;
    struct lens lens;
    struct geo_origin origin;
};

static void city_make(struct city *c, bool distorted)
{
    struct synth_city city;
    struct err e = {0};
    const struct synth_similarity same = {1, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
    city_kit_config(&c->cfg, &texts, "none", PHOTOS);
    c->cfg.distorted = distorted;
    kit_ok(synth_city_make(&c->cfg, &city, &e), e);
    synth_flight_make(&c->cfg, c->photos);
    kit_ok(synth_model_make(&c->cfg, &city, c->photos, &same, &c->model, &e), e);
    synth_city_free(&city);
    c->lens = synth_flight_lens(&c->cfg);
    c->origin = (struct geo_origin){c->cfg.lon_deg, c->cfg.lat_deg, c->cfg.ground_h_m};
}

/* ---- a project ---- */

static void put(const char *dir, const char *name, json_t *o)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, dir, name, &e), e);
    kit_ok(jsonc_write(path, o, &e), e);
    json_decref(o);
}

static json_t *numbers(const double *v, size_t n)
{
    json_t *a = json_array();
    for (size_t i = 0; i < n; i++)
        json_array_append_new(a, json_real(v[i]));
    return a;
}

/* A rotation matrix as axis times angle. */
static json_t *turn_of(const double rot[9])
{
    double q[4], v[3];
    camera_rot_to_quat(rot, q);
    double s = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 3; i++)
        v[i] = s > 0 ? 2 * atan2(s, q[0]) / s * q[1 + i] : 0;
    return numbers(v, 3);
}

static json_t *brown(const struct lens *l)
{
    double side = fmax(l->width_px, l->height_px);
    const double *p = l->params;
    bool bare = l->model == LENS_PINHOLE;
    return json_pack("{s:s, s:i, s:i, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f}",
                     "projection_type", "brown", "width", (int)l->width_px, "height",
                     (int)l->height_px, "focal_x", p[0] / side, "focal_y", p[1] / side, "c_x",
                     (p[2] - 0.5 * l->width_px) / side, "c_y", (p[3] - 0.5 * l->height_px) / side,
                     "k1", bare ? 0.0 : p[4], "k2", bare ? 0.0 : p[5], "p1", bare ? 0.0 : p[6],
                     "p2", bare ? 0.0 : p[7], "k3", 0.0);
}

static json_t *shots_of(const struct city *c)
{
    json_t *shots = json_object();
    for (size_t i = 0; i < PHOTOS; i++)
        json_object_set_new(shots, c->photos[i].name,
                            json_pack("{s:o, s:o, s:s, s:i}", "rotation",
                                      turn_of(c->photos[i].cam.rot), "translation",
                                      numbers(c->photos[i].cam.trans, 3), "camera", "v2 maker",
                                      "orientation", 1));
    return shots;
}

static json_t *points_of(const struct city *c)
{
    json_t *points = json_object();
    for (size_t i = 0; i < c->model.n_points; i++) {
        const struct colmap_point *p = &c->model.points[i];
        const double rgb[3] = {p->rgb[0], p->rgb[1], p->rgb[2]};
        char name[24];
        snprintf(name, sizeof name, "%zu", i);
        json_object_set_new(
            points, name,
            json_pack("{s:o, s:o}", "coordinates", numbers(p->xyz, 3), "color", numbers(rgb, 3)));
    }
    return points;
}

static json_t *reconstruction_of(const struct city *c)
{
    return json_pack("[{s:{s:o}, s:o, s:o, s:{s:f, s:f, s:f}}, {s:{}, s:{}}]", "cameras",
                     "v2 maker", brown(&c->lens), "shots", shots_of(c), "points", points_of(c),
                     "reference_lla", "latitude", c->origin.lat_deg, "longitude", c->origin.lon_deg,
                     "altitude", c->origin.h_m, "cameras", "shots");
}

static void put_tracks(const struct city *c, const char *dir)
{
    struct buf b = {0};
    struct err e = {0};
    char path[FILE_PATH_MAX];
    double side = fmax(c->lens.width_px, c->lens.height_px);
    buf_printf(&b, "OPENSFM_TRACKS_VERSION_v2\n");
    for (size_t p = 0; p < c->model.n_points; p++)
        for (size_t k = 0; k < c->model.points[p].n_track; k++) {
            const struct colmap_track_element *t = &c->model.tracks[c->model.points[p].track + k];
            const struct colmap_observation *o = &c->model.images[t->image].obs[t->obs];
            buf_printf(&b, "%s\t%zu\t%u\t%.17g\t%.17g\t0.004\t1\t2\t3\t-1\t-1\n",
                       c->photos[t->image].name, p, t->obs,
                       (o->x_px - 0.5 * c->lens.width_px) / side,
                       (o->y_px - 0.5 * c->lens.height_px) / side);
        }
    buf_printf(&b, "elsewhere.jpg\t1\t1\t0\t0\nIMG_0001.jpg\tnowhere\t1\t0\t0\n");
    kit_ok(file_join(path, dir, "tracks.csv", &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

static void project_dir(char dir[FILE_PATH_MAX], const char *name, const char *below)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(dir, kit_tmp, name, &e), e);
    kit_ok(file_join(path, dir, below, &e), e);
    kit_ok(file_mkdir(path, &e), e);
}

/* ---- comparisons ---- */

static void pose_of(const struct colmap_image *im, struct camera *c)
{
    camera_quat_to_rot(im->quat_wxyz, c->rot);
    memcpy(c->trans, im->trans, sizeof c->trans);
}

/* Unit ray of a pixel, in the world. */
static void ray_of(const struct lens *l, const double rot[9], double u, double v, double out[3])
{
    double x, y;
    assert_true(lens_undistort(l, u, v, &x, &y));
    double len = sqrt(x * x + y * y + 1);
    for (int i = 0; i < 3; i++)
        out[i] = (rot[i] * x + rot[3 + i] * y + rot[6 + i]) / len;
}

/* The same cameras as the flight's; `shift` is the frame's. */
static void expect_poses(const struct city *c, const struct odm_project *p, const double shift[3])
{
    assert_int_equal(p->model.n_images, PHOTOS);
    for (size_t i = 0; i < PHOTOS; i++) {
        const struct colmap_image *im = &p->model.images[i];
        const struct lens *l = &p->model.cameras[im->camera].lens;
        struct camera got = {0};
        double want_m[3], got_m[3], want_ray[3], got_ray[3];
        assert_string_equal(im->name, c->photos[i].name); /* both are sorted by name */
        pose_of(im, &got);
        kit_near_d("rotation", got.rot, c->photos[i].cam.rot, 9, tol_pose, 0);
        camera_center(&c->photos[i].cam, want_m);
        camera_center(&got, got_m);
        for (int k = 0; k < 3; k++)
            want_m[k] += shift[k];
        kit_near_d("centre", got_m, want_m, 3, tol_pose, 0);
        for (int k = 0; k < 3; k++) { /* the middle of the picture, and two others */
            double u = (0.5 - 0.2 * k) * l->width_px, v = (0.5 + 0.2 * k) * l->height_px;
            ray_of(&c->lens, c->photos[i].cam.rot, u, v, want_ray);
            ray_of(l, got.rot, u, v, got_ray);
            kit_near_d("ray", got_ray, want_ray, 3, tol_ray, 0);
        }
    }
}

static void expect_places(const struct city *c, const struct odm_project *p, double tol_m)
{
    struct err e = {0};
    assert_int_equal(p->n_places, PHOTOS);
    for (size_t i = 0; i < PHOTOS; i++) {
        const struct odm_place *at = &p->places[i];
        double got[3], want[3];
        assert_true(at->known);
        kit_ok(geo_to_enu(&c->origin, at->lon_deg, at->lat_deg, at->h_m, got, &e), e);
        camera_center(&c->photos[i].cam, want);
        kit_near_d("place", got, want, 3, tol_m, 0);
    }
}

/* Point i, the one of the city with the same place, and its observations. */
static void expect_point(const struct city *c, const struct odm_project *p, size_t i)
{
    const struct colmap_point *got = &p->model.points[i];
    size_t at = 0; /* ranked by name, as text */
    while (at < c->model.n_points && memcmp(got->xyz, c->model.points[at].xyz, sizeof got->xyz))
        at++;
    assert_true(at < c->model.n_points);
    const struct colmap_point *want = &c->model.points[at];
    assert_int_equal(got->n_track, want->n_track);
    assert_memory_equal(got->rgb, want->rgb, 3);
    for (size_t k = 0; k < got->n_track; k++) {
        const struct colmap_track_element *t = &p->model.tracks[got->track + k],
                                          *s = &c->model.tracks[want->track + k];
        const struct colmap_observation *o = &p->model.images[t->image].obs[t->obs],
                                        *w = &c->model.images[s->image].obs[s->obs];
        assert_int_equal(t->image, s->image);
        assert_int_equal(o->point, i);
        kit_near_d("observation", (double[2]){o->x_px, o->y_px}, (double[2]){w->x_px, w->y_px}, 2,
                   tol_px, 0);
    }
}

/* ---- tests ---- */

static void test_exact_poses(void **state)
{
    for (int distorted = 0; distorted < 2; distorted++) {
        char dir[FILE_PATH_MAX], sfm[FILE_PATH_MAX];
        struct city *c = mem_array(1, sizeof *c);
        struct odm_project p;
        struct err e = {0};
        city_make(c, distorted);
        project_dir(dir, distorted ? "brown" : "plain", "opensfm");
        kit_ok(file_join(sfm, dir, "opensfm", &e), e);
        put(sfm, "reconstruction.json", reconstruction_of(c));
        put_tracks(c, sfm);
        kit_ok(odm_read(dir, &p, &e), e);
        expect_poses(c, &p, (double[3]){0});
        expect_places(c, &p, tol_pose);
        assert_int_equal(p.links, ODM_LINKS_TRACKS);
        assert_int_equal(p.n_others, 0);
        assert_int_equal(p.n_alone, 0);
        assert_int_equal(p.model.n_points, c->model.n_points);
        assert_int_equal(p.model.n_tracks, c->model.n_tracks);
        for (size_t i = 0; i < p.model.n_points; i++)
            expect_point(c, &p, i);
        odm_free(&p);
        colmap_free(&c->model);
        mem_free(c);
    }
}

/* Without tracks.csv: what is computed is mostly what there is. */
static void test_computed_tracks(void **state)
{
    static const double least_found = 0.9, least_right = 0.8; /* measured: 1.01 and 0.89 */
    char dir[FILE_PATH_MAX];
    struct city *c = mem_array(1, sizeof *c);
    struct odm_project p;
    struct synth_city city;
    struct err e = {0};
    city_make(c, true);
    kit_ok(synth_city_make(&c->cfg, &city, &e), e);
    project_dir(dir, "computed", ".");
    put(dir, "reconstruction.json", reconstruction_of(c));
    kit_ok(odm_read(dir, &p, &e), e);
    assert_int_equal(p.links, ODM_LINKS_COMPUTED);
    size_t right = 0;
    for (size_t i = 0; i < p.model.n_images; i++)
        for (size_t k = 0; k < p.model.images[i].n_obs; k++) {
            const double *at = p.model.points[p.model.images[i].obs[k].point].xyz;
            double near_m[3], eye[3];
            camera_center(&c->photos[i].cam, eye);
            for (int a = 0; a < 3; a++) /* before the surface that it lies on, with its noise */
                near_m[a] = at[a] + 0.02 * (eye[a] - at[a]);
            right += synth_model_sees(&city, &c->lens, &c->photos[i].cam, near_m);
        }
    double found = (double)right / (double)c->model.n_tracks,
           share = (double)right / (double)p.model.n_tracks;
    printf("computed: %.3f of the true ones, %.3f are right\n", found, share);
    assert_true(found > least_found && share > least_right);
    odm_free(&p);
    synth_city_free(&city);
    colmap_free(&c->model);
    mem_free(c);
}

/* Pixel by the formulas of OpenSfM's documentation, in larger sides about the picture's middle. */
static void opensfm_pixel(const char *type, const double *k, double x, double y, double out[2])
{
    double r = hypot(x, y), a = strncmp(type, "fisheye", 7) ? r : atan(r),
           d = 1 + k[0] * a * a + k[1] * pow(a, 4) + k[2] * pow(a, 6) + k[3] * pow(a, 8), t[2];
    double s = a == r || r == 0 ? 1 : a / r;
    t[0] = 2 * k[4] * x * y + k[5] * (r * r + 2 * x * x);
    t[1] = 2 * k[5] * x * y + k[4] * (r * r + 2 * y * y);
    out[0] = k[6] * (d * s * x + t[0]) + k[8];
    out[1] = k[7] * (d * s * y + t[1]) + k[9];
}

/* Every type of camera that is taken projects as OpenSfM's does. */
static void test_camera_models(void **state)
{
    /* k1 k2 k3 k4 p1 p2 fx fy cx cy */
    static const struct {
        const char *type, *json;
        double k[10];
    } all[] = {
        {"perspective",
         "\"focal\":0.8,\"k1\":-0.1,\"k2\":0.02",
         {-0.1, 0.02, 0, 0, 0, 0, 0.8, 0.8, 0, 0}},
        {"simple_radial",
         "\"focal_x\":0.8,\"focal_y\":0.81,\"c_x\":0.01,\"c_y\":-0.02,\"k1\":-0.1",
         {-0.1, 0, 0, 0, 0, 0, 0.8, 0.81, 0.01, -0.02}},
        {"radial",
         "\"focal_x\":0.8,\"focal_y\":0.81,\"c_x\":0.01,\"c_y\":-0.02,\"k1\":-0.1,\"k2\":0.02",
         {-0.1, 0.02, 0, 0, 0, 0, 0.8, 0.81, 0.01, -0.02}},
        {"brown",
         "\"focal_x\":0.8,\"focal_y\":0.81,\"c_x\":0.01,\"c_y\":-0.02,\"k1\":-0.1,\"k2\":0.02,"
         "\"k3\":0.003,\"p1\":0.001,\"p2\":-0.002",
         {-0.1, 0.02, 0.003, 0, 0.001, -0.002, 0.8, 0.81, 0.01, -0.02}},
        {"fisheye",
         "\"focal\":0.5,\"k1\":-0.01,\"k2\":0.002",
         {-0.01, 0.002, 0, 0, 0, 0, 0.5, 0.5, 0, 0}},
        {"fisheye_opencv",
         "\"focal_x\":0.5,\"focal_y\":0.51,\"c_x\":0.01,\"c_y\":-0.02,\"k1\":-0.01,\"k2\":0.002,"
         "\"k3\":0.0003,\"k4\":0.00004",
         {-0.01, 0.002, 0.0003, 0.00004, 0, 0, 0.5, 0.51, 0.01, -0.02}}};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct err e = {0};
    project_dir(dir, "lenses", ".");
    kit_ok(file_join(path, dir, "reconstruction.json", &e), e);
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        for (int tall = 0; tall < 2; tall++) {
            struct odm_project p;
            struct buf b = {0};
            int w = tall ? 3000 : 4000, h = tall ? 4000 : 3000;
            buf_printf(&b,
                       "[{\"cameras\":{\"c\":{\"projection_type\":\"%s\",\"width\":%d,\"height\":"
                       "%d,%s}},\"shots\":{\"a.jpg\":{\"rotation\":[0,0,0],\"translation\":[0,0,"
                       "0],\"camera\":\"c\"}}}]",
                       all[i].type, w, h, all[i].json);
            kit_ok(file_write(path, b.data, b.size, &e), e);
            kit_ok(odm_read(dir, &p, &e), e);
            assert_int_equal(p.links, ODM_LINKS_NONE);
            assert_int_equal(p.n_places, 0);
            kit_near_d("no turn", p.model.images[0].quat_wxyz, (double[4]){1, 0, 0, 0}, 4, 0, 0);
            for (int k = 0; k < 25; k++) {
                double x = 0.15 * (k % 5 - 2), y = 0.15 * (k / 5 - 2), got[2], want[2];
                opensfm_pixel(all[i].type, all[i].k, x, y, want);
                lens_distort(&p.model.cameras[0].lens, x, y, &got[0], &got[1]);
                want[0] = 0.5 * w + 4000 * want[0];
                want[1] = 0.5 * h + 4000 * want[1];
                kit_near_d(all[i].type, got, want, 2, tol_px, 0);
            }
            odm_free(&p);
            buf_free(&b);
        }
}

static json_t *geojson_of(const struct city *c, const double shift[3])
{
    json_t *features = json_array();
    struct err e = {0};
    for (size_t i = 0; i < PHOTOS; i++) {
        double at[3], lonlat[3];
        camera_center(&c->photos[i].cam, at);
        kit_ok(geo_from_enu(&c->origin, at, &lonlat[0], &lonlat[1], &lonlat[2], &e), e);
        for (int k = 0; k < 3; k++)
            at[k] += shift[k];
        json_array_append_new(
            features,
            json_pack("{s:s, s:{s:s, s:f, s:i, s:i, s:o, s:o}, s:{s:s, s:o}}", "type", "Feature",
                      "properties", "filename", c->photos[i].name, "focal",
                      c->lens.params[0] / c->lens.width_px, "width", (int)c->lens.width_px,
                      "height", (int)c->lens.height_px, "translation", numbers(at, 3), "rotation",
                      turn_of(c->photos[i].cam.rot), "geometry", "type", "Point", "coordinates",
                      numbers(lonlat, 3)));
    }
    return json_pack("{s:s, s:o}", "type", "FeatureCollection", "features", features);
}

/* shots.geojson as the only file with poses, and as the one that says where a project in UTM is. */
static void test_shots(void **state)
{
    static const double utm[3] = {634000.25, 5268000.5, 0}; /* grid axes taken as east and north */
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct city *c = mem_array(1, sizeof *c);
    struct odm_project p;
    struct err e = {0};
    city_make(c, true);
    project_dir(dir, "shots", "odm_report");
    kit_ok(file_join(path, dir, "odm_report", &e), e);
    put(path, "shots.geojson", geojson_of(c, utm));
    kit_fails(odm_read(dir, &p, &e), ERR_NOENT, e, "cameras.json");
    put(dir, "cameras.json", json_pack("{s:o}", "maker", brown(&c->lens)));
    kit_ok(odm_read(dir, &p, &e), e);
    double first[3], shift[3];
    camera_center(&c->photos[0].cam, first);
    for (int k = 0; k < 3; k++)
        shift[k] = utm[k] - floor(first[k] + utm[k]);
    expect_poses(c, &p, shift);
    expect_places(c, &p, tol_pose);
    assert_int_equal(p.model.n_cameras, 1);
    assert_int_equal(p.model.n_points, 0);
    odm_free(&p);
    struct lens other = c->lens;
    other.params[4] += 0.1; /* which of the two was it? */
    put(dir, "cameras.json", json_pack("{s:o, s:o}", "a", brown(&c->lens), "b", brown(&other)));
    kit_fails(odm_read(dir, &p, &e), ERR_DATA, e, "2 cameras");

    /* With OpenDroneMap's georeferencing, reconstruction.json is in UTM: its reference is not used,
     * and the topocentric file is read instead where it is there. */
    project_dir(dir, "shots", "opensfm");
    project_dir(dir, "shots", "odm_georeferencing");
    kit_ok(file_join(path, dir, "odm_georeferencing/coords.txt", &e), e);
    kit_ok(file_write(path, "WGS84 UTM 32N\n634000 5268000\n", 30, &e), e);
    kit_ok(file_join(path, dir, "opensfm", &e), e);
    json_t *turned = reconstruction_of(c);
    json_object_set_new(json_object_get(json_array_get(turned, 0), "reference_lla"), "latitude",
                        json_real(10));
    put(path, "reconstruction.json", turned);
    kit_ok(odm_read(dir, &p, &e), e);
    expect_places(c, &p, tol_pose);
    odm_free(&p);
    put(path, "reconstruction.topocentric.json", reconstruction_of(c));
    kit_ok(odm_read(dir, &p, &e), e);
    expect_poses(c, &p, (double[3]){0});
    expect_places(c, &p, tol_pose);
    assert_non_null(strstr(p.from, "topocentric"));
    odm_free(&p);
    colmap_free(&c->model);
    mem_free(c);
}

/* ---- broken files ---- */

static const char good[] =
    "[{\"cameras\":{\"c\":{\"projection_type\":\"perspective\",\"width\":400,\"height\":300,"
    "\"focal\":0.8,\"k1\":0,\"k2\":0}},\"shots\":{\"a.jpg\":{\"rotation\":[0,0,0],"
    "\"translation\":[0,0,1],\"camera\":\"c\"},\"b.jpg\":{\"rotation\":[0,0,0.1],"
    "\"translation\":[1,0,1],\"camera\":\"c\"}},\"points\":{\"7\":{\"coordinates\":[0,0,5],"
    "\"color\":[1,2,300]}},\"reference_lla\":{\"latitude\":47,\"longitude\":8,\"altitude\":0}}]";

/* `good` with the first `from` as `to`. */
static void put_changed(const char *path, const char *from, const char *to)
{
    struct buf b = {0};
    struct err e = {0};
    const char *at = strstr(good, from);
    assert_non_null(at);
    buf_printf(&b, "%.*s%s%s", (int)(at - good), good, to, at + strlen(from));
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

static void test_broken_files(void **state)
{
    static const struct {
        const char *from, *to, *says;
        enum err_code code;
    } all[] = {
        {"[{", "[", "line 1", ERR_FORMAT},
        {"\"shots\"", "\"shot\"", "\"cameras\" and \"shots\"", ERR_FORMAT},
        {"\"cameras\"", "\"camera\"", "\"cameras\" and \"shots\"", ERR_FORMAT},
        {"\"perspective\"", "\"spherical\"", "type spherical", ERR_DATA},
        {"\"perspective\"", "\"fisheye624\"", "type fisheye624", ERR_DATA},
        {"\"perspective\"", "\"dual\"", "camera 'c'", ERR_DATA},
        {"\"perspective\"", "7", "projection_type", ERR_FORMAT},
        {"\"perspective\"", "\"brown\"", "focal_x", ERR_FORMAT},
        {"\"width\":400", "\"width\":0", "number of pixels", ERR_FORMAT},
        {"\"width\":400", "\"width\":1e30", "number of pixels", ERR_FORMAT},
        {"\"width\":400,", "", "\"width\": missing", ERR_FORMAT},
        {"\"focal\":0.8", "\"focal\":-1", "focal length", ERR_FORMAT},
        {"\"focal\":0.8", "\"focal\":\"0.8\"", "focal", ERR_FORMAT},
        {"\"k1\":0", "\"k1\":1e300", "k1", ERR_FORMAT},
        {"[0,0,0.1]", "[0,0]", "photograph 'b.jpg': \"rotation\"", ERR_FORMAT},
        {"[0,0,0.1]", "[0,0,1e9]", "out of range", ERR_FORMAT},
        {"[1,0,1]", "[1,0,null]", "\"translation\"", ERR_FORMAT},
        {"[1,0,1]", "[1e200,0,0]", "out of range", ERR_FORMAT},
        {"\"camera\":\"c\"}}", "\"camera\":\"d\"}}", "'d' is not among", ERR_FORMAT},
        {",\"camera\":\"c\"}}", "}}", "\"camera\": missing", ERR_FORMAT},
        {"\"b.jpg\"", "\"\"", "no name", ERR_FORMAT},
        {"\"b.jpg\"", "\"b\\t.jpg\"", "control", ERR_FORMAT},
        {"\"b.jpg\"", "\"a.jpg\"", "duplicate", ERR_FORMAT},
        {"[0,0,5]", "[0,0]", "point '7'", ERR_FORMAT},
        {"[0,0,5]", "[0,0,1e10]", "out of range", ERR_FORMAT},
        {"[1,2,300]", "\"red\"", "\"color\"", ERR_FORMAT},
        {"\"points\":{\"7\"", "\"points\":[1],\"other\":{\"7\"", "\"points\"", ERR_FORMAT},
        {"\"latitude\":47", "\"latitude\":470", "reference_lla", ERR_FORMAT},
        {"\"latitude\":47,", "", "reference_lla: \"latitude\"", ERR_FORMAT},
    };
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct odm_project p;
    struct err e = {0};
    project_dir(dir, "broken", ".");
    kit_ok(file_join(path, dir, "reconstruction.json", &e), e);
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        put_changed(path, all[i].from, all[i].to);
        kit_fails(odm_read(dir, &p, &e), all[i].code, e, all[i].says);
        assert_int_equal(p.model.n_images, 0);
    }
    kit_ok(file_write(path, "[]", 2, &e), e);
    kit_fails(odm_read(dir, &p, &e), ERR_DATA, e, "no photograph was placed");
    kit_fails(odm_read(kit_tmp, &p, &e), ERR_NOENT, e, "no project of OpenDroneMap");
    kit_fails(odm_read("no/such", &p, &e), ERR_NOENT, e, "no such project");
}

/* says NULL: read, with as many points. */
static void expect_tracks(const char *dir, const char *text, const char *says, size_t n_points)
{
    char path[FILE_PATH_MAX];
    struct odm_project p;
    struct err e = {0};
    kit_ok(file_join(path, dir, "tracks.csv", &e), e);
    kit_ok(file_write(path, text, strlen(text), &e), e);
    if (says) {
        kit_fails(odm_read(dir, &p, &e), ERR_FORMAT, e, says);
        return;
    }
    kit_ok(odm_read(dir, &p, &e), e);
    assert_int_equal(p.model.n_points, n_points);
    assert_int_equal(p.n_alone, 1 - n_points);
    if (n_points)
        assert_memory_equal(p.model.points[0].rgb, ((uint8_t[3]){1, 2, 255}), 3);
    odm_free(&p);
}

static void test_broken_tracks(void **state)
{
    static const char seen[] = "a.jpg\t7\t1\t0.1\t0.2\nb.jpg\t7\t1\t0.1\t0.2";
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct odm_project p;
    struct err e = {0};
    project_dir(dir, "tracks", ".");
    kit_ok(file_join(path, dir, "reconstruction.json", &e), e);
    kit_ok(file_write(path, good, sizeof good - 1, &e), e);
    expect_tracks(dir,
                  "OPENSFM_TRACKS_VERSION_v1\r\na.jpg\t7\t1\t0.1\t0.2\r\nb.jpg\t7\t1\t0\t0\r\n",
                  NULL, 1);
    /* one photograph, twice */
    expect_tracks(dir, "a.jpg\t7\t1\t0.1\t0.2\na.jpg\t7\t2\t0.1\t0.2\n", NULL, 0);
    expect_tracks(dir, "", NULL, 0);
    expect_tracks(dir, "a.jpg\t7\t1\t0.1\n", "line 1", 0);
    expect_tracks(dir, "OPENSFM_TRACKS_VERSION_v2\na.jpg\t7\t1\t0.1\tx\n", "line 2", 0);
    expect_tracks(dir, "a.jpg\t7\t1\tnan\t0\n", "line 1", 0);
    expect_tracks(dir, "a.jpg\t7\t1\t17\t0\n", "larger sides", 0);
    expect_tracks(dir, "a.jpg 7 1 0.1 0.2\n", "tabs", 0);
    expect_tracks(dir, seen, NULL, 1);
    kit_out_of_memory(odm_read(dir, &p, &e), 5, e);
    odm_free(&p);
}

/* ---- the command ---- */

/* Photographs of a city through the command and ingest: the scene has the exact cameras. */
static void test_to_a_scene(void **state)
{
    char dir[FILE_PATH_MAX], sfm[FILE_PATH_MAX], scene[FILE_PATH_MAX];
    const char *bin = kit_program();
    struct city *c = mem_array(1, sizeof *c);
    struct scene s;
    struct buf out = {0};
    struct err e = {0};
    city_make(c, true);
    kit_ok(file_join(dir, kit_tmp, "flown", &e), e);
    c->cfg.output = dir;
    c->cfg.gps_sigma_m = 3; /* what EXIF has is worse than what the project knows */
    kit_ok(synth_run(&c->cfg, &e), e);
    project_dir(dir, "flown", "opensfm");
    kit_ok(file_join(sfm, dir, "opensfm", &e), e);
    put(sfm, "reconstruction.json", reconstruction_of(c));
    put_tracks(c, sfm);
    int rc = kit_run(&out,
                     "'%s' import-odm '%s' -o '%s/model' && '%s' ingest '%s/images' "
                     "'%s/model' --positions '%s/model/positions.tsv' -o '%s/scene' -q",
                     bin, dir, kit_tmp, bin, dir, kit_tmp, kit_tmp, kit_tmp);
    if (rc)
        fail_msg("%.*s", (int)out.size, (const char *)out.data);
    kit_ok(file_join(scene, kit_tmp, "scene", &e), e);
    kit_ok(scene_read(scene, &s, &e), e);
    assert_int_equal(s.n_images, PHOTOS);
    for (size_t i = 0; i < s.n_images; i++) {
        double at[3], lon, lat, h, got[3], want[3];
        camera_center(&s.images[i].cam, at);
        kit_ok(geo_from_enu(&s.origin, at, &lon, &lat, &h, &e), e);
        kit_ok(geo_to_enu(&c->origin, lon, lat, h, got, &e), e);
        camera_center(&c->photos[i].cam, want);
        kit_near_d("camera of the scene", got, want, 3, tol_scene_m, 0);
    }
    scene_free(&s);
    out.size = 0; /* what is there stays, unless asked */
    assert_int_equal(kit_run(&out, "'%s' import-odm '%s' -o '%s/model'", bin, dir, kit_tmp), 2);
    assert_int_equal(
        kit_run(&out, "'%s' import-odm '%s' -o '%s/model' --overwrite", bin, dir, kit_tmp), 0);
    assert_int_equal(
        kit_run(&out, "'%s' import-odm '%s' -o '%s/images' --overwrite", bin, dir, dir), 2);
    assert_int_equal(kit_run(&out, "'%s' import-odm '%s'", bin, dir), 2);
    assert_int_equal(kit_run(&out, "'%s' import-odm '%s/scene' -o '%s/m2'", bin, kit_tmp, kit_tmp),
                     1);
    buf_free(&out);
    colmap_free(&c->model);
    mem_free(c);
}

static int teardown(void **state)
{
    arena_free(&texts);
    return kit_tmp_remove(state);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_exact_poses),   cmocka_unit_test(test_computed_tracks),
        cmocka_unit_test(test_camera_models), cmocka_unit_test(test_shots),
        cmocka_unit_test(test_broken_files),  cmocka_unit_test(test_broken_tracks),
        cmocka_unit_test(test_to_a_scene),
    };
    progress_quiet(true);
    log_set_level(LOG_WARN);
    return cmocka_run_group_tests_name("odm", tests, kit_tmp_make, teardown);
}
