/* citysplat-lab eval-flight: visible jumps while a camera flies into a city. It flies twice, with
 * levels of detail and with the finest level alone.
 *
 * A picture changes between frames for two reasons: the camera moves, and other tiles are drawn. To
 * measure the second alone, each frame is drawn twice with the same camera: with its own tiles, and
 * with the tiles of the frame before. The difference is the jump. Tiles are selected for a slightly
 * larger picture, so that none is missing at its edge. With a fade (lab/eval/fade.h) tiles are
 * drawn in part, and the jump is the change of one step of the fade.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>

#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "lab/eval/eval_lab.h"
#include "lab/eval/fade.h"
#include "lab/lab.h"
#include "lod/choose/view.h"
#include "lod/store/tree.h"

struct eval_flight_options {
#define OPT OPTIONS_MEMBER
#include "lab/eval/eval_flight.def"
};

static const struct options_def eval_flight_defs[] = {
#define OPT(...) OPTIONS_ROW(struct eval_flight_options, __VA_ARGS__)
#include "lab/eval/eval_flight.def"
};

enum { EVAL_FLIGHT_WIDTH = 640, EVAL_FLIGHT_LEVELS = 256, EVAL_FLIGHT_MARGIN = 4 };
/* From four flight heights down to 0.4 over half a turn, 45 degrees down at the middle. */
static const double eval_flight_high = 4.0, eval_flight_low = 0.4, eval_flight_pitch_deg = -45.0;

struct eval_flight_request {
    const struct scene *scene; /* gives the path of the flight and its height */
    size_t frames, fade;
    uint32_t max_edge_px; /* width of the pictures; 0: EVAL_FLIGHT_WIDTH */
    json_t *rows;         /* a JSON array */
};
struct eval_flight_path {
    double middle_m[3], height_m; /* on the ground; of the photographs above it */
    uint32_t width_px, height_px;
};
struct eval_flight_figures {
    uint64_t changes[EVAL_FLIGHT_LEVELS]; /* pixels of all frames by change from the one before */
    /* Of the pops of a frame, in 1/255: the largest 99 % quantile, pixel and mean of all frames. */
    size_t pop_99, pop_max, worst_frame; /* worst_frame: where the mean is largest */
    double worst_mean, gaussians;        /* gaussians: mean a frame */
    size_t stray_99;                     /* likewise, see eval_flight_stray */
};

static double eval_flight_median(double *v, float *scratch, size_t n)
{
    for (size_t i = 0; i < n; i++)
        scratch[i] = (float)v[i];
    return (double)sort_select(scratch, n, n / 2);
}

/* The middle of the photographs, and how high they are above the median point. */
static enum err_code eval_flight_plan(const struct eval_flight_request *q,
                                      struct eval_flight_path *p, struct err *e)
{
    const struct scene *s = q->scene;
    size_t n = s->n_points > s->n_images ? s->n_points : s->n_images;
    double center[3], *v = mem_array(n, sizeof *v), at[3];
    float *scratch = mem_array(n, sizeof *scratch);
    enum err_code rc = v && scratch ? ERR_OK : err_set(e, ERR_MEM, "eval: out of memory");
    if (!rc && (!s->n_points || !s->n_images || q->frames < 2))
        rc = err_set(e, ERR_ARG, "eval-flight: two frames and a scene with points are needed");
    for (size_t k = 0; !rc && k < 3; k++) {
        for (size_t i = 0; i < s->n_images; i++) {
            camera_center(&s->images[i].cam, center);
            v[i] = center[k];
        }
        at[k] = eval_flight_median(v, scratch, s->n_images);
    }
    if (!rc) {
        for (size_t i = 0; i < s->n_points; i++)
            v[i] = s->points[i].enu_m[2];
        p->middle_m[0] = at[0];
        p->middle_m[1] = at[1];
        p->middle_m[2] = eval_flight_median(v, scratch, s->n_points);
        p->height_m = fmax(1.0, at[2] - p->middle_m[2]);
        p->width_px = q->max_edge_px ? q->max_edge_px : EVAL_FLIGHT_WIDTH;
        p->height_px = (p->width_px * 9 + 15) / 16;
    }
    mem_free(v);
    mem_free(scratch);
    return rc;
}

static struct camera eval_flight_camera(const struct eval_flight_path *p, size_t frame, size_t n)
{
    double t = (double)frame / (double)(n - 1), heading = 180.0 * t, h = heading * M_PI / 180;
    double up = p->height_m * eval_flight_high * pow(eval_flight_low / eval_flight_high, t);
    double back = up / tan(-eval_flight_pitch_deg * M_PI / 180);
    const double eye[3] = {p->middle_m[0] - back * sin(h), p->middle_m[1] - back * cos(h),
                           p->middle_m[2] + up};
    return camera_heading(eye, heading, eval_flight_pitch_deg, 50 * M_PI / 180, p->width_px,
                          p->height_px);
}

/* The camera of a picture that is larger on every side, at the same scale. */
static struct camera eval_flight_wide(const struct camera *c)
{
    struct camera w = *c;
    uint32_t x = c->width_px / EVAL_FLIGHT_MARGIN, y = c->height_px / EVAL_FLIGHT_MARGIN;
    w.width_px += 2 * x;
    w.height_px += 2 * y;
    w.cx_px += x;
    w.cy_px += y;
    return w;
}

/* Add the largest difference of the channels of each pixel to a histogram; their mean. */
static double eval_flight_compare(const float *a, const float *b, size_t pixels, uint64_t *counts)
{
    double sum = 0.0;
    for (size_t i = 0; i < pixels; i++) {
        float d = 0.0f;
        for (size_t c = 3 * i; c < 3 * i + 3; c++)
            d = fmaxf(d, fabsf(fminf(a[c], 1.0f) - fminf(b[c], 1.0f)));
        counts[(size_t)(fminf(d, 1.0f) * 255.0f + 0.5f)]++;
        sum += (double)fminf(d, 1.0f) * 255.0;
    }
    return sum / (double)pixels;
}

static size_t eval_flight_quantile(const uint64_t *counts, double share)
{
    uint64_t total = 0, below = 0;
    for (size_t i = 0; i < EVAL_FLIGHT_LEVELS; i++)
        total += counts[i];
    for (size_t i = 0; i < EVAL_FLIGHT_LEVELS; i++) {
        below += counts[i];
        if ((double)below >= share * (double)total)
            return i;
    }
    return 0;
}

static void eval_flight_pop(const float *now, const float *held, size_t pixels, size_t frame,
                            struct eval_flight_figures *f)
{
    uint64_t counts[EVAL_FLIGHT_LEVELS] = {0};
    double mean = eval_flight_compare(now, held, pixels, counts);
    size_t q99 = eval_flight_quantile(counts, 0.99), most = eval_flight_quantile(counts, 1.0);
    f->pop_99 = q99 > f->pop_99 ? q99 : f->pop_99;
    f->pop_max = most > f->pop_max ? most : f->pop_max;
    if (mean > f->worst_mean) {
        f->worst_mean = mean;
        f->worst_frame = frame;
    }
}

/* What two frames are drawn from, the one at hand and the one before. */
struct eval_flight_tiles {
    struct view_tiles now, before;
    struct fade fade;
    uint32_t *wanted, *tile; /* [n_nodes], [2 * n_nodes] */
    float *weight;           /* [2 * n_nodes] */
};

static void eval_flight_clear(struct eval_flight_tiles *t)
{
    fade_close(&t->fade);
    mem_free(t->wanted);
    mem_free(t->tile);
    mem_free(t->weight);
}

static enum err_code eval_flight_prepare(const struct view *v, size_t fade,
                                         struct eval_flight_tiles *t, struct err *e)
{
    const struct tree *tree = store_tree(view_store(v));
    size_t n = tree->n_nodes;
    enum err_code rc = ERR_OK;
    if (fade && view_appearance(v))
        return err_set(e, ERR_ARG, "--fade: not of tiles with appearance");
    t->wanted = mem_array(n + 1, sizeof *t->wanted);
    t->tile = mem_array(2 * n + 1, sizeof *t->tile);
    t->weight = mem_array(2 * n + 1, sizeof *t->weight);
    if (!t->wanted || !t->tile || !t->weight)
        rc = err_set(e, ERR_MEM, "eval: out of memory for %zu tiles", n);
    if (!rc)
        rc = fade_open(tree, fade, &t->fade, e);
    return rc;
}

/* The tiles of the next frame: those that its camera needs, and what fades. */
static enum err_code eval_flight_next(struct view *v, const struct camera *cam,
                                      const struct pick_options *po, struct eval_flight_tiles *t,
                                      struct err *e)
{
    size_t n = 0, other = t->now.tile == t->tile ? t->fade.tree->n_nodes : 0;
    enum err_code rc = pick_tiles(view_store(v), cam, po, t->wanted, &n, e);
    t->before = t->now;
    t->now.tile = t->tile + other;
    t->now.weight = t->fade.frames ? t->weight + other : NULL;
    if (!rc)
        t->now.n = fade_next(&t->fade, t->wanted, n, t->tile + other, t->weight + other);
    return rc;
}

/* How far a picture in a fade leaves what lies between those of either set alone: surfaces that are
 * seen through, or denser than in both. Into the figures; scratch holds two pictures. */
static enum err_code eval_flight_stray(struct view *v, struct eval_flight_tiles *t,
                                       const struct camera *cam, const struct render_options *ro,
                                       const float *now, float *scratch,
                                       struct eval_flight_figures *f, struct err *e)
{
    size_t pixels = (size_t)cam->width_px * cam->height_px;
    const bool *sets[2] = {t->fade.from, t->fade.to};
    uint64_t counts[EVAL_FLIGHT_LEVELS] = {0};
    enum err_code rc = ERR_OK;
    for (size_t k = 0; !rc && k < 2; k++) {
        struct view_tiles one = {.tile = t->wanted};
        for (size_t i = 0; i < t->fade.tree->n_nodes; i++)
            if (sets[k][i])
                t->wanted[one.n++] = (uint32_t)i;
        rc = view_render_tiles(v, &one, cam, ro, scratch + 3 * k * pixels, NULL, e);
    }
    for (size_t i = 0; !rc && i < 3 * pixels; i++) { /* what is nearest to `now` between both */
        float a = scratch[i], b = scratch[3 * pixels + i];
        scratch[i] = fmaxf(fminf(a, b), fminf(fmaxf(a, b), now[i]));
    }
    if (!rc) {
        eval_flight_compare(now, scratch, pixels, counts);
        size_t q99 = eval_flight_quantile(counts, 0.99);
        f->stray_99 = q99 > f->stray_99 ? q99 : f->stray_99;
    }
    return rc;
}

static enum err_code eval_flight_fly(const struct eval_flight_path *p,
                                     const struct eval_flight_request *q, struct view *v,
                                     const struct render_options *ro, const struct pick_options *po,
                                     struct eval_flight_figures *f, struct err *e)
{
    size_t pixels = (size_t)p->width_px * p->height_px;
    float *block = mem_array(pixels, 15 * sizeof *block);
    if (!block)
        return err_set(e, ERR_MEM, "eval: out of memory for pictures of %zu pixels", pixels);
    float *now = block, *last = block + 3 * pixels, *held = block + 6 * pixels;
    struct eval_flight_tiles tiles = {0};
    enum err_code rc = eval_flight_prepare(v, q->fade, &tiles, e);
    for (size_t i = 0; !rc && i < q->frames; i++) {
        struct camera cam = eval_flight_camera(p, i, q->frames), wide = eval_flight_wide(&cam);
        struct view_stats st = {0};
        rc = eval_flight_next(v, &wide, po, &tiles, e);
        if (!rc)
            rc = view_render_tiles(v, &tiles.now, &cam, ro, now, &st, e);
        f->gaussians += (double)st.n_gaussians / (double)q->frames;
        if (!rc && tiles.fade.frame > 0)
            rc = eval_flight_stray(v, &tiles, &cam, ro, now, block + 9 * pixels, f, e);
        if (!rc && i) {
            rc = view_render_tiles(v, &tiles.before, &cam, ro, held, &st, e);
            if (!rc)
                eval_flight_pop(now, held, pixels, i, f);
            if (!rc)
                eval_flight_compare(now, last, pixels, f->changes);
        }
        float *t = now;
        now = last;
        last = t;
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped in flight");
    }
    eval_flight_clear(&tiles);
    mem_free(block);
    return rc;
}

static enum err_code eval_flight_row(const struct eval_flight_request *q, const char *what,
                                     const struct eval_flight_figures *f, struct err *e)
{
    size_t change99 = eval_flight_quantile(f->changes, 0.99);
    printf("%-14s %6zu %8zu %8zu %11.3f %11zu %10zu %11zu %12.0f\n", what, q->frames, f->pop_99,
           f->pop_max, f->worst_mean, f->worst_frame, f->stray_99, change99, f->gaussians);
    json_t *row = json_pack("{s:s, s:I, s:I, s:I, s:I, s:f, s:I, s:I, s:I, s:f}", "what", what,
                            "frames", (json_int_t)q->frames, "fade", (json_int_t)q->fade, "pop_99",
                            (json_int_t)f->pop_99, "pop_max", (json_int_t)f->pop_max,
                            "pop_frame_mean", f->worst_mean, "pop_frame",
                            (json_int_t)f->worst_frame, "stray_99", (json_int_t)f->stray_99,
                            "change_99", (json_int_t)change99, "gaussians", f->gaussians);
    if (!row || json_array_append_new(q->rows, row))
        return err_set(e, ERR_MEM, "eval: out of memory");
    return ERR_OK;
}

static enum err_code eval_flight_run(const struct eval_flight_request *q, struct view *v,
                                     const struct render_options *ro, const struct pick_options *po,
                                     struct err *e)
{
    struct eval_flight_path path = {0};
    enum err_code rc = eval_flight_plan(q, &path, e);
    if (!rc)
        printf("%-14s %6s %8s %8s %11s %11s %10s %11s %12s\n", "what", "frames", "pop 99 %",
               "pop max", "frame mean", "which", "stray 99 %", "change 99 %", "Gaussians");
    for (int finest = 0; !rc && finest < 2; finest++) {
        struct eval_flight_figures f = {0};
        struct pick_options o = *po;
        o.no_lod = finest;
        rc = eval_flight_fly(&path, q, v, ro, &o, &f, e);
        if (!rc)
            rc = eval_flight_row(q, finest ? "tiles, no LOD" : "tiles, LOD", &f, e);
    }
    return rc;
}

enum err_code lab_eval_flight(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "eval-flight",
        .usage = "citysplat-lab eval-flight SCENE --tiles CITY.tiles [options]",
        .about = "Flies from above into the city of a tile store, and prints how much pixels jump "
                 "when levels change, in steps of 1/255.",
        .example = "citysplat-lab eval-flight scene --tiles city.tiles --frames 240 --fade 8",
        .defs = eval_flight_defs,
        .n_defs = sizeof eval_flight_defs / sizeof *eval_flight_defs,
        .min_args = 1,
        .max_args = 1};
    struct eval_lab v = {0};
    struct eval_flight_options o;
    struct view *view = NULL;
    struct render_options ro;
    struct pick_options po;
    enum err_code rc = eval_lab_open(&v, &spec, argc, argv, &o, sizeof o, e);
    if (rc || v.args.done)
        goto out;
    const struct eval_flight_request q = {.scene = &v.city.scene,
                                          .frames = (size_t)o.frames,
                                          .fade = (size_t)o.fade,
                                          .max_edge_px = (uint32_t)v.o.city.max_edge_px,
                                          .rows = v.rows};
    rc = v.o.city.tiles
             ? eval_city_store(&v.city, &view, &ro, &po, e)
             : err_set(e, ERR_ARG, "levels change in tile stores: give one with --tiles FILE");
    if (!rc)
        rc = eval_flight_run(&q, view, &ro, &po, e);
    if (!rc)
        rc = eval_lab_write(&v, e);
out:
    view_close(&view);
    eval_lab_close(&v);
    return rc;
}
