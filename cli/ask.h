/* What the commands that ask about a surface share: the store, the answer as JSON on standard
 * output.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_ASK_H
#define CLI_ASK_H

#include "lod/query.h"

struct ask_options {
    const char *store, *ceiling, *device, *geoid, *geoid_dir; /* but the store NULL: not given */
};
/* LON,LAT. ERR_ARG says what is expected. */
enum err_code ask_place(const char *text, double out[2], struct err *e) ERR_USE;
/* Ask and print. ERR_ARG: a question without an answer; else as query_answer, nadir_open and
 * geoid_open. */
enum err_code ask_print(const struct ask_options *o, const struct query *q, struct err *e) ERR_USE;

#endif
