/* Drawing: whole frames of the procedural city (city.h), the stages of a frame, and the gain of
 * Morton order and exact tile culling. Harmonics have degree 3 unless a case says otherwise.
 *
 * Checked before timing: a frame drawn twice has the same bits; exact culling and the lists that a
 * training step needs change none of them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <stdio.h>
#include <string.h>

#include "lab/bench/city.h"
#include "render/frame.h" /* box_tiles: culling off */

enum { FRAME_W_MAX = 1600, FRAME_H_MAX = 1200 };

struct frame_case {
    struct render *render;
    struct render_model model;
    struct camera cam;
    float *rgb, *again;
    const float *appearance_frame; /* constants of an appearance, or NULL; borrowed */
    bool lists;                    /* as a step needs them, not for the picture alone */
};

static enum err_code frame_once(void *user, struct err *e)
{
    struct frame_case *c = user;
    const struct render_options o = {.aa = RENDER_AA_2D,
                                     .sh_degree = -1,
                                     .picture = !c->lists,
                                     .appearance_frame = c->appearance_frame,
                                     .appearance_hidden = APPEARANCE_HIDDEN};
    return render_forward(c->render, &c->model, &c->cam, &o, c->rgb, NULL, e);
}

static enum err_code frame_check(struct frame_case *c, struct err *e)
{
    size_t bytes = 3 * (size_t)c->cam.width_px * c->cam.height_px * sizeof *c->rgb;
    static const char *const what[] = {"drawing again", "drawing without tile culling",
                                       "drawing with a step's lists"};
    enum err_code rc = frame_once(c, e);
    for (int i = 0; !rc && i < 3; i++) {
        memcpy(c->again, c->rgb, bytes);
        c->render->box_tiles = i == 1;
        c->lists = i == 2;
        rc = frame_once(c, e);
        c->render->box_tiles = c->lists = false;
        if (!rc && memcmp(c->rgb, c->again, bytes) != 0)
            rc = err_set(e, ERR_INTERNAL, "bench_frame: check: %s gives another picture", what[i]);
    }
    if (!rc && render_last_stats(c->render)->visible == 0)
        rc = err_set(e, ERR_INTERNAL, "bench_frame: check: nothing is visible");
    return rc;
}

static enum err_code frame_report(struct bench *b, struct frame_case *c, const char *name,
                                  double *ms, double ratio_to_ms, const char *against,
                                  struct err *e)
{
    char text[96];
    enum err_code rc = bench_time(b, frame_once, c, ms, NULL, e);
    if (rc)
        return rc;
    snprintf(text, sizeof text, "%s, %ux%u", name, c->cam.width_px, c->cam.height_px);
    bench_report(b, text, *ms, "ms", against ? *ms / ratio_to_ms : 0, against);
    return ERR_OK;
}

static enum err_code frame_stages(struct bench *b, struct frame_case *c, const char *name,
                                  struct err *e)
{
    char text[96];
    render_set_timing(c->render, true);
    enum err_code rc = frame_once(c, e);
    render_set_timing(c->render, false);
    const struct render_stats *s = render_last_stats(c->render);
    const struct {
        const char *name, *unit;
        double value;
    } rows[] = {{"visible", "splats", s->visible}, {"intersections", "", (double)s->intersections},
                {"project", "ms", s->ms_project},  {"sort", "ms", s->ms_sort},
                {"bin", "ms", s->ms_bin},          {"blend", "ms", s->ms_blend}};
    for (size_t i = 0; !rc && i < sizeof rows / sizeof *rows; i++) {
        snprintf(text, sizeof text, "%s, %ux%u: %s", name, c->cam.width_px, c->cam.height_px,
                 rows[i].name);
        bench_report(b, text, rows[i].value, rows[i].unit, 0, NULL);
    }
    return rc;
}

static enum err_code frame_open(struct bench *b, const struct gauss *g, struct frame_case *c,
                                struct err *e)
{
    enum err_code rc = render_open(b->dev, &c->render, e);
    if (!rc)
        rc = render_model_upload(c->render, g, &c->model, e);
    c->rgb = mem_array(3 * FRAME_W_MAX * FRAME_H_MAX, sizeof *c->rgb);
    c->again = mem_array(3 * FRAME_W_MAX * FRAME_H_MAX, sizeof *c->again);
    if (!rc && (!c->rgb || !c->again))
        rc = err_set(e, ERR_MEM, "bench_frame: pictures");
    return rc;
}

static void frame_close(struct frame_case *c)
{
    mem_free(c->rgb);
    mem_free(c->again);
    render_model_free(&c->model);
    render_close(&c->render);
}

/* The city under a photograph's light; against the same frame without. */
static enum err_code frame_appearance(struct bench *b, const struct gauss *plain, double plain_ms,
                                      struct err *e)
{
    struct gauss g = {0};
    struct appearance a = {0};
    struct frame_case c = {.cam = city_camera(1280, 720)};
    float *appearance_frame = NULL;
    double ms = 0;
    char name[64];
    enum err_code rc = city_appearance(plain, &g, &a, &appearance_frame, e);
    snprintf(name, sizeof name, "%zu k, appearance", plain->n / 1000);
    if (!rc)
        rc = frame_open(b, &g, &c, e);
    c.appearance_frame = appearance_frame;
    if (!rc)
        rc = frame_check(&c, e);
    if (!rc)
        rc = frame_report(b, &c, name, &ms, plain_ms, "without appearance", e);
    if (!rc)
        rc = frame_stages(b, &c, name, e);
    frame_close(&c);
    appearance_free(&a);
    gauss_free(&g);
    mem_free(appearance_frame);
    return rc;
}

/* Without harmonics, as overview levels and most splats of other programs are. */
static enum err_code frame_plain(struct bench *b, size_t n, struct err *e)
{
    static const uint32_t sizes[][2] = {{1280, 720}, {640, 480}};
    struct gauss g = {0};
    struct frame_case c = {0};
    double ms = 0;
    char name[48];
    enum err_code rc = city_sorted_degree(n, 0, &g, e);
    snprintf(name, sizeof name, "%zu k, SH 0", n / 1000);
    if (!rc)
        rc = frame_open(b, &g, &c, e);
    for (size_t i = 0; !rc && i < sizeof sizes / sizeof *sizes; i++) {
        c.cam = city_camera(sizes[i][0], sizes[i][1]);
        rc = frame_check(&c, e);
        if (!rc)
            rc = frame_report(b, &c, name, &ms, 0, NULL, e);
    }
    frame_close(&c);
    gauss_free(&g);
    return rc;
}

enum err_code bench_frame(struct bench *b, struct err *e)
{
    static const uint32_t sizes[][2] = {{1280, 720}, {1600, 1200}, {640, 480}, {400, 300}};
    size_t n = b->quick ? 20000 : 1000000;
    struct gauss sorted = {0}, random = {0};
    struct frame_case c = {0}, r = {0};
    double ms = 0, hd_ms = 0;
    char name[48];
    enum err_code rc = city_sorted(n, &sorted, e);
    snprintf(name, sizeof name, "%zu k", n / 1000);
    if (!rc)
        rc = frame_open(b, &sorted, &c, e);
    for (size_t i = 0; !rc && i < sizeof sizes / sizeof *sizes; i++) {
        c.cam = city_camera(sizes[i][0], sizes[i][1]);
        rc = frame_check(&c, e);
        if (!rc)
            rc = frame_report(b, &c, name, &ms, 0, NULL, e);
        if (!rc)
            rc = frame_stages(b, &c, name, e);
        hd_ms = i == 0 ? ms : hd_ms;
    }
    if (!rc) {
        c.cam = city_camera(sizes[0][0], sizes[0][1]);
        snprintf(name, sizeof name, "%zu k, boxes", n / 1000);
        c.render->box_tiles = true;
        rc = frame_report(b, &c, name, &ms, hd_ms, "exact tile culling", e);
        c.render->box_tiles = false;
    }
    if (!rc) {
        snprintf(name, sizeof name, "%zu k, a step's lists", n / 1000);
        c.lists = true;
        rc = frame_report(b, &c, name, &ms, hd_ms, "the picture alone", e);
        if (!rc)
            rc = frame_stages(b, &c, name, e);
        c.lists = false;
    }
    if (!rc)
        rc = frame_appearance(b, &sorted, hd_ms, e);
    if (!rc)
        rc = frame_plain(b, n, e);
    if (!rc)
        rc = city_make(n, &random, e);
    if (!rc)
        rc = frame_open(b, &random, &r, e);
    if (!rc) {
        r.cam = city_camera(sizes[0][0], sizes[0][1]);
        snprintf(name, sizeof name, "%zu k, random order", n / 1000);
        rc = frame_report(b, &r, name, &ms, hd_ms, "Morton order", e);
    }
    frame_close(&r);
    frame_close(&c);
    gauss_free(&random);
    gauss_free(&sorted);
    return rc;
}
