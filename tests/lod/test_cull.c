/* Culling never changes a picture: every splat lies in the boxes of its tile, of all tiles above
 * and of its block, and pictures of selected tiles and listed blocks have the same bits as pictures
 * of everything.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/lod/store_kit.h"
#include "tests/render/render_kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lod/choose/block.h"
#include "lod/choose/frustum.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/make/pyramid.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

enum { W = 72, H = 48, N = 12000, VIEWS = 60, TILES_MAX = 256 };
#define BOX_TOLERANCE_M 1e-9 /* sums of doubles about 10^3 m */

static const struct geo_origin origin = {8.6821, 50.1109, 160};
static const struct render_options draw = {
    .aa = RENDER_AA_2D, .background = {0.1f, 0.2f, 0.3f}, .sh_degree = -1};

struct fixture {
    char dir[FILE_PATH_MAX], path[2][FILE_PATH_MAX]; /* quantised, lossless */
};

/* Houses on a plain: most Gaussians small, some as large as a house, a few as large as a tile. */
static void make_scene(struct gauss *g)
{
    kit_gauss(3, N, 150, 1, 0, g);
    for (size_t i = 0; i < g->n; i++) {
        g->mean_m[3 * i + 2] *= 0.15f;
        for (size_t k = 0; k < 3; k++)
            g->scale_log[3 * i + k] -= i % 40 == 0 ? -0.5f : i % 7 == 0 ? 1.0f : 2.5f;
    }
}

static int setup(void **state)
{
    static struct fixture f;
    struct err e = {0};
    struct gauss g;
    kit_tmpdir(f.dir);
    make_scene(&g);
    for (size_t i = 0; i < 2; i++) {
        const struct pyramid_config cfg = {.tile_edge_m = 100, .name = "cull", .lossless = i == 1};
        kit_ok(file_join(f.path[i], f.dir, i ? "exact.tiles" : "city.tiles", &e), e);
        store_fixture_level(f.path[i], &origin, &g, &cfg, NULL);
    }
    gauss_free(&g);
    *state = &f;
    return render_kit_open(state);
}

static int teardown(void **state)
{
    struct fixture *f = *state;
    kit_rmdir(f->dir);
    return render_kit_close(state);
}

/* ---- boxes ---- */

/* How far the ellipsoid of 3.33 sigma reaches along axis k: the root of the diagonal of its
 * covariance. */
static double reach(const struct gauss *g, size_t i, size_t k)
{
    double q[4], len = 0, sum = 0;
    for (size_t c = 0; c < 4; c++)
        len += (double)g->quat_wxyz[4 * i + c] * (double)g->quat_wxyz[4 * i + c];
    for (size_t c = 0; c < 4; c++)
        q[c] = (double)g->quat_wxyz[4 * i + c] / sqrt(len);
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    const double rot[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                              {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                              {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    for (size_t j = 0; j < 3; j++) {
        double s = rot[k][j] * exp((double)g->scale_log[3 * i + j]);
        sum += s * s;
    }
    return 3.33 * sqrt(sum);
}

static void assert_inside(const char *what, const struct gauss *g, size_t i, const double lo[3],
                          const double hi[3])
{
    for (size_t k = 0; k < 3; k++) {
        double at = g->origin_enu_m[k] + (double)g->mean_m[3 * i + k], r = reach(g, i, k);
        if (!(at - r >= lo[k] - BOX_TOLERANCE_M && at + r <= hi[k] + BOX_TOLERANCE_M))
            fail_msg("%s: splat %zu, axis %zu: %g +- %g is not within %g to %g", what, i, k, at, r,
                     lo[k], hi[k]);
    }
}

/* The rows in the order of their blocks, as a picture has them. */
static enum err_code sort_blocks(struct gauss *g, struct err *e)
{
    struct gauss sorted = {0};
    uint32_t *place = mem_array(g->n, sizeof *place);
    float *size_log = mem_array(g->n, sizeof *size_log);
    assert_true(place && size_log);
    enum err_code rc = gauss_alloc(&sorted, g->n, g->sh_degree, g->embed_len, e);
    memcpy(sorted.origin_enu_m, g->origin_enu_m, sizeof sorted.origin_enu_m);
    for (size_t i = 0; i < g->n; i++)
        size_log[i] =
            fmaxf(fmaxf(g->scale_log[3 * i], g->scale_log[3 * i + 1]), g->scale_log[3 * i + 2]);
    block_places(size_log, g->n, place);
    for (size_t i = 0; !rc && i < g->n; i++)
        gauss_copy_row(&sorted, place[i], g, i);
    sorted.n = g->n;
    mem_free(place);
    mem_free(size_log);
    gauss_free(g);
    *g = sorted;
    return rc;
}

/* Boxes of the blocks of these rows, in the layout that is drawn. */
static void measure_blocks(const struct gauss *g, struct block *out)
{
    const uint32_t planes = layout_planes(g->sh_degree, g->embed_len);
    float *rows = mem_array(layout_floats(g->n, planes), sizeof *rows);
    assert_non_null(rows);
    for (size_t i = 0; i < g->n; i++)
        for (size_t k = 0; k < 3; k++) {
            float *row = rows + layout_at(i, planes);
            row[k * LAYOUT_LANES] = g->mean_m[3 * i + k];
            row[(LAYOUT_PLANE_SCALE + k) * LAYOUT_LANES] = g->scale_log[3 * i + k];
        }
    for (size_t b = 0; b < block_count(g->n); b++) {
        const size_t left = g->n - b * BLOCK_ROWS;
        block_measure(rows + layout_at(b * BLOCK_ROWS, planes), planes,
                      left < BLOCK_ROWS ? left : BLOCK_ROWS, g->origin_enu_m, &out[b]);
    }
    mem_free(rows);
}

/* Widths of the tile's blocks in a row, before sorting in width[0] and after in [1]. */
static void check_blocks(struct gauss *g, double width[2])
{
    struct err e = {0};
    struct block b[64];
    double sum = 0, all = 0;
    for (size_t i = 0; i < g->n; i++)
        sum += (double)g->mean_m[3 * i] + (double)g->opacity_logit[i];
    assert_in_range(block_count(g->n), 1, 64);
    measure_blocks(g, b);
    for (size_t i = 0; i < block_count(g->n); i++)
        width[0] += b[i].max_enu_m[0] - b[i].min_enu_m[0];
    kit_ok(sort_blocks(g, &e), e);
    for (size_t i = 0; i < g->n; i++)
        all += (double)g->mean_m[3 * i] + (double)g->opacity_logit[i];
    assert_true(fabs(sum - all) < 1e-6 * (fabs(sum) + (double)g->n)); /* the same rows */
    measure_blocks(g, b);
    for (size_t i = 0; i < g->n; i++) {
        const struct block *x = &b[i / BLOCK_ROWS];
        assert_inside("block", g, i, x->min_enu_m, x->max_enu_m);
        for (size_t k = 0; k < 3; k++)
            assert_true(exp((double)g->scale_log[3 * i + k]) <= x->sigma_max_m * (1 + 1e-12));
    }
    for (size_t i = 0; i < block_count(g->n); i++)
        width[1] += b[i].max_enu_m[0] - b[i].min_enu_m[0];
}

static void every_splat_lies_in_its_boxes(void **state)
{
    struct fixture *f = *state;
    struct err e = {0};
    for (size_t kind = 0; kind < 2; kind++) {
        struct store *s;
        double width[2] = {0};
        size_t n, levels = 0;
        kit_ok(store_open(f->path[kind], &s, &e), e);
        const struct store_tile *t = store_tiles(s, &n);
        const struct tree *tree = store_tree(s);
        for (size_t i = 0; i < n; i++) {
            struct gauss g;
            kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
            assert_int_equal(g.n, t[i].count);
            const struct store_shape x = store_shape(s, &t[i]);
            levels |= 1u << t[i].level;
            for (size_t r = 0; r < g.n; r++) {
                assert_inside("tile", &g, r, x.min_enu_m, x.max_enu_m);
                for (uint32_t v = (uint32_t)i; v != TREE_NONE; v = tree_node(tree, v).parent) {
                    const struct tree_bounds b = tree_bounds(tree, v);
                    assert_inside("node", &g, r, b.min_enu_m, b.max_enu_m);
                }
                for (size_t k = 0; k < 3; k++)
                    assert_true(exp((double)g.scale_log[3 * r + k]) <= x.sigma_max_m * (1 + 1e-12));
            }
            for (size_t k = 0; k < 3; k++)
                assert_true(x.core_min_enu_m[k] >= x.min_enu_m[k] &&
                            x.core_max_enu_m[k] <= x.max_enu_m[k]);
            check_blocks(&g, width);
            gauss_free(&g);
        }
        assert_true((levels & 14) == 14);
        print_message("blocks are %.2f as wide as unsorted\n", width[1] / width[0]);
        assert_true(width[1] < 0.9 * width[0]); /* large ones keep to themselves */
        store_close(&s);
    }
}

/* ---- pictures ---- */

/* All tiles of the cut that a camera at `eye` needs, wherever it looks: the documented rule without
 * lod/choose/pick.c. */
static size_t cut(const struct tree *t, const struct store_tile *tiles, uint32_t node,
                  const double eye[3], double focal_px, double error_px, uint32_t *out, size_t n)
{
    const struct tree_node v = tree_node(t, node);
    const struct tree_bounds b = tree_bounds(t, node);
    double d2 = 0;
    for (size_t k = 0; k < 3; k++) {
        double d = fmax(fmax(b.core_min_enu_m[k] - eye[k], eye[k] - b.core_max_enu_m[k]), 0.0);
        d2 += d * d;
    }
    bool refine = v.child_count > 0 && (v.tile == TREE_NONE || d2 == 0 ||
                                        v.geometric_error_m * focal_px / sqrt(d2) > 16 * error_px);
    if (!refine) {
        out[n] = v.tile;
        return n + 1;
    }
    for (uint32_t i = 0; i < v.child_count; i++)
        n = cut(t, tiles, t->children[v.child_first + i], eye, focal_px, error_px, out, n);
    return n;
}

/* The picture of these tiles, every row handed over. */
static void picture_of_all(struct store *s, const bool *used, const struct camera *cam, float *rgb)
{
    struct err e = {0};
    struct gauss all;
    struct render_model m;
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    kit_ok(gauss_alloc(&all, 0, 1, 0, &e), e);
    const struct store_shape first = store_shape(s, &t[0]);
    memcpy(all.origin_enu_m, first.center_enu_m, sizeof all.origin_enu_m);
    for (size_t i = 0; i < n; i++) {
        struct gauss g;
        if (!used[i])
            continue;
        kit_ok(store_read_gauss(s, t[i].key, &g, &e), e);
        kit_ok(sort_blocks(&g, &e), e); /* rows of one depth are drawn by number */
        kit_ok(gauss_append(&all, &g, NULL, g.n, &e), e);
        gauss_free(&g);
    }
    kit_ok(render_model_upload(render, &all, &m, &e), e);
    kit_ok(render_forward(render, &m, cam, &draw, rgb, NULL, &e), e);
    render_model_free(&m);
    gauss_free(&all);
}

/* High above, among the Gaussians, in a tile's middle; narrow, wide, and with the axis off the
 * middle. */
static struct camera random_camera(uint64_t seed, double eye[3])
{
    for (size_t k = 0; k < 2; k++)
        eye[k] = (seed % 3 == 2 ? 500 : 300) * (rng_unit(seed, 20, k) - 0.5);
    eye[2] = seed % 3 == 2 ? 100 + 700 * rng_unit(seed, 20, 2) : 30 * (rng_unit(seed, 20, 2) - 0.5);
    double pitch =
        seed % 3 == 2 ? -90 + 80 * rng_unit(seed, 20, 4) : 178 * (rng_unit(seed, 20, 4) - 0.5);
    double fov = seed % 2 ? 0.15 + rng_unit(seed, 20, 5) : 1.2 + 1.5 * rng_unit(seed, 20, 5);
    struct camera c = camera_heading(eye, 360 * rng_unit(seed, 20, 3), pitch, fov, W, H);
    if (seed % 5 == 0)
        c.cx_px += 25 * rng_normal(seed, 20, 6);
    if (seed % 5 == 1)
        c.fx_px *= 0.5 + rng_unit(seed, 20, 7);
    return c;
}

static void check_pictures(struct fixture *f)
{
    struct err e = {0};
    struct view *v;
    static float full[W * H * 3], got[W * H * 3];
    size_t n, n_left_out = 0, n_cut = 0;
    uint64_t whole = 0, blocks = 0, visible = 0;
    kit_ok(view_open(f->path[0], render, 100000, &v, &e), e); /* tiles come and go */
    struct store *s;
    kit_ok(store_open(f->path[0], &s, &e), e);
    const struct store_tile *tiles = store_tiles(s, &n);
    const struct tree *tree = store_tree(s);
    assert_in_range(n, 10, TILES_MAX);
    for (uint64_t seed = 0; seed < VIEWS; seed++) {
        uint32_t want[TILES_MAX], picked[TILES_MAX];
        bool used[TILES_MAX] = {false};
        double eye[3];
        size_t n_picked;
        struct view_stats st;
        struct camera cam = random_camera(seed, eye);
        struct pick_options o = {.error_px = 0.05 * pow(40, rng_unit(seed, 21, 0))};
        size_t n_want =
            cut(tree, tiles, tree->root, eye, fmax(cam.fx_px, cam.fy_px), o.error_px, want, 0);
        for (size_t i = 0; i < n_want; i++)
            used[want[i]] = true;
        kit_ok(pick_tiles(s, &cam, &o, picked, &n_picked, &e), e);
        for (size_t i = 0; i < n_picked; i++)
            assert_true(used[picked[i]]);
        n_cut += n_want;
        n_left_out += n_want - n_picked;
        picture_of_all(s, used, &cam, full);
        kit_ok(view_render(v, &cam, &draw, &o, got, &st, &e), e);
        if (memcmp(full, got, sizeof full))
            fail_msg("view %llu: leaving out changes the picture", (unsigned long long)seed);
        blocks += st.n_gaussians;
        visible += st.n_visible;
        assert_true(st.n_visible <= st.n_gaussians);
        uint64_t seen = st.n_visible;
        o.whole_tiles = true;
        kit_ok(view_render(v, &cam, &draw, &o, got, &st, &e), e);
        assert_memory_equal(full, got, sizeof full);
        assert_true(st.n_visible == seen);
        whole += st.n_gaussians;
    }
    /* Or the test would say nothing. */
    assert_in_range(n_left_out, n_cut / 5, n_cut);
    assert_true(visible > 0 && blocks < whole);
    print_message("of %zu tiles %zu left out; %.2f of the rest handed over, %.2f in the pictures\n",
                  n_cut, n_left_out, (double)blocks / (double)whole,
                  (double)visible / (double)whole);
    store_close(&s);
    view_close(&v);
}

static void what_is_left_out_changes_no_bit(void **state)
{
    check_pictures(*state);
}

/* The kernels of GPUs, and no mapping of buffers. */
static void nor_as_on_a_gpu(void **state)
{
    const struct dev own = dev;
    struct render *of_own = render;
    struct err e = {0};
    dev.vector_width = 1;
    dev.is_cpu = false;
    kit_ok(render_open(&dev, &render, &e), e);
    check_pictures(*state);
    render_close(&render);
    render = of_own;
    dev = own;
}

/* Among the Gaussians of many sizes the reach of the longest one counts, wherever it is. */
static void frustums_by_brute_force(void **state)
{
    for (uint64_t seed = 0; seed < 2000; seed++) {
        double eye[3], lo[3], hi[3], x[3];
        struct frustum f;
        struct camera cam = random_camera(seed, eye);
        frustum_make(&cam, &f);
        /* A point before the camera and in the picture, and any box with it inside. */
        double z = 0.01 + 300 * rng_unit(seed, 30, 0), u = W * rng_unit(seed, 30, 1),
               w = H * rng_unit(seed, 30, 2);
        const double at[3] = {(u - cam.cx_px) / cam.fx_px * z, (w - cam.cy_px) / cam.fy_px * z, z};
        for (size_t k = 0; k < 3; k++) {
            x[k] = 0;
            for (size_t r = 0; r < 3; r++)
                x[k] += cam.rot[3 * r + k] * (at[r] - cam.trans[r]);
            lo[k] = x[k] - 100 * pow(rng_unit(seed, 31, k), 4);
            hi[k] = x[k] + 100 * pow(rng_unit(seed, 32, k), 4);
        }
        assert_true(frustum_sees(&f, lo, hi, 0));
        /* Behind the camera nothing is. */
        for (size_t k = 0; k < 3; k++) {
            double back = eye[k] - (1 + z) * cam.rot[6 + k];
            lo[k] = back - 0.5;
            hi[k] = back + 0.5;
        }
        assert_false(frustum_sees(&f, lo, hi, 0));
    }
}

int main(void)
{
    progress_quiet(true);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_splat_lies_in_its_boxes),
        cmocka_unit_test(frustums_by_brute_force),
        cmocka_unit_test(what_is_left_out_changes_no_bit),
        cmocka_unit_test(nor_as_on_a_gpu),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
