/* Shared by the commands that ask about a surface: they open a store and print the answer as JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_ASK_H
#define CLI_ASK_H

#include "core/options/options.h"
#include "lod/surface/query.h"

enum { ASK_PLACES_MAX = 15 }; /* the usage of these commands names it */
struct ask_options {
#define OPT OPTIONS_MEMBER
#include "cli/maps/ask.def"
#define OPT OPTIONS_MEMBER
#include "cli/maps/geoid.def"
};
/* Asks the store args->arg[0] and prints the answer. The places LON,LAT of the other arguments are
 * added to those of q. ERR_ARG: a place is none, or there is no answer. Else the errors of
 * query_answer, nadir_open and geoid_open. */
enum err_code ask_print(const struct options_args *args, const struct ask_options *o,
                        struct query *q, struct err *e) ERR_USE;

#endif
