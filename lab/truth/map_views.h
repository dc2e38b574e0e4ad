/* Map views: ground truth at camera poses that are usual in maps, and scores of drawings against
 * it. `citysplat-lab map-views` writes them; lab/EVALUATION.md explains the files and the
 * measures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_MAP_VIEWS_H
#define LAB_MAP_VIEWS_H

#include "codec/image/image.h"
#include "core/splat/camera.h"

struct scene;

enum { MAP_VIEWS_KINDS_MAX = 16, MAP_VIEWS_NAME = 64 };
#define MAP_VIEWS_ONE_LIGHT UINT32_MAX /* the light of the city without variation */
struct map_move {                      /* y = scale rot x + trans between frames */
    double scale, rot[9], trans[3];
};
/* Computes the transform from the truth's frame to the scene's, by the COLMAP model to which both
 * frames have a transform. ERR_FORMAT: a scale is invalid. */
enum err_code map_views_move(const struct map_move *colmap_to_truth, const struct scene *s,
                             struct map_move *out, struct err *e) ERR_USE;
struct map_move map_views_move_back(const struct map_move *m);
/* Converts a camera to the new frame so that it sees the same. Depths grow by scale. For an
 * orthographic camera the caller divides fx and fy by scale. */
void map_views_move_camera(const struct map_move *m, struct camera *c);

struct map_view {
    char name[MAP_VIEWS_NAME], kind[MAP_VIEWS_NAME];
    /* the scene's photograph whose light the view has; or MAP_VIEWS_ONE_LIGHT */
    uint32_t photograph;
    struct camera cam; /* in the scene's frame */
};
struct map_views { /* {0} is empty; map_views_free */
    char dir[FILE_PATH_MAX];
    struct map_view *views;
    size_t n;
    double scale; /* metres of the scene in a metre of the truth */
};
/* Reads a folder's views.json and cameras, and converts them to the scene's frame by the COLMAP
 * model that both come from. Free *out with map_views_free. ERR_NOENT, ERR_FORMAT. ERR_DATA: a view
 * has the light of a photograph that the scene does not have. ERR_MEM. */
enum err_code map_views_read(const char *dir, const struct scene *s, struct map_views *out,
                             struct err *e) ERR_USE;
void map_views_free(struct map_views *v);

struct map_truth { /* {0} is empty; map_truth_free */
    uint32_t width_px, height_px;
    struct image picture;
    uint8_t *mask;   /* [h][w]: 255 supported, 128 seen, 64 hidden, 0 unobserved */
    uint8_t *square; /* [h][w]: 255 within the built-up square */
    float *depth_m;  /* [h][w] along the axis, in metres of the scene; 0 = sky */
};
/* Reads the truth of view i. Free *out with map_truth_free. ERR_NOENT, ERR_FORMAT names the file
 * and what is wrong. ERR_MEM. */
enum err_code map_views_load(const struct map_views *v, size_t i, struct map_truth *out,
                             struct err *e) ERR_USE;
void map_truth_free(struct map_truth *t);
/* Computes limit_m [h][w]: colour drawn at smaller depths counts as in front of the truth. The
 * limit is nearer than the truth by the share MAP_VIEWS_HAZE. Sky is infinitely far. */
#define MAP_VIEWS_HAZE 0.05
void map_views_limit(const struct map_truth *t, float *limit_m);

struct map_drawing { /* all [h][w], see struct render_surface_maps; rgb is on black */
    const float *rgb /*[h][w][3]*/, *median_m, *front, *transmittance;
};
/* The second background of a drawing: the colour that the viewer uses. On black alone, a half
 * transparent surface looks dark, as the ground behind it often is, so the error is small. */
#define MAP_VIEWS_BRIGHT                                                                           \
    {                                                                                              \
        0.62f, 0.66f, 0.40f                                                                        \
    }
struct map_score {
    /* number of views; numbers of views with PSNR in each of the two masks */
    size_t n_views, n_supported, n_square;
    double psnr_db, ssim, gmsd; /* means over views, inside the mask, on black */
    double square_psnr_db;      /* inside the built-up square, seen or not */
    /* the same two on MAP_VIEWS_BRIGHT, which half transparent surfaces show */
    double bright_psnr_db, bright_square_psnr_db;
    /* relative error of the median depth, over the pixels of all views; a hole has an error of 1 */
    double depth_median, depth_95;
    double depth_above; /* share of these errors above MAP_VIEWS_DEPTH */
    double halo;        /* mean alpha where no photograph looked */
    double fog;         /* the same, only MAP_VIEWS_EDGE_PX or more away from where one looked */
    double gaps; /* mean alpha where something hides the surface in all photographs that looked */
    double haze; /* share of seen pixels whose depth is nearer than the limit */
    double veil; /* share of their colour from depths nearer than the limit */
    double supported, unobserved; /* shares of the pixels */
};
#define MAP_VIEWS_DEPTH 0.02
enum { MAP_VIEWS_EDGE_PX = 8, MAP_VIEWS_SEEN = 128 /* value of the mask: a photograph sees it */ };
struct map_sums { /* {0} is empty; map_sums_free */
    struct map_score sum;
    float *errors; /* errors of depth, [n_errors] */
    size_t n_errors, cap_errors;
    double n_pixels, n_seen, n_hidden, n_unobserved, n_fog;
};
/* Adds one view. ERR_MEM. ERR_ARG: the picture is smaller than 4 x 4 pixels. */
enum err_code map_sums_add(struct map_sums *s, const struct map_truth *t,
                           const struct map_drawing *d, struct err *e) ERR_USE;
/* Scores of all views that were added. A measure without pixels is NaN. */
struct map_score map_sums_score(struct map_sums *s);
void map_sums_free(struct map_sums *s);

#endif
