/* A part of a store, cut out by polygons and a range of heights. A Gaussian belongs to it by its
 * mean: what lies inside is kept whole, also where it reaches out.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_CLIP_H
#define LOD_CLIP_H

#include <stdbool.h>
#include <stddef.h>

#include "codec/geojson.h"
#include "core/base.h"

struct buf;
struct gauss;
struct geo_origin;

struct clip {                 /* clip_free */
    struct geojson_area area; /* empty: everywhere */
    double low_m, high_m;     /* ellipsoidal; -INFINITY, INFINITY: any */
};
/* The polygons of a GeoJSON file (codec/geojson.h), by the even-odd rule; path NULL: everywhere.
 * ERR_DATA: low_m not below high_m; errors of geojson_read: ERR_NOENT, ERR_IO, ERR_LIMIT,
 * ERR_FORMAT, ERR_DATA, ERR_MEM. */
enum err_code clip_open(const char *path, double low_m, double high_m, struct clip *out,
                        struct err *e) ERR_USE;
/* The same of what three options say, texts or NULL: the polygons' file, and heights; `prefix` of
 * the options' names in errors, as "clip-". *any: at least one is given. ERR_ARG (no number);
 * errors of clip_open: ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_DATA, ERR_MEM. */
enum err_code clip_of_options(const char *path, const char *low_m, const char *high_m,
                              const char *prefix, struct clip *out, bool *any,
                              struct err *e) ERR_USE;
/* The polygon of one ring [n]: longitude, latitude, the first corner not repeated; any height.
 * ERR_DATA: it crosses itself or has no area; ERR_MEM. */
enum err_code clip_of_ring(const double (*at)[2], size_t n, struct clip *out,
                           struct err *e) ERR_USE;
void clip_free(struct clip *c);
/* The same of the same polygons and heights, and of no others; zeros of NULL. */
struct hash128 clip_hash(const struct clip *c);
bool clip_holds(const struct clip *c, double lon_deg, double lat_deg, double h_m);
/* Leave the rows in place that are held; the others go. origin: of the ENU frame. ERR_ARG. */
enum err_code clip_rows(const struct clip *c, const struct geo_origin *origin, struct gauss *g,
                        struct err *e) ERR_USE;

struct clip_report {
    size_t n_tiles, n_copied; /* written; of these byte by byte */
    size_t n_kept, n_dropped; /* Gaussians of all levels */
    char revision[13];
};
/* What a store that is clipped says of it: the GeoJSON of its blob STORE_CLIP, `before` (that of a
 * store that was clipped already; NULL: none) with one feature more. Nothing is added without
 * polygons. ERR_MEM. */
enum err_code clip_describe(const struct clip *c, const char *before, struct buf *out,
                            struct err *e) ERR_USE;
/* A store of what is held: every level, blobs copied, STORE_CLIP says to what. The same store and
 * the same clip give the same revision. name NULL: that of the store. ERR_DATA: nothing is held,
 * says where the store lies; ERR_ARG (name, or the store itself as output), ERR_NOENT, ERR_FORMAT,
 * ERR_IO, ERR_LIMIT, ERR_MEM, ERR_CANCEL. */
enum err_code clip_store(const struct clip *c, const char *path, const char *name,
                         const char *out_path, struct clip_report *report, struct err *e) ERR_USE;

/* The same for the time that it is open: an unnamed file in the folder dir (NULL: TMPDIR, or /tmp),
 * gone with its descriptor *fd, which the caller closes (store_open_fd). Errors as clip_store:
 * ERR_DATA, ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM, ERR_CANCEL. */
enum err_code clip_open_part(const struct clip *c, const char *path, const char *dir, int *fd,
                             struct clip_report *report, struct err *e) ERR_USE;

#endif
