/* A procedural city photographed by a drone: photographs, a COLMAP model, and the exact truth.
 *
 * With it people can try the program without a download, and tests know the right answer: poses,
 * depth, clean pictures, and errors of GPS positions. Reading order: synth.c (what is written),
 * synth_city.c (objects), synth_flight.c (cameras), synth_trace.c (rays), synth_shade.c (colours),
 * synth_draw.c (a picture) and synth_model.c (the COLMAP model). lab/ draws more of it: maps, map
 * views, and a city of any size as Gaussians.
 *
 * The city has its own frame: metres, z up, ground at z = 0, streets along x and y. ENU is that
 * frame rotated by city.yaw_rad about z.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_SYNTH_SYNTH_H
#define SCENE_SYNTH_SYNTH_H

#include "core/options/options.h"
#include "core/splat/camera.h"

struct camera;
struct colmap_model;
struct lens;

struct synth_config {
#define OPT OPTIONS_MEMBER
#include "scene/synth/synth.def"
#define OPT OPTIONS_MEMBER
#include "scene/synth/synth_vary.def"
};
enum { SYNTH_PAINT_RICH, SYNTH_PAINT_TRICKY }; /* cfg->paint */
/* The table of struct synth_config: flags, defaults, ranges, help. `citysplat synth` has those of
 * synth.def alone. */
const struct options_spec *synth_options(void);
/* Makes the city of cfg in cfg->output:
 *
 *     images/IMG_0001.jpg ...        photographs with EXIF GPS
 *     masks/IMG_0001.jpg.png ...     of photographs with moving vehicles: 0 where those are
 *     sparse/0/...                   COLMAP model in its own frame (rotation, scale and shift)
 *     truth/truth.json               origin, COLMAP -> ENU; for each photograph its exact pose and
 *                                    its disturbances
 *     truth/clean/NAME.png           every test_every-th photograph without appearance changes and
 *                                    vehicles
 *     truth/depth/NAME.npy           its depth along the optical axis at pixel centres, m,
 *                                    0 = sky
 *
 * ERR_ARG, ERR_IO, ERR_LIMIT, ERR_MEM, ERR_CANCEL. */
enum err_code synth_run(const struct synth_config *cfg, struct err *e) ERR_USE;

/* ---- synth_city.c ---- */

enum synth_kind { SYNTH_BOX, SYNTH_GABLE, SYNTH_ELLIPSOID };
enum synth_material { SYNTH_HOUSE, SYNTH_SHED, SYNTH_TREE, SYNTH_TRUNK, SYNTH_CAR, SYNTH_CABIN };
struct synth_solid {
    enum synth_kind kind;
    enum synth_material material;
    uint32_t seed;      /* of its texture */
    double center_m[2]; /* city frame */
    double cos_yaw, sin_yaw;
    double half_m[2];  /* half-size along its own x and y */
    double z0_m, z1_m; /* bottom and top; the top of a gable is its eaves */
    double ridge_m;    /* gable: height of the ridge, which runs along its own x; else z1_m */
    float color[3];    /* linear albedo */
};
struct synth_grid {                   /* solids by square cell of the ground plane; synth_trace.c */
    const struct synth_solid *solids; /* borrowed */
    double min_m[2], cell_m, top_m;
    uint32_t nx, ny;
    uint32_t *start; /* [nx * ny + 1] into items */
    uint32_t *items;
    float *cell_top_m; /* [nx * ny] height of the highest solid of the cell, 0 = none */
};
enum { SYNTH_STREETS_MAX = 130 };
struct synth_city { /* {0} is empty; synth_city_free */
    uint32_t seed;
    double half_m, yaw_rad;
    double street_m[2][SYNTH_STREETS_MAX]; /* centre lines: [0] x, along y; [1] y, along x */
    double street_half_m[2][SYNTH_STREETS_MAX];
    size_t n_streets[2];
    double sun[3]; /* unit vector to the sun, city frame */
    bool tricky;   /* its paint shows little of shape: see synth_shade_paint */
    double gloss;  /* share of the full gloss; 0: everything is matt */
    struct synth_solid *solids;
    size_t n_solids, cap_solids;
    struct synth_grid grid;
};
enum err_code synth_city_make(const struct synth_config *cfg, struct synth_city *out,
                              struct err *e) ERR_USE;
/* One district of a city without end: a square of SYNTH_DISTRICT_M, whose streets go on in the
 * districts around it. All districts of a seed have one sun and one yaw_rad. The origin of its
 * frame is the middle of the district. ERR_MEM. */
enum { SYNTH_DISTRICT_BLOCKS = 6 }; /* a multiple of 3, so that no avenue lies on a border */
#define SYNTH_DISTRICT_M (46.0 * SYNTH_DISTRICT_BLOCKS)
enum err_code synth_city_district(uint32_t seed, int64_t column, int64_t row,
                                  struct synth_city *out, struct err *e) ERR_USE;
void synth_city_free(struct synth_city *c);
/* Makes n vehicles that move in photograph `photo`: two solids each (body, cabin), out[2 * n]. */
void synth_city_vehicles(const struct synth_city *c, uint64_t photo, size_t n,
                         struct synth_solid *out);

/* ---- synth_trace.c ---- */

enum err_code synth_grid_make(const struct synth_solid *solids, size_t n, struct synth_grid *out,
                              struct err *e) ERR_USE;
void synth_grid_free(struct synth_grid *g);

struct synth_hit {
    double t_m; /* along the unit direction; INFINITY = sky */
    double pos[3], normal[3];
    /* in the solid's frame: along its axes, about its centre, z from its bottom */
    double local[3];
    double local_normal[3];
    const struct synth_solid *solid; /* NULL: ground or sky */
};
/* Finds the nearest hit of origin + t dir, t > 0. `moving` may be NULL. */
void synth_trace_ray(const struct synth_city *c, const struct synth_grid *moving,
                     const double origin[3], const double dir[3], struct synth_hit *out);
/* Returns whether anything is between origin and the sun. */
bool synth_trace_shadow(const struct synth_city *c, const struct synth_grid *moving,
                        const double origin[3]);

/* ---- synth_shade.c ---- */

/* light and camera settings of a photograph; synth_shade_light gives neutral ones */
struct synth_light {
    float sun[3], sky[3]; /* linear radiance */
    float gain[3];        /* exposure and white balance */
};
struct synth_light synth_shade_light(void);
/* Linear colour of a ray. footprint_m is the size of a sample at the hit; finer texture fades out.
 */
void synth_shade_hit(const struct synth_city *c, const struct synth_grid *moving,
                     const struct synth_light *light, const double dir[3],
                     const struct synth_hit *hit, double footprint_m, float rgb[3]);
/* The paint of a tricky city at a hit. Other cities have SYNTH_RICH everywhere. Each other paint
 * has one albedo. */
enum synth_paint {
    SYNTH_RICH,
    SYNTH_ASPHALT,
    SYNTH_MARK,
    SYNTH_LAWN,
    SYNTH_BLACK, /* of a roof */
    SYNTH_GLASS  /* of a front */
};
enum synth_paint synth_shade_paint(const struct synth_city *c, const struct synth_hit *hit);
/* Converts a linear colour, after gains, to an sRGB byte. */
uint8_t synth_shade_encode(float linear);

/* ---- synth_draw.c ---- */

struct image;
/* free with synth_draw_close; drawing only reads it, so threads may share it */
struct synth_draw {
    const struct synth_city *city; /* borrowed */
    struct lens lens;
    int supersample; /* rays on each axis of a pixel */
    double blur_px;  /* standard deviation of the lens' blur */
    float *rays;     /* [rows][cols][2] camera-plane directions at a coarse grid of pixels */
    size_t rows, cols;
};
/* Prepares drawing. Cameras must have the size and focal length of this lens. ERR_MEM. ERR_ARG: the
 * lens cannot be inverted at the picture's corner. */
enum err_code synth_draw_open(const struct synth_city *city, const struct lens *lens,
                              int supersample, double blur_px, struct synth_draw *out,
                              struct err *e) ERR_USE;
void synth_draw_close(struct synth_draw *d);
/* Draws a picture. cam: pose in ENU. `moving` may be NULL. Free *out with image_free, also after
 * ERR_MEM. */
enum err_code synth_draw_picture(const struct synth_draw *d, const struct camera *cam,
                                 const struct synth_light *light, const struct synth_grid *moving,
                                 struct image *out, struct err *e) ERR_USE;
/* Blurs rgb [h][w][3] with a Gaussian. ERR_MEM. */
enum err_code synth_draw_blur(float *rgb, size_t w, size_t h, double sigma_px,
                              struct err *e) ERR_USE;
/* Finds what a pixel position sees of the city without vehicles. Returns the depth along the
 * optical axis in metres, 0 = sky. */
double synth_draw_hit(const struct synth_draw *d, const struct camera *cam, double u_px,
                      double v_px, struct synth_hit *hit);
/* Computes the depth at every pixel centre: depth [h][w]. */
void synth_draw_depth(const struct synth_draw *d, const struct camera *cam, float *depth);

/* ---- synth_flight.c ---- */

struct synth_photo {
    char name[32];
    struct camera cam; /* true pose, ENU; without lens distortion */
    struct synth_light light;
    bool vehicles, gps_outlier, pose_error;
    uint32_t flight;        /* 0 or 1 */
    double gps_enu_m[3];    /* as EXIF has it */
    double pose_shift_m[3]; /* ENU error of the COLMAP pose */
    double exposure_ev;
};
struct lens synth_flight_lens(const struct synth_config *cfg);
/* Height of the nadir strips above the ground, m. */
double synth_flight_height(const struct synth_config *cfg);
/* out[cfg->photos] */
void synth_flight_make(const struct synth_config *cfg, struct synth_photo *out);

/* ---- synth_model.c ---- */

struct synth_similarity { /* y_enu = scale rot x_colmap + trans */
    double scale, rot[9], trans[3];
};
struct synth_similarity synth_model_frame(const struct synth_config *cfg);
/* Makes the COLMAP model as structure from motion would. Free *out with colmap_free. ERR_MEM. */
enum err_code synth_model_make(const struct synth_config *cfg, const struct synth_city *city,
                               const struct synth_photo *photos,
                               const struct synth_similarity *frame, struct colmap_model *out,
                               struct err *e) ERR_USE;

/* Returns whether a place (ENU) lies in a photograph's picture. Occlusion is not considered. */
bool synth_model_frames(const struct lens *lens, const struct camera *cam,
                        const double place_enu_m[3]);
/* Returns whether a photograph shows it: in the picture, and not hidden. */
bool synth_model_sees(const struct synth_city *c, const struct lens *lens, const struct camera *cam,
                      const double place_enu_m[3]);

/* Streams of random numbers. */
enum synth_stream {
    SYNTH_STREAM_STREETS = 1,
    SYNTH_STREAM_LOTS,
    SYNTH_STREAM_TREES,
    SYNTH_STREAM_CARS,
    SYNTH_STREAM_YAW,
    SYNTH_STREAM_MOVING,
    SYNTH_STREAM_FLIGHT,
    SYNTH_STREAM_LIGHT,
    SYNTH_STREAM_GPS,
    SYNTH_STREAM_OUTLIER,
    SYNTH_STREAM_POSE,
    SYNTH_STREAM_FRAME,
    SYNTH_STREAM_POINTS,
    SYNTH_STREAM_PIXELS,
    SYNTH_STREAM_VIEWS,
    SYNTH_STREAM_DISTRICTS,
    SYNTH_STREAM_SPLATS
};

#endif
