/* Pictures of a store: level selection, tiles on the device, drawing. view.c.
 *
 * Only one thread at a time may use a struct view and its renderer.
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
struct buf;
struct camera;
struct geo_origin;
struct pick_options;
struct render;
struct render_model;
struct render_options;
struct store;

struct view; /* a store, a renderer, and the tiles that are on the device */
/* Opens a store for drawing. cache_bytes limits the tiles that are kept on the device beside those
 * of a picture; 0 = 1 GiB. r is borrowed until view_close, which frees all else. ERR_NOENT,
 * ERR_FORMAT, ERR_IO as in store_open; ERR_MEM. */
enum err_code view_open(const char *store_path, struct render *r, size_t cache_bytes,
                        struct view **out, struct err *e) ERR_USE;
/* As view_open, from an open file (store_open_fd), which is borrowed during the call. ERR_NOENT,
 * ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code view_open_fd(int fd, const char *name, struct render *r, size_t cache_bytes,
                           struct view **out, struct err *e) ERR_USE;
void view_close(struct view **v);
/* Frees the tiles that are kept for the next picture. */
void view_shrink(struct view *v);
/* Borrowed until view_close. */
const struct store *view_store(const struct view *v);
/* Calls store_lift for the view's store. Call it before anything is drawn. */
void view_lift(struct view *v, double up_m);
/* As store_get_blob. ERR_BUSY (a store at an address), ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code view_get_blob(struct view *v, const char *name, struct buf *out,
                            struct err *e) ERR_USE;
/* that of the store; NULL: none */
const struct appearance *view_appearance(const struct view *v);
/* Sets the appearance of pictures, if the store has one: an embedding [len_image], which is copied,
 * or NULL for the default one. ERR_MEM. */
enum err_code view_set_appearance(struct view *v, const float *image, struct err *e) ERR_USE;
/* As bake_find on the view's store. ERR_NOENT, ERR_ARG. */
enum err_code view_find_appearance(struct view *v, const char *text, float *image,
                                   struct err *e) ERR_USE;
/* A value of render_options.supersample for views: 2 if Gaussians are small in the picture, else 1.
 */
#define VIEW_SUPERSAMPLE_AUTO UINT32_MAX
struct view_stats {
    size_t n_tiles;
    uint64_t n_gaussians; /* given to the renderer: in blocks that may be in view */
    uint64_t n_visible;   /* number of these in the picture; 0 from view_model */
    double ms_pick, ms_load, ms_render;
};
/* Draws into rgb [h][w][3]. ro->appearance_frame, if set, overrides view_set_appearance. stats may
 * be NULL. ERR_ARG, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_DEVICE, ERR_CANCEL (render_set_stop),
 * ERR_MEM as in pick_tiles, store_read_gauss and render_forward. */
enum err_code view_render(struct view *v, const struct camera *cam, const struct render_options *ro,
                          const struct pick_options *po, float *rgb, struct view_stats *stats,
                          struct err *e) ERR_USE;
/* As view_render, for the pictures of a camera that moves: where nothing has moved by more than a
 * few pixels since, tiles, depth order and tile lists are those of an earlier picture, which takes
 * 0.6 to 0.9 of the time. The picture is then not quite the same as view_render's
 * (docs/decisions/027-streams.md). Other pictures of this view or its renderer in between only cost
 * time. Errors as there: ERR_ARG, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_DEVICE, ERR_CANCEL, ERR_MEM.
 */
enum err_code view_render_moving(struct view *v, const struct camera *cam,
                                 const struct render_options *ro, const struct pick_options *po,
                                 float *rgb, struct view_stats *stats, struct err *e) ERR_USE;
/* Tiles by index, ascending, and their shares of opacity (NULL: 1). Borrowed. */
struct view_tiles {
    const uint32_t *tile;
    const float *weight; /* above 0, at most 1; only for stores without appearance */
    size_t n;
    bool whole; /* see pick_options.whole_tiles */
};
/* As view_render, with tiles that the caller chose. Such pictures show the effect of a change of
 * levels alone. ERR_ARG, and the errors of render_forward. */
enum err_code view_render_tiles(struct view *v, const struct view_tiles *tiles,
                                const struct camera *cam, const struct render_options *ro,
                                float *rgb, struct view_stats *stats, struct err *e) ERR_USE;

/* Brings the Gaussians of such a picture to the device, where they stay until the next call. Tiles
 * are whole. Colours are as trained, with embeddings if the store has appearance. render_backward
 * accepts this model. ERR_ARG, ERR_FORMAT, ERR_IO, ERR_DEVICE, ERR_MEM. */
enum err_code view_model(struct view *v, const struct camera *cam, const struct pick_options *po,
                         const struct render_model **out, struct view_stats *stats,
                         struct err *e) ERR_USE;

/* A camera as maps define it: heading clockwise from north, pitch above the horizon, ellipsoidal
 * height. */
struct view_pose {
    double lon_deg, lat_deg, h_m, heading_deg, pitch_deg, fov_y_deg;
};
/* The camera of a pose, in the ENU frame of the origin. ERR_ARG. Any thread. */
enum err_code view_camera(const struct geo_origin *origin, const struct view_pose *pose,
                          uint32_t width_px, uint32_t height_px, struct camera *out,
                          struct err *e) ERR_USE;

#endif
