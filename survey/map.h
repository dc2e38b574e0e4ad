/* Maps of a store: orthophoto and surface model, as Cloud Optimized GeoTIFF. A city of any size is
 * drawn piece by piece; memory holds one piece and the tiles that it shows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_MAP_H
#define SURVEY_MAP_H

#include "lod/nadir.h"
#include "survey/geotiff.h"

struct geoid;

enum { MAP_PIECE_PX = 512 };
#define MAP_EDGE_MAX 1000000 /* px, of a picture */
#define MAP_PIXELS_MAX 2e10
#define MAP_OFF_MAX_PX 0.1 /* how far the plane of a piece may be from the projection */

struct map_request {
    enum geotiff_kind kind;
    int epsg;                  /* 0: the UTM zone of the middle */
    double gsd_m;              /* pixel, in the projection; 0: by how fine the Gaussians are */
    const double *bbox_deg;    /* west, south, east, north; NULL: all that was surveyed */
    uint32_t piece_px;         /* 0: MAP_PIECE_PX */
    const struct geoid *geoid; /* heights count from it; NULL: from the ellipsoid */
};
struct map_grid { /* pixels of the projection: edges are multiples of a pixel */
    double west_m, north_m, pixel_m;
    uint32_t width, height;
    int epsg;
};
struct map_report {
    struct map_grid grid;
    uint64_t pixels_held; /* with a surface */
    double off_px;        /* how far the planes of pieces were from the projection, at most */
    double seconds;
    double height_min_m, height_max_m; /* of a surface model; NAN: none */
};
/* Where pieces go. */
struct map_visitor {
    const char *what; /* of the progress bar */
    void *user;
    /* Before the first piece. */
    enum err_code (*begin)(void *user, const struct crs *crs, const struct map_grid *g,
                           struct err *e);
    /* w x h pixels from (x, y) on, row by row of pieces: rgb [h][w][3], 0 to 1, NULL for
     * GEOTIFF_HEIGHT; height_m [h][w], NAN where there is no surface or nothing was surveyed.
     * Pieces of which nothing was surveyed are left out. */
    enum err_code (*piece)(void *user, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                           const float *rgb, const float *height_m, struct err *e);
};
/* The pixels of a request. ERR_ARG: EPSG code, an empty area, or more pixels than allowed; each
 * says what is. ERR_IO: PROJ's database lacks the geoid's heights. */
enum err_code map_plan(const struct nadir *n, const struct map_request *r, struct crs **crs,
                       struct map_grid *out, struct err *e) ERR_USE;
/* The piece of p->width x p->height pixels whose top left one is (x, y) of the grid; its corners as
 * area_mask wants them; off_px grows to how far its plane is from the projection. ERR_ARG: farther
 * than MAP_OFF_MAX_PX. */
enum err_code map_place(const struct nadir *n, const struct crs *crs, const struct map_grid *g,
                        uint32_t x, uint32_t y, struct nadir_piece *p, double corner[8],
                        double *off_px, struct err *e) ERR_USE;
/* Draw a map and hand its pieces on. ERR_ARG: nothing was surveyed there; errors of map_plan,
 * nadir_draw and the visitor's own; ERR_CANCEL when the program was told to stop. */
enum err_code map_run(struct nadir *n, const struct map_request *r, const struct map_visitor *v,
                      struct map_report *report, struct err *e) ERR_USE;
/* What heights of a request are: "height above the WGS 84 ellipsoid". */
void map_heights(const struct map_request *r, char out[100]);
/* Write the file beside and rename it. Errors of map_plan, nadir_draw and geotiff.h; ERR_CANCEL
 * when the program was told to stop. report may be NULL. */
enum err_code map_write(struct nadir *n, const struct map_request *r, const char *path,
                        struct map_report *report, struct err *e) ERR_USE;

#endif
