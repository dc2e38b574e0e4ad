/* The first Gaussians: one at each point of the sparse model (3D Gaussian Splatting, Kerbl 2023,
 * section 5.1). They are round and have the point's colour in the constant harmonic and a size
 * by the distance to their neighbours.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/mask.h"
#include "codec/scene/scene.h"
#include "core/math/knn.h"
#include "core/pool.h"
#include "core/splat/camera.h"
#include "scene/cells/cell.h"
#include "scene/cells/footprint.h"
#include "train/base/config.h"
#include "train/model/init.h"

/* Points lie on surfaces, so the first Gaussians are half opaque and leave gaps; 3DGS begins with
 * 0.1 and 1. Measured: docs/decisions/011-density-control.md. */
#define INIT_OPACITY 0.5
#define INIT_SIGMA 0.7         /* of the distance to neighbours */
#define INIT_DIST2_MIN_M2 1e-7 /* coincident points */
/* A point that lies alone does not become a Gaussian as large as the gap around it: at most this
 * many times the size of its neighbours. */
#define INIT_GAP_MAX 3.0f
#define INIT_THIN_MOST 4.0 /* times as long, where others were left out */
enum {
    INIT_NEIGHBOURS = 3,
    INIT_AROUND = 9,
    INIT_RANDOM_POINTS = 100,
    INIT_DENSE = 6,
    INIT_CHUNK = 4096
};

/* ---- nearest neighbours ---- */

struct init_search {
    const float *xyz;
    struct knn tree;
    float *dist2;
    float *limited;
};

static enum err_code init_search_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct init_search *s = user;
    size_t n = s->tree.n, end = (chunk + 1) * INIT_CHUNK < n ? (chunk + 1) * INIT_CHUNK : n;
    for (size_t i = chunk * INIT_CHUNK; i < end; i++) {
        uint32_t ids[INIT_NEIGHBOURS];
        float dist2[INIT_NEIGHBOURS];
        double sum = 0.0;
        size_t found = knn_find(&s->tree, s->xyz + 3 * i, (uint32_t)i, INIT_NEIGHBOURS, ids, dist2);
        for (size_t k = 0; k < found; k++)
            sum += (double)dist2[k];
        s->dist2[i] = found ? (float)(sum / (double)found) : 0.0f;
    }
    return ERR_OK;
}

static int init_float_compare(const void *a, const void *b)
{
    float x, y;
    memcpy(&x, a, sizeof x);
    memcpy(&y, b, sizeof y);
    return (x > y) - (x < y);
}

/* Distances that are not much above the median of those around. */
static enum err_code init_limit_chunk(void *user, size_t chunk, struct err *e)
{
    (void)e;
    struct init_search *s = user;
    size_t n = s->tree.n, end = (chunk + 1) * INIT_CHUNK < n ? (chunk + 1) * INIT_CHUNK : n;
    for (size_t i = chunk * INIT_CHUNK; i < end; i++) {
        uint32_t ids[INIT_AROUND];
        float dist2[INIT_AROUND];
        size_t found = knn_find(&s->tree, s->xyz + 3 * i, (uint32_t)i, INIT_AROUND, ids, dist2);
        s->limited[i] = s->dist2[i];
        if (found < INIT_AROUND)
            continue;
        for (size_t k = 0; k < found; k++)
            dist2[k] = s->dist2[ids[k]];
        qsort(dist2, found, sizeof *dist2, init_float_compare);
        float most = INIT_GAP_MAX * INIT_GAP_MAX * dist2[found / 2];
        if (most > 0.0f && s->dist2[i] > most)
            s->limited[i] = most;
    }
    return ERR_OK;
}

static enum err_code init_search_all(struct init_search *s, size_t n, struct err *e)
{
    size_t chunks = (n + INIT_CHUNK - 1) / INIT_CHUNK;
    enum err_code rc = knn_build(s->xyz, n, &s->tree, e);
    if (!rc)
        rc = pool_for(chunks, 0, init_search_chunk, s, e);
    if (!rc)
        rc = pool_for(chunks, 0, init_limit_chunk, s, e);
    knn_free(&s->tree);
    return rc;
}

enum err_code init_size2(const float *xyz, size_t n, float *size2, struct err *e)
{
    struct init_search s = {.xyz = xyz, .limited = size2};
    s.dist2 = mem_array(n, sizeof *s.dist2);
    enum err_code rc = s.dist2 ? init_search_all(&s, n, e)
                               : err_set(e, ERR_MEM, "init: out of memory for %zu points", n);
    mem_free(s.dist2);
    return rc;
}

/* ---- points to Gaussians ---- */

struct init_points {
    double *enu_m; /* [n][3] */
    uint8_t *rgb;  /* [n][3] */
    size_t n;
};

/* No sparse model: grey points at half to one and a half cell edges in front of random pixels. */
static void init_random_points(const struct scene *s, const uint32_t *images, size_t n_images,
                               const struct cell *cell, uint64_t seed, struct init_points *p)
{
    uint64_t stream = train_stream(TRAIN_STREAM_INIT, 1, 0);
    for (size_t i = 0; i < p->n; i++) {
        size_t pick = (size_t)(rng_unit(seed, stream, 4 * i) * (double)n_images);
        const struct camera *c = &s->images[images[pick]].cam;
        double depth = cell->edge_m * (0.5 + rng_unit(seed, stream, 4 * i + 1));
        double x = (rng_unit(seed, stream, 4 * i + 2) * c->width_px - c->cx_px) / c->fx_px * depth;
        double y = (rng_unit(seed, stream, 4 * i + 3) * c->height_px - c->cy_px) / c->fy_px * depth;
        double t[3] = {x - c->trans[0], y - c->trans[1], depth - c->trans[2]};
        for (int k = 0; k < 3; k++) {
            p->enu_m[3 * i + k] = c->rot[k] * t[0] + c->rot[3 + k] * t[1] + c->rot[6 + k] * t[2];
            p->rgb[3 * i + k] = 128;
        }
    }
}

/* Which points to start from: those that one of the photographs observes, or all for the whole
 * scene and where no observations are known. Returns their number; `use` is [n_points]. */
static size_t init_mark_points(const struct scene *s, const uint32_t *images, size_t n_images,
                               bool whole, uint8_t *use, uint8_t *seen)
{
    size_t n = 0;
    for (size_t i = 0; i < n_images; i++)
        seen[images[i]] = 1;
    for (size_t i = 0; i < s->n_tracks; i++)
        if (seen[s->tracks[i].image])
            use[s->tracks[i].point] = 1;
    for (size_t i = 0; i < s->n_points; i++) {
        use[i] = use[i] || whole || !s->n_tracks;
        n += use[i];
    }
    return n;
}

static void init_scene_points(const struct scene *s, const uint8_t *use, size_t n_use,
                              uint64_t seed, struct init_points *p)
{
    uint64_t stream = train_stream(TRAIN_STREAM_INIT, 1, 0);
    size_t taken = 0, passed = 0;
    for (size_t i = 0; i < s->n_points && taken < p->n; i++) {
        if (!use[i])
            continue;
        /* Selection sampling (Knuth 3.4.2 S): each of the remaining with equal chance. */
        double left = (double)(n_use - passed++), want = (double)(p->n - taken);
        if (p->n < n_use && rng_unit(seed, stream, i) * left >= want)
            continue;
        memcpy(p->enu_m + 3 * taken, s->points[i].enu_m, 3 * sizeof(double));
        memcpy(p->rgb + 3 * taken, s->points[i].rgb, 3);
        taken++;
    }
}

static void init_row(struct gauss *g, size_t i, const uint8_t rgb[3], double dist2,
                     double largest_m)
{
    size_t per_row = 3 * gauss_sh_count(g->sh_degree);
    double sigma = fmin(INIT_SIGMA * sqrt(fmax(dist2, INIT_DIST2_MIN_M2)), largest_m);
    memset(g->sh + i * per_row, 0, per_row * sizeof(float));
    for (int k = 0; k < 3; k++) {
        g->scale_log[3 * i + k] = (float)log(sigma);
        g->sh[i * per_row + k] = (float)((rgb[k] / 255.0 - 0.5) / GAUSS_SH_C0);
    }
    static const float identity[4] = {1.0f, 0.0f, 0.0f, 0.0f};
    memcpy(g->quat_wxyz + 4 * i, identity, sizeof identity);
    g->opacity_logit[i] = (float)log(INIT_OPACITY / (1.0 - INIT_OPACITY));
}

static enum err_code init_fill(const struct init_points *p, const struct cell *cell,
                               struct gauss *g, struct err *e)
{
    double mean[3] = {0};
    for (size_t i = 0; i < p->n; i++)
        for (int k = 0; k < 3; k++)
            mean[k] += p->enu_m[3 * i + k] / (double)p->n;
    memcpy(g->origin_enu_m, mean, sizeof mean);
    for (size_t i = 0; i < 3 * p->n; i++)
        g->mean_m[i] = (float)(p->enu_m[i] - mean[i % 3]);
    float *dist2 = mem_array(p->n, sizeof *dist2);
    if (!dist2)
        return err_set(e, ERR_MEM, "init: out of memory for %zu points", p->n);
    enum err_code rc = init_size2(g->mean_m, p->n, dist2, e);
    for (size_t i = 0; !rc && i < p->n; i++)
        init_row(g, i, p->rgb + 3 * i, (double)dist2[i], cell->extent_m);
    g->n = p->n;
    mem_free(dist2);
    return rc;
}

/* How many to begin with, and a word where that is not simply all points. */
static size_t init_count(size_t n_use, size_t limit)
{
    if (n_use > limit)
        log_warn("init", "%zu points are more than the first level's budget: %zu of them are used",
                 n_use, limit);
    if (n_use)
        return n_use < limit ? n_use : limit;
    size_t n = limit < INIT_RANDOM_POINTS ? limit : INIT_RANDOM_POINTS;
    log_warn("init", "no points are seen: starting from %zu random ones", n);
    return n;
}

/* Points that a photograph sees on an ignored pixel lie on what moves. */
static enum err_code init_drop_masked(const struct scene *s, const uint32_t *images,
                                      size_t n_images, uint8_t *use, size_t *n, struct err *e)
{
    enum err_code rc = mask_points(s, images, n_images, use, e);
    *n = 0;
    for (size_t i = 0; i < s->n_points; i++)
        *n += use[i];
    return rc;
}

enum err_code init_count_points(const struct scene *s, const uint32_t *images, size_t n_images,
                                const struct cell *cell, size_t *out, struct err *e)
{
    uint8_t *use = mem_array(s->n_points, 1), *seen = mem_array(s->n_images, 1);
    *out = 0;
    enum err_code rc = use && seen
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "init: out of memory for %zu points", s->n_points);
    if (!rc)
        *out = init_mark_points(s, images, n_images, cell->whole, use, seen);
    mem_free(use);
    mem_free(seen);
    return rc;
}

/* ---- ground without points ---- */

/* The parts of the photographs that count. */
struct init_views {
    struct camera *part; /* [n] */
    size_t n;
    size_t
        last; /* the one that showed the last place: places are asked for in the order of space */
};

/* Free v->part with mem_free. */
static enum err_code init_views_open(struct init_views *v, const struct scene *s,
                                     const uint32_t *images, const struct camera_window *windows,
                                     size_t n_images, struct err *e)
{
    *v = (struct init_views){.part = mem_array(n_images, sizeof *v->part), .n = n_images};
    if (!v->part && n_images)
        return err_set(e, ERR_MEM, "init: out of memory for %zu photographs", n_images);
    for (size_t i = 0; i < n_images; i++) {
        const struct camera *full = &s->images[images[i]].cam;
        v->part[i] = windows ? camera_crop(full, &windows[i]) : *full;
    }
    return ERR_OK;
}

static bool init_is_seen(struct init_views *v, const double x[3])
{
    if (v->n && camera_frames(&v->part[v->last], x, 0.0, NULL))
        return true;
    for (size_t i = 0; i < v->n; i++)
        if (camera_frames(&v->part[i], x, 0.0, NULL)) {
            v->last = i;
            return true;
        }
    return false;
}

/* Places on the ground that photographs see and no point marks. out_enu_m: room for all cells,
 * [][3]. */
static size_t init_ground_places(const struct init_input *in, struct init_views *views,
                                 double *out_enu_m)
{
    const struct footprint *f = in->ground;
    size_t n = 0;
    for (size_t i = 0; i < f->nx * f->ny; i++) {
        double x[3] = {f->corner_m[0] + ((double)(i % f->nx) + 0.5) * f->cell_m,
                       f->corner_m[1] + ((double)(i / f->nx) + 0.5) * f->cell_m,
                       (double)f->ground_m[i]};
        if (f->has_points[i] || !f->views[i] || !isfinite(x[2]) || !init_is_seen(views, x) ||
            (!in->cell->whole && cell_distance(in->cell, x[0], x[1]) > in->cell->edge_m))
            continue;
        memcpy(out_enu_m + 3 * n++, x, sizeof x);
    }
    return n;
}

/* The colour of the nearest of the first n points for those behind them. */
static enum err_code init_ground_colours(struct init_points *p, size_t n, struct err *e)
{
    struct knn tree = {0};
    float *xyz = mem_array(3 * p->n, sizeof *xyz);
    enum err_code rc =
        xyz ? ERR_OK : err_set(e, ERR_MEM, "init: out of memory for %zu points", p->n);
    for (size_t i = 0; !rc && i < 3 * p->n; i++)
        xyz[i] = (float)(p->enu_m[i] - p->enu_m[i % 3]);
    if (!rc)
        rc = knn_build(xyz, n, &tree, e);
    for (size_t i = n; !rc && i < p->n; i++) {
        uint32_t id = 0;
        float dist2;
        (void)knn_find(&tree, xyz + 3 * i, KNN_NOBODY, 1, &id, &dist2);
        memcpy(p->rgb + 3 * i, p->rgb + 3 * (size_t)id, 3);
    }
    knn_free(&tree);
    mem_free(xyz);
    return rc;
}

/* How many more the cell may have outside of its box: together at most half of the first level's
 * budget. */
static size_t init_ground_outside(const struct init_input *in, const struct init_points *p)
{
    size_t n = 0, most = in->cell->whole ? SIZE_MAX : in->limit / 2;
    for (size_t i = 0; i < p->n; i++)
        n += cell_distance(in->cell, p->enu_m[3 * i], p->enu_m[3 * i + 1]) > 0.0;
    return n < most ? most - n : 0;
}

/* Add them behind the points there are. */
static enum err_code init_ground(const struct init_input *in, struct init_points *p, struct err *e)
{
    size_t cells = in->ground->nx * in->ground->ny, n = p->n, taken = 0;
    size_t outside = init_ground_outside(in, p);
    double *place = mem_array(3 * cells, sizeof *place);
    struct init_views views;
    enum err_code rc = init_views_open(&views, in->scene, in->images, in->windows, in->n_images, e);
    size_t found = place && !rc ? init_ground_places(in, &views, place) : 0;
    mem_free(views.part);
    size_t most = (size_t)(in->ground_share * (double)in->limit);
    most = most < in->limit - n ? most : in->limit - n;
    most = most < found ? most : found;
    uint64_t stream = train_stream(TRAIN_STREAM_GROUND, 1, 0);
    double *enu_m = mem_resize(p->enu_m, 3 * n, 3 * (n + most), sizeof *enu_m);
    p->enu_m = enu_m ? enu_m : p->enu_m;
    uint8_t *rgb = mem_resize(p->rgb, 3 * n, 3 * (n + most), 1);
    p->rgb = rgb ? rgb : p->rgb;
    if (!rc && !(place && enu_m && rgb))
        rc = err_set(e, ERR_MEM, "init: out of memory for %zu cells", cells);
    for (size_t i = 0; !rc && i < found && taken < most; i++) {
        double left = (double)(found - i), want = (double)(most - taken); /* as above */
        if (rng_unit(in->seed, stream, i) * left >= want)
            continue;
        bool out = cell_distance(in->cell, place[3 * i], place[3 * i + 1]) > 0.0;
        if (out && !outside)
            continue;
        outside -= out;
        memcpy(p->enu_m + 3 * (n + taken++), place + 3 * i, 3 * sizeof *place);
    }
    mem_free(place);
    p->n = n + taken;
    if (!rc && taken)
        rc = init_ground_colours(p, n, e);
    if (!rc && taken)
        log_info("init", "%zu points, and %zu places of ground without", n, taken);
    return rc;
}

/* Random ones of the dense points in the cell or near it, behind the points there are. */
static enum err_code init_dense(const struct init_input *in, struct init_points *p, struct err *e)
{
    size_t n = p->n, most = (size_t)(in->dense_share * (double)in->limit), found = 0, taken = 0;
    bool *near = mem_array(in->n_dense + 1, sizeof *near);
    for (size_t i = 0; near && i < in->n_dense; i++) {
        const float *x = in->dense + INIT_DENSE * i;
        near[i] = in->cell->whole ||
                  cell_distance(in->cell, (double)x[0], (double)x[1]) <= in->cell->edge_m;
        found += near[i];
    }
    most = most < in->limit - n ? most : in->limit - n;
    most = most < found ? most : found;
    uint64_t stream = train_stream(TRAIN_STREAM_INIT, 1, 1);
    double *enu_m = mem_resize(p->enu_m, 3 * n, 3 * (n + most), sizeof *enu_m);
    p->enu_m = enu_m ? enu_m : p->enu_m;
    uint8_t *rgb = mem_resize(p->rgb, 3 * n, 3 * (n + most), 1);
    p->rgb = rgb ? rgb : p->rgb;
    enum err_code rc = near && enu_m && rgb
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "init: out of memory for %zu points", in->n_dense);
    for (size_t i = 0, passed = 0; !rc && i < in->n_dense && taken < most; i++) {
        const float *x = in->dense + INIT_DENSE * i;
        if (!near[i])
            continue;
        double left = (double)(found - passed++), want = (double)(most - taken); /* as above */
        if (rng_unit(in->seed, stream, i) * left >= want)
            continue;
        for (size_t k = 0; k < 3; k++) {
            p->enu_m[3 * (n + taken) + k] = (double)x[k];
            p->rgb[3 * (n + taken) + k] = (uint8_t)fminf(fmaxf(x[3 + k], 0.0f), 255.0f);
        }
        taken++;
    }
    p->n = n + taken;
    if (!rc)
        log_info("init", "%zu of %zu points of stereo", taken, found);
    mem_free(near);
    return rc;
}

static enum err_code init_pick(const struct init_input *in, struct init_points *p, struct err *e)
{
    const struct scene *s = in->scene;
    enum err_code rc = ERR_OK;
    size_t n_use = 0;
    uint8_t *use = mem_array(s->n_points, 1), *seen = mem_array(s->n_images, 1);
    if (use && seen) {
        n_use = init_mark_points(s, in->images, in->n_images, in->cell->whole, use, seen);
        if (!in->no_masks)
            rc = init_drop_masked(s, in->images, in->n_images, use, &n_use, e);
    }
    if (!rc && use && seen) {
        p->n = init_count(n_use, in->limit);
        p->enu_m = mem_array(3 * p->n, sizeof *p->enu_m);
        p->rgb = mem_array(3 * p->n, 1);
    }
    if (!rc && (!p->enu_m || !p->rgb))
        rc = err_set(e, ERR_MEM, "init: out of memory for %zu points", s->n_points);
    if (!rc && n_use)
        init_scene_points(s, use, n_use, in->seed, p);
    else if (!rc)
        init_random_points(s, in->images, in->n_images, in->cell, in->seed, p);
    if (!rc && n_use && in->ground && in->ground_share > 0.0)
        rc = init_ground(in, p, e);
    if (!rc && in->n_dense)
        rc = init_dense(in, p, e);
    mem_free(use);
    mem_free(seen);
    return rc;
}

enum err_code init_gauss(const struct init_input *in, struct gauss *out, struct err *e)
{
    struct init_points p = {0};
    *out = (struct gauss){0};
    enum err_code rc = init_pick(in, &p, e);
    if (!rc)
        rc = gauss_alloc(out, p.n, in->sh_degree, 0, e);
    if (!rc)
        rc = init_fill(&p, in->cell, out, e);
    if (rc)
        gauss_free(out);
    mem_free(p.enu_m);
    mem_free(p.rgb);
    return rc;
}

/* ---- from a coarse model of the whole scene ---- */

enum { INIT_LOOK_POINTS = 20000 /* enough for shares */ };
enum init_part { INIT_INSIDE, INIT_AROUND_IT, INIT_UNSEEN };

static enum init_part init_part_of(const double enu_m[3], struct init_views *views,
                                   const struct cell *cell)
{
    if (cell_distance(cell, enu_m[0], enu_m[1]) <= 0.0)
        return INIT_INSIDE;
    return init_is_seen(views, enu_m) ? INIT_AROUND_IT : INIT_UNSEEN;
}

static enum init_part init_part(const struct gauss *coarse, size_t row, struct init_views *views,
                                const struct cell *cell)
{
    double x[3];
    for (int k = 0; k < 3; k++)
        x[k] = coarse->origin_enu_m[k] + (double)coarse->mean_m[3 * row + k];
    return init_part_of(x, views, cell);
}

enum err_code init_point_shares(const struct scene *s, const uint32_t *images,
                                const struct camera_window *windows, size_t n_images,
                                const struct cell *cell, double *inside, double *around,
                                struct err *e)
{
    const size_t step = s->n_points / INIT_LOOK_POINTS + 1;
    struct init_views views;
    double n = 0.0;
    *inside = *around = 0.0;
    enum err_code rc = init_views_open(&views, s, images, windows, n_images, e);
    for (size_t i = 0; !rc && i < s->n_points; i += step) {
        enum init_part part = init_part_of(s->points[i].enu_m, &views, cell);
        *inside += part == INIT_INSIDE;
        *around += part == INIT_AROUND_IT;
        n++;
    }
    mem_free(views.part);
    *inside /= fmax(n, 1.0);
    *around /= fmax(n, 1.0);
    return rc;
}

enum err_code init_count_around(const struct gauss *coarse, const struct scene *s,
                                const uint32_t *images, const struct camera_window *windows,
                                size_t n_images, const struct cell *cell, size_t *out,
                                struct err *e)
{
    struct init_views views;
    enum err_code rc = init_views_open(&views, s, images, windows, n_images, e);
    *out = 0;
    for (size_t i = 0; !rc && i < coarse->n; i++)
        *out += init_part(coarse, i, &views, cell) == INIT_AROUND_IT;
    mem_free(views.part);
    return rc;
}

/* An even random choice of `most` of n rows, in place. Returns the logarithm of how much longer
 * those must be that stay, so that they cover what all did (stochastic simplification, Cook 2007).
 */
static float init_thin(uint32_t *rows, size_t n, size_t most, uint64_t seed)
{
    uint64_t stream = train_stream(TRAIN_STREAM_INIT, 1, 0);
    size_t taken = 0;
    for (size_t i = 0; i < n && taken < most; i++) {
        double left = (double)(n - i), want = (double)(most - taken);
        if (rng_unit(seed, stream, i) * left < want)
            rows[taken++] = rows[i];
    }
    return most ? (float)fmin(0.5 * log((double)n / (double)most), log(INIT_THIN_MOST)) : 0.0f;
}

enum err_code init_coarse(const struct init_input *in, const struct gauss *coarse,
                          struct gauss *out, struct err *e)
{
    uint32_t *rows = mem_array(coarse->n, sizeof *rows),
             *around = mem_array(coarse->n, sizeof *rows);
    size_t n = 0, n_around = 0, most = 0;
    float longer = 0.0f;
    struct init_views views;
    *out = (struct gauss){0};
    enum err_code rc = init_views_open(&views, in->scene, in->images, in->windows, in->n_images, e);
    if (!rc && (!rows || !around))
        rc = err_set(e, ERR_MEM, "init: out of memory for %zu Gaussians", (size_t)coarse->n);
    if (rc)
        goto end;
    for (size_t i = 0; i < coarse->n; i++) {
        enum init_part part = init_part(coarse, i, &views, in->cell);
        if (part == INIT_INSIDE)
            rows[n++] = (uint32_t)i;
        else if (part == INIT_AROUND_IT)
            around[n_around++] = (uint32_t)i;
    }
    most = n < in->limit ? n : in->limit;
    longer = init_thin(rows, n, most, in->seed);
    log_info("init", "of the coarse model %zu of %zu Gaussians in the cell, and %zu around it",
             most, n, n_around);
    rc = gauss_alloc(out, most + n_around, in->sh_degree, coarse->embed_len, e);
    if (!rc) {
        out->antialiased = coarse->antialiased;
        memcpy(out->origin_enu_m, coarse->origin_enu_m, sizeof out->origin_enu_m);
        rc = gauss_append(out, coarse, rows, most, e);
    }
    if (!rc)
        rc = gauss_append(out, coarse, around, n_around, e);
    for (size_t i = 0; !rc && i < 3 * most; i++)
        out->scale_log[i] += longer;
    if (rc)
        gauss_free(out);
end:
    mem_free(views.part);
    mem_free(rows);
    mem_free(around);
    return rc;
}
