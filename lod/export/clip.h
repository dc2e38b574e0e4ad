/* A part of a store, cut out by polygons and a range of heights. A Gaussian belongs to it if its
 * mean does. It is then kept whole, even if it reaches outside.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_CLIP_H
#define LOD_CLIP_H

#include <stdbool.h>
#include <stddef.h>

#include "codec/container/geojson.h"
#include "core/base.h"

struct buf;
struct gauss;
struct geo_origin;

struct clip {                 /* free with clip_free */
    struct geojson_area area; /* empty: everywhere */
    double low_m, high_m;     /* as the store counts them; -INFINITY, INFINITY: no limit */
};
/* Reads the polygons of a GeoJSON file (codec/container/geojson.h), each by the even-odd rule. path
 * NULL: everywhere. Heights: -HUGE_VAL, HUGE_VAL: no limit. ERR_DATA: low_m is not below high_m.
 * ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_FORMAT, ERR_DATA, ERR_MEM as in geojson_read. */
enum err_code clip_open(const char *path, double low_m, double high_m, struct clip *out,
                        struct err *e) ERR_USE;
/* A polygon of one ring [n] of longitude and latitude, for any height. The first corner is not
 * repeated at the end. ERR_DATA: it crosses itself or has no area. ERR_MEM. */
enum err_code clip_of_ring(const double (*at)[2], size_t n, struct clip *out,
                           struct err *e) ERR_USE;
void clip_free(struct clip *c);
bool clip_holds(const struct clip *c, double lon_deg, double lat_deg, double h_m);
/* Removes the rows of g that the clip does not hold. The others keep their order. origin: of the
 * ENU frame. ERR_ARG. */
enum err_code clip_rows(const struct clip *c, const struct geo_origin *origin, struct gauss *g,
                        struct err *e) ERR_USE;

struct clip_report {
    size_t n_tiles, n_copied; /* tiles written; tiles among them that were copied byte by byte */
    size_t n_kept, n_dropped; /* Gaussians of all levels */
    char revision[13];
};
/* Writes a store with the Gaussians that the clip holds, at every level. Blobs are copied, and
 * STORE_CLIP describes the clip. The same store and clip give the same revision. name NULL: that of
 * the store. ERR_DATA: nothing is left; the message says where the store lies. ERR_ARG (the name,
 * or the output is the store itself), ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM,
 * ERR_CANCEL. */
enum err_code clip_store(const struct clip *c, const char *path, const char *name,
                         const char *out_path, struct clip_report *report, struct err *e) ERR_USE;

#endif
