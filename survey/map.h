/* Maps of a store: orthophoto and surface model, as Cloud Optimized GeoTIFF. A city of any size is
 * drawn piece by piece. Memory holds one piece and the tiles that it shows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_MAP_H
#define SURVEY_MAP_H

#include "lod/surface/surface.h"
#include "survey/geotiff.h"

struct geoid;
struct bare;

enum { MAP_PIECE_PX = 512 };
#define MAP_EDGE_MAX 1000000 /* px, of a picture */
#define MAP_PIXELS_MAX 2e10
#define MAP_OFF_MAX_PX 0.1 /* largest distance between the plane of a piece and the projection */

struct map_request {
    enum geotiff_kind kind;
    int epsg;               /* 0: the UTM zone of the middle */
    double gsd_m;           /* size of a pixel in the projection; 0: that of the photographs, where
                               it is known, else about that of the Gaussians */
    bool coarse;            /* gsd_m 0 means about that of the Gaussians in any case */
    const double *bbox_deg; /* west, south, east, north; NULL: the whole survey */
    uint32_t piece_px;      /* 0: MAP_PIECE_PX */
    const struct geoid *geoid; /* reference of heights; NULL: the ellipsoid */
    /* Only for map_write and surface_points_write: bare earth and classes by it, of the same
     * request (survey/bare.h). NULL: the surface as it is. */
    const struct bare *ground;
    bool walls; /* only for surface_points_write: points on walls too */
};
struct map_grid { /* pixels in the projection; edges are multiples of a pixel */
    double west_m, north_m, pixel_m;
    uint32_t width, height;
    int epsg;
};
struct map_report {
    struct map_grid grid;
    uint64_t pixels_held; /* number of pixels with a surface */
    uint64_t more;        /* for points: number of those on walls */
    double off_px;        /* largest distance between a piece's plane and the projection */
    double seconds;
    double height_min_m, height_max_m; /* of a surface model; NAN: none */
};
/* Receives the pieces of a map. */
struct map_visitor {
    const char *what; /* text of the progress bar */
    void *user;
    /* Called before the first piece. */
    enum err_code (*begin)(void *user, const struct crs *crs, const struct map_grid *g,
                           struct err *e);
    /* Receives w x h pixels from (x, y) on. Pieces come row by row. rgb is NULL for GEOTIFF_HEIGHT.
     * height_m is NAN where there is no surface or nothing was surveyed. Pieces outside the survey
     * are left out. */
    enum err_code (*piece)(void *user, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                           const struct surface_maps *m, struct err *e);
    /* Only colours are needed. Heights are then those of single rays and only show where there is a
     * surface; there is no uncertainty. Drawing is several times as fast. */
    bool colors_alone;
};
/* A pixel as fine as the photographs are, to two digits. */
double map_fine(double gsd_m);
/* Pixels of an area: box is west, south, east, north in the projection. epsg is left 0. ERR_ARG:
 * too many pixels; the message says what fits. */
enum err_code map_grid_make(const double box[4], double gsd_m, struct map_grid *out,
                            struct err *e) ERR_USE;
/* Computes the pixels of a request. ERR_ARG: an invalid EPSG code, an empty area, or too many
 * pixels; the message says what is allowed. ERR_IO: PROJ's database lacks the geoid's heights.
 * ERR_MEM. */
enum err_code map_plan(const struct nadir *n, const struct map_request *r, struct crs **crs,
                       struct map_grid *out, struct err *e) ERR_USE;
/* Fits the piece of p->width x p->height pixels whose top left pixel is (x, y) of the grid.
 * `corner` is as area_mask wants it. off_px is raised to the distance between its plane and the
 * projection. ERR_ARG: that is more than MAP_OFF_MAX_PX. */
enum err_code map_place(const struct nadir *n, const struct crs *crs, const struct map_grid *g,
                        uint32_t x, uint32_t y, struct nadir_piece *p, double corner[8],
                        double *off_px, struct err *e) ERR_USE;
/* Draws a map and gives its pieces to the visitor. ERR_ARG: nothing was surveyed there. ERR_CANCEL:
 * the program was told to stop. Else the errors of map_plan, nadir_draw and the visitor. */
enum err_code map_run(struct nadir *n, const struct map_request *r, const struct map_visitor *v,
                      struct map_report *report, struct err *e) ERR_USE;
/* Describes the heights of a request: "height above the WGS 84 ellipsoid". */
void map_heights(const struct nadir *n, const struct map_request *r, char out[100]);
/* Writes a map under another name and renames it. report may be NULL. ERR_CANCEL: the program was
 * told to stop. Else the errors of map_plan, nadir_draw and geotiff.h. */
enum err_code map_write(struct nadir *n, const struct map_request *r, const char *path,
                        struct map_report *report, struct err *e) ERR_USE;

#endif
