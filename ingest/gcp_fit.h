/* Where ground control points lie in COLMAP's frame, and the similarity that puts them where they
 * were surveyed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_GCP_FIT_H
#define INGEST_GCP_FIT_H

#include "codec/colmap.h"
#include "core/geo.h"
#include "ingest/gcp.h"
#include "ingest/sim3.h"

struct gcp_view { /* a photograph that was kept */
    const struct colmap_image *image;
    const struct lens *lens;
    double center[3], rot[9]; /* in COLMAP's frame; rot is world -> camera */
};
struct gcp_place {   /* of a GCP */
    size_t n_photos; /* that it is marked in, among those kept; 0: it is not located */
    bool
        by_points; /* one photograph only: the depth is that of the sparse points around the mark */
    double gap_px; /* then: how far away the nearest of them is */
    double x[3];   /* in COLMAP's frame */
    double residual_m[3]; /* fitted minus surveyed: east, north, up */
};
struct gcp_fit {                 /* {0} is empty; gcp_fit_free */
    struct gcp_place *places;    /* [list.n] */
    const struct gcp_list *list; /* borrowed */
    struct sim3 sim;             /* COLMAP -> ENU about `frame` */
    struct geo_origin frame;
    bool level_by_points;      /* the control points lie on a line */
    size_t n_control, n_check; /* located */
    double control_plan_m, control_height_m, check_plan_m, check_height_m; /* RMSE; NAN: none */
};
/* list: longitude, latitude, height, plus height_offset_m. A mark belongs to the photograph of m
 * whose path ends like the mark's; views: those that were kept, pointing into m. px_scale: pixels
 * of the list a pixel of COLMAP's photographs. up: the ground's normal in COLMAP's frame, on the
 * side of the cameras, 0 0 0 = unknown. ERR_DATA: fewer than two control points are located, or
 * they lie on a line and up is not known, or the name of a mark fits several photographs: says
 * which and what to do; ERR_ARG, ERR_MEM. */
enum err_code gcp_fit_make(const struct gcp_list *list, const struct colmap_model *m,
                           const struct gcp_view *views, size_t n_views, double px_scale,
                           double height_offset_m, const double up[3], struct gcp_fit *out,
                           struct err *e) ERR_USE;
void gcp_fit_free(struct gcp_fit *f);

#endif
