/* Ground control: the similarity that puts points where they were surveyed, which of them
 * contradict the others, and whether all of them contradict the photographs' GPS.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_GCP_FIT_H
#define INGEST_GCP_FIT_H

#include "core/geo.h"
#include "ingest/gcp_locate.h"
#include "ingest/gcp_solve.h"
#include "ingest/sim3.h"

enum gcp_suspects {              /* what is done with points and marks that contradict the others */
                    GCP_REWEIGH, /* they count less the more they do, and not at all in the end */
                    GCP_DROP,    /* left out; the others all count alike */
                    GCP_KEEP     /* all count alike */
};
struct gcp_fit_config {
    double px_scale;        /* pixels of the list a pixel of COLMAP's photographs */
    double height_offset_m; /* added to the heights of the list */
    double sigma_m;         /* of surveyed points that say none, each axis */
    double mark_px;         /* of marks that say none, pixels of the list */
    enum gcp_suspects suspects;
    bool gps_check;
};
struct gcp_point {        /* what is known of a GCP in the end */
    double residual_m[3]; /* fitted minus surveyed: east, north, up */
    double gsd_m;         /* of a pixel of its marks on the ground */
    struct gcp_left left; /* control points: without it; check points: as they are */
    double influence_m;   /* how far a located point goes, at most, when this one is left out */
    double weight;        /* 0 to 1; of check points 0 */
    bool suspect;
    bool far;        /* kilometres from its photographs: it never counts */
    char cause[160]; /* of a suspect, "" = not known */
};
struct gcp_gps {             /* GPS minus cameras, where the points put these */
    size_t n;                /* photographs with GPS; 0: nothing is known */
    double plan_m, height_m; /* of the median in plan and in height */
    double limit_m[2];       /* beyond which it is warned of, in plan and in height */
    char cause[200];         /* "" = within limits */
};
struct gcp_fit {                 /* {0} is empty; gcp_fit_free */
    struct gcp_point *points;    /* [list.n] */
    struct gcp_places at;        /* and where they are */
    const struct gcp_list *list; /* borrowed */
    struct sim3 sim;             /* COLMAP -> ENU about `frame` */
    struct geo_origin frame;
    bool level_by_points;      /* the control points lie on a line */
    bool contradict;           /* control points contradict each other; which, cannot be told */
    size_t n_control, n_check; /* located; control points without those that do not count */
    size_t n_suspects, n_mark_suspects;
    int redundancy; /* coordinates of control points beyond the unknowns of the frame */
    double factor;  /* control points err so many times what survey and marks explain; at least 1 */
    /* RMSE in plan and height; NAN: no such points, or no redundancy. */
    double control_m[2], check_m[2];
    double
        check_expected_m[2]; /* what the errors of survey, marks and frame make of check points */
    double frame_m[2];       /* predicted error of the frame at the points, plan and height */
    struct gcp_gps gps;
};
/* list: longitude, latitude, height. views: photographs that were kept, pointing into m. up: the
 * ground's normal in COLMAP's frame, on the side of the cameras, 0 0 0 = unknown. ERR_DATA: fewer
 * than two control points are located, or they lie on a line and up is not known, or the name of a
 * mark fits several photographs, or the points lie kilometres from the photographs' GPS: says which
 * and what to do; ERR_ARG, ERR_MEM. */
enum err_code gcp_fit_make(const struct gcp_list *list, const struct colmap_model *m,
                           const struct gcp_view *views, size_t n_views,
                           const struct gcp_fit_config *cfg, const double up[3],
                           struct gcp_fit *out, struct err *e) ERR_USE;
void gcp_fit_free(struct gcp_fit *f);

/* ---- gcp_blame.c ---- */

/* Before the fit: points that lie farther from the GPS of their photographs than any of these see
 * are far. ERR_DATA: half of them do; names the likely cause. ERR_MEM. */
enum err_code gcp_blame_far(struct gcp_fit *f, const struct gcp_view *views, size_t n_views,
                            struct err *e) ERR_USE;
/* After it: gps of f. ERR_MEM, ERR_ARG. */
enum err_code gcp_blame_gps(struct gcp_fit *f, const struct gcp_view *views, size_t n_views,
                            struct err *e) ERR_USE;
/* Causes of suspects. y [list.n]: where they were surveyed, in f's frame. ERR_ARG. */
enum err_code gcp_blame_suspects(struct gcp_fit *f, const double (*y)[3], double height_offset_m,
                                 struct err *e) ERR_USE;

#endif
