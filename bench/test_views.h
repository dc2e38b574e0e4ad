/* Test photographs of a scene at one size, and how close pictures of Gaussians come to them and to
 * pictures of other Gaussians from the same places: what the studies of tiles score by.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_TEST_VIEWS_H
#define BENCH_TEST_VIEWS_H

#include "bench/bench.h"
#include "render/render.h"

struct photo_loader;
struct scene;

struct test_views { /* {0} is empty */
    struct render *render;
    struct photo_loader *feed;
    size_t n;      /* photographs */
    float **truth; /* [n] pictures that others are held against; NULL entries until they are kept */
    uint32_t edge_px;
};
struct test_views_score { /* means over the photographs */
    double psnr_db, ssim; /* against the photographs, exposed as each of them was */
    double self_db; /* PSNR against the truth, 120 when this is it: pictures as they are seen */
};
/* The n photographs `images` of the scene, no longer than max_edge_px (0: as they are) and
 * `downsample` times smaller. Where the scene tells exposures, what is drawn is taken to be trained
 * at the mean one. All are borrowed until test_views_close. ERR_MEM, and those of photographs. */
enum err_code test_views_open(struct render *r, const struct scene *scene, const uint32_t *images,
                              size_t n, uint32_t max_edge_px, double downsample,
                              struct test_views *out, struct err *e) ERR_USE;
void test_views_close(struct test_views *s);
/* Draw g (ENU) from every photograph's place. keep: its pictures are the truth from now on. */
enum err_code test_views_score(struct test_views *s, const struct gauss *g,
                               const struct render_options *ro, bool keep,
                               struct test_views_score *out, struct err *e) ERR_USE;

#endif
