/* Where known depths of the photographs lie (option depth_prior), and the points fused from them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_DEPTH_PRIOR_H
#define TRAIN_DEPTH_PRIOR_H

#include <stddef.h>

#include "core/err.h"

struct scene;
struct train_config;

/* Folder of the maps in out [FILE_PATH_MAX]; "": there is none. ERR_NOENT: the folder that the
 * option asks for does not exist; the message says how to make it. ERR_LIMIT. */
enum err_code depth_prior_dir(const struct train_config *cfg, const struct scene *s, char *out,
                              struct err *e) ERR_USE;
/* Reads the folder's points.npy, [n][6] as scene/stereo/fuse.h. n is 0 without such a file. Free
 * *out with mem_free. ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code depth_prior_points(const char *dir, float **out, size_t *n, struct err *e) ERR_USE;

#endif
