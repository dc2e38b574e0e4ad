/* How the time of a frame and of a training iteration grows with the number of Gaussians and
 * pixels, and the memory of a Gaussian while it is drawn.
 *
 * It uses the city (city.h) without harmonics. The extent stays the same, so more Gaussians are
 * smaller, as in trained levels. Memory is the growth of the process's resident set from a small
 * model to a large one, without pictures and kernels. This is valid for devices that share the
 * host's memory.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <stdio.h>
#include <unistd.h>

#include "lab/bench/city.h"
#include "render/render.h"

struct growth_case {
    struct render *render;
    struct render_model model;
    struct camera cam;
    float *rgb;
    const float *appearance_frame; /* constants of an appearance, or NULL; borrowed */
};

static const uint32_t growth_sizes[][2] = {{320, 180},   {640, 360},   {1280, 720},
                                           {1920, 1080}, {2560, 1440}, {3840, 2160}};
enum {
    GROWTH_SIZES = sizeof growth_sizes / sizeof *growth_sizes,
    GROWTH_HD = 2, /* of growth_sizes: the one against which Gaussians grow */
};
static const size_t growth_counts[] = {10000, 30000, 100000, 300000, 1000000, 3000000, 10000000};
enum {
    GROWTH_COUNTS = sizeof growth_counts / sizeof *growth_counts,
    GROWTH_QUICK = 2,  /* counts of --quick */
    GROWTH_PIXELS = 4, /* of growth_counts: the one against which pixels grow */
};

static enum err_code growth_draw(void *user, struct err *e)
{
    struct growth_case *c = user;
    const struct render_options o = {.aa = RENDER_AA_2D,
                                     .sh_degree = -1,
                                     .appearance_frame = c->appearance_frame,
                                     .appearance_hidden = APPEARANCE_HIDDEN};
    return render_forward(c->render, &c->model, &c->cam, &o, c->rgb, NULL, e);
}

/* Bytes of this process in memory now. */
static double growth_resident_bytes(void)
{
    double pages = 0.0;
    FILE *f = fopen("/proc/self/statm", "r");
    if (!f)
        return 0.0;
    if (fscanf(f, "%*s %lf", &pages) != 1)
        pages = 0.0;
    fclose(f);
    return pages * (double)sysconf(_SC_PAGESIZE);
}

static enum err_code growth_measure(struct bench *b, struct growth_case *c, const char *name,
                                    size_t n, size_t size, struct err *e)
{
    double ms = 0.0;
    c->cam = city_camera(growth_sizes[size][0], growth_sizes[size][1]);
    enum err_code rc = bench_time(b, growth_draw, c, &ms, NULL, e);
    if (!rc && render_last_stats(c->render)->visible == 0)
        rc = err_set(e, ERR_INTERNAL, "bench_growth: check: nothing is visible");
    if (!rc)
        bench_report_at(b, name, ms, "ms", (double)n, (double)c->cam.width_px * c->cam.height_px);
    return rc;
}

static enum err_code growth_open(struct bench *b, const struct gauss *g, struct growth_case *c,
                                 struct err *e)
{
    const uint32_t *largest = growth_sizes[GROWTH_SIZES - 1];
    c->rgb = mem_array(3 * (size_t)largest[0] * largest[1], sizeof *c->rgb);
    enum err_code rc = c->rgb ? ERR_OK : err_set(e, ERR_MEM, "bench_growth: pictures");
    if (!rc)
        rc = render_open(b->dev, &c->render, e);
    if (!rc)
        rc = render_model_upload(c->render, g, &c->model, e);
    return rc;
}

static void growth_close(struct growth_case *c)
{
    mem_free(c->rgb);
    render_model_free(&c->model);
    render_close(&c->render);
}

/* One number of Gaussians; *resident: what the process takes with this model drawn. */
static enum err_code growth_count(struct bench *b, size_t which, double *resident, struct err *e)
{
    size_t n = growth_counts[which];
    struct growth_case c = {0};
    struct gauss g = {0};
    enum err_code rc = city_sorted_degree(n, 0, &g, e);
    if (!rc)
        rc = growth_open(b, &g, &c, e);
    gauss_free(&g);
    if (!rc)
        rc = growth_measure(b, &c, "Gaussians", n, GROWTH_HD, e);
    *resident = growth_resident_bytes();
    for (size_t s = 0; !rc && which == GROWTH_PIXELS && s < GROWTH_SIZES; s++)
        rc = growth_measure(b, &c, "pixels", n, s, e);
    growth_close(&c);
    return rc;
}

/* Memory with all harmonics, and embeddings if wanted: what the process takes after a frame of `n`
 * Gaussians. */
static enum err_code growth_full(struct bench *b, size_t n, bool with_look, double *resident,
                                 struct err *e)
{
    struct growth_case c = {0};
    struct gauss plain = {0}, embedded = {0};
    struct appearance a = {0};
    float *appearance_frame = NULL;
    enum err_code rc = city_sorted_degree(n, 3, &plain, e);
    if (!rc && with_look)
        rc = city_appearance(&plain, &embedded, &a, &appearance_frame, e);
    if (!rc)
        rc = growth_open(b, with_look ? &embedded : &plain, &c, e);
    gauss_free(&plain);
    gauss_free(&embedded);
    c.appearance_frame = appearance_frame;
    c.cam = city_camera(growth_sizes[GROWTH_HD][0], growth_sizes[GROWTH_HD][1]);
    if (!rc)
        rc = growth_draw(&c, e);
    *resident = growth_resident_bytes();
    growth_close(&c);
    appearance_free(&a);
    mem_free(appearance_frame);
    return rc;
}

static enum err_code growth_memory(struct bench *b, bool with_look, struct err *e)
{
    double small = 0.0, large = 0.0;
    size_t n = b->quick ? 5000 : 500000;
    enum err_code rc = growth_full(b, n, with_look, &small, e);
    if (!rc)
        rc = growth_full(b, 4 * n, with_look, &large, e);
    if (!rc)
        bench_report(b,
                     with_look ? "memory a resident Gaussian, SH degree 3 and appearance"
                               : "memory a resident Gaussian, SH degree 3",
                     (large - small) / (3.0 * (double)n), "B", 0, NULL);
    return rc;
}

enum err_code bench_growth(struct bench *b, struct err *e)
{
    size_t counts = b->quick ? GROWTH_QUICK : GROWTH_COUNTS;
    double resident[GROWTH_COUNTS] = {0};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < counts; i++)
        rc = growth_count(b, i, &resident[i], e);
    if (!rc && counts == GROWTH_COUNTS)
        bench_report(b, "memory a resident Gaussian, SH degree 0",
                     (resident[counts - 1] - resident[GROWTH_PIXELS]) /
                         (double)(growth_counts[counts - 1] - growth_counts[GROWTH_PIXELS]),
                     "B", 0, NULL);
    if (!rc)
        rc = growth_memory(b, false, e);
    if (!rc)
        rc = growth_memory(b, true, e);
    return !rc ? bench_step_growth(b, e) : rc;
}
