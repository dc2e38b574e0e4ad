/* The commands for tile stores, through the program: import, export and import again without losing
 * a bit; the cells of a scene combined; pictures; errors.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/archive.h"
#include "codec/container/ckpt.h"
#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "codec/splat/ply.h"
#include "lod/choose/view.h"
#include "lod/store/store.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/statvfs.h>

#include <jansson.h>

struct fixture {
    char dir[FILE_PATH_MAX];
    const char *bin;
};

static int setup(void **state)
{
    static struct fixture f;
    kit_tmpdir(f.dir);
    *state = &f;
    return 0;
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    kit_rmdir(f->dir);
    return 0;
}

/* Run the program in the fixture's folder; `part` (may be NULL) must be in its output. */
#define run(f, want, part, ...) run_at(f, want, part, __FILE__, __LINE__, __VA_ARGS__)
static void ERR_PRINTF(6, 7) run_at(struct fixture *f, int want, const char *part, const char *file,
                                    int line, const char *fmt, ...)
{
    char args[2048];
    struct buf out = {0};
    va_list ap;
    if (!f->bin)
        f->bin = kit_program();
    va_start(ap, fmt);
    vsnprintf(args, sizeof args, fmt, ap);
    va_end(ap);
    int got = kit_run(&out, "cd '%s' && '%s' %s", f->dir, f->bin, args);
    if (got != want)
        fail_msg("%s:%d: citysplat %s: exit code %d, want %d\n%s", file, line, args, got, want,
                 (const char *)out.data);
    if (part)
        kit_expect_text((const char *)out.data, part, file, line);
    buf_free(&out);
}

static void path_in(const struct fixture *f, const char *name, char out[FILE_PATH_MAX])
{
    struct err e = {0};
    kit_ok(file_join(out, f->dir, name, &e), e);
}

static void write_ply(const struct fixture *f, const char *name, const struct gauss *g)
{
    struct err e = {0};
    struct buf b = {0};
    struct ply_info info = {0};
    char path[FILE_PATH_MAX];
    path_in(f, name, path);
    kit_ok(ply_encode(g, &info, &b, &e), e);
    kit_ok(file_write(path, b.data, b.size, &e), e);
    buf_free(&b);
}

static void read_ply(const struct fixture *f, const char *name, struct gauss *g,
                     struct ply_info *info)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    path_in(f, name, path);
    kit_ok(ply_read(path, NULL, g, info, &e), e);
}

static void assert_same_file(const struct fixture *f, const char *a, const char *b)
{
    if (kit_run(NULL, "cmp '%s/%s' '%s/%s'", f->dir, a, f->dir, b))
        fail_msg("%s and %s differ", a, b);
}

/* Every file of the folder "static" is an entry of city.3tz with the same bytes. */
static void packed_is_folder(const struct fixture *f)
{
    struct err e = {0};
    struct buf zip = {0};
    struct archive_reader *r = NULL;
    char path[FILE_PATH_MAX], listed[FILE_PATH_MAX], line[FILE_PATH_MAX];
    path_in(f, "city.3tz", path);
    kit_ok(file_read(path, 0, &zip, &e), e);
    kit_ok(archive_open(zip.data, zip.size, &r, &e), e);
    path_in(f, "static", path);
    path_in(f, "listed", listed);
    assert_int_equal(kit_run(NULL, "find '%s' -type f -printf '%%P\\n' > '%s'", path, listed), 0);
    FILE *in = fopen(listed, "r");
    size_t n = 0;
    for (; in && fgets(line, sizeof line, in); n++) {
        struct buf want = {0}, got = {0};
        char file[FILE_PATH_MAX];
        line[strcspn(line, "\n")] = '\0';
        kit_ok(file_join(file, path, line, &e), e);
        kit_ok(file_read(file, 0, &want, &e), e);
        kit_ok(archive_get(r, line, 1 << 28, &got, &e), e);
        assert_int_equal(got.size, want.size);
        assert_memory_equal(got.data, want.data, want.size);
        buf_free(&want);
        buf_free(&got);
    }
    assert_non_null(in);
    fclose(in);
    assert_true(n > 3);
    archive_close(&r);
    buf_free(&zip);
}

static void import_export_import_is_lossless(void **state)
{
    struct fixture *f = *state;
    struct gauss in, out;
    struct ply_info info;
    kit_gauss(1, 3000, 120, 3, 0, &in);
    for (size_t i = 0; i < in.n; i++)
        in.sh[48 * i + 47] = (float)i; /* to find rows again */
    write_ply(f, "a.ply", &in);
    run(f, 0, "revision",
        "import a.ply --origin 8.6821,50.1109,160.5 --tile-edge-m 60 -o a.tiles -q");
    run(f, 0, "are whole", "verify a.tiles -q");
    run(f, 0, "3000 Gaussians", "export a.tiles -o b.ply -q");
    read_ply(f, "b.ply", &out, &info);
    assert_int_equal(out.n, in.n);
    assert_true(info.has_origin && info.origin.h_m == 160.5 && info.origin.lon_deg == 8.6821);
    assert_int_equal(info.axes, PLY_AXES_ENU);
    for (size_t i = 0; i < out.n; i++) {
        size_t id = (size_t)out.sh[48 * i + 47];
        assert_true(id < in.n);
        assert_memory_equal(&out.mean_m[3 * i], &in.mean_m[3 * id], 12);
        assert_memory_equal(&out.scale_log[3 * i], &in.scale_log[3 * id], 12);
        assert_memory_equal(&out.quat_wxyz[4 * i], &in.quat_wxyz[4 * id], 16);
        assert_memory_equal(&out.opacity_logit[i], &in.opacity_logit[id], 4);
        assert_memory_equal(&out.sh[48 * i], &in.sh[48 * id], 192);
    }
    /* The file says where it is now, and the second round changes nothing at all. */
    run(f, 0, NULL, "import b.ply --tile-edge-m 60 --name a -o c.tiles -q");
    run(f, 0, NULL, "export c.tiles -o c.ply -q");
    assert_same_file(f, "b.ply", "c.ply");
    struct store *sa, *sc;
    struct err e = {0};
    char path[FILE_PATH_MAX];
    path_in(f, "a.tiles", path);
    kit_ok(store_open(path, &sa, &e), e);
    path_in(f, "c.tiles", path);
    kit_ok(store_open(path, &sc, &e), e);
    assert_string_equal(store_info(sa)->revision, store_info(sc)->revision);
    store_close(&sa);
    store_close(&sc);
    gauss_free(&in);
    gauss_free(&out);
}

static void levels_and_formats(void **state)
{
    struct fixture *f = *state;
    struct gauss in, out;
    struct ply_info info;
    kit_gauss(2, 2000, 60, 1, 0, &in);
    write_ply(f, "a.ply", &in);
    run(f, 0, NULL,
        "import a.ply --origin -122.4,37.8,10 --level-count 3 --no-lossless -o a.tiles -q "
        "--attribution 'A & B'");
    run(f, 0, NULL, "export a.tiles --level 1 -o one.ply -q");
    read_ply(f, "one.ply", &out, &info);
    assert_in_range(out.n, 120, 300); /* a sixteenth, rounded up a tile */
    gauss_free(&out);
    /* .spz is y up: back on the ground it gives the same places to half a step, twice (.spz and
     * the payload of the store): 2^-13 m with the reference grid; near-lossless, which is the
     * default, half of 1/128 of the median sigma, which is 1.9 m here. */
    const struct {
        const char *preset;
        double tolerance_m;
    } spz[] = {{"--preset spz", 3e-4}, {"", 0.5 * 1.9 / 128 + 3e-4}};
    for (size_t i = 0; i < 2; i++) {
        run(f, 0, NULL, "export a.tiles -o a.spz -q --overwrite %s", spz[i].preset);
        run(f, 0, "2000", "info a.spz");
        run(f, 0, NULL, "import a.spz --origin -122.4,37.8,10 -o b.tiles -q --overwrite");
        run(f, 0, NULL, "export b.tiles -o b.ply -q --overwrite");
        read_ply(f, "b.ply", &out, &info);
        double lo[3], hi[3], lo2[3], hi2[3];
        gauss_bounds(&in, 0, lo, hi);
        gauss_bounds(&out, 0, lo2, hi2);
        kit_near_d("lower corner", lo2, lo, 3, spz[i].tolerance_m, 0);
        kit_near_d("upper corner", hi2, hi, 3, spz[i].tolerance_m, 0);
        gauss_free(&out);
    }
    run(f, 0, "plain.glb: ", "export a.tiles -o plain.glb -q");
    run(f, 0, NULL, "convert plain.glb plain.ply -q");
    run(f, 2, "finest or 1 to 3", "export a.tiles --level 4 -o x.ply");
    run(f, 0, "tileset.json", "export a.tiles -o static --format 3dtiles -q");
    run(f, 2, "exists", "export a.tiles -o static --format 3dtiles -q");
    run(f, 0, NULL, "export a.tiles -o static --format 3dtiles --overwrite -q");
    run(f, 0, "city.3tz: ", "export a.tiles -o city.3tz -q");
    packed_is_folder(f);
    run(f, 0, "again: ", "export a.tiles -o again --format 3tz -q");
    run(f, 1, "Not a directory", "export a.tiles -o a.tiles/city.3tz -q");
    struct err e = {0};
    json_t *j;
    char path[FILE_PATH_MAX];
    path_in(f, "static/tileset.json", path);
    kit_ok(jsonc_read(path, &j, &e), e);
    json_t *content =
        json_object_get(json_object_get(json_object_get(j, "root"), "content"), "uri");
    char glb[FILE_PATH_MAX];
    snprintf(glb, sizeof glb, "static/%s", json_string_value(content));
    run(f, 0, ".glb", "info '%s'", glb);
    json_decref(j);
    gauss_free(&in);
}

static void info_as_json(void **state)
{
    struct fixture *f = *state;
    struct gauss in;
    struct err e = {0};
    struct buf out = {0};
    json_t *j;
    kit_gauss(3, 500, 50, 2, 0, &in);
    write_ply(f, "a.ply", &in);
    run(f, 0, NULL, "import a.ply --origin 8,50,0 -o a.tiles -q");
    assert_int_equal(
        kit_run(&out, "cd '%s' && '%s' info a.tiles --json --tiles", f->dir, kit_program()), 0);
    kit_ok(jsonc_parse((const char *)out.data, out.size, "info", &j, &e), e);
    assert_int_equal(json_integer_value(json_object_get(j, "gaussians")), 500);
    assert_int_equal(json_integer_value(json_object_get(j, "sh_degree")), 2);
    assert_int_equal(json_array_size(json_object_get(j, "box_enu_m")), 6);
    assert_int_equal(json_array_size(json_object_get(j, "tiles")),
                     json_integer_value(json_object_get(j, "tiles_count")));
    json_decref(j);
    buf_free(&out);
    gauss_free(&in);
}

/* The same camera, once by place and once as JSON, once of the store and once of the file, gives
 * the same picture. */
static void pictures(void **state)
{
    struct fixture *f = *state;
    struct gauss in;
    struct err e = {0};
    const struct geo_origin origin = {8, 50, 100};
    struct camera cam;
    char path[FILE_PATH_MAX];
    kit_gauss(4, 400, 20, 1, 0, &in);
    write_ply(f, "a.ply", &in);
    run(f, 0, NULL, "import a.ply --origin 8,50,100 -o a.tiles -q");
    const struct view_pose pose = {8, 49.9995, 130, 3, -25, 50};
    kit_ok(view_camera(&origin, &pose, 64, 48, &cam, &e), e);
    json_t *j =
        json_pack("{s:i,s:i,s:f,s:f,s:f,s:f,s:o}", "width", 64, "height", 48, "fx", cam.fx_px, "fy",
                  cam.fy_px, "cx", cam.cx_px, "cy", cam.cy_px, "world_to_camera", json_array());
    for (size_t i = 0; i < 16; i++) {
        double v = i < 12 ? (i % 4 < 3 ? cam.rot[3 * (i / 4) + i % 4] : cam.trans[i / 4]) : i == 15;
        json_array_append_new(json_object_get(j, "world_to_camera"), json_real(v));
    }
    path_in(f, "cam.json", path);
    kit_ok(jsonc_write(path, j, &e), e);
    json_decref(j);
    const char *place = "--lon 8 --lat 49.9995 --height-m 130 --heading-deg 3 --pitch-deg -25 "
                        "--fov-deg 50 --width-px 64 "
                        "--height-px 48 --background 0.2,0.4,0.6 --error-px 0 -q";
    run(f, 0, "visible", "render a.tiles %s -o place.npy", place);
    run(f, 0, "visible",
        "render a.tiles --camera cam.json --background 0.2,0.4,0.6 --error-px 0 -o cam.npy -q");
    run(f, 0, "visible", "render a.ply --camera cam.json --background 0.2,0.4,0.6 -o ply.npy -q");
    run(f, 0, "visible", "render a.tiles %s -o place.png", place);
    size_t shape[3];
    float *a, *b, *c;
    path_in(f, "place.npy", path);
    kit_ok(npy_read(path, 3, shape, &a, &e), e);
    assert_true(shape[0] == 48 && shape[1] == 64 && shape[2] == 3);
    path_in(f, "cam.npy", path);
    kit_ok(npy_read(path, 3, shape, &b, &e), e);
    path_in(f, "ply.npy", path);
    kit_ok(npy_read(path, 3, shape, &c, &e), e);
    double lo = 1, hi = 0;
    for (size_t i = 0; i < 48 * 64 * 3; i++) {
        /* Camera numbers pass through text with 17 digits; the origin on the device differs for the
         * file. */
        assert_true(fabsf(a[i] - b[i]) < 1e-4f && fabsf(a[i] - c[i]) < 2e-3f);
        lo = fmin(lo, (double)a[i]);
        hi = fmax(hi, (double)a[i]);
    }
    assert_true(hi - lo > 0.3); /* there is something to see */
    struct image img;
    path_in(f, "place.png", path);
    kit_ok(image_read(path, NULL, &img, &e), e);
    for (size_t i = 0; i < 48 * 64 * 3; i++)
        assert_true(fabs(img.px[i] / 255.0 - fmin(fmax((double)a[i], 0), 1)) < 0.51 / 255);
    image_free(&img);
    mem_free(a);
    mem_free(b);
    mem_free(c);
    gauss_free(&in);
    run(f, 2, "either", "render a.tiles -o x.png");
    run(f, 2, "no place on Earth", "render a.ply --lon 8 --lat 50 --height-m 9 -o x.png");
    run(f, 2, "--background", "render a.tiles %s --background 1,2,3 -o x.png", place);
}

/* ---- scenes ---- */

/* Two photographs 100 m apart over points: a cell each. */
static void write_scene(const struct fixture *f, struct partition *p)
{
    struct err e = {0};
    struct scene s = {.origin = {8.6, 50.1, 100}, .scale = 1, .rot = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    char path[FILE_PATH_MAX];
    s.attribution = arena_text(&s.arena, "© Someone");
    s.n_images = 2;
    s.images = arena_get(&s.arena, 2, sizeof *s.images);
    s.n_points = 200;
    s.points = arena_get(&s.arena, s.n_points, sizeof *s.points);
    for (size_t i = 0; i < s.n_points; i++)
        s.points[i] = (struct scene_point){
            .enu_m = {140 * rng_unit(1, 0, i) - 20, 40 * rng_unit(1, 1, i) - 20, 0},
            .track_length = 3};
    for (size_t i = 0; i < 2; i++) {
        const double eye[3] = {100.0 * (double)i, 0, 40};
        s.images[i] = (struct scene_image){.cam = camera_heading(eye, 0, -90, 1, 64, 48),
                                           .gps_enu_m = {(double)NAN, (double)NAN, (double)NAN},
                                           .residual_m = (double)NAN};
        s.images[i].name = arena_printf(&s.arena, "p%zu.jpg", i);
    }
    path_in(f, "scene", path);
    kit_ok(file_mkdir(path, &e), e);
    kit_ok(scene_write(path, &s, &e), e);
    struct partition_config cfg = partition_defaults();
    cfg.edge_m = 60;
    cfg.images_few = 0;
    cfg.images_least = 1;
    kit_ok(partition_make(&s, &cfg, p, &e), e);
    path_in(f, "scene/plan.json", path);
    kit_ok(cell_plan_write(path, &s, p, &e), e);
    scene_free(&s);
}

/* Every cell's checkpoint covers all of the ground; the first DC value says which cell it is from.
 */
static void write_cell(const struct fixture *f, const char *id, float tag, int level, size_t n)
{
    struct err e = {0};
    struct gauss g;
    char path[FILE_PATH_MAX];
    kit_gauss((uint64_t)level + 10 * (uint64_t)tag, n, 60, 0, 0, &g);
    for (size_t i = 0; i < n; i++)
        g.sh[3 * i] = tag;
    g.origin_enu_m[0] = 50;
    json_t *meta = json_pack("{s:i}", "level", level);
    char name[80];
    snprintf(name, sizeof name, "scene/cells/%.24s", id);
    path_in(f, name, path);
    kit_ok(file_mkdir(path, &e), e);
    snprintf(name, sizeof name, "scene/cells/%.24s/level%d.ckpt", id, level);
    path_in(f, name, path);
    kit_ok(ckpt_write(path, meta, &g, NULL, 0, &e), e);
    json_decref(meta);
    gauss_free(&g);
}

/* Cell 1 trained again, put into a.tiles: its ground has the new rows, the others what they had
 * (`at`, a cell). */
static void update_one_cell(struct fixture *f, const struct partition *p, const size_t *at)
{
    struct gauss g;
    struct ply_info info;
    size_t now[8] = {0};
    const char *id = p->cells[1].id;
    assert_int_equal(kit_run(NULL, "cp '%s/a.tiles' '%s/u.tiles'", f->dir, f->dir), 0);
    for (int l = 1; l <= 3; l++)
        write_cell(f, id, 7.0f, l, (size_t)150 << l);
    run(f, 2, "belong together", "tile scene --update u.tiles -q");
    run(f, 2, "no trained cell", "tile scene --update u.tiles --cell nowhere -q");
    run(f, 1, "none.tiles", "tile scene --update none.tiles --cell %s -q", id);
    run(f, 0, "tiles written", "tile scene --update u.tiles --cell %s -q", id);
    run(f, 0, NULL, "verify u.tiles");
    run(f, 0, "© Someone", "info u.tiles");
    run(f, 0, NULL, "export u.tiles -o u.ply -q");
    read_ply(f, "u.ply", &g, &info);
    for (size_t i = 0; i < g.n; i++) {
        size_t owner = partition_owner(p, (double)g.mean_m[3 * i], (double)g.mean_m[3 * i + 1]);
        assert_true(fabs((double)g.sh[3 * i] - (owner == 1 ? 7.0 : (double)owner)) < 1e-6);
        now[owner]++;
    }
    gauss_free(&g);
    /* Carried copies of coarse rows may come and go where the cell's finest rows do. */
    for (size_t c = 0; c < p->n_cells; c++)
        if (c == 1)
            assert_true(now[c] > at[c]); /* half as many again */
        else
            assert_in_range(now[c], at[c] - at[c] / 20, at[c] + at[c] / 20);
    /* A level that the store has not is refused. */
    write_cell(f, id, 7.0f, 4, 1000);
    run(f, 1, "level 4", "tile scene --update u.tiles --cell %s -q", id);
    assert_int_equal(kit_run(NULL, "rm '%s/scene/cells/%s/level4.ckpt'", f->dir, id), 0);
}

static void cells_become_one_store(void **state)
{
    struct fixture *f = *state;
    struct partition p;
    struct gauss g;
    struct ply_info info;
    write_scene(f, &p);
    assert_true(p.n_cells >= 2);
    run(f, 1, "citysplat train", "tile scene -o a.tiles -q");
    for (size_t c = 0; c < p.n_cells; c++)
        for (int l = 1; l <= 3; l++)
            write_cell(f, p.cells[c].id, (float)c, l, (size_t)100 << l);
    run(f, 0, "level 3", "tile scene -o a.tiles -q");
    run(f, 0, "© Someone", "info a.tiles");
    run(f, 0, NULL, "export a.tiles -o a.ply -q");
    read_ply(f, "a.ply", &g, &info);
    size_t want = 0, at[8] = {0};
    for (size_t c = 0; c < p.n_cells; c++) {
        struct gauss one;
        kit_gauss(3 + 10 * (uint64_t)c, 800, 60, 0, 0, &one);
        for (size_t i = 0; i < one.n; i++)
            want += partition_owner(&p, (double)one.mean_m[3 * i] + 50,
                                    (double)one.mean_m[3 * i + 1]) == c;
        gauss_free(&one);
    }
    assert_in_range(g.n, want, want + want / 10); /* and some carried down from coarser levels */
    for (size_t i = 0; i < g.n; i++) {
        size_t owner = partition_owner(&p, (double)g.mean_m[3 * i], (double)g.mean_m[3 * i + 1]);
        assert_true(fabs((double)g.sh[3 * i] - (double)owner) < 1e-6);
        at[owner]++;
    }
    for (size_t c = 0; c < p.n_cells; c++)
        assert_true(at[c] > 100);
    size_t all = g.n, south = 0;
    for (size_t i = 0; i < g.n; i++)
        south += (double)g.mean_m[3 * i + 2] < 0;
    gauss_free(&g);
    /* Cut: what lies above the origin's height goes, of every level. */
    run(f, 0, NULL, "tile scene -o whole.tiles -q");
    run(f, 0, NULL, "clip whole.tiles -o low.tiles -q --high-m %.3f", info.origin.h_m);
    run(f, 0, NULL, "export low.tiles -o low.ply -q");
    read_ply(f, "low.ply", &g, &info);
    assert_true(south > 100 && south < all);
    assert_in_range(g.n, south - south / 20, south + south / 10);
    for (size_t i = 0; i < g.n; i++)
        assert_true((double)g.mean_m[3 * i + 2] < 0.05);
    gauss_free(&g);
    run(f, 2, "--low-m", "clip whole.tiles -o x.tiles --low-m high");
    run(f, 1, "none.geojson", "clip whole.tiles -o x.tiles --polygon none.geojson");
    update_one_cell(f, &p, at);
    /* A level that one cell lacks is filled with its coarser one. */
    assert_int_equal(kit_run(NULL, "rm '%s/scene/cells/%s/level3.ckpt'", f->dir, p.cells[0].id), 0);
    run(f, 0, "no level 3", "tile scene -o b.tiles");
    /* Without the plan nothing says who owns what. */
    assert_int_equal(kit_run(NULL, "rm '%s/scene/plan.json'", f->dir), 0);
    run(f, 1, "plan.json is missing", "tile scene -o c.tiles -q");
    assert_int_equal(kit_run(NULL, "ls '%s'/c.tiles*", f->dir) != 0, 1);
    partition_free(&p);
}

static void one_clear_error_each(void **state)
{
    struct fixture *f = *state;
    struct gauss in;
    kit_gauss(5, 100, 20, 0, 0, &in);
    write_ply(f, "a.ply", &in);
    gauss_free(&in);
    run(f, 2, "-o FILE is missing", "import a.ply --origin 8,50,0");
    run(f, 2, "give --origin", "import a.ply -o x.tiles");
    run(f, 2, "expected", "import a.ply --origin 8,50 -o x.tiles");
    run(f, 2, "no place on Earth", "import a.ply --origin 50,120,0 -o x.tiles");
    run(f, 1, "none.ply", "import none.ply --origin 8,50,0 -o x.tiles");
    run(f, 2, "Bad Name", "import a.ply --origin 8,50,0 -o x.tiles --name 'Bad Name'");
    run(f, 1, "folder", "import a.ply --origin 8,50,0 -o no/such/folder/x.tiles");
    run(f, 1, "not a tile store", "export a.ply -o x.ply");
    run(f, 1, "not a tile store", "verify a.ply");
    run(f, 1, "scene.json", "tile . -o x.tiles");
    assert_int_equal(kit_run(NULL, "ls '%s'/x.*", f->dir) != 0, 1);
}

/* A city of Gaussians without training: both forms tile, and nothing is left of a run that was
 * killed or that has no room. */
static void a_city_without_training(void **state)
{
    struct fixture *f = *state;
    struct buf out = {0};
    struct fixture lab = *f;
    char bin[FILE_PATH_MAX];
    snprintf(bin, sizeof bin, "%.*s-lab", FILE_PATH_MAX - 8, kit_program());
    lab.bin = bin;
    run(&lab, 0, "20000 Gaussians", "splats --count 20k -o flat.ply -q");
    run(f, 0, "tiles", "import flat.ply -o flat.tiles -q");
    run(&lab, 0, "20000", "splats --count 20k -o deep -q");
    run(f, 0, "level 2         10000", "tile deep -o deep.tiles -q");
    struct statvfs disk;
    assert_int_equal(statvfs(f->dir, &disk), 0);
    if ((double)disk.f_bavail * (double)disk.f_frsize < 1e12)
        run(&lab, 1, "are needed on the disk", "splats --count 4G --sh-degree 3 -o no.ply -q");
    run(&lab, 2, "exists", "splats --count 1k -o flat.ply -q");
    kit_run(&out,
            "cd '%s' && mkdir dies && { '%s' splats --count 20M -o dies/x.ply -q & p=$!; sleep "
            "0.4; kill -9 $p; wait $p; ls dies; }",
            f->dir, lab.bin);
    assert_null(strstr((const char *)out.data, "x.ply"));
    assert_false(kit_run(&out, "cd '%s' && ls no.ply*", f->dir) == 0);
    buf_free(&out);
}

int main(void)
{
#define CASE(name) cmocka_unit_test_setup_teardown(name, setup, teardown)
    progress_quiet(true);
    const struct CMUnitTest tests[] = {
        CASE(import_export_import_is_lossless),
        CASE(levels_and_formats),
        CASE(info_as_json),
        CASE(pictures),
        CASE(cells_become_one_store),
        CASE(one_clear_error_each),
        CASE(a_city_without_training),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
