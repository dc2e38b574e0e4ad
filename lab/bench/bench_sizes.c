/* A frame and a training iteration at the sizes that are published for this method: up to the 6.84
 * million Gaussians of a whole scene, at the two picture sizes of its tables, with harmonics of
 * degree 3. GPUs are measured by it (lab/gpu.sh).
 *
 * A size that does not fit into the device's memory is skipped with a message.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include "lab/bench/city.h"
#include "render/render.h"

struct sizes_case {
    struct render *render;
    struct render_model model;
    struct camera cam;
    float *rgb;
};

static const uint32_t sizes_px[][2] = {{1280, 720}, {1600, 1200}};
enum { SIZES_PX = sizeof sizes_px / sizeof *sizes_px, SIZES_LARGEST = SIZES_PX - 1 };
static const size_t sizes_counts[] = {100000, 1000000, 3600000, 6840000}, sizes_quick[] = {5000};

static enum err_code sizes_draw(void *user, struct err *e)
{
    struct sizes_case *c = user;
    const struct render_options o = {.aa = RENDER_AA_2D, .sh_degree = -1};
    return render_forward(c->render, &c->model, &c->cam, &o, c->rgb, NULL, e);
}

static enum err_code sizes_frames(struct bench *b, size_t n, struct err *e)
{
    const uint32_t *largest = sizes_px[SIZES_LARGEST];
    struct sizes_case c = {.rgb = mem_array(3 * (size_t)largest[0] * largest[1], sizeof *c.rgb)};
    struct gauss g = {0};
    enum err_code rc = c.rgb ? city_sorted(n, &g, e) : err_set(e, ERR_MEM, "bench_sizes: picture");
    if (!rc)
        rc = render_open(b->dev, &c.render, e);
    if (!rc)
        rc = render_model_upload(c.render, &g, &c.model, e);
    gauss_free(&g);
    for (size_t i = 0; !rc && i < SIZES_PX; i++) {
        double ms = 0;
        c.cam = city_camera(sizes_px[i][0], sizes_px[i][1]);
        rc = bench_time(b, sizes_draw, &c, &ms, NULL, e);
        if (!rc && render_last_stats(c.render)->visible == 0)
            rc = err_set(e, ERR_INTERNAL, "bench_sizes: check: nothing is visible");
        if (!rc)
            bench_report_at(b, "frame", ms, "ms", (double)n,
                            (double)sizes_px[i][0] * sizes_px[i][1]);
    }
    mem_free(c.rgb);
    render_model_free(&c.model);
    render_close(&c.render);
    return rc;
}

static enum err_code sizes_steps(struct bench *b, size_t n, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < SIZES_PX; i++)
        rc = bench_step_at(b, "training iteration", n, sizes_px[i][0], sizes_px[i][1], e);
    return rc;
}

enum err_code bench_sizes(struct bench *b, struct err *e)
{
    const size_t *counts = b->quick ? sizes_quick : sizes_counts;
    size_t n = b->quick ? sizeof sizes_quick / sizeof *sizes_quick
                        : sizeof sizes_counts / sizeof *sizes_counts;
    for (size_t i = 0; i < n && (b->most <= 0 || counts[i] <= (size_t)b->most); i++) {
        enum err_code rc = sizes_frames(b, counts[i], e);
        if (!rc)
            rc = sizes_steps(b, counts[i], e);
        if (rc == ERR_MEM || rc == ERR_LIMIT) {
            log_warn("bench", "sizes: left out from %zu Gaussians on: %s", counts[i], e->msg);
            break;
        }
        if (rc)
            return rc;
    }
    return ERR_OK;
}
