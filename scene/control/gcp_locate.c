/* Locates ground control points: see gcp_locate.h.
 *
 * A point that is marked in several photographs lies where the sum of squared distances to its
 * marks, in the pictures, is least. A point that is marked in one photograph lies on its ray, at
 * the height of the sparse points that the photograph sees around the mark. This is accurate if the
 * ground there is level.
 *
 * Each mark is also compared with the point that the other marks give. It is a suspect if leaving
 * it out lowers the sum of squares by more than errors of marks explain: then it is wrong, or the
 * pose of its photograph is. Errors of marks are those that were stated, or those that half of the
 * points show if they are larger.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp_locate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "core/math/sort.h"
#include "scene/control/table.h"

static const double ray_angle_least = 0.01; /* rad between two rays, below it they fix no point */
static const double sink_least = 0.1;       /* of a ray that is cut with level ground */
/* A normal error is beyond so many standard deviations once in 25000 marks. */
static const double mark_sigmas = 4.5;
/* Other marks whose removal explains nearly as much are suspects, too: three deviations. */
static const double mark_alike = 9;
enum { NEAR_POINTS = 8, LOCATE_STEPS = 12 };

void gcp_places_free(struct gcp_places *p)
{
    mem_free(p->places);
    mem_free(p->sights);
    *p = (struct gcp_places){0};
}

static enum err_code locate_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "out of memory for ground control points");
}

bool gcp_inverse(const double a[9], double inverse[9])
{
    double c[9] = {a[4] * a[8] - a[5] * a[7], a[2] * a[7] - a[1] * a[8], a[1] * a[5] - a[2] * a[4],
                   a[5] * a[6] - a[3] * a[8], a[0] * a[8] - a[2] * a[6], a[2] * a[3] - a[0] * a[5],
                   a[3] * a[7] - a[4] * a[6], a[1] * a[6] - a[0] * a[7], a[0] * a[4] - a[1] * a[3]};
    double det = a[0] * c[0] + a[1] * c[3] + a[2] * c[6], mean = (a[0] + a[4] + a[8]) / 3;
    if (!(det > 1e-13 * mean * mean * mean))
        return false;
    for (size_t k = 0; k < 9; k++)
        inverse[k] = c[k] / det;
    return true;
}

/* ---- which photograph ---- */

enum err_code gcp_locate_photo(const struct colmap_model *m, const struct gcp_list *list,
                               const struct gcp_mark *mark, const struct colmap_image **out,
                               struct err *e)
{
    const struct colmap_image *best = NULL, *other = NULL;
    size_t most = 0;
    for (size_t i = 0; i < m->n_images; i++) {
        size_t alike = table_alike(m->images[i].name, mark->image);
        if (alike && alike == most)
            other = &m->images[i];
        if (alike <= most)
            continue;
        best = &m->images[i];
        other = NULL;
        most = alike;
    }
    *out = best;
    if (!other)
        return ERR_OK;
    return err_set(e, ERR_DATA,
                   "ground control point %s: '%s' may be %.200s or %.200s: name it with its folder",
                   list->gcps[mark->gcp].name, mark->image, best->name, other->name);
}

static int locate_sight_compare(const void *a, const void *b)
{
    const struct gcp_sight *p = a, *q = b;
    if (p->mark->gcp != q->mark->gcp)
        return p->mark->gcp < q->mark->gcp ? -1 : 1;
    return (p->mark > q->mark) - (p->mark < q->mark);
}

static enum err_code locate_sight(const struct gcp_list *list, const struct gcp_mark *mark,
                                  const struct gcp_view *v, double px_scale, double mark_px,
                                  struct gcp_sight *out, bool *seen, struct err *e)
{
    double fx, fy, cx, cy;
    const struct lens *l = v->lens;
    struct gcp_sight s = {.mark = mark,
                          .view = v,
                          .x_px = mark->x_px / px_scale,
                          .y_px = mark->y_px / px_scale,
                          .out_px = (double)NAN,
                          .out_sigmas = (double)NAN,
                          .moves = (double)NAN,
                          .used = true};
    if (s.x_px < 0 || s.y_px < 0 || s.x_px > l->width_px || s.y_px > l->height_px)
        return err_set(e, ERR_DATA,
                       "ground control point %s: mark %.0f, %.0f lies outside of %s, which "
                       "is %u x %u px for COLMAP; if it was marked in photographs of another "
                       "size give --gcp-scale, their width over %u",
                       list->gcps[mark->gcp].name, mark->x_px, mark->y_px, mark->image, l->width_px,
                       l->height_px, l->width_px);
    lens_focal(l, &fx, &fy, &cx, &cy);
    s.focal_px = 0.5 * (fx + fy) * px_scale;
    s.sigma = (mark->sigma_px > 0 ? mark->sigma_px : mark_px) / s.focal_px;
    *seen = lens_undistort(l, s.x_px, s.y_px, &s.ray[0], &s.ray[1]);
    *out = s;
    return ERR_OK;
}

static enum err_code locate_sights(const struct gcp_list *list, const struct colmap_model *m,
                                   const struct gcp_view *views, size_t n_views, double px_scale,
                                   double mark_px, struct gcp_places *out, struct err *e)
{
    struct table_renamed renamed = {0};
    for (size_t k = 0; k < list->n_marks; k++) {
        const struct colmap_image *photo;
        enum err_code rc = gcp_locate_photo(m, list, &list->marks[k], &photo, e);
        if (rc)
            return rc;
        if (!photo && !out->n_lost++)
            out->lost = list->marks[k].image;
        if (photo)
            table_rename(&renamed, photo->name, list->marks[k].image);
        for (size_t v = 0; photo && v < n_views; v++) {
            bool seen = false;
            if (views[v].image != photo)
                continue;
            rc = locate_sight(list, &list->marks[k], &views[v], px_scale, mark_px,
                              &out->sights[out->n_sights], &seen, e);
            if (rc)
                return rc;
            out->n_sights += seen;
            break;
        }
    }
    table_tell_renamed(&renamed, "ground control points");
    qsort(out->sights, out->n_sights, sizeof *out->sights, locate_sight_compare);
    for (size_t k = 0; k < out->n_sights; k++) {
        struct gcp_place *p = &out->places[out->sights[k].mark->gcp];
        if (!p->n++)
            p->first = k;
    }
    return ERR_OK;
}

/* ---- where rays meet ---- */

static void locate_direction(const struct gcp_sight *s, double d[3])
{
    const double *r = s->view->rot, len = sqrt(s->ray[0] * s->ray[0] + s->ray[1] * s->ray[1] + 1);
    for (size_t k = 0; k < 3; k++)
        d[k] = (r[k] * s->ray[0] + r[3 + k] * s->ray[1] + r[6 + k]) / len;
}

/* Does this sight take part, with `skip` left out? */
static bool locate_counts(const struct gcp_sight *s, size_t i, size_t skip)
{
    return i != skip && s[i].used;
}

/* Least squares of the distances in space to all rays: where to begin. False: there are not two, or
 * they are too nearly parallel. */
static bool locate_begin(const struct gcp_sight *s, size_t n, size_t skip, double x[3])
{
    double a[9] = {0}, b[3] = {0}, inverse[9], least = 1;
    for (size_t i = 0; i < n; i++) {
        double d[3], other[3];
        const double *c = s[i].view->center;
        if (!locate_counts(s, i, skip))
            continue;
        locate_direction(&s[i], d);
        double dc = d[0] * c[0] + d[1] * c[1] + d[2] * c[2];
        for (size_t r = 0; r < 3; r++) {
            b[r] += c[r] - d[r] * dc;
            for (size_t k = 0; k < 3; k++)
                a[3 * r + k] += (r == k) - d[r] * d[k];
        }
        for (size_t k = 0; k < i; k++) {
            if (!locate_counts(s, k, skip))
                continue;
            locate_direction(&s[k], other);
            least = fmin(least, fabs(d[0] * other[0] + d[1] * other[1] + d[2] * other[2]));
        }
    }
    if (!(least < cos(ray_angle_least)) || !gcp_inverse(a, inverse))
        return false;
    for (size_t r = 0; r < 3; r++)
        x[r] = inverse[3 * r] * b[0] + inverse[3 * r + 1] * b[1] + inverse[3 * r + 2] * b[2];
    return true;
}

/* Mark minus place, as x / z and y / z, and its derivatives by the place. False: behind. */
static bool locate_miss(const struct gcp_sight *s, const double x[3], double miss[2],
                        double slope[2][3])
{
    const double *r = s->view->rot, *c = s->view->center;
    double p[3];
    for (size_t k = 0; k < 3; k++)
        p[k] =
            r[3 * k] * (x[0] - c[0]) + r[3 * k + 1] * (x[1] - c[1]) + r[3 * k + 2] * (x[2] - c[2]);
    if (!(p[2] > 0))
        return false;
    for (size_t a = 0; a < 2; a++) {
        miss[a] = s->ray[a] - p[a] / p[2];
        for (size_t k = 0; k < 3; k++)
            slope[a][k] = (r[3 * a + k] - p[a] / p[2] * r[6 + k]) / p[2];
    }
    return true;
}

/* The place of the marks that count without `skip`, its covariance, and the sum of squares in
 * standard deviations. False: they do not fix it. */
static bool locate_meet(const struct gcp_sight *s, size_t n, size_t skip, double x[3],
                        double cov[9], double *square)
{
    if (!locate_begin(s, n, skip, x))
        return false;
    for (size_t step = 0; step < LOCATE_STEPS; step++) {
        double a[9] = {0}, b[3] = {0}, moved = 0, size = 0;
        *square = 0;
        for (size_t i = 0; i < n; i++) {
            double miss[2], slope[2][3], w = 1 / (s[i].sigma * s[i].sigma);
            if (!locate_counts(s, i, skip))
                continue;
            if (!locate_miss(&s[i], x, miss, slope))
                return false;
            for (size_t q = 0; q < 2; q++) {
                *square += w * miss[q] * miss[q];
                for (size_t r = 0; r < 3; r++) {
                    b[r] += w * slope[q][r] * miss[q];
                    for (size_t k = 0; k < 3; k++)
                        a[3 * r + k] += w * slope[q][r] * slope[q][k];
                }
            }
        }
        if (!gcp_inverse(a, cov))
            return false;
        for (size_t r = 0; r < 3; r++) {
            double d = cov[3 * r] * b[0] + cov[3 * r + 1] * b[1] + cov[3 * r + 2] * b[2];
            x[r] += d;
            moved += d * d;
            size += cov[4 * r];
        }
        if (moved < 1e-8 * size)
            break;
    }
    return true;
}

/* The ray meets the level plane at the height of the sparse points around the mark, the nearer the
 * weightier; where nobody knows what is level, or the ray runs along it, it ends at their depth. */
static bool locate_by_points(const struct colmap_model *m, const struct gcp_sight *s,
                             const double up[3], struct gcp_place *p)
{
    struct {
        double gap, at;
    } near[NEAR_POINTS];
    const struct gcp_view *v = s->view;
    double d[3], sum = 0, square = 0, weight = 0;
    locate_direction(s, d);
    double sink = -(up[0] * d[0] + up[1] * d[1] + up[2] * d[2]);
    bool level = sink > sink_least;
    size_t n = 0;
    for (size_t i = 0; i < v->image->n_obs; i++) {
        const struct colmap_observation *o = &v->image->obs[i];
        if (o->point < 0)
            continue;
        const double *x = m->points[o->point].xyz,
                     t[3] = {x[0] - v->center[0], x[1] - v->center[1], x[2] - v->center[2]};
        double gap = hypot(o->x_px - s->x_px, o->y_px - s->y_px),
               depth = v->rot[6] * t[0] + v->rot[7] * t[1] + v->rot[8] * t[2],
               below = -(up[0] * t[0] + up[1] * t[1] + up[2] * t[2]);
        if (!(depth > 0) || (level && !(below > 0)) || (n == NEAR_POINTS && gap >= near[n - 1].gap))
            continue;
        size_t at = n < NEAR_POINTS ? n++ : NEAR_POINTS - 1;
        for (; at > 0 && near[at - 1].gap > gap; at--)
            near[at] = near[at - 1];
        near[at].gap = gap;
        near[at].at =
            level ? below / sink : depth * sqrt(s->ray[0] * s->ray[0] + s->ray[1] * s->ray[1] + 1);
    }
    for (size_t i = 0; i < n; i++) {
        double w = 1 / (near[i].gap * near[i].gap + 1);
        sum += w * near[i].at;
        square += w * near[i].at * near[i].at;
        weight += w;
    }
    if (!n)
        return false;
    double along = sum / weight, across = along * s->sigma,
           spread = square / weight - along * along + 9 * across * across;
    p->gap_px = near[0].gap;
    for (size_t r = 0; r < 3; r++) {
        p->x[r] = v->center[r] + along * d[r];
        for (size_t k = 0; k < 3; k++)
            p->cov[3 * r + k] = spread * d[r] * d[k] + across * across * ((r == k) - d[r] * d[k]);
    }
    return true;
}

/* ---- marks against each other ---- */

/* Fill in what leaving each mark out says. */
static void locate_leave_out(struct gcp_sight *s, size_t n, const struct gcp_place *p,
                             double factor)
{
    for (size_t i = 0; i < n; i++) {
        double x[3], with[3], cov[9], square, miss[2], slope[2][3], spread = 0;
        bool used = s[i].used;
        if (locate_miss(&s[i], p->x, miss, slope))
            s[i].residual_px = s[i].focal_px * hypot(miss[0], miss[1]);
        s[i].used = true;
        bool known = locate_meet(s, n, n, with, cov, &square);
        s[i].used = used;
        if (!known || !locate_meet(s, n, i, x, cov, &square) || !locate_miss(&s[i], x, miss, slope))
            continue;
        for (size_t a = 0; a < 2; a++)
            for (size_t r = 0; r < 3; r++)
                for (size_t k = 0; k < 3; k++)
                    spread += 0.5 * slope[a][r] * cov[3 * r + k] * slope[a][k];
        s[i].out_px = s[i].focal_px * hypot(miss[0], miss[1]);
        s[i].out_sigmas =
            hypot(miss[0], miss[1]) / (factor * sqrt(s[i].sigma * s[i].sigma + spread));
        s[i].moves =
            sqrt((x[0] - with[0]) * (x[0] - with[0]) + (x[1] - with[1]) * (x[1] - with[1]) +
                 (x[2] - with[2]) * (x[2] - with[2]));
    }
}

/* Take out the mark that explains most, while what it explains is more than an error of marks. */
static void locate_suspects(struct gcp_sight *s, size_t n, double factor)
{
    for (size_t left = n; left >= 3; left--) {
        double x[3], cov[9], all, without, least = HUGE_VAL;
        size_t worst = n;
        if (!locate_meet(s, n, n, x, cov, &all))
            return;
        for (size_t i = 0; i < n; i++)
            if (s[i].used && locate_meet(s, n, i, x, cov, &without) && without < least) {
                least = without;
                worst = i;
            }
        if (worst == n || !(all - least > mark_sigmas * mark_sigmas * factor * factor))
            return;
        for (size_t i = 0; i < n; i++)
            if (s[i].used && locate_meet(s, n, i, x, cov, &without) &&
                without <= least + mark_alike * factor * factor)
                s[i].suspect = true;
        s[worst].used = false;
    }
}

/* How much more marks err than was said: by the points of three marks and more, half of which may
 * be wrong. */
static enum err_code locate_factor(const struct gcp_list *list, struct gcp_places *p, struct err *e)
{
    double *v = mem_array(list->n, sizeof *v), x[3], cov[9], square;
    size_t n = 0;
    if (!v)
        return locate_no_memory(e);
    for (size_t i = 0; i < list->n; i++) {
        const struct gcp_place *at = &p->places[i];
        if (at->n >= 3 && locate_meet(p->sights + at->first, at->n, at->n, x, cov, &square))
            v[n++] = square / (double)(2 * at->n - 3);
    }
    p->factor = fmax(1, sqrt(sort_median(v, n)));
    mem_free(v);
    return ERR_OK;
}

static void locate_place(const struct colmap_model *m, const double up[3], bool use_suspects,
                         struct gcp_places *all, struct gcp_place *p)
{
    struct gcp_sight *s = all->sights + p->first;
    double square, moved = all->factor * all->factor;
    p->n_photos = p->n;
    for (size_t i = 0; i < p->n; i++)
        s[i].used = true;
    locate_suspects(s, p->n, all->factor);
    for (size_t i = 0; use_suspects && i < p->n; i++)
        s[i].used = true;
    p->by_points = !locate_meet(s, p->n, p->n, p->x, p->cov, &square);
    if (p->by_points && (!p->n || !locate_by_points(m, &s[0], up, p)))
        p->n_photos = 0;
    if (!p->n_photos)
        return;
    for (size_t k = 0; k < 9 && !p->by_points; k++)
        p->cov[k] *= moved;
    locate_leave_out(s, p->n, p, all->factor);
    for (size_t i = 0; i < p->n; i++) {
        double d = 0;
        for (size_t k = 0; k < 3; k++)
            d += (p->x[k] - s[i].view->center[k]) * (p->x[k] - s[i].view->center[k]);
        p->depth += sqrt(d) / s[i].focal_px / (double)p->n;
    }
}

enum err_code gcp_locate(const struct gcp_list *list, const struct colmap_model *m,
                         const struct gcp_view *views, size_t n_views, double px_scale,
                         double mark_px, const double up[3], bool use_suspects, double factor_most,
                         struct gcp_places *out, struct err *e)
{
    struct gcp_places p = {.places = mem_array(list->n, sizeof *p.places),
                           .sights = mem_array(list->n_marks, sizeof *p.sights),
                           .factor = 1};
    enum err_code rc = p.places && p.sights ? ERR_OK : locate_no_memory(e);
    if (!rc)
        rc = locate_sights(list, m, views, n_views, px_scale, mark_px, &p, e);
    if (!rc)
        rc = locate_factor(list, &p, e);
    p.factor = fmin(p.factor, factor_most);
    for (size_t i = 0; !rc && i < list->n; i++)
        locate_place(m, up, use_suspects, &p, &p.places[i]);
    if (rc)
        gcp_places_free(&p);
    *out = p;
    return rc;
}
