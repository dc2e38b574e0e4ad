/* What the commands that draw a store from straight above share: their options, the store, the line
 * at the end.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_MAPS_H
#define CLI_MAPS_H

#include "core/options.h"
#include "survey/map.h"

struct maps_options {
#define OPT(type, tier, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/maps.def"
#undef OPT
};
struct geoid_options {
#define OPT(type, tier, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/geoid.def"
#undef OPT
};
struct maps { /* maps_close */
    struct nadir *nadir;
    struct geoid *geoid; /* NULL: not asked for */
    double bbox[4];
    struct map_request request; /* points to bbox and geoid: stays where it is */
};
/* Check the options and open the store. appearance and g may be NULL. ERR_ARG names the option;
 * else as nadir_open and geoid_open: ERR_NOENT, ERR_FORMAT, ERR_DATA, ERR_DEVICE, ERR_MEM. */
enum err_code maps_open(const char *store, const struct maps_options *o,
                        const struct geoid_options *g, const char *appearance, struct maps *out,
                        struct err *e) ERR_USE;
void maps_close(struct maps *m);
/* How large, where, how fast, without an end of the line. */
void maps_print(const char *path, const struct map_report *r);
/* What heights lie between and count from. */
void maps_print_heights(const struct maps *m, const struct map_report *r);
/* A map that one call writes: opens the store, writes, prints. As maps_open and c->write. */
struct maps_command {
    enum geotiff_kind kind;
    const char *appearance;              /* NULL: the store's own */
    const struct geoid_options *heights; /* NULL: the map has none */
    const char *counts;                  /* what its pixels with a surface are; NULL: pixels */
    enum err_code (*write)(struct nadir *n, const struct map_request *r, const char *path,
                           struct map_report *out, struct err *e);
};
enum err_code maps_write(const char *store, const struct maps_options *o,
                         const struct maps_command *c, struct err *e) ERR_USE;
/* A number of this option, NAN when text is NULL. ERR_ARG. */
enum err_code maps_number(const char *option, const char *text, double *out, struct err *e) ERR_USE;

#endif
