/* Locates ground control points in COLMAP's frame by their marks, with standard deviations.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GCP_LOCATE_H
#define SCENE_CONTROL_GCP_LOCATE_H

#include "codec/scene/colmap.h"
#include "scene/control/gcp.h"

struct gcp_view { /* a photograph that was kept */
    const struct colmap_image *image;
    const struct lens *lens;
    double center[3], rot[9]; /* in COLMAP's frame; rot is world -> camera */
    bool has_gps;
    double lon_deg, lat_deg, h_m; /* position by its GPS */
    double sigma_m[2]; /* its accuracy, on each horizontal axis and of height; 0: not known */
};
struct gcp_sight { /* a mark in a kept photograph */
    const struct gcp_mark *mark;
    const struct gcp_view *view;
    double x_px, y_px;  /* in COLMAP's photograph */
    double ray[2];      /* x / z and y / z of the mark in the camera */
    double sigma;       /* standard deviation of both */
    double focal_px;    /* of the photograph in which it is marked */
    double residual_px; /* distance to the point that all used marks give */
    double out_px;      /* distance to the point that the other marks give; NAN: they give none */
    double out_sigmas;  /* the same in its own standard deviations; NAN */
    double moves;       /* movement of the point when the mark is left out, in COLMAP's units */
    bool suspect, used;
};
struct gcp_place {   /* where a ground control point lies */
    size_t first, n; /* slice of sights */
    size_t n_photos; /* number of kept photographs in which it is marked; 0: it is not located */
    bool by_points;  /* only one photograph: the depth comes from sparse points around the mark */
    double gap_px;   /* with one photograph: distance to the nearest of these sparse points */
    double x[3], cov[9]; /* in COLMAP's frame */
    double depth; /* mean depth over the focal length: COLMAP's units in a pixel of the marks */
};
struct gcp_places {           /* {0} is empty; gcp_places_free */
    struct gcp_place *places; /* [list.n] */
    struct gcp_sight *sights; /* [n_sights], sorted by point */
    size_t n_sights;
    size_t n_lost;    /* number of marks in photographs that the model does not have */
    const char *lost; /* the first of these photographs, borrowed from the list */
    double factor;    /* ratio of errors of marks to their stated accuracy; at least 1 */
};
/* Locates. A mark belongs to the photograph of m whose path ends like the mark's. px_scale: pixels
 * of the list in a pixel of COLMAP's photographs. mark_px: standard deviation of marks without
 * accuracy, in pixels of the list. up: the ground's normal on the side of the cameras; 0 0 0 =
 * unknown. use_suspects: also use marks that contradict the others of their point. factor_most:
 * limit of the factor, for lists that are not complete. Free *out with
 * gcp_places_free. ERR_DATA: a mark lies outside its photograph, or its name fits several. ERR_MEM.
 */
enum err_code gcp_locate(const struct gcp_list *list, const struct colmap_model *m,
                         const struct gcp_view *views, size_t n_views, double px_scale,
                         double mark_px, const double up[3], bool use_suspects, double factor_most,
                         struct gcp_places *out, struct err *e) ERR_USE;
/* Finds the photograph of a mark; NULL: there is none. It searches all photographs of the model,
 * also dropped ones, because the mark of a dropped photograph must not go to another of that name.
 * ERR_DATA: the name fits several. */
enum err_code gcp_locate_photo(const struct colmap_model *m, const struct gcp_list *list,
                               const struct gcp_mark *mark, const struct colmap_image **out,
                               struct err *e) ERR_USE;
void gcp_places_free(struct gcp_places *p);
/* Inverts a symmetric positive definite matrix. Returns false if it is singular to 13 digits. */
bool gcp_inverse(const double a[9], double inverse[9]);

#endif
