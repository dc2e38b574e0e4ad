/* Locating ground control points and fitting to them: see gcp_fit.h.
 *
 * A point that is marked in several photographs lies where its rays pass each other most closely.
 * One that is marked in a single photograph lies on its ray, at the height of the sparse points
 * that the photograph sees around the mark: as good as the ground there is level.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "ingest/gcp_fit.h"

#include <math.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"

static const double ray_angle_least = 0.01; /* rad between two rays, below it they fix no point */
static const double line_share = 1e-3;  /* second to first principal variance: on a line below */
static const double sink_least = 0.1;   /* of a ray that is cut with level ground */
static const double upright_most = 0.7; /* upward part of a line about which up says nothing */
enum { NEAR_POINTS = 8 };

void gcp_fit_free(struct gcp_fit *f)
{
    mem_free(f->places);
    *f = (struct gcp_fit){0};
}

static bool gcp_fit_is_slash(char c)
{
    return c == '/' || c == '\\';
}

/* How well the path of a photograph and the one of a mark end alike, 0 for not: folders that both
 * have must be the same, capitals do not matter (cameras write .JPG), the whole path is better than
 * a part. */
static size_t gcp_fit_alike(const char *photo, const char *mark)
{
    size_t n = strlen(photo), k = strlen(mark), same = 0, least = n < k ? n : k;
    while (same < least) {
        char a = photo[n - same - 1], b = mark[k - same - 1];
        if (gcp_fit_is_slash(a) ? !gcp_fit_is_slash(b) : strncasecmp(&a, &b, 1) != 0)
            return 0;
        same++;
    }
    if ((n > least && !gcp_fit_is_slash(photo[n - least - 1])) ||
        (k > least && !gcp_fit_is_slash(mark[k - least - 1])))
        return 0;
    return 4 * same + 2 * (n == k) + !strcmp(photo, mark);
}

/* The photograph of a mark, NULL: none. Of all that COLMAP knows, also those that were dropped: the
 * mark of one must not go to another of that name. */
static enum err_code gcp_fit_photo(const struct colmap_model *m, const struct gcp_list *list,
                                   const struct gcp_mark *mark, const struct colmap_image **out,
                                   struct err *e)
{
    const struct colmap_image *best = NULL, *other = NULL;
    size_t most = 0;
    for (size_t i = 0; i < m->n_images; i++) {
        size_t alike = gcp_fit_alike(m->images[i].name, mark->image);
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

struct gcp_ray {
    const struct gcp_view *view;
    double x_px, y_px; /* of COLMAP's photograph */
    double dir[3];     /* unit, in COLMAP's frame */
    double along;      /* dir over depth */
};

static bool gcp_fit_ray(const struct gcp_view *v, double x_px, double y_px, struct gcp_ray *out)
{
    double d[3] = {0, 0, 1};
    if (!lens_undistort(v->lens, x_px, y_px, &d[0], &d[1]))
        return false;
    double len = sqrt(d[0] * d[0] + d[1] * d[1] + 1);
    *out = (struct gcp_ray){.view = v, .x_px = x_px, .y_px = y_px, .along = len};
    for (size_t k = 0; k < 3; k++)
        out->dir[k] = (v->rot[k] * d[0] + v->rot[3 + k] * d[1] + v->rot[6 + k] * d[2]) / len;
    return true;
}

/* Solve a x = b for symmetric positive a, by its inverse. */
static bool gcp_fit_solve(const double a[9], const double b[3], double x[3])
{
    double c[9] = {a[4] * a[8] - a[5] * a[7], a[2] * a[7] - a[1] * a[8], a[1] * a[5] - a[2] * a[4],
                   a[5] * a[6] - a[3] * a[8], a[0] * a[8] - a[2] * a[6], a[2] * a[3] - a[0] * a[5],
                   a[3] * a[7] - a[4] * a[6], a[1] * a[6] - a[0] * a[7], a[0] * a[4] - a[1] * a[3]};
    double det = a[0] * c[0] + a[1] * c[3] + a[2] * c[6];
    if (!(fabs(det) > 1e-12))
        return false;
    for (size_t r = 0; r < 3; r++)
        x[r] = (c[3 * r] * b[0] + c[3 * r + 1] * b[1] + c[3 * r + 2] * b[2]) / det;
    return true;
}

/* Least squares of the distances to all rays. False: they are too nearly parallel. */
static bool gcp_fit_meet(const struct gcp_ray *ray, size_t n, double x[3])
{
    double a[9] = {0}, b[3] = {0}, least = 1;
    for (size_t i = 0; i < n; i++) {
        const double *d = ray[i].dir, *c = ray[i].view->center;
        double dc = d[0] * c[0] + d[1] * c[1] + d[2] * c[2];
        for (size_t r = 0; r < 3; r++) {
            b[r] += c[r] - d[r] * dc;
            for (size_t k = 0; k < 3; k++)
                a[3 * r + k] += (r == k) - d[r] * d[k];
        }
        for (size_t k = 0; k < i; k++)
            least = fmin(least,
                         fabs(d[0] * ray[k].dir[0] + d[1] * ray[k].dir[1] + d[2] * ray[k].dir[2]));
    }
    return least < cos(ray_angle_least) && gcp_fit_solve(a, b, x);
}

/* The ray meets the level plane at the height of the sparse points around the mark, the nearer the
 * weightier; where nobody knows what is level, or the ray runs along it, it ends at their depth. */
static bool gcp_fit_depth(const struct colmap_model *m, const struct gcp_ray *ray,
                          const double up[3], double x[3], double *gap_px)
{
    struct {
        double gap, at;
    } near[NEAR_POINTS];
    const struct gcp_view *v = ray->view;
    double sink = -(up[0] * ray->dir[0] + up[1] * ray->dir[1] + up[2] * ray->dir[2]);
    bool level = sink > sink_least;
    size_t n = 0;
    for (size_t i = 0; i < v->image->n_obs; i++) {
        const struct colmap_observation *o = &v->image->obs[i];
        if (o->point < 0)
            continue;
        const double *p = m->points[o->point].xyz,
                     d[3] = {p[0] - v->center[0], p[1] - v->center[1], p[2] - v->center[2]};
        double gap = hypot(o->x_px - ray->x_px, o->y_px - ray->y_px),
               depth = v->rot[6] * d[0] + v->rot[7] * d[1] + v->rot[8] * d[2],
               below = -(up[0] * d[0] + up[1] * d[1] + up[2] * d[2]);
        if (!(depth > 0) || (level && !(below > 0)) || (n == NEAR_POINTS && gap >= near[n - 1].gap))
            continue;
        size_t at = n < NEAR_POINTS ? n++ : NEAR_POINTS - 1;
        for (; at > 0 && near[at - 1].gap > gap; at--)
            near[at] = near[at - 1];
        near[at].gap = gap;
        near[at].at = level ? below / sink : depth * ray->along;
    }
    double sum = 0, weight = 0;
    for (size_t i = 0; i < n; i++) {
        double w = 1 / (near[i].gap * near[i].gap + 1);
        sum += w * near[i].at;
        weight += w;
    }
    if (!n)
        return false;
    *gap_px = near[0].gap;
    for (size_t k = 0; k < 3; k++)
        x[k] = v->center[k] + sum / weight * ray->dir[k];
    return true;
}

static enum err_code gcp_fit_locate(const struct gcp_fit *f, const struct colmap_model *m,
                                    const struct gcp_view *views, size_t n_views, double px_scale,
                                    const double up[3], size_t i, struct gcp_ray *ray,
                                    struct err *e)
{
    struct gcp_place *p = &f->places[i];
    size_t n = 0;
    for (size_t k = 0; k < f->list->n_marks; k++) {
        const struct gcp_mark *mark = &f->list->marks[k];
        const struct colmap_image *photo = NULL;
        enum err_code rc = mark->gcp == i ? gcp_fit_photo(m, f->list, mark, &photo, e) : ERR_OK;
        if (rc)
            return rc;
        for (size_t v = 0; photo && v < n_views; v++) {
            if (views[v].image != photo)
                continue;
            double x = mark->x_px / px_scale, y = mark->y_px / px_scale;
            const struct lens *l = views[v].lens;
            if (x < 0 || y < 0 || x > l->width_px || y > l->height_px)
                return err_set(
                    e, ERR_DATA,
                    "ground control point %s: mark %.0f, %.0f lies outside of %s, which "
                    "is %u x %u px for COLMAP; if it was marked in photographs of another "
                    "size give --gcp-scale, their width over %u",
                    f->list->gcps[i].name, mark->x_px, mark->y_px, mark->image, l->width_px,
                    l->height_px, l->width_px);
            n += gcp_fit_ray(&views[v], x, y, &ray[n]);
            break;
        }
    }
    p->n_photos = n;
    if (n >= 2 && gcp_fit_meet(ray, n, p->x))
        return ERR_OK;
    p->by_points = true;
    if (n && !gcp_fit_depth(m, &ray[0], up, p->x, &p->gap_px))
        p->n_photos = 0;
    return ERR_OK;
}

/* Three points that are not on a line fix everything. Of two, or of more on a line, the survey
 * could turn about that line: then the ground that the sparse points make out says what is
 * level. */
static enum err_code gcp_fit_check(struct gcp_fit *f, const double (*y)[3], const uint32_t *index,
                                   size_t n, const double up[3], struct err *e)
{
    double mean[3] = {0}, cov[9] = {0}, values[3], vectors[9];
    bool known_up = up[0] != 0 || up[1] != 0 || up[2] != 0;
    if (n < 2)
        return err_set(e, ERR_DATA,
                       "%zu of %zu ground control points to fit to %s marked in photographs that "
                       "were kept: at least 2 are needed, better 4; are the photographs named as "
                       "in the list?%s",
                       n, f->list->n, n == 1 ? "is" : "are",
                       f->n_check ? " Or keep fewer out by --check" : "");
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < 3; k++)
            mean[k] += y[index[i]][k] / (double)n;
    for (size_t i = 0; i < n; i++)
        for (size_t r = 0; r < 3; r++)
            for (size_t k = 0; k < 3; k++)
                cov[3 * r + k] += (y[index[i]][r] - mean[r]) * (y[index[i]][k] - mean[k]);
    sim3_eigen(cov, 3, values, vectors);
    f->level_by_points = !(values[1] > line_share * values[2]);
    if (f->level_by_points && (!known_up || fabs(vectors[8]) > upright_most))
        return err_set(e, ERR_DATA,
                       "the %zu ground control points lie on a line, and the sparse points make "
                       "out no level ground: give a point beside that line",
                       n);
    if (f->level_by_points)
        log_warn("ingest",
                 "%zu ground control points on a line: what is level about it comes from "
                 "the sparse points; give one beside the line",
                 n);
    return ERR_OK;
}

static void gcp_fit_judge(struct gcp_fit *f, const double (*y)[3])
{
    double sum[2][2] = {{0}};
    for (size_t i = 0; i < f->list->n; i++) {
        struct gcp_place *p = &f->places[i];
        double at[3], *s = sum[f->list->gcps[i].check];
        if (!p->n_photos)
            continue;
        sim3_apply(&f->sim, p->x, at);
        for (size_t k = 0; k < 3; k++)
            p->residual_m[k] = at[k] - y[i][k];
        s[0] += p->residual_m[0] * p->residual_m[0] + p->residual_m[1] * p->residual_m[1];
        s[1] += p->residual_m[2] * p->residual_m[2];
    }
    f->control_plan_m = sqrt(sum[0][0] / (double)f->n_control);
    f->control_height_m = sqrt(sum[0][1] / (double)f->n_control);
    f->check_plan_m = f->n_check ? sqrt(sum[1][0] / (double)f->n_check) : (double)NAN;
    f->check_height_m = f->n_check ? sqrt(sum[1][1] / (double)f->n_check) : (double)NAN;
}

enum err_code gcp_fit_make(const struct gcp_list *list, const struct colmap_model *m,
                           const struct gcp_view *views, size_t n_views, double px_scale,
                           double height_offset_m, const double up[3], struct gcp_fit *out,
                           struct err *e)
{
    size_t n = list->n;
    struct gcp_fit f = {
        .list = list,
        .places = mem_array(n, sizeof *f.places),
        .frame = {list->gcps[0].at[0], list->gcps[0].at[1], list->gcps[0].at[2] + height_offset_m}};
    struct gcp_ray *ray = mem_array(list->n_marks, sizeof *ray);
    double(*x)[3] = mem_array(n, sizeof *x), (*y)[3] = mem_array(n, sizeof *y);
    uint32_t *index = mem_array(n, sizeof *index);
    enum err_code rc = f.places && ray && x && y && index
                           ? ERR_OK
                           : err_set(e, ERR_MEM, "out of memory for ground control points");
    for (size_t i = 0; !rc && i < n; i++) {
        const struct gcp *g = &list->gcps[i];
        rc = geo_to_enu(&f.frame, g->at[0], g->at[1], g->at[2] + height_offset_m, y[i], e);
        if (!rc)
            rc = gcp_fit_locate(&f, m, views, n_views, px_scale, up, i, ray, e);
        if (rc || !f.places[i].n_photos)
            continue;
        memcpy(x[i], f.places[i].x, sizeof x[i]);
        if (g->check)
            f.n_check++;
        else
            index[f.n_control++] = (uint32_t)i;
    }
    if (!rc)
        rc = gcp_fit_check(&f, (const double(*)[3])y, index, f.n_control, up, e);
    if (!rc && !sim3_from_pairs((const double(*)[3])x, (const double(*)[3])y, index, f.n_control,
                                up, &f.sim))
        rc = err_set(e, ERR_DATA,
                     "the ground control points do not fit the poses at any scale: are "
                     "they marked in the right photographs?");
    if (!rc)
        gcp_fit_judge(&f, (const double(*)[3])y);
    mem_free(ray);
    mem_free(x);
    mem_free(y);
    mem_free(index);
    if (rc)
        gcp_fit_free(&f);
    *out = f;
    return rc;
}
