/* Known depths of a photograph: maps of inverse depth, as `citysplat stereo` makes them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TRAIN_LOSS_DEPTH_MAP_H
#define TRAIN_LOSS_DEPTH_MAP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"
#include "core/splat/camera.h"

struct scene;

/* Finds the map of a photograph in a folder. path has FILE_PATH_MAX bytes; *found: there is such a
 * file. ERR_LIMIT. */
enum err_code depth_map_find(const char *dir, const char *name, bool *found, char *path,
                             struct err *e) ERR_USE;

struct depth_map_config {
    const struct scene *scene; /* borrowed, as is images */
    const uint32_t *images;
    size_t n_images;
    /* folder with NAME.npy, .png, .pfm or .tif of inverse depth in 1/m, NAME with or without its
     * own extension */
    const char *dir;
};
struct depth_map; /* which photographs have a map, and the target of one photograph */
/* Looks for the map of every photograph. Close *out with depth_map_close. ERR_DATA: there is none.
 * ERR_LIMIT, ERR_MEM. */
enum err_code depth_map_open(const struct depth_map_config *cfg, struct depth_map **out,
                             struct err *e) ERR_USE;
void depth_map_close(struct depth_map **d);

struct depth_target {
    /* [h][w] inverse depth times unit_m, below 0 = unknown; borrowed until the next call */
    const float *t;
    double unit_m;  /* 1 / median inverse depth */
    size_t n_known; /* number of known pixels, for the mean; 0: nothing is known, and t is NULL */
};
/* Makes the target of a photograph. `cam` is its camera at any size. mask [h][w] (NULL: none) is 0
 * where depth is not known. It reads the map from its file. ERR_NOENT, ERR_IO, ERR_FORMAT: the file
 * has changed since. ERR_MEM. */
enum err_code depth_map_target(struct depth_map *d, uint32_t image, const struct camera *cam,
                               const uint8_t *mask, struct depth_target *out,
                               struct err *e) ERR_USE;
#endif
