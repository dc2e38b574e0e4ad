/* Exposure of photographs: the curve and its inverse, fits against drawings, and what ingest
 * measures from points that several photographs see, some of them wrongly.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "core/splat/exposure.h"
#include "lab/eval/exposure_fit.h"
#include "scene/ingest/ingest_internal.h"
#include "tests/kit.h"

enum { W = 96, H = 64, PHOTOS = 10, POINTS = 60, PATCH = 2 };

static void bytes_come_back_from_the_mean_exposure(void **state)
{
    static const float evs[][3] = {{0, 0, 0}, {0.5f, 0.25f, -0.25f}, {-1, -1.2f, -0.8f}};
    for (size_t c = 0; c < sizeof evs / sizeof *evs; c++) {
        uint8_t table[3][256];
        exposure_table(evs[c], table);
        for (int i = 16; i <= EXPOSURE_BYTE_MAX; i++) {
            float rgb[3];
            for (size_t k = 0; k < 3; k++)
                rgb[k] = (float)table[k][i] / 255.0f;
            exposure_expose(evs[c], rgb, 1);
            for (size_t k = 0; k < 3; k++) /* one step of the darker byte, or it was cut at white */
                if (table[k][i] < 255)
                    assert_true(fabsf(255.0f * rgb[k] - (float)i) < 1.5f);
        }
        assert_int_equal(exposure_is_mean(evs[c]), c == 0);
    }
    const uint8_t white[3] = {255, 255, 255}, grey[3] = {128, 128, 128};
    assert_false(exposure_clipped(evs[0], white));
    assert_true(exposure_clipped(evs[1], white));
    assert_false(exposure_clipped(evs[1], grey));
    assert_false(exposure_clipped(evs[2], white)); /* a dark photograph's white is white */
}

static void a_drawing_tells_the_exposure_of_its_photograph(void **state)
{
    const float ev[3] = {0.7f, 0.4f, -0.3f};
    float drawn[W * H * 3], taken[W * H * 3], got[3];
    uint8_t px[W * H * 3], mask[W * H];
    for (size_t i = 0; i < W * H * 3; i++)
        taken[i] = drawn[i] = (float)(0.15 + 0.4 * rng_unit(1, 1, i));
    exposure_expose(ev, taken, W * H);
    for (size_t i = 0; i < W * H; i++) {
        bool wrong = i % W < W / 2 && rng_unit(1, 2, i) < 0.3; /* cars, left of the middle */
        mask[i] = i / W < H / 2 ? 255 : 0;
        for (size_t k = 0; k < 3; k++)
            px[3 * i + k] = wrong || !mask[i] ? 200 : (uint8_t)(255.0f * taken[3 * i + k] + 0.5f);
    }
    assert_true(exposure_fit(drawn, px, mask, W, H, 0, W / 2, got));
    for (size_t k = 0; k < 3; k++)
        assert_true(fabsf(got[k] - ev[k]) < 0.25f); /* a third is wrong */
    assert_true(exposure_fit(drawn, px, mask, W, H, W / 2, W / 2, got));
    for (size_t k = 0; k < 3; k++)
        assert_true(fabsf(got[k] - ev[k]) < 0.02f);
    memset(mask, 0, sizeof mask);
    assert_false(exposure_fit(drawn, px, mask, W, H, 0, W, got));
    assert_true(exposure_is_mean(got));
}

/* ---- ingest ---- */

static void patch(struct image *img, float x, float y, const float rgb[3])
{
    for (int dy = -PATCH; dy <= PATCH; dy++)
        for (int dx = -PATCH; dx <= PATCH; dx++) {
            size_t at = (size_t)((int)y + dy) * W + (size_t)((int)x + dx);
            for (size_t k = 0; k < 3; k++)
                img->px[3 * at + k] = (uint8_t)(255.0f * fminf(rgb[k], 1.0f) + 0.5f);
        }
}

/* Photographs of POINTS patches in a grid, each photograph with its own exposure; a seventh of the
 * patches show something else. The last photograph sees too few of them. */
static void write_photos(struct ingest *g, float want[PHOTOS][3])
{
    struct scene *s = &g->scene;
    struct err e = {0};
    char path[FILE_PATH_MAX + 64];
    for (size_t i = 0; i < PHOTOS; i++) {
        struct image img = {0};
        kit_ok(image_alloc(W, H, 3, &img, &e), e);
        for (uint32_t j = 0; j < (i == PHOTOS - 1 ? 10 : POINTS); j++) {
            float rgb[3], x = 4.5f + 9.0f * (float)(j % 10), y = 4.5f + 9.0f * (float)(j / 10);
            bool wrong = rng_unit(2, i, j) < 1.0 / 7.0;
            for (size_t k = 0; k < 3; k++)
                rgb[k] = (float)(wrong ? 0.1 + 0.8 * rng_unit(3, i, 3 * j + k)
                                       : 0.2 + 0.3 * rng_unit(4, 0, 3 * j + k));
            if (!wrong)
                exposure_expose(want[i], rgb, 1);
            patch(&img, x, y, rgb);
            s->tracks[s->n_tracks++] = (struct scene_track){j, (uint32_t)i, x, y};
        }
        s->images[i].name = arena_printf(&s->arena, "p%zu.png", i);
        snprintf(path, sizeof path, "%s/images/%s", g->dir.part, s->images[i].name);
        kit_ok(image_write(path, &img, 0, NULL, &e), e);
        image_free(&img);
    }
}

static void ingest_finds_what_each_photograph_was_exposed_with(void **state)
{
    struct err e = {0};
    struct ingest g = {0};
    char path[FILE_PATH_MAX + 64];
    float want[PHOTOS][3];
    double mean[3] = {0.0}, worst = 0.0;
    struct scene *s = &g.scene;
    kit_tmpdir(g.dir.part);
    snprintf(path, sizeof path, "%s/images", g.dir.part);
    kit_ok(file_mkdir(path, &e), e);
    s->n_images = PHOTOS;
    s->n_points = POINTS;
    s->images = arena_get(&s->arena, PHOTOS, sizeof *s->images);
    s->points = arena_get(&s->arena, POINTS, sizeof *s->points);
    s->tracks = arena_get(&s->arena, (size_t)PHOTOS * POINTS, sizeof *s->tracks);
    assert_true(s->images && s->points && s->tracks);
    for (size_t i = 0; i < PHOTOS; i++)
        for (size_t k = 0; k < 3; k++)
            want[i][k] = (float)(1.6 * rng_unit(5, i, 0) - 1.0 + 0.3 * rng_unit(5, i, 1 + k));
    write_photos(&g, want);
    for (size_t i = 0; i + 1 < PHOTOS; i++) /* of those that can be known */
        for (size_t k = 0; k < 3; k++)
            mean[k] += (double)want[i][k] / (PHOTOS - 1);
    kit_ok(ingest_exposure_find(&g, &e), e);
    for (size_t k = 0; k < 3; k++) {
        double sum = 0.0;
        for (size_t i = 0; i + 1 < PHOTOS; i++) {
            double ev = (double)s->images[i].exposure_ev[k];
            sum += ev;
            worst = fmax(worst, fabs(ev - ((double)want[i][k] - mean[k])));
        }
        assert_true(fabs(sum) < 1e-5); /* no constant is left over */
    }
    kit_figure("exposure", "worst_ev=%.4f limit=0.15", worst);
    assert_true(worst < 0.15);
    assert_true(exposure_is_mean(s->images[PHOTOS - 1].exposure_ev));
    kit_rmdir(g.dir.part);
    scene_free(s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bytes_come_back_from_the_mean_exposure),
        cmocka_unit_test(a_drawing_tells_the_exposure_of_its_photograph),
        cmocka_unit_test(ingest_finds_what_each_photograph_was_exposed_with),
    };
    return cmocka_run_group_tests_name("exposure", tests, NULL, NULL);
}
