/* Shared by the commands that ask about a surface: they open a store and print the answer as JSON.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_ASK_H
#define CLI_ASK_H

#include "core/options/options.h"
#include "lod/surface/query.h"

struct ask_options {
#define OPT(type, tier, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/maps/ask.def"
#include "cli/maps/geoid.def"
#undef OPT
};
/* Parses "LON,LAT". ERR_ARG says what is expected. */
enum err_code ask_place(const char *text, double out[2], struct err *e) ERR_USE;
/* Answers a question and prints it. ERR_ARG: there is no answer. Else the errors of query_answer,
 * nadir_open and geoid_open. */
enum err_code ask_print(const char *store, const struct ask_options *o, const struct query *q,
                        struct err *e) ERR_USE;

#endif
