/* Map views: ground truth at poses that people take in maps, and how close drawings come to it.
 * `citysplat synth --map-views` writes them; docs/evaluation.md has the files and the measures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_MAP_VIEWS_H
#define TRAIN_MAP_VIEWS_H

#include "codec/image.h"
#include "core/camera.h"

struct scene;

enum { MAP_VIEWS_KINDS_MAX = 16, MAP_VIEWS_NAME = 64 };
#define MAP_VIEWS_ONE_LIGHT UINT32_MAX /* that of the city without any variation */
struct map_move {                      /* y = scale rot x + trans between frames */
    double scale, rot[9], trans[3];
};
/* From a truth's frame into the scene's: both know their way from one COLMAP model. ERR_FORMAT: a
 * scale that is none. */
enum err_code map_views_move(const struct map_move *colmap_to_truth, const struct scene *s,
                             struct map_move *out, struct err *e) ERR_USE;
struct map_move map_views_move_back(const struct map_move *m);
/* The camera in the new frame that sees what c sees in the old one: depths grow by scale. An
 * orthographic one sees the same ground once fx and fy are divided by it. */
void map_views_move_camera(const struct map_move *m, struct camera *c);

struct map_view {
    char name[MAP_VIEWS_NAME], kind[MAP_VIEWS_NAME];
    uint32_t photograph; /* of the scene, in whose light it is; MAP_VIEWS_ONE_LIGHT */
    struct camera cam;   /* in the scene's frame */
};
struct map_views { /* {0} is empty; map_views_free */
    char dir[FILE_PATH_MAX];
    struct map_view *views;
    size_t n;
    double scale; /* metres of the scene per metre of the truth */
};
/* Read a folder's views.json and cameras, and move them into the scene's frame through the COLMAP
 * model that both come from. ERR_NOENT, ERR_FORMAT; ERR_DATA: the light of a photograph that the
 * scene does not have. */
enum err_code map_views_read(const char *dir, const struct scene *s, struct map_views *out,
                             struct err *e) ERR_USE;
void map_views_free(struct map_views *v);

struct map_truth { /* {0} is empty; map_truth_free */
    uint32_t width_px, height_px;
    struct image picture;
    uint8_t *mask;   /* [h][w]: 255 supported, 128 seen, 64 hidden, 0 unobserved */
    uint8_t *square; /* [h][w]: 255 within the built-up square */
    float *depth_m;  /* [h][w] along the axis, in the scene's metres; 0 = sky */
};
/* The truth of view i. ERR_NOENT, ERR_FORMAT: what and which file; ERR_MEM. */
enum err_code map_views_load(const struct map_views *v, size_t i, struct map_truth *out,
                             struct err *e) ERR_USE;
void map_truth_free(struct map_truth *t);
/* Depths up to which drawn colour counts as in front of the truth, limit_m [h][w]: MAP_VIEWS_HAZE
 * nearer than it; sky is infinitely far. */
#define MAP_VIEWS_HAZE 0.05
void map_views_limit(const struct map_truth *t, float *limit_m);

struct map_drawing { /* all [h][w], see struct render_surface_maps */
    const float *rgb /*[h][w][3]*/, *median_m, *front, *transmittance;
};
struct map_score {
    size_t n_views, n_supported, n_square; /* views; those that count for PSNR in either mask */
    double psnr_db, ssim, gmsd;            /* means over views, within the mask */
    double square_psnr_db;                 /* within the built-up square, seen or not */
    double depth_median, depth_95;         /* relative error of the median depth, pixels of all
                                            * views together; a hole is an error of 1 */
    double depth_above;                    /* share of them above MAP_VIEWS_DEPTH */
    double halo;                           /* mean alpha where no photograph has looked */
    double fog;                   /* the same, MAP_VIEWS_EDGE_PX and more beyond what was */
    double gaps;                  /* mean alpha of what is hidden in all that looked there */
    double haze;                  /* share of seen pixels whose depth is nearer than the limit */
    double veil;                  /* share of their colour that comes from nearer than the limit */
    double supported, unobserved; /* shares of the pixels */
};
#define MAP_VIEWS_DEPTH 0.02
enum { MAP_VIEWS_EDGE_PX = 8, MAP_VIEWS_SEEN = 128 /* of a mask: what a photograph sees */ };
struct map_sums { /* {0} is empty; map_sums_free */
    struct map_score sum;
    float *errors; /* of depth, [n_errors] */
    size_t n_errors, cap_errors;
    double n_pixels, n_seen, n_hidden, n_unobserved, n_fog;
};
/* Add one view. ERR_MEM; ERR_ARG for pictures smaller than 4 x 4 pixels. */
enum err_code map_sums_add(struct map_sums *s, const struct map_truth *t,
                           const struct map_drawing *d, struct err *e) ERR_USE;
/* Scores of all views added; measures over nothing are NaN. */
struct map_score map_sums_score(struct map_sums *s);
void map_sums_free(struct map_sums *s);

#endif
