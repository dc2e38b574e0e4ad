/* Results of sort and bin, for drawing and for the backward pass: depth order and lists of tiles,
 * in both shapes of the kernels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <string.h>

#include "core/device/dev.h"
#include "core/splat/camera.h"
#include "render/frame.h"

static struct dev dev;
static struct render *render;
static const struct render_options PLAIN = {.aa = RENDER_AA_2D, .sh_degree = -1};

static struct camera view_from(double x, double y, double z, uint32_t width, uint32_t height)
{
    const double eye[3] = {x, y, z}, target[3] = {0.2, -0.1, 0.1};
    return camera_look_at(eye, target, 0.9, width, height);
}

/* Tile of each slot, from the records of the splats. */
static void slots_expand(const struct layout_splat *splats, const uint32_t *of,
                         const uint32_t *first, size_t n, uint32_t tiles_x, uint32_t *tile_of_slot)
{
    for (size_t i = 0; i < n; i++) {
        const struct layout_splat *s = &splats[i];
        uint32_t row0 = s->cover & 1023, col0 = s->cover >> 10 & 1023, shift = s->cover >> 30;
        uint32_t rows = (s->cover >> 20 & 1023) + 1, slot = first[i];
        uint32_t step = (rows + LAYOUT_BANDS - 1) / LAYOUT_BANDS;
        for (uint32_t row = 0; of[i] && row < rows; row++) {
            uint32_t pair = s->bands[row / step / 2] >> (row / step % 2 * 16) & 0xFFFF;
            for (uint32_t c = (pair & 255) << shift; c < ((pair >> 8) + 1) << shift; c++)
                if (col0 + c < tiles_x)
                    tile_of_slot[slot++] = (row0 + row) * tiles_x + col0 + c;
        }
        assert_int_equal(slot, first[i] + of[i]);
    }
}

/* What backward relies on: lists in depth order, ties by index, every slot of every visible
 * Gaussian used exactly once and in the list of its own tile. */
static void lists_hold(size_t n, uint32_t width, uint32_t height, size_t least)
{
    struct gauss g;
    struct err e = {0};
    struct render_model m;
    struct camera cam = view_from(3, -5, 4, width, height);
    kit_gauss(191, n, 4.0, 0, 0, &g);
    for (size_t i = 3; i < n; i += 5) /* equal depths, near each other and far apart */
        memcpy(g.mean_m + 3 * i, g.mean_m + 3 * (i / 10), 3 * sizeof *g.mean_m);
    kit_ok(render_model_upload(render, &g, &m, &e), e);
    kit_ok(render_forward(render, &m, &cam, &PLAIN, NULL, NULL, &e), e);
    size_t intersections = (size_t)render->intersections, tiles = render->tiles;
    uint32_t *start = mem_array(tiles + 1, 4), *splat = mem_array(intersections, 4),
             *slot = mem_array(intersections, 4);
    uint32_t *of = mem_array(n, 4), *first = mem_array(n, 4), *key = mem_array(n, 4);
    uint32_t *owner = mem_array(intersections, 4), *tile_of_slot = mem_array(intersections, 4);
    struct layout_splat *splats = mem_array(n, sizeof *splats);
    kit_ok(dev_read(&dev, render->splats.mem, 0, n * sizeof *splats, splats, &e), e);
    kit_ok(dev_read(&dev, render->tile_start.mem, 0, 4 * (tiles + 1), start, &e), e);
    kit_ok(dev_read(&dev, render->intersection_splat.mem, 0, 4 * intersections, splat, &e), e);
    kit_ok(dev_read(&dev, render->intersection_slot.mem, 0, 4 * intersections, slot, &e), e);
    kit_ok(dev_read(&dev, render->tiles_of.mem, 0, 4 * n, of, &e), e);
    kit_ok(dev_read(&dev, render->slot_first.mem, 0, 4 * n, first, &e), e);
    kit_ok(dev_read(&dev, render->depth_key.mem, 0, 4 * n, key, &e), e);
    assert_true(intersections >= least);
    assert_int_equal(start[0], 0);
    assert_int_equal(start[tiles], intersections);
    size_t sum = 0, ties = 0;
    for (size_t i = 0; i < n; i++) {
        assert_int_equal(first[i], sum);
        assert_int_equal(of[i] == 0, key[i] == 0xFFFFFFFFu);
        sum += of[i];
    }
    assert_int_equal(sum, intersections);
    slots_expand(splats, of, first, n, render->view.tiles_x, tile_of_slot);
    for (size_t t = 0; t < tiles; t++)
        for (size_t i = start[t]; i < start[t + 1]; i++) {
            assert_true(splat[i] < n);
            assert_true(slot[i] >= first[splat[i]] && slot[i] < first[splat[i]] + of[splat[i]]);
            assert_int_equal(tile_of_slot[slot[i]], t);
            assert_int_equal(owner[slot[i]], 0);
            owner[slot[i]] = 1;
            if (i > start[t]) {
                uint32_t a = splat[i - 1], b = splat[i];
                assert_true(key[a] < key[b] || (key[a] == key[b] && a < b));
                ties += key[a] == key[b];
            }
        }
    assert_true(ties > 0 || least == 0);
    void *all[] = {start, splat, slot, of, first, key, owner, tile_of_slot, splats};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        mem_free(all[i]);
    render_model_free(&m);
    gauss_free(&g);
}

/* One tile or thousands, none or many Gaussians: more than a block of the GPU shape takes, and
 * tiles whose numbers have one to three digits there. */
static void lists_hold_everywhere(void)
{
    lists_hold(0, 300, 200, 0);
    lists_hold(40, 16, 16, 10);
    lists_hold(777, 300, 200, 500);
    lists_hold(9000, 1000, 700, 20000);
    lists_hold(300, 100, 90, 200); /* buffers are larger than the frame now */
}

static void lists_hold_in_shape(uint32_t vector_width, void (*hold)(void))
{
    struct err e = {0};
    kit_ok(dev_open(NULL, &dev, &e), e);
    dev.vector_width = vector_width;
    kit_ok(render_open(&dev, &render, &e), e);
    hold();
    render_close(&render);
    dev_close(&dev);
}

static void test_lists_of_cpus(void **state)
{
    lists_hold_in_shape(LAYOUT_LANES, lists_hold_everywhere);
}

static void test_lists_of_gpus(void **state)
{
    lists_hold_in_shape(1, lists_hold_everywhere);
}

/* For the simulator that looks for races and reads beyond buffers, which takes its time. */
static void lists_hold_small(void)
{
    lists_hold(300, 100, 90, 200);
}

static void test_small_lists_of_both(void **state)
{
    lists_hold_in_shape(LAYOUT_LANES, lists_hold_small);
    lists_hold_in_shape(1, lists_hold_small);
}

int main(int argc, char **argv)
{
    cmocka_set_test_filter(argc > 1 ? argv[1] : NULL);
    const struct CMUnitTest tests[] = {cmocka_unit_test(test_lists_of_cpus),
                                       cmocka_unit_test(test_lists_of_gpus),
                                       cmocka_unit_test(test_small_lists_of_both)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
