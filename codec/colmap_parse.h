/* Between the COLMAP files: what the two readers fill, before ids are resolved to indices.
 *
 * A raw model is a struct colmap_model in which colmap_image.camera, colmap_observation.point and
 * colmap_track_element.image still hold COLMAP's ids (an absent point is -1).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_COLMAP_PARSE_H
#define CODEC_COLMAP_PARSE_H

#include "core/err.h"

struct buf;
struct colmap_camera;
struct colmap_image;
struct colmap_model;
struct colmap_point;
struct err;

/* Each fills its part of m, whose arena owns it, from the bytes of one file. ERR_FORMAT names file
 * and record, ERR_MEM. */
enum err_code colmap_bin_cameras(const struct buf *file, struct colmap_model *m,
                                 struct err *e) ERR_USE;
enum err_code colmap_bin_images(const struct buf *file, struct colmap_model *m,
                                struct err *e) ERR_USE;
enum err_code colmap_bin_points(const struct buf *file, struct colmap_model *m,
                                struct err *e) ERR_USE;
/* The text readers write into the buffer (line ends become NUL); it must end in a NUL byte.
 * ERR_FORMAT names file and line, ERR_MEM. */
enum err_code colmap_txt_cameras(struct buf *file, struct colmap_model *m, struct err *e) ERR_USE;
enum err_code colmap_txt_images(struct buf *file, struct colmap_model *m, struct err *e) ERR_USE;
enum err_code colmap_txt_points(struct buf *file, struct colmap_model *m, struct err *e) ERR_USE;

/* Checks of one record, shared by both. NULL when sound, else what is wrong with it. */
const char *colmap_check_camera(const struct colmap_camera *c);
const char *colmap_check_image(const struct colmap_image *im);
const char *colmap_check_point(const struct colmap_point *p);

#endif
