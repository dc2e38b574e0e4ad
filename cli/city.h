/* What the parts of `citysplat city` share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_CITY_H
#define CLI_CITY_H

#include "core/options/options.h"

struct city_options {
#define OPT OPTIONS_MEMBER
#include "cli/city.def"
};
struct city {
    const struct city_options *o;
    const char *images;
    const char *sparse; /* the model that came with the photographs; NULL: align finds one */
    char name[64];
    struct arena arena;
};

/* Prints what the city will take: minutes of each stage, Gaussians, memory, disk. Times are those
 * of this machine, whose speed is measured for a second. ERR_NOENT, ERR_DATA, ERR_IO, ERR_LIMIT,
 * ERR_CANCEL, ERR_MEM: of the photographs, as align_plan_read. */
enum err_code city_forecast(struct city *c, struct err *e) ERR_USE;

#endif
