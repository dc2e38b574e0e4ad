/* The process that draws. One thread owns the OpenCL device, the compiled kernels and the tiles on
 * the device. It has a lower priority, which OpenCL's own threads inherit, so tiles are answered
 * while a picture is made. picture.c decides which stores are open.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/draw.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "codec/image/image.h"
#include "core/device/dev.h"
#include "core/geo/geo.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "lod/store/remote.h"
#include "lod/store/tree.h"
#include "lod/surface/nadir.h"
#include "render/render.h"
#include "server/drawing/composite.h"

enum {
    DRAW_OVER = 16 /* a process that holds so much of its memory too much, 1/16, is replaced */
};

#define DRAW_AGE_S 60.0   /* but not before */
#define REMOTE_WAIT_S 5.0 /* for what is read of a store at an address */

struct draw_slot {
    struct view *view;   /* NULL: empty */
    struct nadir *nadir; /* over the view; NULL: nobody asked for a map yet */
    bool has_sky;
    struct backdrop sky; /* of this light */
    struct appearance_choice sky_of;
};
struct draw {
    struct draw_hello hello;
    struct dev dev;
    bool has_dev;
    struct render *render;
    struct render_surface *surface; /* NULL: nobody asked for depth or a background yet */
    struct geoid *geoid;            /* NULL: none */
    struct draw_slot slot[DRAW_SLOTS];
};

/* ---- open, close ---- */

static void draw_empty(struct draw_slot *s)
{
    nadir_close(&s->nadir);
    view_close(&s->view);
    s->has_sky = false;
}

static void draw_close(void *user)
{
    struct draw *d = user;
    if (!d)
        return;
    for (int i = 0; i < DRAW_SLOTS; i++)
        draw_empty(&d->slot[i]);
    render_surface_close(&d->surface);
    render_close(&d->render);
    if (d->has_dev)
        dev_close(&d->dev);
    geoid_close(&d->geoid);
    mem_free(d);
}

static enum err_code draw_open(const void *hello, size_t n, void **user, char about[WORKER_ABOUT],
                               struct err *e)
{
    struct draw *d = mem_array(1, sizeof *d);
    *user = d;
    if (!d)
        return err_set(e, ERR_MEM, "out of memory");
    if (n != sizeof d->hello)
        return err_set(e, ERR_INTERNAL, "a greeting of %zu bytes, not %zu", n, sizeof d->hello);
    memcpy(&d->hello, hello, n);
    if (!d->hello.slots || d->hello.slots > DRAW_SLOTS)
        return err_set(e, ERR_INTERNAL, "a greeting of %u stores", d->hello.slots);
    mem_return_large();
    log_set_json(d->hello.log_json);
    if (d->hello.nice)
        setpriority(PRIO_PROCESS, 0, d->hello.nice);
    enum err_code rc = dev_open(d->hello.device[0] ? d->hello.device : NULL, &d->dev, e);
    d->has_dev = !rc;
    if (!rc)
        rc = render_open(&d->dev, &d->render, e);
    if (!rc && d->hello.geoid[0])
        rc = geoid_open(d->hello.geoid, &d->geoid, e);
    if (rc)
        return rc;
    log_set_level(LOG_WARN); /* that kernels are compiled was told; the server tells what is well */
    render_set_stop(d->render, worker_cancelled, NULL);
    remote_patience(REMOTE_WAIT_S);
    snprintf(about, WORKER_ABOUT, "%.100s %.50s", d->dev.name, d->dev.driver);
    return ERR_OK;
}

/* ---- answers ---- */

/* The store of a request, in its appearance. fd is taken. */
static enum err_code draw_find(struct draw *d, const struct draw_request *q, int fd,
                               struct draw_slot **out, struct err *e)
{
    struct draw_slot *s = *out = &d->slot[q->slot % DRAW_SLOTS];
    enum err_code rc = ERR_OK;
    for (uint32_t i = 0; i < DRAW_SLOTS; i++)
        if (q->drop >> i & 1)
            draw_empty(&d->slot[i]);
    const double from_s = clock_s();
    if (q->opens) {
        draw_empty(s);
        rc = view_open_fd(fd, q->name, d->render,
                          (size_t)d->hello.view_cache_bytes / d->hello.slots, &s->view, e);
        if (!rc)
            view_lift(s->view, q->lift_m);
        worker_span(DRAW_OPENS, from_s, clock_s());
    }
    if (fd >= 0)
        close(fd);
    if (!rc && !s->view)
        rc = err_set(e, ERR_INTERNAL, "%s: not open", q->name);
    return rc ? rc : view_set_appearance(s->view, appearance_api_image(&q->appearance), e);
}

/* What is left behind the last frame's Gaussians, and how far away they are. NULL: not wanted. */
/* NOLINTNEXTLINE(readability-non-const-parameter): they are written through `maps` */
static enum err_code draw_measure(struct draw *d, float *transmittance, float *depth_m,
                                  struct err *e)
{
    const struct render_surface_maps maps = {.median_m = depth_m};
    enum err_code rc = ERR_OK;
    if (transmittance)
        rc = render_transmittance(d->render, transmittance, e);
    if (rc || !depth_m)
        return rc;
    if (!d->surface)
        rc = render_surface_open(d->render, &d->surface, e);
    return !rc ? render_surface_run(d->surface, NULL, &maps, e) : rc;
}

/* Notes the stages of a picture that was drawn from from_s on. */
static void draw_note(const struct view_stats *st, double from_s)
{
    const double load_s = from_s + 1e-3 * st->ms_pick, draw_s = load_s + 1e-3 * st->ms_load;
    worker_span(DRAW_PICKS, from_s, load_s);
    worker_span(DRAW_LOADS, load_s, draw_s);
    worker_span(DRAW_DRAWS, draw_s, draw_s + 1e-3 * st->ms_render);
}

/* What is behind the city in the light of the request: once for each light, by a small picture from
 * above. */
static enum err_code draw_sky(struct draw *d, const struct draw_request *q, struct draw_slot *s,
                              struct err *e)
{
    enum { CELLS = BACKDROP_PX * BACKDROP_PX };
    if (s->has_sky && !memcmp(&s->sky_of, &q->appearance, sizeof s->sky_of))
        return ERR_OK;
    double min[3], max[3];
    s->has_sky = false;
    tree_extent(store_tree(view_store(s->view)), min, max);
    const struct camera cam = backdrop_camera(min, max);
    const struct render_options ro = {.aa = q->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
                                      .sh_degree = -1};
    const struct pick_options po = {.max_gaussians = d->hello.view_gaussians};
    float *rgb = mem_array(CELLS, 4 * sizeof *rgb);
    enum err_code rc = rgb ? ERR_OK : err_set(e, ERR_MEM, "sky: out of memory");
    if (!rc)
        rc = view_render(s->view, &cam, &ro, &po, rgb, NULL, e);
    if (!rc)
        rc = render_transmittance(d->render, rgb + (size_t)3 * CELLS, e);
    if (!rc)
        rc = backdrop_read(min, max, rgb, rgb + (size_t)3 * CELLS, &s->sky, e);
    if (!rc) {
        s->sky_of = q->appearance;
        s->has_sky = true;
    }
    mem_free(rgb);
    return rc;
}

static enum err_code draw_picture(struct draw *d, const struct draw_request *q, struct draw_slot *s,
                                  struct buf *out, struct err *e)
{
    const struct draw_view *v = &q->view;
    const struct composite *paint = &v->composite;
    size_t n = (size_t)v->cam.width_px * v->cam.height_px;
    struct view_stats st;
    bool left = composite_needs_transmittance(paint),
         depth = composite_needs_depth(paint, v->format);
    struct render_options ro = {.aa = q->antialiased ? RENDER_AA_2D : RENDER_AA_NONE,
                                .sh_degree = -1};
    if (q->antialiased)
        ro.supersample = paint->supersample ? paint->supersample : VIEW_SUPERSAMPLE_AUTO;
    const struct pick_options po = {.max_gaussians = d->hello.view_gaussians};
    for (int c = 0; c < 3; c++)
        ro.background[c] = (float)(paint->rgb >> (16 - 8 * c) & 255) / 255.0f;
    float *rgb = mem_array(n, (3 + left + depth) * sizeof(float));
    enum err_code rc = rgb ? ERR_OK : err_set(e, ERR_MEM, "picture: out of memory");
    float *more = rgb ? rgb + 3 * n : NULL;
    const struct composite_planes planes = {rgb, left ? more : NULL,
                                            depth ? more + (left ? n : 0) : NULL, &s->sky};
    if (!rc && paint->background == BACKGROUND_SKY) {
        rc = draw_sky(d, q, s, e);
        ro.edge = &s->sky.edge;
    }
    double since_s = clock_s();
    if (!rc)
        rc = (v->moves && !depth ? view_render_moving : view_render)(s->view, &v->cam, &ro, &po,
                                                                     rgb, &st, e);
    if (!rc)
        draw_note(&st, since_s);
    if (!rc && worker_cancelled(NULL))
        rc = err_set(e, ERR_CANCEL, "cancelled");
    since_s = clock_s();
    if (!rc)
        rc = draw_measure(d, left ? more : NULL, depth ? more + (left ? n : 0) : NULL, e);
    if (left || depth)
        worker_span(DRAW_MEASURES, since_s, clock_s());
    since_s = clock_s();
    if (!rc)
        rc = v->planes ? composite_frame(paint, &v->cam, &planes, out, e)
                       : composite_encode(paint, &v->cam, v->format, v->quality, &planes, out, e);
    worker_span(DRAW_ENCODES, since_s, clock_s());
    mem_free(rgb);
    return rc;
}

static enum err_code draw_answer(struct draw *d, const struct draw_request *q, struct nadir *n,
                                 struct buf *out, struct err *e)
{
    json_t *o = NULL;
    enum err_code rc = query_answer(n, d->geoid, &q->query, &o, e);
    char *text = rc ? NULL : json_dumps(o, JSON_COMPACT | JSON_REAL_PRECISION(13));
    json_decref(o);
    if (!rc && !text)
        return err_set(e, ERR_MEM, "out of memory for an answer");
    if (text)
        buf_printf(out, "%s\n", text);
    free(text);
    return rc;
}

static enum err_code draw_run(void *user, const void *request, size_t n, int fd, struct buf *out,
                              struct err *e)
{
    struct draw *d = user;
    const struct draw_request *q = request;
    struct draw_slot *s;
    if (n != sizeof *q) {
        if (fd >= 0)
            close(fd);
        return err_set(e, ERR_INTERNAL, "a request of %zu bytes, not %zu", n, sizeof *q);
    }
    enum err_code rc = draw_find(d, q, fd, &s, e);
    if (!rc && q->kind == DRAW_VIEW)
        return draw_picture(d, q, s, out, e);
    if (!rc && !s->nadir)
        rc = nadir_over(s->view, d->render, (double)NAN, &s->nadir, e);
    if (rc)
        return rc;
    const double from_s = clock_s();
    rc = q->kind == DRAW_MAP ? map_tile_make(s->nadir, &q->map, out, e)
                             : draw_answer(d, q, s->nadir, out, e);
    worker_span(DRAW_MAKES, from_s, clock_s());
    return rc;
}

/* Compilers and drivers leave much behind that is free and not given back. What is then still too
 * much are tiles of earlier pictures, and after them what cannot be freed but by a new process. */
static bool draw_rest(void *user)
{
    struct draw *d = user;
    const size_t limit = (size_t)d->hello.memory_bytes;
    if (!limit || mem_held_bytes(0) <= limit)
        return false;
    mem_give_back();
    if (mem_held_bytes(0) <= limit)
        return false;
    for (int i = 0; i < DRAW_SLOTS; i++)
        if (d->slot[i].view)
            view_shrink(d->slot[i].view);
    mem_give_back();
    return mem_held_bytes(0) > limit + limit / DRAW_OVER;
}

const struct worker_service draw_service = {draw_open, draw_run, draw_close, draw_rest, DRAW_AGE_S};

int draw_main(void)
{
    return worker_main(&draw_service);
}
