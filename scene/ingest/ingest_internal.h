/* Shared by the files of ingest: the state of a run, and its steps.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_INGEST_INTERNAL_H
#define SCENE_INGEST_INGEST_INTERNAL_H

#include <stdatomic.h>

#include "codec/image/image.h"
#include "codec/scene/colmap.h"
#include "codec/scene/scene.h"
#include "core/outdir.h"
#include "scene/control/gcp_fit.h"
#include "scene/control/georef.h"
#include "scene/control/positions.h"
#include "scene/ingest/ingest_files.h"
#include "scene/ingest/ingest_look.h"
#include "scene/ingest/ingest_photo.h"
#include "scene/ingest/pose_error.h"

struct ingest_config;

enum ingest_verdict {
    INGEST_KEPT,
    INGEST_LOOSE, /* its points do not fix its pose */
    INGEST_POSE,
    INGEST_GPS,
    INGEST_MISSING,
    INGEST_BROKEN /* its file cannot be read */
};
enum ingest_point { /* verdict on a sparse point: ingest_points.c */
                    INGEST_POINT_KEPT,
                    INGEST_POINT_ANGLE,
                    INGEST_POINT_ERROR,
                    INGEST_POINT_ALONE,
                    INGEST_POINT_BELOW,
                    INGEST_POINT_ABOVE,
                    INGEST_POINT_VERDICTS
};
enum ingest_altitude { /* source of the altitude that is used: ingest_drone.c */
                       INGEST_ALTITUDE_EXIF,
                       INGEST_ALTITUDE_BAROMETER,
                       INGEST_ALTITUDE_XMP,     /* where EXIF's are wrong or missing */
                       INGEST_ALTITUDE_TAKEOFF, /* above the place of take-off */
                       INGEST_ALTITUDE_NONE,    /* 0 for all photographs */
                       INGEST_ALTITUDE_EXIF_ELLIPSOID,
                       INGEST_ALTITUDE_RTK,
                       INGEST_ALTITUDE_FILE, /* of --positions */
                       INGEST_ALTITUDES
};
enum { INGEST_AUTO, INGEST_EXIF }; /* values of --altitude */
/* The direction up, by the gimbals of the cameras. */
struct ingest_gimbal {
    size_t n, used;    /* number of photographs with that value, and of those without outliers */
    bool known;        /* there are enough, and they agree */
    double up[3];      /* unit, in COLMAP's frame */
    double spread_rad; /* median angle between one photograph and all */
    /* angle between this direction and the frame's up; its parts to the east and north */
    double tilt_rad, east_rad, north_rad;
};
struct ingest_photo {
    const struct colmap_image *image;
    /* path below the folder of photographs; its case may differ from that of the name */
    const char *file;
    char *fault;    /* reason why a photograph is broken; else NULL */
    char *out_name; /* name in images/ of the scene */
    uint32_t width_px, height_px;
    struct image_gps gps; /* its altitude is the one that is used */
    struct drone_meta drone;
    enum ingest_altitude altitude;
    bool apart; /* its altitude has another reference than its flight's, and so does not count */
    struct georef_photo geo;
    struct pose_error pose;
    double residual_m; /* NaN without GPS */
    /* accuracy of its GPS, on each horizontal axis and of height; 0: not known */
    double sigma_m[2];
    uint32_t flight, view;
    enum ingest_verdict verdict;
};

struct ingest_result { /* input of ingest_report.c */
    const struct ingest_config *cfg;
    const struct ingest_photo *photos; /* in the order of file names */
    size_t n_photos, n_kept, n_train, n_test, n_gps, n_unplaced;
    char *const *unplaced;     /* [n_unplaced] photographs that the model does not have */
    const char *images_dir;    /* as they were given */
    const char *model_dir;     /* the model that was read */
    size_t n_models, n_second; /* number of models found, and photographs of the second largest */
    const struct scene *scene;
    const size_t *points;               /* [INGEST_POINT_VERDICTS] sparse points by verdict */
    const struct georef_result *georef; /* NULL: there was too little GPS */
    const struct gcp_fit *gcp; /* NULL: the frame does not come from ground control points */
    const struct ingest_gimbal *gimbal;
    const struct positions *positions; /* NULL: none */
    size_t n_positioned;
    double seconds;
};

struct ingest {
    const struct ingest_config *cfg;
    const char *images_dir;
    struct ingest_files files;
    char **unplaced; /* photographs that the model does not have */
    size_t n_unplaced;
    atomic_size_t n_broken;
    struct outdir dir;
    struct colmap_model model;
    struct ingest_photo *photos; /* by name; arrays and names live in the scene's arena */
    size_t n;
    struct ingest_view *views;
    size_t n_views;
    /* [model.n_images] by index in the model: index in the scene, UINT32_MAX = dropped */
    uint32_t *kept;
    struct georef_result georef;
    bool fitted;
    bool scaled; /* what is not fitted has metres, by --metres-per-unit */
    struct ingest_gimbal gimbal;
    const struct gcp_list *gcps;       /* NULL: none */
    const struct positions *positions; /* NULL: none */
    size_t n_positioned;               /* number of photographs with one of these positions */
    struct gcp_fit gcp;
    struct geoid *geoid; /* --geoid; NULL: none */
    bool gcps_of_sea;    /* the geoid is added to heights of ground control points */
    struct scene scene;
    struct progress progress;
    atomic_flag progress_busy;         /* only its holder may use `progress` */
    atomic_size_t done, masks, alphas; /* masks of --mask-dir, and by alpha */
    atomic_size_t blanks;              /* photographs whose alpha is 0 everywhere */
    atomic_size_t wholes;              /* photographs of which a mask leaves nothing */
    atomic_size_t darks, whites;       /* photographs in which nothing is bright, or all is */
    atomic_size_t skies;               /* photographs that show the sky */
    size_t points[INGEST_POINT_VERDICTS];
};

/* ingest_frame.c: computes origin and similarity of the scene, and drops photographs that
 * contradict their GPS. ERR_ARG (--origin), ERR_DATA (no frame), ERR_MEM. */
enum err_code ingest_frame_find(struct ingest *g, struct err *e) ERR_USE;
/* Parses --origin: "LON,LAT,H" in degrees and metres. ERR_ARG. */
enum err_code ingest_frame_parse(const char *text, struct geo_origin *o, struct err *e) ERR_USE;
/* ---- ingest_heights.c ---- */

/* Checks --heights, --geoid and --geoid-offset-m, and opens the geoid. ERR_ARG; of the geoid
 * ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code ingest_heights_open(struct ingest *g, struct err *e) ERR_USE;
/* Checks that the geoid covers all photographs. ERR_ARG: it does not. */
enum err_code ingest_heights_check(const struct ingest *g, struct err *e) ERR_USE;
/* The height of a photograph, ellipsoidal if that is known. */
double ingest_heights_photo_m(const struct ingest *g, const struct ingest_photo *p);
/* Sets the scene's reference of heights. */
void ingest_heights_name(struct ingest *g);

/* ---- ingest_positions.c ---- */

/* Sets positions and accuracies of photographs from the file of --positions, or accuracies from
 * XMP. ERR_DATA: the file does not fit the photographs, or lies kilometres from their GPS, or EXIF
 * from XMP. ERR_MEM. */
enum err_code ingest_positions_apply(struct ingest *g, struct err *e) ERR_USE;

/* ---- ingest_drone.c ---- */

/* Chooses the altitudes to use, flight by flight. ERR_MEM. */
enum err_code ingest_drone_heights(struct ingest *g, struct err *e) ERR_USE;
/* Computes up from the gimbals of the kept photographs. ERR_MEM. */
enum err_code ingest_drone_up(const struct ingest *g, struct ingest_gimbal *out,
                              struct err *e) ERR_USE;
/* Computes the tilt of the frame against the up of the gimbals. */
void ingest_drone_check(const struct sim3 *sim, struct ingest_gimbal *io);

/* ---- other steps ---- */

/* ingest_scene.c: makes images, points and tracks of the scene from what was kept; fills `kept` and
 * `views`. ERR_MEM. */
enum err_code ingest_scene_fill(struct ingest *g, struct err *e) ERR_USE;
/* ingest_split.c: a test photograph of which less than 65 % of its ground, taken as a plane at the
 * median height of the points, is shown by two that train gives its place to a neighbour in order
 * (at most seven away) that is covered better. ERR_MEM. */
enum err_code ingest_split_cover(struct scene *s, struct err *e) ERR_USE;

/* ingest_points.c: removes sparse points that are not on a surface, with their observations.
 * count[] gives the numbers by reason. ERR_MEM. */
enum err_code ingest_points_filter(const struct ingest_config *cfg, struct scene *s,
                                   size_t count[INGEST_POINT_VERDICTS], struct err *e) ERR_USE;

/* ingest_exposure.c: measures exposure and white balance of the scene's photographs, which are
 * written already. ERR_IO, ERR_NOENT, ERR_FORMAT: a photograph cannot be read. ERR_CANCEL, ERR_MEM.
 */
enum err_code ingest_exposure_find(struct ingest *g, struct err *e) ERR_USE;

/* ---- ingest_mask.c ---- */

/* Converts the mask of a photograph, or the photograph's own alpha, for its pinhole picture, as
 * PNG. *made: whether there was one, and whether it leaves nothing; an alpha of 0 everywhere is
 * none. ERR_NOENT, ERR_FORMAT, ERR_LIMIT: the mask cannot be read. ERR_IO, ERR_MEM. */
enum ingest_mask { INGEST_MASK_NONE, INGEST_MASK_BLANK, INGEST_MASK_MADE, INGEST_MASK_WHOLE };
enum err_code ingest_mask_convert(const struct ingest_view *v, const char *from, bool alpha,
                                  const char *to, enum ingest_mask *made, struct err *e) ERR_USE;

/* ---- ingest_sky.c ---- */

/* Whether any ray of the picture goes up. */
bool ingest_sky_looks_up(const struct camera *c);
/* The steepest rise, height over distance on the ground, at which the camera sees a point, at least
 * 0; HUGE_VAL without points. Rays that rise more meet nothing: they show the sky. */
double ingest_sky_slope(const struct scene *s, const struct camera *c);
/* Sets mask [h][w] to 0 where rays rise more. Returns the number of these pixels. */
size_t ingest_sky_mark(const struct camera *c, double slope, uint8_t *mask);
/* The same in the PNG of a mask, which is made where none is there. *seen: there is sky; without
 * it nothing is written. ERR_IO, ERR_DATA, ERR_NOENT, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code ingest_sky_mask(const struct scene *s, const struct camera *c, const char *path,
                              bool there, bool *seen, struct err *e) ERR_USE;

/* ---- ingest_report.c ---- */

void ingest_report_print(const struct ingest_result *r);
/* Writes report.json. ERR_IO, ERR_DATA, ERR_MEM. */
enum err_code ingest_report_write(const struct ingest_result *r, const char *path,
                                  struct err *e) ERR_USE;

#endif
