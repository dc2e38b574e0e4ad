/* Grid, assignment by location and visibility, rebalancing, ownership. See partition.h.
 *
 * The hull of all scene points that a photograph could see does not depend on the cells, so it is
 * computed once a photograph. Only the leftmost and rightmost point of an image row can lie on the
 * hull, so there are at most two candidates a row. Rebalancing keeps cells rectangular: two cells
 * are merged only if their union is a rectangle with an aspect of at most 2.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/partition.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "core/splat/camera.h"

enum {
    PARTITION_TRACK_MIN = 3,  /* "reliable" point: seen in three photographs ... */
    PARTITION_STEPS_MAX = 64, /* rebalancing ends here */
    PARTITION_CELLS_MAX = 4096,
    PARTITION_BORDER_PX =
        64, /* points this far outside the picture still count, clamped to its edge */
    PARTITION_RELAX =
        4, /* cells without a camera of their own: gate times, threshold divided by this */
    PARTITION_ASPECT_MAX = 2,
    PARTITION_SNAP = 8, /* cuts lie on multiples of P/8 */
};
#define PARTITION_ERROR_PX 2.0f /* ... with at most this reprojection error */
#define PARTITION_NEAR_M 0.01
/* As published: photographs farther than P are not considered, and a sixth of a view is needed. */
#define PARTITION_GATE 1.0
#define PARTITION_VISIBILITY (1.0 / 6.0)
#define PARTITION_EPS_M 1e-6

struct partition_config partition_defaults(void)
{
    return (struct partition_config){.edge_m = 0.0,
                                     .location_margin = 0.1,
                                     .images_few = 64,
                                     .images_many = 1200,
                                     .images_least = 32,
                                     .use_visibility = true};
}

/* ---- convex hulls ---- */

struct xy {
    double x, y;
};

static int partition_compare_xy(const void *a, const void *b)
{
    const struct xy *p = a, *q = b;
    if (p->x < q->x || p->x > q->x)
        return p->x < q->x ? -1 : 1;
    return (p->y > q->y) - (p->y < q->y);
}

static double partition_cross(struct xy o, struct xy a, struct xy b)
{
    return (a.x - o.x) * (b.y - o.y) - (a.y - o.y) * (b.x - o.x);
}

/* Area of the convex hull (Andrew's monotone chain). Sorts p; `hull` holds 2 n. 0 for n < 3 or
 * collinear. */
static double partition_hull_area(struct xy *p, size_t n, struct xy *hull)
{
    if (n < 3)
        return 0.0;
    qsort(p, n, sizeof *p, partition_compare_xy);
    size_t k = 0;
    for (size_t i = 0; i < n; i++) {
        while (k >= 2 && partition_cross(hull[k - 2], hull[k - 1], p[i]) <= 0.0)
            k--;
        hull[k++] = p[i];
    }
    for (size_t i = n - 1, lower = k + 1; i-- > 0;) {
        while (k >= lower && partition_cross(hull[k - 2], hull[k - 1], p[i]) <= 0.0)
            k--;
        hull[k++] = p[i];
    }
    double twice = 0.0;
    for (size_t i = 0; i + 1 < k; i++)
        twice += hull[i].x * hull[i + 1].y - hull[i + 1].x * hull[i].y;
    return 0.5 * fabs(twice);
}

/* ---- what does not depend on the cells ---- */

struct survey {
    const struct scene *scene;
    const struct partition_config *cfg;
    struct xy *center;     /* [n_images] camera centres */
    double *view_area_px2; /* [n_images] hull of everything it could see */
    bool *reliable;        /* [n_points] */
    size_t *track_first;   /* [n_images + 1] into scene.tracks */
};

/* A place in ENU along the axes of the grid. */
static struct xy partition_along(const struct cell_grid *g, const double enu_m[3])
{
    double at[2];
    cell_grid_from_enu(g, enu_m[0], enu_m[1], at);
    return (struct xy){at[0], at[1]};
}

static void partition_survey_free(struct survey *v)
{
    mem_free(v->center);
    mem_free(v->view_area_px2);
    mem_free(v->reliable);
    mem_free(v->track_first);
    *v = (struct survey){0};
}

static bool partition_survey_uses(const struct survey *v, size_t image)
{
    return v->scene->images[image].split == SCENE_TRAIN;
}

/* Project a point; false when it is behind the camera or more than the border outside. Clamps to
 * the picture. */
static bool partition_survey_project(const struct camera *c, const double enu[3], struct xy *out)
{
    double px[2], w = c->width_px, h = c->height_px;
    if (!camera_project(c, enu, PARTITION_NEAR_M, px, NULL))
        return false;
    if (!(px[0] >= -PARTITION_BORDER_PX && px[0] <= w + PARTITION_BORDER_PX &&
          px[1] >= -PARTITION_BORDER_PX && px[1] <= h + PARTITION_BORDER_PX))
        return false;
    *out = (struct xy){fmin(fmax(px[0], 0.0), w), fmin(fmax(px[1], 0.0), h)};
    return true;
}

static enum err_code partition_survey_view_area(void *user, size_t image, struct err *e)
{
    struct survey *v = user;
    const struct scene *s = v->scene;
    const struct camera *c = &s->images[image].cam;
    size_t rows = (size_t)c->height_px + 1;
    struct xy *ends = mem_array(2 * rows, sizeof *ends); /* leftmost and rightmost of each row */
    struct xy *hull = mem_array(4 * rows, sizeof *hull);
    enum err_code rc = ends && hull ? ERR_OK : err_set(e, ERR_MEM, "out of memory for a hull");
    for (size_t r = 0; !rc && r < rows; r++) {
        ends[2 * r].x = HUGE_VAL;
        ends[2 * r + 1].x = -HUGE_VAL;
    }
    for (size_t i = 0; !rc && i < s->n_points; i++) {
        struct xy p;
        if (!v->reliable[i] || !partition_survey_project(c, s->points[i].enu_m, &p))
            continue;
        size_t r = (size_t)p.y;
        if (p.x < ends[2 * r].x)
            ends[2 * r] = p;
        if (p.x > ends[2 * r + 1].x)
            ends[2 * r + 1] = p;
    }
    size_t n = 0;
    for (size_t i = 0; !rc && i < 2 * rows; i++)
        if (isfinite(ends[i].x))
            ends[n++] = ends[i];
    if (!rc)
        v->view_area_px2[image] = partition_hull_area(ends, n, hull);
    mem_free(ends);
    mem_free(hull);
    return rc;
}

static enum err_code partition_survey_make(const struct scene *s,
                                           const struct partition_config *cfg, struct survey *v,
                                           struct err *e)
{
    *v = (struct survey){.scene = s, .cfg = cfg};
    v->center = mem_array(s->n_images, sizeof *v->center);
    v->view_area_px2 = mem_array(s->n_images, sizeof *v->view_area_px2);
    v->reliable = mem_array(s->n_points, sizeof *v->reliable);
    v->track_first = mem_array(s->n_images + 1, sizeof *v->track_first);
    if (!v->center || !v->view_area_px2 || !v->reliable || !v->track_first)
        return err_set(e, ERR_MEM, "out of memory to survey %zu photographs", s->n_images);
    for (size_t i = 0; i < s->n_images; i++) {
        double c[3];
        camera_center(&s->images[i].cam, c);
        v->center[i] = partition_along(&cfg->grid, c);
    }
    for (size_t i = 0; i < s->n_points; i++)
        v->reliable[i] = s->points[i].track_length >= PARTITION_TRACK_MIN &&
                         s->points[i].error_px <= PARTITION_ERROR_PX;
    for (size_t t = 0; t < s->n_tracks; t++)
        v->track_first[s->tracks[t].image + 1]++;
    for (size_t i = 0; i < s->n_images; i++)
        v->track_first[i + 1] += v->track_first[i];
    return cfg->use_visibility ? pool_for(s->n_images, 0, partition_survey_view_area, v, e)
                               : ERR_OK;
}

/* ---- assignment ---- */

double partition_distance(const struct partition_cell *c, double x_m, double y_m)
{
    double dx = fmax(fmax(c->min_m[0] - x_m, x_m - c->max_m[0]), 0.0);
    double dy = fmax(fmax(c->min_m[1] - y_m, y_m - c->max_m[1]), 0.0);
    return sqrt(dx * dx + dy * dy);
}

/* Inside the cell grown by `grow` on each side, closed. */
static bool partition_near(const struct partition_cell *c, struct xy p, double grow)
{
    return p.x >= c->min_m[0] - grow && p.x <= c->max_m[0] + grow && p.y >= c->min_m[1] - grow &&
           p.y <= c->max_m[1] + grow;
}

/* Share of what the photograph could see that lies in the cell. `scratch` holds 3 n of its
 * observations. */
static double partition_visibility(const struct survey *v, const struct partition_cell *c,
                                   size_t image, struct xy *scratch)
{
    const struct scene *s = v->scene;
    if (!(v->view_area_px2[image] > 0.0))
        return 0.0;
    size_t n = 0, first = v->track_first[image], end = v->track_first[image + 1];
    for (size_t t = first; t < end; t++) {
        const struct scene_track *o = &s->tracks[t];
        const double *at = s->points[o->point].enu_m;
        if (v->reliable[o->point] && partition_near(c, partition_along(&v->cfg->grid, at), 0.0))
            scratch[n++] = (struct xy){(double)o->x_px, (double)o->y_px};
    }
    return partition_hull_area(scratch, n, scratch + (end - first)) / v->view_area_px2[image];
}

void partition_count_azimuth(const struct scene *s, const struct cell_grid *g,
                             struct partition_cell *c)
{
    memset(c->azimuth, 0, sizeof c->azimuth);
    for (size_t k = 0; k < c->n_images; k++) {
        double eye[3];
        camera_center(&s->images[c->images[k]].cam, eye);
        struct xy p = partition_along(g, eye);
        double dx = p.x - 0.5 * (c->min_m[0] + c->max_m[0]);
        double dy = p.y - 0.5 * (c->min_m[1] + c->max_m[1]);
        const double octant = 0.7853981633974483;
        double azimuth = atan2(dx, dy) - g->yaw_rad; /* north of the grid is turned */
        c->azimuth[(int)(floor(azimuth / octant + 0.5) + 64.0) % 8]++;
    }
}

static enum err_code partition_assign(const struct survey *v, double edge_m,
                                      struct partition_cell *c, struct arena *a, struct err *e)
{
    const struct scene *s = v->scene;
    const struct partition_config *cfg = v->cfg;
    size_t longest = 0;
    for (size_t i = 0; i < s->n_images; i++)
        if (v->track_first[i + 1] - v->track_first[i] > longest)
            longest = v->track_first[i + 1] - v->track_first[i];
    struct xy *scratch = mem_array(3 * longest + 1, sizeof *scratch);
    uint32_t *list = arena_get(a, s->n_images + 1, sizeof *list);
    if (!scratch || !list) {
        mem_free(scratch);
        return err_set(e, ERR_MEM, "out of memory to assign photographs");
    }
    c->images = list;
    c->n_images = 0;
    for (size_t i = 0; i < s->n_images; i++)
        if (partition_survey_uses(v, i) &&
            partition_near(c, v->center[i], cfg->location_margin * edge_m))
            list[c->n_images++] = (uint32_t)i;
    c->n_location = c->n_images;
    double relax = c->n_location ? 1.0 : PARTITION_RELAX;
    for (size_t i = 0, at = 0; cfg->use_visibility && i < s->n_images; i++) {
        if (at < c->n_location && list[at] == i) { /* selected by location already */
            at++;
            continue;
        }
        if (partition_survey_uses(v, i) &&
            partition_near(c, v->center[i], relax * PARTITION_GATE * edge_m) &&
            partition_visibility(v, c, i, scratch) >= PARTITION_VISIBILITY / relax)
            list[c->n_images++] = (uint32_t)i;
    }
    mem_free(scratch);
    c->n_points = 0;
    for (size_t i = 0; i < s->n_points; i++)
        c->n_points += v->reliable[i] &&
                       partition_near(c, partition_along(&cfg->grid, s->points[i].enu_m), 0.0);
    partition_count_azimuth(s, &cfg->grid, c);
    return ERR_OK;
}

/* ---- grid and rebalancing ---- */

static enum err_code partition_grid(const struct survey *v, struct partition *p, struct err *e)
{
    struct xy lo = {HUGE_VAL, HUGE_VAL}, hi = {-HUGE_VAL, -HUGE_VAL};
    for (size_t i = 0; i < v->scene->n_images; i++) {
        lo = (struct xy){fmin(lo.x, v->center[i].x), fmin(lo.y, v->center[i].y)};
        hi = (struct xy){fmax(hi.x, v->center[i].x), fmax(hi.y, v->center[i].y)};
    }
    double span = fmax(hi.x - lo.x, hi.y - lo.y) + 2.0 * PARTITION_EPS_M;
    double edge = v->cfg->edge_m > 0.0 ? v->cfg->edge_m : fmax(span, 1.0);
    p->edge_m = edge;
    double fx = ceil((hi.x - lo.x) / edge - PARTITION_EPS_M);
    double fy = ceil((hi.y - lo.y) / edge - PARTITION_EPS_M);
    if (!(fmax(fx, 1.0) * fmax(fy, 1.0) <= PARTITION_CELLS_MAX))
        return err_set(
            e, ERR_LIMIT,
            "an edge of %g m over %g m x %g m makes more than %d cells; take a larger one", edge,
            hi.x - lo.x, hi.y - lo.y, PARTITION_CELLS_MAX);
    size_t nx = fx < 1.0 ? 1 : (size_t)fx, ny = fy < 1.0 ? 1 : (size_t)fy;
    /* Without an origin it is centred on the cameras: the outer cells lose equally on all sides. */
    double x0 = 0.5 * (lo.x + hi.x - (double)nx * edge),
           y0 = 0.5 * (lo.y + hi.y - (double)ny * edge);
    if (p->grid.turned) {
        x0 = edge * floor(lo.x / edge);
        y0 = edge * floor(lo.y / edge);
        nx = (size_t)fmax(ceil((hi.x - x0) / edge), 1.0);
        ny = (size_t)fmax(ceil((hi.y - y0) / edge), 1.0);
    }
    /* A division adds a cell a step. */
    p->cells = arena_get(&p->arena, nx * ny + PARTITION_STEPS_MAX, sizeof *p->cells);
    if (!p->cells)
        return err_set(e, ERR_MEM, "out of memory for %zu cells", nx * ny);
    for (size_t j = 0; j < ny; j++)
        for (size_t i = 0; i < nx; i++) {
            struct partition_cell *c = &p->cells[p->n_cells++];
            *c = (struct partition_cell){
                .min_m = {x0 + (double)i * edge, y0 + (double)j * edge},
                .max_m = {x0 + (double)(i + 1) * edge, y0 + (double)(j + 1) * edge},
                .parent = -1};
            snprintf(c->id, sizeof c->id, "x%zuy%zu", i, j);
            enum err_code rc = partition_assign(v, edge, c, &p->arena, e);
            if (rc)
                return rc;
        }
    return ERR_OK;
}

static bool partition_same(double a, double b)
{
    return fabs(a - b) <= PARTITION_EPS_M;
}

/* Do the two share a whole edge, so that their union is a rectangle, and of what aspect? 0: no. */
static double partition_union_aspect(const struct partition_cell *a, const struct partition_cell *b)
{
    for (size_t k = 0; k < 2; k++) {
        size_t o = 1 - k;
        bool touch =
            partition_same(a->max_m[k], b->min_m[k]) || partition_same(b->max_m[k], a->min_m[k]);
        if (touch && partition_same(a->min_m[o], b->min_m[o]) &&
            partition_same(a->max_m[o], b->max_m[o])) {
            double along = (a->max_m[k] - a->min_m[k]) + (b->max_m[k] - b->min_m[k]);
            double across = a->max_m[o] - a->min_m[o];
            return fmax(along / across, across / along);
        }
    }
    return 0.0;
}

/* The poorest cell below the limit that has a partner, and its poorest partner. */
static bool partition_find_merge(const struct partition *p, size_t few, size_t *cell,
                                 size_t *partner)
{
    bool found = false;
    for (size_t i = 0; i < p->n_cells; i++) {
        if (p->cells[i].n_images >= few ||
            (found && p->cells[i].n_images >= p->cells[*cell].n_images))
            continue;
        size_t best = p->n_cells;
        for (size_t j = 0; j < p->n_cells; j++) {
            double aspect = j == i ? 0.0 : partition_union_aspect(&p->cells[i], &p->cells[j]);
            if (aspect > 0.0 && aspect <= PARTITION_ASPECT_MAX + PARTITION_EPS_M &&
                (best == p->n_cells || p->cells[j].n_images < p->cells[best].n_images))
                best = j;
        }
        if (best < p->n_cells) {
            found = true;
            *cell = i;
            *partner = best;
        }
    }
    return found;
}

static enum err_code partition_merge(const struct survey *v, struct partition *p, size_t i,
                                     size_t j, struct err *e)
{
    size_t keep = i < j ? i : j, drop = i < j ? j : i; /* the lower index keeps its id */
    struct partition_cell *c = &p->cells[keep], *d = &p->cells[drop];
    for (size_t k = 0; k < 2; k++) {
        c->min_m[k] = fmin(c->min_m[k], d->min_m[k]);
        c->max_m[k] = fmax(c->max_m[k], d->max_m[k]);
    }
    memmove(d, d + 1, (p->n_cells - drop - 1) * sizeof *d);
    p->n_cells--;
    p->n_merged++;
    return partition_assign(v, p->edge_m, c, &p->arena, e);
}

/* Bisect the longer edge at the median of the location cameras, snapped to P/8. */
static enum err_code partition_divide(const struct survey *v, struct partition *p, size_t i,
                                      struct err *e)
{
    struct partition_cell *c = &p->cells[i];
    size_t k = c->max_m[0] - c->min_m[0] >= c->max_m[1] - c->min_m[1] ? 0 : 1;
    double *at = mem_array(c->n_location, sizeof *at);
    if (!at)
        return err_set(e, ERR_MEM, "out of memory to divide a cell");
    for (size_t m = 0; m < c->n_location; m++) {
        struct xy q = v->center[c->images[m]];
        at[m] = k == 0 ? q.x : q.y;
    }
    sort_doubles(at, c->n_location);
    double step = p->edge_m / PARTITION_SNAP, lo = c->min_m[k], hi = c->max_m[k];
    double median = c->n_location ? at[c->n_location / 2] : 0.5 * (lo + hi);
    mem_free(at);
    double cut = lo + step * floor((median - lo) / step + 0.5);
    cut = fmin(fmax(cut, lo + step), hi - step);
    memmove(c + 2, c + 1, (p->n_cells - i - 1) * sizeof *c);
    p->n_cells++;
    p->n_divided++;
    c[1] = c[0];
    snprintf(c[1].id + strnlen(c[1].id, 12), sizeof c[1].id - 12, "d%zu", p->n_divided);
    c[0].max_m[k] = cut;
    c[1].min_m[k] = cut;
    enum err_code rc = partition_assign(v, p->edge_m, &c[0], &p->arena, e);
    return rc ? rc : partition_assign(v, p->edge_m, &c[1], &p->arena, e);
}

static size_t partition_find_divide(const struct partition *p, size_t many)
{
    size_t best = p->n_cells;
    for (size_t i = 0; i < p->n_cells; i++) {
        const struct partition_cell *c = &p->cells[i];
        double edge = fmax(c->max_m[0] - c->min_m[0], c->max_m[1] - c->min_m[1]);
        if (c->n_images > many && edge > 0.5 * p->edge_m + PARTITION_EPS_M &&
            (best == p->n_cells || c->n_images > p->cells[best].n_images))
            best = i;
    }
    return best;
}

static enum err_code partition_rebalance(const struct survey *v, struct partition *p, struct err *e)
{
    enum err_code rc = ERR_OK;
    size_t steps = 0, i = 0, j = 0;
    while (!rc && steps++ < PARTITION_STEPS_MAX &&
           partition_find_merge(p, v->cfg->images_few, &i, &j))
        rc = partition_merge(v, p, i, j, e);
    /* A merge undone by a division, or the other way round, would be a loop: divisions come last.
     */
    while (!rc && steps++ < PARTITION_STEPS_MAX &&
           (i = partition_find_divide(p, v->cfg->images_many)) < p->n_cells)
        rc = partition_divide(v, p, i, e);
    return rc;
}

/* Cells too poor to train become the background of the neighbour with most photographs (any cell if
 * none touches). If all are too poor, the richest is trained all the same: a small scene is still a
 * scene. */
static void partition_attach_poor(struct partition *p, size_t least)
{
    size_t richest = 0;
    for (size_t i = 1; i < p->n_cells; i++)
        if (p->cells[i].n_images > p->cells[richest].n_images)
            richest = i;
    for (size_t i = 0; i < p->n_cells; i++) {
        struct partition_cell *c = &p->cells[i];
        if (c->n_images >= least || i == richest)
            continue;
        size_t best = richest;
        double nearest = HUGE_VAL;
        for (size_t j = 0; j < p->n_cells; j++) {
            const struct partition_cell *d = &p->cells[j];
            if (j == i || (d->n_images < least && j != richest))
                continue;
            double gap = partition_distance(d, 0.5 * (c->min_m[0] + c->max_m[0]),
                                            0.5 * (c->min_m[1] + c->max_m[1]));
            if (gap < nearest - PARTITION_EPS_M ||
                (gap < nearest + PARTITION_EPS_M && d->n_images > p->cells[best].n_images)) {
                best = j;
                nearest = gap;
            }
        }
        c->parent = (ptrdiff_t)best;
    }
}

enum err_code partition_make(const struct scene *s, const struct partition_config *cfg,
                             struct partition *out, struct err *e)
{
    *out = (struct partition){0};
    if (!s->n_images)
        return err_set(e, ERR_DATA, "the scene has no photographs");
    out->grid = cfg->grid;
    struct survey v;
    enum err_code rc = partition_survey_make(s, cfg, &v, e);
    if (!rc)
        rc = partition_grid(&v, out, e);
    if (!rc)
        rc = partition_rebalance(&v, out, e);
    if (!rc)
        partition_attach_poor(out, cfg->images_least);
    partition_survey_free(&v);
    if (rc)
        partition_free(out);
    return rc;
}

void partition_free(struct partition *p)
{
    arena_free(&p->arena);
    *p = (struct partition){0};
}

static bool partition_holds(const struct partition_cell *c, const double at[2])
{
    return at[0] >= c->min_m[0] && at[0] < c->max_m[0] && at[1] >= c->min_m[1] &&
           at[1] < c->max_m[1];
}

bool partition_covers(const struct partition *p, size_t index, const double min_enu_m[2],
                      const double max_enu_m[2])
{
    bool covers = true;
    for (int corner = 0; corner < 4; corner++) {
        double at[2];
        cell_grid_from_enu(&p->grid, corner & 1 ? max_enu_m[0] : min_enu_m[0],
                           corner & 2 ? max_enu_m[1] : min_enu_m[1], at);
        covers = covers && partition_holds(&p->cells[index], at);
    }
    return covers;
}

size_t partition_owner(const struct partition *p, double x_m, double y_m)
{
    size_t best = 0;
    double nearest = HUGE_VAL, at[2];
    cell_grid_from_enu(&p->grid, x_m, y_m, at);
    for (size_t i = 0; i < p->n_cells; i++) {
        const struct partition_cell *c = &p->cells[i];
        double d = partition_holds(c, at) ? -1.0 : partition_distance(c, at[0], at[1]);
        if (d < nearest) {
            nearest = d;
            best = i;
        }
    }
    while (p->cells[best].parent >= 0)
        best = (size_t)p->cells[best].parent;
    return best;
}
