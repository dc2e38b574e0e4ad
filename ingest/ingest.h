/* Photographs and COLMAP poses in, a scene in metres out. Reading order: ingest.c (the whole way),
 * ingest_frame.c (where the scene lies), georef.c (which positions to trust), sim3.c (the
 * mathematics), ingest_scene.c (cameras, points), ingest_points.c (which points to trust), ingest_photo.c (pixels), ingest_report.c (what is
 * told).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_INGEST_H
#define INGEST_INGEST_H

#include "codec/image.h"
#include "core/camera.h"
#include "core/options.h"
#include "ingest/sim3.h"

struct camera;
struct codec_limits;
struct colmap_image;
struct lens;
struct scene;

struct ingest_config {
#define OPT(type, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "ingest/ingest.def"
#undef OPT
};
/* The table behind struct ingest_config: flags, defaults, ranges, help. */
const struct options_spec *ingest_options(void);

/* ---- georef.c ---- */

struct georef_photo {         /* in order of file names */
    double center[3], rot[9]; /* in COLMAP's frame; rot is world -> camera */
    bool has_gps;
    double gps_enu_m[3];
    uint32_t flight_hint; /* flights told apart by time or folder, 0 .. */
};
struct georef_config {
    double inlier_m;             /* 8: of the random draws */
    double tau_min_m, tau_max_m; /* 6, 64: bounds of the rejection distance */
    double ground_normal[3];     /* unit, in COLMAP's frame, either sign; 0 0 0 = unknown */
    uint64_t seed;
};
struct georef_result { /* {0} is empty; georef_free */
    struct sim3 sim;   /* COLMAP -> ENU */
    struct sim3_fit fit;
    double tau_m; /* photographs farther than this from their GPS position were dropped */
    int rounds;
    bool collinear; /* the flight line is straight: its roll comes from the cameras being level */
    size_t n_gps, n_dropped, n_flights;
    double flight_offset_m[SIM3_GROUPS_MAX]; /* of the GPS heights, relative to flight 0, the
                                                      largest */
    double *residual_m;                      /* [n] after flight offsets; NaN without GPS */
    bool *dropped;                           /* [n] */
    uint32_t *flight;                        /* [n] */
};
/* ERR_DATA: fewer than three usable positions, or all cameras at one place; the message says which.
 */
enum err_code georef_fit(const struct georef_photo *photos, size_t n,
                         const struct georef_config *cfg, struct georef_result *out,
                         struct err *e) ERR_USE;
/* Without GPS: COLMAP's frame turned upright and scaled, the mean camera over the origin's east and
 * north. */
enum err_code georef_upright(const struct georef_photo *photos, size_t n,
                             const double ground_normal[3], double scale, struct sim3 *out,
                             struct err *e) ERR_USE;
void georef_free(struct georef_result *r);

/* ---- ingest_photo.c ---- */

struct ingest_view {       /* how one camera's photographs become pinhole pictures */
    struct lens lens;      /* at the size of the photograph itself */
    struct camera pinhole; /* intrinsics of the result; pose unused */
    uint32_t mid_width_px,
        mid_height_px; /* the photograph is first shrunk to this, then undistorted */
    bool undistort;
    size_t camera; /* index in the COLMAP model; set by ingest.c */
};
/* Choose size and pinhole: longest edge at most max_edge_px; without distortion the intrinsics are
 * kept, with it the focal length is the smallest that leaves no pixel without a source. ERR_DATA:
 * no such view. */
enum err_code ingest_view_make(const struct lens *lens, uint32_t width_px, uint32_t height_px,
                               uint32_t max_edge_px, struct ingest_view *out,
                               struct err *e) ERR_USE;
/* Where an observation (pixels of the COLMAP camera `lens`) lies in the result; false when outside.
 */
bool ingest_view_map(const struct ingest_view *v, const struct lens *lens, double x_px, double y_px,
                     double *u_px, double *v_px);
/* Convert one photograph. Its bytes are copied when nothing changes and the format fits. */
enum err_code ingest_photo_convert(const struct ingest_view *v, const char *from, const char *to,
                                   const struct codec_limits *lim, struct err *e) ERR_USE;

/* ---- ingest.c ---- */

enum ingest_verdict { INGEST_KEPT, INGEST_FEW_POINTS, INGEST_POSE, INGEST_GPS, INGEST_MISSING };
enum ingest_point { /* of a sparse point: ingest_points.c */
                    INGEST_POINT_KEPT,
                    INGEST_POINT_ANGLE,
                    INGEST_POINT_ERROR,
                    INGEST_POINT_ALONE,
                    INGEST_POINT_BELOW,
                    INGEST_POINT_ABOVE,
                    INGEST_POINT_VERDICTS
};
struct ingest_photo {
    const struct colmap_image *image;
    char *out_name; /* in images/ of the scene */
    uint32_t width_px, height_px;
    struct image_gps gps;
    struct georef_photo geo;
    size_t n_points;        /* triangulated observations */
    double reprojection_px; /* median */
    double residual_m;      /* NaN without GPS */
    uint32_t flight, view;
    enum ingest_verdict verdict;
};
struct ingest_result { /* what ingest_report.c tells */
    const struct ingest_config *cfg;
    const struct ingest_photo *photos; /* in order of file names */
    size_t n_photos, n_kept, n_train, n_test, n_gps, n_unregistered;
    const struct scene *scene;
    const size_t *points;               /* [INGEST_POINT_VERDICTS] sparse points by verdict */
    const struct georef_result *georef; /* NULL when there was too little GPS */
    double seconds;
};
/* Make the scene folder. A report is printed on stdout and kept as report.json. */
enum err_code ingest_run(const char *images_dir, const char *sparse_dir,
                         const struct ingest_config *cfg, struct err *e) ERR_USE;
void ingest_report_print(const struct ingest_result *r);
enum err_code ingest_report_write(const struct ingest_result *r, const char *path,
                                  struct err *e) ERR_USE;

#endif
