/* Shared by the readers of COLMAP's binary and text files, before ids become indices.
 *
 * In a raw model, colmap_image.camera, colmap_observation.point and colmap_track_element.image
 * still hold COLMAP's ids. A missing point is -1.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_COLMAP_PARSE_H
#define CODEC_COLMAP_PARSE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/splat/camera.h"

struct buf;
struct colmap_camera;
struct colmap_image;
struct colmap_model;
struct colmap_point;

/* Each reads the bytes of one file into its part of m, which m's arena owns. ERR_FORMAT names file
 * and record. ERR_MEM. */
enum err_code colmap_bin_cameras(const struct buf *file, struct colmap_model *m,
                                 struct err *e) ERR_USE;
enum err_code colmap_bin_images(const struct buf *file, struct colmap_model *m,
                                struct err *e) ERR_USE;
enum err_code colmap_bin_points(const struct buf *file, struct colmap_model *m,
                                struct err *e) ERR_USE;
/* Each reads one text file. They change the buffer: line ends become NUL. The buffer must end with
 * a NUL byte. ERR_FORMAT names file and line. ERR_MEM. */
enum err_code colmap_txt_cameras(struct buf *file, struct colmap_model *m, struct err *e) ERR_USE;
enum err_code colmap_txt_images(struct buf *file, struct colmap_model *m, struct err *e) ERR_USE;
enum err_code colmap_txt_points(struct buf *file, struct colmap_model *m, struct err *e) ERR_USE;

/* A camera model by COLMAP's number, or if `name` is not NULL, by its name. */
struct colmap_lens {
    const char *name;
    size_t n_params;
    enum lens_model
        model; /* whose first parameters these are, the others 0; LENS_COUNT: not read */
};
/* Returns whether COLMAP has such a model. */
bool colmap_lens_find(const char *name, uint32_t id, struct colmap_lens *out);
enum { COLMAP_PARAMS_MAX = 16 };
/* Takes the parameters [l->n_params] over. Returns NULL if the camera is valid or of a model that
 * is not read, else what is wrong with it. */
const char *colmap_set_lens(const struct colmap_lens *l, const double *params,
                            struct colmap_camera *c);
/* Checks a record, for both readers. Returns NULL if it is valid, else what is wrong with it. */
const char *colmap_check_image(const struct colmap_image *im);
/* Are its coordinates finite? */
bool colmap_point_is_somewhere(const struct colmap_point *p);

/* ---- colmap_tracks.c ---- */

/* Checks tracks against observations, when references are indices. Where the model has only one of
 * them, it makes the other. ERR_FORMAT: they contradict each other. ERR_MEM. */
enum err_code colmap_tracks_agree(struct colmap_model *m, struct err *e) ERR_USE;
/* Computes errors of points that the model does not say, by their observations. */
void colmap_tracks_errors(struct colmap_model *m);

#endif
