/* Ground control: fits the similarity that moves points to their surveyed places. It finds points
 * that contradict the others, and checks all of them against the photographs' GPS.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GCP_FIT_H
#define SCENE_CONTROL_GCP_FIT_H

#include "core/geo/geo.h"
#include "scene/control/gcp_locate.h"
#include "scene/control/gcp_solve.h"
#include "scene/control/sim3.h"

enum gcp_suspects { /* treatment of points and marks that contradict the others */
                    /* the more they contradict, the less weight they have, down to none */
                    GCP_REWEIGH,
                    GCP_DROP, /* they are left out; all others have equal weight */
                    GCP_KEEP  /* all have equal weight */
};
struct gcp_fit_config {
    double px_scale;           /* pixels of the list in a pixel of COLMAP's photographs */
    double height_offset_m;    /* added to the heights of the list */
    const struct geoid *geoid; /* geoid whose heights are added too; NULL: none */
    double sigma_m;            /* accuracy of surveyed points that state none, on each axis */
    double mark_px;            /* accuracy of marks that state none, in pixels of the list */
    enum gcp_suspects suspects;
    bool gps_check;
};
struct gcp_point {        /* results for a point */
    double residual_m[3]; /* fitted minus surveyed: east, north, up */
    double gsd_m;         /* size on the ground of a pixel of its marks */
    /* effect of leaving out a control point; a check point is left out already */
    struct gcp_left left;
    double influence_m; /* largest movement of any located point when this one is left out */
    double weight;      /* 0 to 1; check points have 0 */
    bool suspect;
    bool far;        /* lies kilometres from its photographs; it is never used */
    char cause[160]; /* why a suspect may be wrong; "" = not known */
};
struct gcp_gps {             /* GPS minus camera positions that follow from the points */
    size_t n;                /* number of photographs with GPS; 0: nothing is known */
    double plan_m, height_m; /* median, horizontal and vertical */
    double limit_m[2];       /* larger differences give a warning; horizontal and vertical */
    char cause[200];         /* "" = within the limits */
};
struct gcp_fit {                 /* {0} is empty; gcp_fit_free */
    struct gcp_point *points;    /* [list.n] */
    struct gcp_places at;        /* where the points lie in COLMAP's frame */
    const struct gcp_list *list; /* borrowed */
    struct sim3 sim;             /* COLMAP -> ENU about `frame` */
    struct geo_origin frame;
    bool level_by_points; /* the control points lie on a line */
    /* control points contradict each other, and it is not known which is wrong */
    bool contradict;
    /* located points; control points that are not used are not counted */
    size_t n_control, n_check;
    size_t n_suspects, n_mark_suspects;
    int redundancy; /* number of coordinates of control points minus the unknowns of the frame */
    /* ratio of errors of control points to what survey and marks explain; at least 1 */
    double factor;
    /* RMSE, horizontal and vertical; NAN: no such points, or no redundancy */
    double control_m[2], check_m[2];
    double check_expected_m[2]; /* expected RMSE of check points, from errors of the inputs */
    double frame_m[2]; /* predicted error of the frame at the points, horizontal and vertical */
    struct gcp_gps gps;
};
/* Fits. list: longitude, latitude, height. views: the kept photographs, which point into m. up: the
 * ground's normal in COLMAP's frame, on the side of the cameras; 0 0 0 = unknown. Free *out with
 * gcp_fit_free. ERR_DATA: fewer than two control points are located, or they lie on a line and `up`
 * is not known, or the name of a mark fits several photographs, or the points lie kilometres from
 * the photographs' GPS. The message says which, and what to do. ERR_ARG, ERR_MEM. */
enum err_code gcp_fit_make(const struct gcp_list *list, const struct colmap_model *m,
                           const struct gcp_view *views, size_t n_views,
                           const struct gcp_fit_config *cfg, const double up[3],
                           struct gcp_fit *out, struct err *e) ERR_USE;
void gcp_fit_free(struct gcp_fit *f);

/* ---- gcp_blame.c ---- */

/* Call it before the fit. It marks a point as `far` if it lies farther from the GPS positions of
 * its photographs than these can see. ERR_DATA: half of the points do; the message names the likely
 * cause. ERR_MEM. */
enum err_code gcp_blame_far(struct gcp_fit *f, const struct gcp_view *views, size_t n_views,
                            struct err *e) ERR_USE;
/* Call it after the fit: computes f->gps. ERR_MEM, ERR_ARG. */
enum err_code gcp_blame_gps(struct gcp_fit *f, const struct gcp_view *views, size_t n_views,
                            struct err *e) ERR_USE;
/* Finds the causes of suspects. y [list.n]: their surveyed places in f's frame. ERR_ARG. */
enum err_code gcp_blame_suspects(struct gcp_fit *f, const double (*y)[3], struct err *e) ERR_USE;

#endif
