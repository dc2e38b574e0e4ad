/* Known depths of a photograph.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_DEPTH_MAP_H
#define LOSS_DEPTH_MAP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/camera.h"
#include "core/err.h"

struct scene;
/* Why a map is not used. DEPTH_MAP_OK: it is used. */
enum depth_verdict {
    DEPTH_MAP_OK,
    DEPTH_MAP_MISSING, /* there is no such file */
    DEPTH_MAP_FEW,     /* at most 10 good observations */
    DEPTH_MAP_FLAT,    /* inverse depths of the points, or the map there, hardly differ */
    /* the map falls where it should rise, or is off by a factor e^0.3 after alignment */
    DEPTH_MAP_MISFIT,
    DEPTH_MAP_SCALE, /* its scale differs from that of the other photographs' maps */
    DEPTH_VERDICTS
};
extern const char *const depth_verdict_text[DEPTH_VERDICTS];
/* Aligns a map to inverse depths: x of n points, y of the map there, x ~ a y + b. It uses mean
 * absolute deviations about medians, which outliers hardly change. */
enum depth_verdict depth_align(const double *x, const double *y, size_t n, double *a, double *b);

/* Finds the map of a photograph in a folder. path has FILE_PATH_MAX bytes; *found: there is such a
 * file. ERR_LIMIT. */
enum err_code depth_map_find(const char *dir, const char *name, bool *found, char *path,
                             struct err *e) ERR_USE;

struct depth_map_config {
    const struct scene *scene; /* borrowed, as is images */
    const uint32_t *images;
    size_t n_images;
    /* folder with NAME.npy, .png, .pfm or .tif of inverse depth, NAME with or without its own
     * extension; NULL: none */
    const char *dir;
    bool metric; /* maps are in 1/m: they are taken as they are */
    bool sparse; /* photographs without a map use the points that they observe */
};
struct depth_map; /* alignments of all maps, and the target of one photograph */
/* Reads every map once. Close *out with depth_map_close. ERR_DATA: no map can be used; the message
 * gives the reason. ERR_IO, ERR_MEM. */
enum err_code depth_map_open(const struct depth_map_config *cfg, struct depth_map **out,
                             struct err *e) ERR_USE;
void depth_map_close(struct depth_map **d);
size_t depth_map_count(const struct depth_map *d, enum depth_verdict v);

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
