/* Makes the scene from what was kept: cameras in ENU, points, tracks in pixels of the new pictures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "scene/ingest/ingest.h"
#include "scene/ingest/ingest_internal.h"

static enum err_code scene_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "ingest: out of memory");
}

/* The view of a photograph: one for each camera and size. */
static enum err_code scene_find_view(struct ingest *g, struct ingest_photo *p, struct err *e)
{
    const struct lens *l = &g->model.cameras[p->image->camera].lens;
    for (size_t k = 0; k < g->n_views; k++) {
        const struct ingest_view *v = &g->views[k];
        if (v->camera == p->image->camera && v->lens.width_px == p->width_px &&
            v->lens.height_px == p->height_px) {
            p->view = (uint32_t)k;
            return ERR_OK;
        }
    }
    uint32_t edge = (uint32_t)g->cfg->max_edge_px;
    enum err_code rc =
        ingest_view_make(l, p->width_px, p->height_px, edge, &g->views[g->n_views], e);
    if (rc) {
        err_add(e, "camera %u", g->model.cameras[p->image->camera].id);
        return rc;
    }
    g->views[g->n_views].camera = p->image->camera;
    p->view = (uint32_t)g->n_views++;
    return ERR_OK;
}

static void scene_image_fill(const struct ingest *g, size_t i, uint32_t group,
                             struct scene_image *out)
{
    const struct ingest_photo *p = &g->photos[i];
    const struct scene *s = &g->scene;
    bool every = g->cfg->test_every > 0 && !(g->cfg->test_block > 0.0);
    bool test = every && i % (size_t)g->cfg->test_every == 0;
    *out = (struct scene_image){.name = p->out_name,
                                .cam = g->views[p->view].pinhole,
                                .group = group,
                                .split = test ? SCENE_TEST : SCENE_TRAIN,
                                .residual_m = p->residual_m};
    scene_time(p->gps.time, out->time);
    for (int a = 0; a < 3; a++) { /* W' = W R^T, d' = s d - W' t */
        out->gps_enu_m[a] = p->geo.has_gps ? p->geo.gps_enu_m[a] : (double)NAN;
        for (int b = 0; b < 3; b++)
            out->cam.rot[3 * a + b] = p->geo.rot[3 * a] * s->rot[3 * b] +
                                      p->geo.rot[3 * a + 1] * s->rot[3 * b + 1] +
                                      p->geo.rot[3 * a + 2] * s->rot[3 * b + 2];
        out->cam.trans[a] = s->scale * p->image->trans[a];
        for (int b = 0; b < 3; b++)
            out->cam.trans[a] -= out->cam.rot[3 * a + b] * s->trans[b];
    }
}

/* ---- a block of test photographs ---- */

struct scene_place { /* of a kept photograph */
    double x_m, y_m, away2;
    size_t image;
};

static int scene_place_compare(const void *a, const void *b)
{
    const struct scene_place *p = a, *q = b;
    if (p->away2 != q->away2)
        return p->away2 < q->away2 ? -1 : 1;
    return (p->image > q->image) - (p->image < q->image);
}

/* Order by distance on the ground from (x, y). */
static void scene_places_sort(struct scene_place *p, size_t n, double x_m, double y_m)
{
    for (size_t i = 0; i < n; i++)
        p[i].away2 = (p[i].x_m - x_m) * (p[i].x_m - x_m) + (p[i].y_m - y_m) * (p[i].y_m - y_m);
    qsort(p, n, sizeof *p, scene_place_compare);
}

/* The photographs nearest to the one in the middle test, the others train: what the block shows is
 * seen in training from its rim alone, not from between. */
static enum err_code scene_hold_block(struct scene *s, double share, struct err *e)
{
    size_t n = s->n_images, block = (size_t)(share * (double)n + 0.5);
    struct scene_place *p = mem_array(n, sizeof *p);
    double *v = mem_array(n, sizeof *v), middle[2];
    if (!p || !v) {
        mem_free(p);
        mem_free(v);
        return scene_no_memory(e);
    }
    for (size_t i = 0; i < n; i++) {
        double c[3];
        camera_center(&s->images[i].cam, c);
        p[i] = (struct scene_place){.x_m = c[0], .y_m = c[1], .image = i};
    }
    for (int axis = 0; axis < 2; axis++) {
        for (size_t i = 0; i < n; i++)
            v[i] = axis ? p[i].y_m : p[i].x_m;
        middle[axis] = sort_median(v, n);
    }
    scene_places_sort(p, n, middle[0], middle[1]);
    if (n)
        scene_places_sort(p, n, p[0].x_m, p[0].y_m);
    for (size_t i = 0; i < n && i < (block ? block : 1); i++)
        s->images[p[i].image].split = SCENE_TEST;
    mem_free(p);
    mem_free(v);
    return ERR_OK;
}

static enum err_code scene_fill_images(struct ingest *g, struct err *e)
{
    struct scene *s = &g->scene;
    s->images = arena_get(&s->arena, g->n, sizeof *s->images);
    g->views = arena_get(&s->arena, g->n, sizeof *g->views);
    if (!s->images || !g->views)
        return scene_no_memory(e);
    for (size_t i = 0; i < g->n; i++)
        g->kept[i] = UINT32_MAX;
    for (size_t i = 0; i < g->n; i++) {
        if (g->photos[i].verdict != INGEST_KEPT)
            continue;
        enum err_code rc = scene_find_view(g, &g->photos[i], e);
        if (rc)
            return rc;
        g->kept[g->photos[i].image - g->model.images] = (uint32_t)s->n_images;
        scene_image_fill(g, i, (uint32_t)s->n_images, &s->images[s->n_images]);
        s->n_images++;
    }
    return ERR_OK;
}

static int scene_track_compare(const void *a, const void *b)
{
    const struct scene_track *p = a, *q = b;
    if (p->image != q->image)
        return p->image < q->image ? -1 : 1;
    return (p->point > q->point) - (p->point < q->point);
}

/* Points with the observations of kept photographs. A point that nobody sees any more is left out;
 * one without a track, as of a dense cloud, stays. */
static enum err_code scene_fill_points(struct ingest *g, struct err *e)
{
    struct scene *s = &g->scene;
    const struct colmap_model *m = &g->model;
    const struct sim3 sim = {s->scale,
                             {s->rot[0], s->rot[1], s->rot[2], s->rot[3], s->rot[4], s->rot[5],
                              s->rot[6], s->rot[7], s->rot[8]},
                             {s->trans[0], s->trans[1], s->trans[2]}};
    s->points = arena_get(&s->arena, m->n_points, sizeof *s->points);
    s->tracks = arena_get(&s->arena, m->n_tracks, sizeof *s->tracks);
    uint32_t *view_of = mem_array(m->n_images, sizeof *view_of);
    if (!s->points || !s->tracks || !view_of) {
        mem_free(view_of);
        return scene_no_memory(e);
    }
    for (size_t i = 0; i < g->n; i++)
        view_of[g->photos[i].image - m->images] = g->photos[i].view;
    for (size_t i = 0; i < m->n_points; i++) {
        const struct colmap_point *p = &m->points[i];
        struct scene_point *out = &s->points[s->n_points];
        size_t seen = 0;
        for (size_t k = 0; k < p->n_track; k++) {
            const struct colmap_track_element *t = &m->tracks[p->track + k];
            if (g->kept[t->image] == UINT32_MAX)
                continue;
            seen++;
            const struct colmap_observation *o = &m->images[t->image].obs[t->obs];
            double u, v;
            if (ingest_view_map(&g->views[view_of[t->image]],
                                &m->cameras[m->images[t->image].camera].lens, o->x_px, o->y_px, &u,
                                &v))
                s->tracks[s->n_tracks++] = (struct scene_track){
                    (uint32_t)s->n_points, g->kept[t->image], (float)u, (float)v};
        }
        if (!seen && p->n_track)
            continue;
        *out = (struct scene_point){.error_px = (float)p->error_px, .track_length = (uint32_t)seen};
        memcpy(out->rgb, p->rgb, sizeof out->rgb);
        sim3_apply(&sim, p->xyz, out->enu_m);
        s->n_points++;
    }
    mem_free(view_of);
    qsort(s->tracks, s->n_tracks, sizeof *s->tracks, scene_track_compare);
    return ERR_OK;
}

enum err_code ingest_scene_fill(struct ingest *g, struct err *e)
{
    enum err_code rc = scene_fill_images(g, e);
    if (!rc && g->cfg->test_block > 0.0)
        rc = scene_hold_block(&g->scene, g->cfg->test_block, e);
    if (!rc)
        rc = scene_fill_points(g, e);
    return rc || g->cfg->test_block > 0.0 ? rc : ingest_split_cover(&g->scene, e);
}
