/* What is known of the depth of a photograph.
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
/* Why a map is not used; DEPTH_MAP_OK: it is. */
enum depth_verdict {
    DEPTH_MAP_OK,
    DEPTH_MAP_MISSING, /* no file of that name */
    DEPTH_MAP_FEW,     /* 10 good observations or fewer */
    DEPTH_MAP_FLAT,    /* the points' inverse depths, or the map at them, hardly differ */
    DEPTH_MAP_MISFIT,  /* falls where it should rise, or is off by a factor e^0.3 after alignment */
    DEPTH_MAP_SCALE,   /* aligned by another scale than the other photographs' maps */
    DEPTH_VERDICTS
};
extern const char *const depth_verdict_text[DEPTH_VERDICTS];
/* Align a map to inverse depths x of n points, y the map there: x ~ a y + b by mean absolute
 * deviations about medians, which outliers do not move far. */
enum depth_verdict depth_align(const double *x, const double *y, size_t n, double *a, double *b);

struct depth_map_config {
    const struct scene *scene; /* borrowed, as is images */
    const uint32_t *images;
    size_t n_images;
    const char *dir; /* NAME.npy, .png, .pfm or .tif of inverse depth, NAME with or without its own
                      * ending; NULL: none */
    bool sparse;     /* photographs without a map: the points that they observe */
};
struct depth_map; /* alignments of all maps, and the target of one photograph */
/* Reads every map once. ERR_DATA when not one can be used, with the reason; ERR_IO, ERR_MEM.
 * depth_map_close it. */
enum err_code depth_map_open(const struct depth_map_config *cfg, struct depth_map **out,
                             struct err *e) ERR_USE;
void depth_map_close(struct depth_map **d);
size_t depth_map_count(const struct depth_map *d, enum depth_verdict v);

struct depth_target {
    /* [h][w] inverse depth times unit_m, below 0 = unknown; borrowed until the next */
    const float *t;
    double unit_m;  /* 1 / median inverse depth */
    size_t n_known; /* over which the mean is taken; 0: nothing is known, t is NULL */
};
/* The target of a photograph seen by `cam`, that of the scene at any size. mask: [h][w], 0 =
 * nothing is known there; NULL: none. Reads the map from its file. ERR_NOENT, ERR_IO, ERR_FORMAT:
 * it has changed since; ERR_MEM. */
enum err_code depth_map_target(struct depth_map *d, uint32_t image, const struct camera *cam,
                               const uint8_t *mask, struct depth_target *out,
                               struct err *e) ERR_USE;
#endif
