/* Shared by the commands that draw a store from straight above: options, opening the store, the
 * line at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_MAPS_H
#define CLI_MAPS_H

#include "core/options/options.h"
#include "survey/map.h"

struct maps_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/maps.def"
};
struct geoid_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/geoid.def"
};
struct ground_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/ground.def"
};

struct maps { /* free with maps_close */
    struct nadir *nadir;
    struct geoid *geoid; /* NULL: not wanted */
    double bbox[4];
    struct map_request request; /* has pointers to bbox and geoid, so do not move the struct */
};
/* Endings of file names, one list for each kind of file; NULL after the last. */
extern const char *const maps_geotiff[], *const maps_vector[], *const maps_points[];
/* Checks that there is a name, that it has one of these endings, and that there is no such file or
 * it may be replaced. ERR_ARG says what to do. */
enum err_code maps_check_output(const char *path, const char *const *ends, bool overwrite,
                                struct err *e) ERR_USE;
/* Checks the options and opens the store. appearance and g may be NULL. ERR_ARG names the option.
 * ERR_NOENT, ERR_FORMAT, ERR_DATA, ERR_DEVICE, ERR_MEM as in nadir_open and geoid_open. */
enum err_code maps_open(const char *store, const struct maps_options *o, const char *const *ends,
                        const struct geoid_options *g, const char *appearance, struct maps *out,
                        struct err *e) ERR_USE;
void maps_close(struct maps *m);
/* Prints size, path and speed, without a newline. */
void maps_print(const char *path, const struct map_report *r);
/* Prints the range of heights and their reference. */
void maps_print_heights(const struct maps *m, const struct map_report *r);
/* A map that one call writes: maps_write opens the store, writes and prints. Errors of maps_open
 * and c->write. */
struct maps_command {
    enum geotiff_kind kind;
    const char *appearance;              /* NULL: the store's default */
    const struct geoid_options *heights; /* NULL: the map has no heights */
    const struct ground_options *bare;   /* NULL: the map knows no bare earth */
    const char *const *ends;             /* of the file; NULL: maps_geotiff */
    bool walls;                          /* points on walls too */
    const char *counts;                  /* name for pixels with a surface; NULL: pixels */
    enum err_code (*write)(struct nadir *n, const struct map_request *r, const char *path,
                           struct map_report *out, struct err *e);
};
enum err_code maps_write(const char *store, const struct maps_options *o,
                         const struct maps_command *c, struct err *e) ERR_USE;
/* Parses west,south,east,north of --bbox, degrees. ERR_ARG. */
enum err_code maps_bbox(const char *text, double out[4], struct err *e) ERR_USE;

#endif
