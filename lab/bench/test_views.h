/* Test photographs of a scene at one size. Pictures of Gaussians are compared with them, and with
 * pictures of other Gaussians from the same places. The studies of tiles use these scores.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_TEST_VIEWS_H
#define LAB_TEST_VIEWS_H

#include "lab/bench/bench.h"
#include "render/render.h"

struct photo_loader;
struct scene;

struct test_views { /* {0} is empty */
    struct render *render;
    struct photo_loader *feed;
    size_t n;      /* number of photographs */
    float **truth; /* [n] pictures to compare with; NULL until they are kept */
    uint32_t edge_px;
};
struct test_views_score { /* means over the photographs */
    double psnr_db, ssim; /* against the photographs, with the exposure of each */
    double self_db;       /* PSNR against `truth` without exposure; 120 if this is the truth */
};
/* Loads the n photographs `images` of the scene, with edges of at most max_edge_px (0: no limit),
 * `downsample` times smaller. If the scene has exposures, drawings count as drawn at the mean
 * exposure. All arguments are borrowed until test_views_close. ERR_MEM, and the errors of
 * photographs. */
enum err_code test_views_open(struct render *r, const struct scene *scene, const uint32_t *images,
                              size_t n, uint32_t max_edge_px, double downsample,
                              struct test_views *out, struct err *e) ERR_USE;
void test_views_close(struct test_views *s);
/* Draws g (ENU) from the place of every photograph and scores the pictures. keep: they become
 * `truth`. The errors of render_forward, ERR_MEM. */
enum err_code test_views_score(struct test_views *s, const struct gauss *g,
                               const struct render_options *ro, bool keep,
                               struct test_views_score *out, struct err *e) ERR_USE;

#endif
