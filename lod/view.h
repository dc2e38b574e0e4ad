/* Pictures of a store: level selection, tiles in memory and on the device, drawing. view.c.
 *
 * A struct view is for one caller at a time, as is its renderer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_VIEW_H
#define LOD_VIEW_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct appearance;
struct camera;
struct geo_origin;
struct pick_options;
struct render;
struct render_model;
struct render_options;
struct store;

struct view; /* a store, a renderer, and the tiles resident on the device */
/* cache_bytes: of decoded tiles in memory, 0 = 1 GiB. r is borrowed until view_close, which frees
 * the rest. Errors as store_open: ERR_NOENT, ERR_FORMAT, ERR_IO; ERR_MEM. */
enum err_code view_open(const char *store_path, struct render *r, size_t cache_bytes,
                        struct view **out, struct err *e) ERR_USE;
/* The same of an open file (store_open_fd), borrowed during the call. Errors as view_open:
 * ERR_NOENT, ERR_FORMAT, ERR_IO; ERR_MEM. */
enum err_code view_open_fd(int fd, const char *name, struct render *r, size_t cache_bytes,
                           struct view **out, struct err *e) ERR_USE;
void view_close(struct view **v);
/* Borrowed, until view_close. */
const struct store *view_store(const struct view *v);
const struct appearance *view_appearance(const struct view *v); /* of the store; NULL: none */
/* The appearance of pictures of a store that has one: an embedding [len_image] (copied), NULL for
 * the default one. ERR_MEM. */
enum err_code view_set_appearance(struct view *v, const float *image, struct err *e) ERR_USE;
/* bake_find of the view's store, with its errors: ERR_NOENT, ERR_ARG. */
enum err_code view_find_appearance(struct view *v, const char *text, float *image,
                                   struct err *e) ERR_USE;
/* render_options.supersample of a view: 2 where its Gaussians are small on the screen, else 1. */
#define VIEW_SUPERSAMPLE_AUTO UINT32_MAX
struct view_stats {
    size_t n_tiles;
    uint64_t n_gaussians; /* handed to the renderer: blocks of the tiles that may be in view */
    uint64_t n_visible;   /* of them in the picture; 0 from view_model */
    double ms_pick, ms_load, ms_render;
};
/* Draw into rgb [h][w][3]. An appearance_frame in ro comes before the appearance that was set.
 * stats may be NULL. Errors of pick_tiles, store_read_gauss and render_forward: ERR_ARG,
 * ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_DEVICE, ERR_CANCEL (render_set_stop), ERR_MEM. */
enum err_code view_render(struct view *v, const struct camera *cam, const struct render_options *ro,
                          const struct pick_options *po, float *rgb, struct view_stats *stats,
                          struct err *e) ERR_USE;
/* Tiles by index, ascending, and how much of their opacity is drawn (NULL: all); borrowed. */
struct view_tiles {
    const uint32_t *tile;
    const float *weight; /* above 0, to 1; not of stores with appearance */
    size_t n;
    bool whole; /* see pick_options.whole_tiles */
};
/* The same with tiles of the caller's choice: what a change of levels alone does to a picture.
 * ERR_ARG, and what render_forward gives. */
enum err_code view_render_tiles(struct view *v, const struct view_tiles *tiles,
                                const struct camera *cam, const struct render_options *ro,
                                float *rgb, struct view_stats *stats, struct err *e) ERR_USE;

/* The Gaussians that such a picture is drawn from, tiles whole, on the device until the next call:
 * colours as they were trained, with embeddings where the store has appearance. render_backward
 * works on this model. Errors as view_render: ERR_ARG, ERR_FORMAT, ERR_IO, ERR_DEVICE, ERR_MEM. */
enum err_code view_model(struct view *v, const struct camera *cam, const struct pick_options *po,
                         const struct render_model **out, struct view_stats *stats,
                         struct err *e) ERR_USE;

/* A camera as maps give it: heading clockwise from north, pitch above the horizon, height
 * ellipsoidal. */
struct view_pose {
    double lon_deg, lat_deg, h_m, heading_deg, pitch_deg, fov_y_deg;
};
/* The camera of a pose, in the ENU frame of the origin. ERR_ARG. Any thread. */
enum err_code view_camera(const struct geo_origin *origin, const struct view_pose *pose,
                          uint32_t width_px, uint32_t height_px, struct camera *out,
                          struct err *e) ERR_USE;

#endif
