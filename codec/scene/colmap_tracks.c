/* Tracks of points and observations of photographs: two lists of the same in COLMAP's models.
 *
 * A point and the observations in its track must agree in both directions, so files of two
 * different models are refused. Other programs write only one of the two lists; the other one is
 * made from it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "codec/scene/colmap.h"
#include "codec/scene/colmap_parse.h"

enum { TRACKS_BEHIND_PX = 1000000000 }; /* error of a point behind a camera that has it */

static enum err_code tracks_check(const struct colmap_model *m, struct err *e)
{
    for (size_t p = 0; p < m->n_points; p++) {
        const struct colmap_point *pt = &m->points[p];
        for (size_t k = 0; k < pt->n_track; k++) {
            const struct colmap_track_element *t = &m->tracks[pt->track + k];
            const struct colmap_image *im = &m->images[t->image];
            if (t->obs >= im->n_obs)
                return err_set(
                    e, ERR_FORMAT,
                    "points3D: point %llu refers to observation %u of '%.200s', which has %zu; are "
                    "the files of one model?",
                    (unsigned long long)pt->id, t->obs, im->name, im->n_obs);
            if (im->obs[t->obs].point != (int64_t)p)
                return err_set(e, ERR_FORMAT,
                               "points3D: point %llu: observation %u of '%.200s' belongs to "
                               "another point; are the "
                               "files of one model?",
                               (unsigned long long)pt->id, t->obs, im->name);
        }
    }
    return ERR_OK;
}

/* The pixel that pose and lens give a point; false: it lies behind the photograph. */
static bool tracks_place(const struct colmap_model *m, const struct colmap_image *im,
                         const double xyz[3], double *u, double *v)
{
    double rot[9], at[3];
    camera_quat_to_rot(im->quat_wxyz, rot);
    for (int a = 0; a < 3; a++)
        at[a] =
            rot[3 * a] * xyz[0] + rot[3 * a + 1] * xyz[1] + rot[3 * a + 2] * xyz[2] + im->trans[a];
    if (!(at[2] > 0))
        return false;
    lens_distort(&m->cameras[im->camera].lens, at[0] / at[2], at[1] / at[2], u, v);
    return isfinite(*u) && isfinite(*v);
}

/* Some programs write which photographs see a point, and not where in them: that follows from
 * poses and lenses. A photograph does not see a point behind it. */
static enum err_code tracks_observe(struct colmap_model *m, struct err *e)
{
    size_t kept = 0;
    struct colmap_track_element *tracks = arena_get(&m->arena, m->n_tracks, sizeof *tracks);
    struct colmap_observation *obs = arena_get(&m->arena, m->n_tracks, sizeof *obs),
                              *at = mem_array(m->n_tracks, sizeof *at);
    if (!tracks || !obs || !at) {
        mem_free(at);
        return err_set(e, ERR_MEM, "out of memory for %zu observations", m->n_tracks);
    }
    for (size_t p = 0; p < m->n_points; p++) {
        struct colmap_point *pt = &m->points[p];
        const size_t first = kept;
        for (size_t k = 0; k < pt->n_track; k++) {
            tracks[kept] = m->tracks[pt->track + k];
            at[kept].point = (int64_t)p;
            struct colmap_image *im = &m->images[tracks[kept].image];
            if (tracks_place(m, im, pt->xyz, &at[kept].x_px, &at[kept].y_px)) {
                im->n_obs++;
                kept++;
            }
        }
        pt->track = first;
        pt->n_track = kept - first;
    }
    for (size_t i = 0; i < m->n_images; i++) {
        m->images[i].obs = obs;
        obs += m->images[i].n_obs;
        m->images[i].n_obs = 0;
    }
    for (size_t k = 0; k < kept; k++) {
        struct colmap_image *im = &m->images[tracks[k].image];
        tracks[k].obs = (uint32_t)im->n_obs;
        im->obs[im->n_obs++] = at[k];
    }
    mem_free(at);
    log_warn("colmap",
             "images has no observations: points lie in photographs where poses and lenses put "
             "them, so poses are unchecked; export the model with observations to check them");
    m->tracks = tracks;
    m->n_tracks = kept;
    return ERR_OK;
}

/* Observations do not say which points they are of, and tracks do. */
static void tracks_name_points(struct colmap_model *m)
{
    for (size_t p = 0; p < m->n_points; p++)
        for (size_t k = 0; k < m->points[p].n_track; k++) {
            const struct colmap_track_element *t = &m->tracks[m->points[p].track + k];
            struct colmap_image *im = &m->images[t->image];
            if (t->obs < im->n_obs && im->obs[t->obs].point < 0) /* else tracks_check says it */
                im->obs[t->obs].point = (int64_t)p;
        }
}

/* Points have no tracks, and observations say which points they are of. */
static enum err_code tracks_gather(struct colmap_model *m, size_t n, struct err *e)
{
    size_t first = 0;
    m->tracks = arena_get(&m->arena, n, sizeof *m->tracks);
    if (!m->tracks)
        return err_set(e, ERR_MEM, "out of memory for %zu observations", n);
    for (size_t i = 0; i < m->n_images; i++)
        for (size_t k = 0; k < m->images[i].n_obs; k++)
            if (m->images[i].obs[k].point >= 0)
                m->points[m->images[i].obs[k].point].n_track++;
    for (size_t p = 0; p < m->n_points; p++) {
        m->points[p].track = first;
        first += m->points[p].n_track;
        m->points[p].n_track = 0;
    }
    for (size_t i = 0; i < m->n_images; i++)
        for (size_t k = 0; k < m->images[i].n_obs; k++) {
            const int64_t p = m->images[i].obs[k].point;
            if (p >= 0)
                m->tracks[m->points[p].track + m->points[p].n_track++] =
                    (struct colmap_track_element){(uint32_t)i, (uint32_t)k};
        }
    m->n_tracks = n;
    return ERR_OK;
}

enum err_code colmap_tracks_agree(struct colmap_model *m, struct err *e)
{
    size_t n_obs = 0, n_of_points = 0;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < m->n_images; i++) {
        n_obs += m->images[i].n_obs;
        for (size_t k = 0; k < m->images[i].n_obs; k++)
            n_of_points += m->images[i].obs[k].point >= 0;
    }
    if (m->n_tracks && !n_obs)
        rc = tracks_observe(m, e);
    else if (m->n_tracks && !n_of_points)
        tracks_name_points(m);
    else if (!m->n_tracks && n_of_points)
        rc = tracks_gather(m, n_of_points, e);
    return !rc ? tracks_check(m, e) : rc;
}

/* Mean distance of a point's observations from where it projects; 0: nobody sees it. */
static double tracks_point_error(const struct colmap_model *m, const struct colmap_point *p)
{
    double sum = 0, u, v;
    for (size_t k = 0; k < p->n_track; k++) {
        const struct colmap_track_element *t = &m->tracks[p->track + k];
        const struct colmap_image *im = &m->images[t->image];
        if (!tracks_place(m, im, p->xyz, &u, &v))
            return TRACKS_BEHIND_PX;
        sum += hypot(u - im->obs[t->obs].x_px, v - im->obs[t->obs].y_px);
    }
    return p->n_track ? sum / (double)p->n_track : 0;
}

/* COLMAP writes -1 for an error that nobody has computed. */
void colmap_tracks_errors(struct colmap_model *m)
{
    size_t n = 0;
    for (size_t i = 0; i < m->n_points; i++)
        if (!(m->points[i].error_px >= 0) || isinf(m->points[i].error_px)) {
            m->points[i].error_px = tracks_point_error(m, &m->points[i]);
            n++;
        }
    if (n)
        log_info("colmap", "%zu of %zu points have no error: it is computed from observations", n,
                 m->n_points);
}
