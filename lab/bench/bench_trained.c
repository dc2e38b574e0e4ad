/* Drawing trained Gaussians: those of a checkpoint (--trained) or of the finest tiles of a store
 * (--tiles), from near, from an orbit and from afar. Where the time of a frame goes, stage by
 * stage, and how long its lists are. The procedural city of bench_frame has few small splats and
 * solid surfaces; trained scenes have neither.
 *
 * Those of a store are drawn twice: as training draws them, and as a view of the store does, from
 * pages with harmonics of 16 bits.
 *
 * Places are found from the middle nine tenths of the Gaussians, so one file always gives the same
 * views. From afar, frames are also drawn as a view of a store draws them: with twice the pixels.
 *
 * Checked before timing: a frame drawn twice has the same bits, and so has one with the lists that
 * a training step needs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/ckpt.h"
#include "core/math/sort.h"
#include "core/splat/camera.h"
#include "lab/bench/roofline_count.h"
#include "lod/choose/resident.h"
#include "lod/store/store.h"
#include "render/frame.h" /* the lists of a frame */

enum { TRAINED_W = 1280, TRAINED_H = 720, TRAINED_RUNS_MAX = 1000, TRAINED_STAGES = 5 };

struct trained {
    struct bench *b;
    struct render *render;
    struct render_model model; /* of all Gaussians */
    struct store *store;       /* NULL: of a checkpoint */
    struct resident resident;
    const struct render_model *drawn;
    struct render_options options;
    struct camera cam;
    double center_m[3], radius_m, top_m;
    float *rgb, *again;
    double ms[TRAINED_STAGES][TRAINED_RUNS_MAX];
};

/* ---- Gaussians ---- */

/* All that no finer tile covers: the finest zoom. */
static enum err_code trained_read_store(const char *path, struct gauss *out, struct err *e)
{
    struct store *s = NULL;
    struct gauss g = {0};
    size_t n_tiles = 0;
    enum err_code rc = store_open(path, &s, e);
    const struct store_tile *tiles = !rc ? store_tiles(s, &n_tiles) : NULL;
    uint32_t finest = 0, total = 0;
    for (size_t i = 0; i < n_tiles; i++)
        finest = tiles[i].key.z > finest ? tiles[i].key.z : finest;
    for (size_t i = 0; i < n_tiles; i++)
        total += tiles[i].key.z == finest ? tiles[i].count : 0;
    if (!rc)
        rc = gauss_alloc(out, total, store_info(s)->sh_degree, 0, e);
    for (size_t i = 0; !rc && i < n_tiles; i++) {
        if (tiles[i].key.z != finest)
            continue;
        rc = store_read_gauss(s, tiles[i].key, &g, e);
        if (!rc && out->n == 0)
            memcpy(out->origin_enu_m, g.origin_enu_m, sizeof out->origin_enu_m);
        for (size_t k = 0; !rc && k < 3 * g.n; k++)
            g.mean_m[k] += (float)(g.origin_enu_m[k % 3] - out->origin_enu_m[k % 3]);
        g.embed_len = 0; /* colours as trained */
        for (size_t k = 0; !rc && k < g.n; k++)
            gauss_copy_row(out, out->n++, &g, k);
        out->antialiased = g.antialiased;
        gauss_free(&g);
    }
    store_close(&s);
    return rc;
}

static enum err_code trained_read(const struct bench *b, struct gauss *out, struct err *e)
{
    struct ckpt c = {0};
    if (!b->tiles && !b->trained)
        return err_set(e, ERR_ARG, "give --trained FILE, a checkpoint, or --tiles FILE, a store");
    if (b->tiles)
        return trained_read_store(b->tiles, out, e);
    enum err_code rc = ckpt_read(b->trained, &c, e);
    if (!rc) {
        *out = c.g;
        c.g = (struct gauss){0};
        out->embed_len = 0;
    }
    ckpt_free(&c);
    return rc;
}

/* The same tiles as a view of the store has them. */
static enum err_code trained_open_store(struct trained *t, const char *path, struct err *e)
{
    size_t n_tiles = 0, n = 0;
    uint64_t shown;
    enum err_code rc = store_open(path, &t->store, e);
    const struct store_tile *tiles = !rc ? store_tiles(t->store, &n_tiles) : NULL;
    uint32_t *tile = mem_array(n_tiles + 1, sizeof *tile);
    if (!rc && !tile)
        rc = err_set(e, ERR_MEM, "out of memory for %zu tiles", n_tiles);
    for (size_t i = 0; !rc && i < n_tiles; i++)
        if (tiles[i].key.z == store_info(t->store)->zoom_max)
            tile[n++] = (uint32_t)i;
    if (!rc)
        rc = resident_open(t->store, t->render, 0, 0, &t->resident, e);
    if (!rc)
        rc = resident_show(&t->resident, tile, n, NULL, &shown, e);
    mem_free(tile);
    return rc;
}

/* ---- views ---- */

static enum err_code trained_measure(const struct gauss *g, struct trained *t, struct err *e)
{
    double lo[3], hi[3], *v = mem_array(g->n + 1, sizeof *v);
    if (!v || g->n == 0) {
        mem_free(v);
        return v ? err_set(e, ERR_DATA, "there are no Gaussians")
                 : err_set(e, ERR_MEM, "out of memory");
    }
    for (size_t c = 0; c < 3; c++) {
        for (size_t i = 0; i < g->n; i++)
            v[i] = (double)g->mean_m[3 * i + c] + g->origin_enu_m[c];
        sort_doubles(v, g->n);
        lo[c] = v[g->n / 20];
        hi[c] = v[g->n - 1 - g->n / 20];
        t->center_m[c] = 0.5 * (lo[c] + hi[c]);
    }
    t->radius_m = fmax(0.5 * hypot(hi[0] - lo[0], hi[1] - lo[1]), 1.0);
    t->top_m = hi[2];
    mem_free(v);
    return ERR_OK;
}

/* Looks at the middle from so many radii away, that much above the horizon. */
static struct camera trained_camera(const struct trained *t, double radii, double up_deg)
{
    const double up = up_deg * 3.14159265358979323846 / 180.0, away = radii * t->radius_m;
    const double eye[3] = {t->center_m[0] - 0.6 * away * cos(up),
                           t->center_m[1] - 0.8 * away * cos(up),
                           fmax(t->center_m[2] + away * sin(up), t->top_m)};
    return camera_look_at(eye, t->center_m, 0.9, TRAINED_W, TRAINED_H);
}

/* ---- frames ---- */

static enum err_code trained_draw(struct trained *t, struct err *e)
{
    return render_forward(t->render, t->drawn, &t->cam, &t->options, t->rgb, NULL, e);
}

static enum err_code trained_check(struct trained *t, struct err *e)
{
    const size_t bytes = 3 * sizeof *t->rgb * TRAINED_W * TRAINED_H;
    static const char *const what[] = {"drawing again", "drawing with a step's lists"};
    enum err_code rc = trained_draw(t, e);
    for (int i = 0; !rc && i < 2; i++) {
        memcpy(t->again, t->rgb, bytes);
        t->options.picture = i == 0;
        rc = trained_draw(t, e);
        t->options.picture = true;
        if (!rc && memcmp(t->rgb, t->again, bytes) != 0)
            rc = err_set(e, ERR_INTERNAL, "check: %s gives another picture", what[i]);
    }
    if (!rc && render_last_stats(t->render)->visible == 0)
        rc = err_set(e, ERR_INTERNAL, "check: nothing is visible");
    return rc;
}

/* How much work the lists were: their entries that blending came to before its tiles were opaque,
 * and the blocks of 4 x 4 pixels that these drew into. Of the last frame, which has hits. */
static enum err_code trained_lists(struct trained *t, const char *name, struct err *e)
{
    struct roofline_work w = {0};
    char text[160];
    t->options.picture = false;
    enum err_code rc = trained_draw(t, e);
    t->options.picture = true;
    if (!rc)
        rc = roofline_count_lists(t->b->dev, t->render, &w, e);
    const struct render_stats *s = render_last_stats(t->render);
    const struct {
        const char *name;
        double value;
    } rows[] = {{"visible", s->visible},
                {"list entries", (double)s->intersections},
                {"list entries visited", w.entries},
                {"blocks drawn into", w.blocks}};
    for (size_t i = 0; !rc && i < sizeof rows / sizeof *rows; i++) {
        snprintf(text, sizeof text, "%s: %s", name, rows[i].name);
        bench_report(t->b, text, rows[i].value, "", 0, NULL);
    }
    return rc;
}

/* Medians of the stages, by the clock or in processor time. */
static enum err_code trained_stages(struct trained *t, const char *name, bool cpu, struct err *e)
{
    static const char *const stage[TRAINED_STAGES] = {"project", "sort", "bin", "blend", "all"};
    const int runs = t->b->runs < TRAINED_RUNS_MAX ? t->b->runs : TRAINED_RUNS_MAX;
    const struct render_stats *s = render_last_stats(t->render);
    char text[160];
    enum err_code rc = ERR_OK;
    render_set_timing(t->render, true);
    t->render->timing_cpu = cpu;
    for (int i = 0; !rc && i < runs; i++) {
        rc = trained_draw(t, e);
        const double ms[TRAINED_STAGES] = {s->ms_project, s->ms_sort, s->ms_bin, s->ms_blend,
                                           s->ms_total};
        for (int k = 0; k < TRAINED_STAGES; k++)
            t->ms[k][i] = ms[k];
    }
    t->render->timing_cpu = false;
    render_set_timing(t->render, false);
    for (int k = TRAINED_STAGES; !rc && k-- > 0;) {
        sort_doubles(t->ms[k], (size_t)runs);
        snprintf(text, sizeof text, "%s: %s", name, stage[k]);
        bench_report(t->b, text, t->ms[k][runs / 2], cpu ? "core ms" : "ms", 0, NULL);
    }
    return rc;
}

/* Its checks, times and lists. */
static enum err_code trained_view(struct trained *t, const char *name, struct err *e)
{
    enum err_code rc = trained_check(t, e);
    for (int cpu = 0; !rc && cpu < 2; cpu++)
        rc = trained_stages(t, name, cpu, e);
    return !rc ? trained_lists(t, name, e) : rc;
}

enum err_code bench_trained(struct bench *b, struct err *e)
{
    static const struct {
        const char *name;
        double radii, up_deg;
        uint32_t supersample;
    } views[] = {{"near", 0.3, 25.0, 1},
                 {"orbit", 1.5, 35.0, 1},
                 {"afar", 5.0, 45.0, 1},
                 {"afar, twice the pixels", 5.0, 45.0, 2}};
    struct trained *t = mem_array(1, sizeof *t);
    struct gauss g = {0};
    char text[96];
    enum err_code rc = t ? trained_read(b, &g, e) : err_set(e, ERR_MEM, "out of memory");
    if (!rc) {
        t->b = b;
        t->options = (struct render_options){
            .aa = g.antialiased ? RENDER_AA_2D : RENDER_AA_NONE, .sh_degree = -1, .picture = true};
        t->rgb = mem_array((size_t)3 * TRAINED_W * TRAINED_H, sizeof *t->rgb);
        t->again = mem_array((size_t)3 * TRAINED_W * TRAINED_H, sizeof *t->again);
        rc = t->rgb && t->again ? trained_measure(&g, t, e) : err_set(e, ERR_MEM, "out of memory");
    }
    if (!rc)
        rc = render_open(b->dev, &t->render, e);
    if (!rc)
        rc = render_model_upload(t->render, &g, &t->model, e);
    if (!rc && b->tiles)
        rc = trained_open_store(t, b->tiles, e);
    for (size_t i = 0; !rc && i < sizeof views / sizeof *views; i++) {
        if (views[i].supersample > 1 && t->options.aa == RENDER_AA_NONE)
            continue;
        t->cam = trained_camera(t, views[i].radii, views[i].up_deg);
        t->options.supersample = views[i].supersample;
        snprintf(text, sizeof text, "%zu k, %s", g.n / 1000, views[i].name);
        t->drawn = &t->model;
        rc = trained_view(t, text, e);
        snprintf(text, sizeof text, "%zu k, from pages, %s", g.n / 1000, views[i].name);
        t->drawn = &t->resident.model;
        if (!rc && t->store)
            rc = trained_view(t, text, e);
    }
    if (t) {
        mem_free(t->rgb);
        mem_free(t->again);
        render_model_free(&t->model);
        resident_close(&t->resident);
        store_close(&t->store);
        render_close(&t->render);
        mem_free(t);
    }
    gauss_free(&g);
    return rc;
}
