/* Where ground control points lie in COLMAP's frame by their marks, with what that is worth.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_GCP_LOCATE_H
#define INGEST_GCP_LOCATE_H

#include "codec/colmap.h"
#include "ingest/gcp.h"

struct gcp_view { /* a photograph that was kept */
    const struct colmap_image *image;
    const struct lens *lens;
    double center[3], rot[9]; /* in COLMAP's frame; rot is world -> camera */
    bool has_gps;
    double lon_deg, lat_deg, h_m; /* where its GPS has it */
    double sigma_m[2];            /* of that, an axis in plan and in height; 0: not said */
};
struct gcp_sight { /* a mark in a photograph that was kept */
    const struct gcp_mark *mark;
    const struct gcp_view *view;
    double x_px, y_px;  /* of COLMAP's photograph */
    double ray[2];      /* x / z and y / z of the mark in the camera */
    double sigma;       /* of each of them */
    double focal_px;    /* of the marked photograph */
    double residual_px; /* to the point by all marks that count */
    double out_px;      /* to the point by the other marks; NAN: they do not tell */
    double out_sigmas;  /* the same in its own standard deviations; NAN */
    double moves;       /* how far the point goes when the mark is left out, COLMAP's units */
    bool suspect, used;
};
struct gcp_place {       /* of a GCP */
    size_t first, n;     /* slice of sights */
    size_t n_photos;     /* that it is marked in, among those kept; 0: it is not located */
    bool by_points;      /* one photograph only: the depth is that of the sparse points around */
    double gap_px;       /* then: how far away the nearest of them is */
    double x[3], cov[9]; /* in COLMAP's frame */
    double depth;        /* mean of the cameras, COLMAP's units over pixels of the marks: a pixel */
};
struct gcp_places {           /* {0} is empty; gcp_places_free */
    struct gcp_place *places; /* [list.n] */
    struct gcp_sight *sights; /* [n_sights], by point */
    size_t n_sights;
    size_t n_lost;    /* marks in photographs that the model does not hold */
    const char *lost; /* the first of their photographs, borrowed from the list */
    double factor;    /* times that marks err more than was said; at least 1 */
};
/* A mark belongs to the photograph of m whose path ends like the mark's. px_scale: pixels of the
 * list a pixel of COLMAP's photographs. mark_px: standard deviation of marks that say none, in
 * pixels of the list. up: the ground's normal on the side of the cameras, 0 0 0 = unknown.
 * use_suspects: marks that contradict the others of their point count all the same. ERR_DATA: a
 * mark outside of its photograph, or whose name fits several; ERR_MEM. */
enum err_code gcp_locate(const struct gcp_list *list, const struct colmap_model *m,
                         const struct gcp_view *views, size_t n_views, double px_scale,
                         double mark_px, const double up[3], bool use_suspects,
                         struct gcp_places *out, struct err *e) ERR_USE;
void gcp_places_free(struct gcp_places *p);
/* The inverse of a symmetric positive definite matrix. False: it has none to 13 digits. */
bool gcp_inverse(const double a[9], double inverse[9]);

#endif
