/* Which photographs see which point: OpenSfM's tracks.csv, or computed where it is not there.
 *
 * A line of tracks.csv is: photograph, track, feature, x, y, and more that is not needed, with tabs
 * between. x and y count from the picture's middle, in larger sides. A point of the reconstruction
 * has the name of its track. Where the file is missing, a point counts as seen by the photographs
 * into whose picture it projects, unless another point that projects nearby lies well before it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "codec/scene/odm_parts.h"

enum { ODM_LEAST = 2, ODM_GRID = 96 /* cells along the larger side, for what hides a point */ };
static const double odm_before = 0.95; /* a point at less than this part of the depth hides */

struct odm_sight { /* of a point in a photograph */
    uint32_t point, image;
    double x_px, y_px;
};
struct odm_sights {
    struct odm_sight *list;
    size_t n, cap;
};

static enum err_code odm_sight_add(struct odm_sights *s, const struct odm_sight *one, struct err *e)
{
    struct odm_sight *list = mem_room(s->list, s->n, &s->cap, 4096, sizeof *list);
    if (!list)
        return err_set(e, ERR_MEM, "out of memory for %zu observations", s->n + 1);
    s->list = list;
    s->list[s->n++] = *one;
    return ERR_OK;
}

/* ---- tracks.csv ---- */

static bool odm_coordinate(const char *text, double *out)
{
    return number_list(text, 1, out) && fabs(*out) <= 1;
}

static enum err_code odm_track_line(char *line, const struct odm_keys *names,
                                    const struct odm_keys *points, const struct colmap_model *m,
                                    struct odm_sights *s, struct err *e)
{
    enum { IMAGE, TRACK, FEATURE, X, Y, FIELDS };
    char *field[FIELDS];
    size_t n = 0;
    for (char *p = line; p && n < FIELDS; n++) {
        field[n] = p;
        p = strchr(p, '\t');
        if (p)
            *p++ = '\0';
    }
    double x, y;
    if (n < FIELDS || !odm_coordinate(field[X], &x) || !odm_coordinate(field[Y], &y))
        return err_set(e, ERR_FORMAT,
                       "expected are photograph, track, feature, x and y with tabs between, x and "
                       "y in larger sides of the picture");
    uint32_t image = odm_keys_find(names, field[IMAGE]),
             point = odm_keys_find(points, field[TRACK]);
    if (image == UINT32_MAX || point == UINT32_MAX)
        return ERR_OK; /* of another reconstruction, or dropped by the adjustment */
    const struct lens *l = &m->cameras[m->images[image].camera].lens;
    double side = l->width_px > l->height_px ? l->width_px : l->height_px;
    return odm_sight_add(s,
                         &(struct odm_sight){point, image, 0.5 * l->width_px + side * x,
                                             0.5 * l->height_px + side * y},
                         e);
}

static enum err_code odm_tracks_read(const char *path, const struct odm_keys *names,
                                     const struct odm_keys *points, const struct colmap_model *m,
                                     struct odm_sights *s, struct err *e)
{
    struct buf file = {0};
    size_t number = 0;
    enum err_code rc = file_read(path, 0, &file, e);
    if (!rc) {
        buf_u8(&file, 0);
        rc = buf_check(&file, e);
    }
    char *line = rc ? NULL : (char *)file.data, *end = rc ? NULL : line + file.size - 1;
    while (!rc && line < end) {
        char *stop = memchr(line, '\n', (size_t)(end - line)), *next = stop ? stop + 1 : end;
        if (stop)
            *stop = '\0';
        number++;
        line[strcspn(line, "\r")] = '\0';
        if (*line && !(number == 1 && !strncmp(line, "OPENSFM_TRACKS_VERSION", 22)))
            rc = odm_track_line(line, names, points, m, s, e);
        line = next;
    }
    if (rc && number)
        err_add(e, "%s: line %zu", path, number);
    buf_free(&file);
    return rc;
}

/* ---- computed ---- */

/* Where a point projects; false: behind, or outside the picture. */
static bool odm_project_point(const struct lens *l, const struct camera *c, const double at[3],
                              double px[2], double *depth)
{
    double t[3], fx, fy, cx, cy;
    for (int i = 0; i < 3; i++)
        t[i] = c->rot[3 * i] * at[0] + c->rot[3 * i + 1] * at[1] + c->rot[3 * i + 2] * at[2] +
               c->trans[i];
    if (!(t[2] > 0))
        return false;
    double x = t[0] / t[2], y = t[1] / t[2];
    lens_focal(l, &fx, &fy, &cx, &cy);
    if (!(fabs(x * fx) <= l->width_px && fabs(y * fy) <= l->height_px))
        return false; /* far outside, where a distortion may fold back */
    lens_distort(l, x, y, &px[0], &px[1]);
    *depth = t[2];
    return px[0] >= 0 && px[1] >= 0 && px[0] < l->width_px && px[1] < l->height_px;
}

static size_t odm_cell(const struct lens *l, const double px[2])
{
    double side = l->width_px > l->height_px ? l->width_px : l->height_px;
    size_t x = (size_t)(px[0] * ODM_GRID / side), y = (size_t)(px[1] * ODM_GRID / side);
    x = x < ODM_GRID ? x : ODM_GRID - 1; /* a product may be rounded up to the edge */
    y = y < ODM_GRID ? y : ODM_GRID - 1;
    return y * ODM_GRID + x;
}

static enum err_code odm_links_of(const struct colmap_model *m, uint32_t image, double *nearest,
                                  struct odm_sights *s, struct err *e)
{
    const struct colmap_image *im = &m->images[image];
    const struct lens *l = &m->cameras[im->camera].lens;
    struct camera c = {0};
    double px[2], depth;
    enum err_code rc = ERR_OK;
    camera_quat_to_rot(im->quat_wxyz, c.rot);
    memcpy(c.trans, im->trans, sizeof c.trans);
    for (size_t i = 0; i < (size_t)ODM_GRID * ODM_GRID; i++)
        nearest[i] = (double)INFINITY;
    for (size_t p = 0; p < m->n_points; p++)
        if (odm_project_point(l, &c, m->points[p].xyz, px, &depth))
            nearest[odm_cell(l, px)] = fmin(nearest[odm_cell(l, px)], depth);
    for (size_t p = 0; !rc && p < m->n_points; p++)
        if (odm_project_point(l, &c, m->points[p].xyz, px, &depth) &&
            odm_before * depth <= nearest[odm_cell(l, px)])
            rc = odm_sight_add(s, &(struct odm_sight){(uint32_t)p, image, px[0], px[1]}, e);
    return rc;
}

static enum err_code odm_links_compute(const struct colmap_model *m, struct odm_sights *s,
                                       struct err *e)
{
    double *nearest = mem_array((size_t)ODM_GRID * ODM_GRID, sizeof *nearest);
    enum err_code rc = nearest ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
    for (size_t i = 0; !rc && i < m->n_images; i++)
        rc = signals_stopping() ? err_set(e, ERR_CANCEL, "stopped")
                                : odm_links_of(m, (uint32_t)i, nearest, s, e);
    mem_free(nearest);
    return rc;
}

/* ---- both ---- */

static int odm_sight_compare(const void *a, const void *b)
{
    const struct odm_sight *p = a, *q = b;
    if (p->point != q->point)
        return p->point < q->point ? -1 : 1;
    if (p->image != q->image)
        return p->image < q->image ? -1 : 1;
    if (p->x_px != q->x_px)
        return p->x_px < q->x_px ? -1 : 1;
    return (p->y_px > q->y_px) - (p->y_px < q->y_px);
}

/* Sorts by point. One observation a photograph and point; points that are seen less often than
 * twice go. */
static void odm_sights_clean(struct odm_sights *s, struct odm_project *out)
{
    struct colmap_model *m = &out->model;
    size_t n = 0, kept = 0, at = 0;
    qsort(s->list, s->n, sizeof *s->list, odm_sight_compare);
    for (size_t p = 0; p < m->n_points; p++) {
        size_t first = n;
        for (; at < s->n && s->list[at].point == p; at++)
            if (n == first || s->list[n - 1].image != s->list[at].image)
                s->list[n++] = s->list[at];
        if (n - first < ODM_LEAST) {
            n = first;
            continue;
        }
        for (size_t k = first; k < n; k++)
            s->list[k].point = (uint32_t)kept;
        m->points[kept] = m->points[p];
        m->points[kept].track = first;
        m->points[kept].n_track = n - first;
        kept++;
    }
    out->n_alone = m->n_points - kept;
    m->n_points = kept;
    s->n = n;
}

/* Mean distance in pixels between a point's observations and where it projects. */
static double odm_error_of(const struct colmap_model *m, const struct odm_sight *s, size_t n)
{
    double sum = 0, px[2], depth;
    size_t used = 0;
    for (size_t k = 0; k < n; k++) {
        const struct colmap_image *im = &m->images[s[k].image];
        struct camera c = {0};
        camera_quat_to_rot(im->quat_wxyz, c.rot);
        memcpy(c.trans, im->trans, sizeof c.trans);
        if (!odm_project_point(&m->cameras[im->camera].lens, &c, m->points[s[k].point].xyz, px,
                               &depth))
            continue;
        sum += hypot(px[0] - s[k].x_px, px[1] - s[k].y_px);
        used++;
    }
    return used ? sum / (double)used : 0;
}

static enum err_code odm_sights_assemble(const struct odm_sights *s, struct colmap_model *m,
                                         struct err *e)
{
    struct colmap_observation *obs = arena_get(&m->arena, s->n, sizeof *obs);
    m->tracks = arena_get(&m->arena, s->n, sizeof *m->tracks);
    if (!obs || !m->tracks)
        return err_set(e, ERR_MEM, "out of memory for %zu observations", s->n);
    m->n_tracks = s->n;
    for (size_t k = 0; k < s->n; k++)
        m->images[s->list[k].image].n_obs++;
    for (size_t i = 0; i < m->n_images; i++) {
        m->images[i].obs = obs;
        obs += m->images[i].n_obs;
        m->images[i].n_obs = 0;
    }
    for (size_t p = 0; p < m->n_points; p++)
        m->points[p].error_px = odm_error_of(m, s->list + m->points[p].track, m->points[p].n_track);
    for (size_t k = 0; k < s->n; k++) {
        const struct odm_sight *one = &s->list[k];
        struct colmap_image *im = &m->images[one->image];
        m->tracks[k] = (struct colmap_track_element){one->image, (uint32_t)im->n_obs};
        im->obs[im->n_obs++] = (struct colmap_observation){one->x_px, one->y_px, one->point};
    }
    return ERR_OK;
}

enum err_code odm_tracks_link(const char *path, const struct odm_keys *names,
                              const struct odm_keys *points, struct odm_project *out, struct err *e)
{
    struct odm_sights s = {0};
    out->links = !out->model.n_points ? ODM_LINKS_NONE
                 : path               ? ODM_LINKS_TRACKS
                                      : ODM_LINKS_COMPUTED;
    enum err_code rc = out->links == ODM_LINKS_NONE ? ERR_OK
                       : path ? odm_tracks_read(path, names, points, &out->model, &s, e)
                              : odm_links_compute(&out->model, &s, e);
    if (!rc && s.n)
        odm_sights_clean(&s, out);
    else if (!rc) {
        out->n_alone = out->model.n_points;
        out->model.n_points = 0;
    }
    if (!rc)
        rc = odm_sights_assemble(&s, &out->model, e);
    mem_free(s.list);
    return rc;
}
