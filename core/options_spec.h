/* What a command's options are: the rows of its table, and the texts of its help. core/options.h
 * has how a table is written and read, core/options_help.h how it is shown.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_SPEC_H
#define CORE_OPTIONS_SPEC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef double OPTIONS_C_NUM;
typedef int64_t OPTIONS_C_INT;
typedef bool OPTIONS_C_BOOL;
typedef const char *OPTIONS_C_TEXT; /* NULL when the default is "" */
typedef int OPTIONS_C_ENUM;         /* index into the choices listed in `unit`, "none|2d|mip" */

enum options_type {
    OPTIONS_NUM,
    OPTIONS_INT,
    OPTIONS_BOOL,
    OPTIONS_TEXT,
    OPTIONS_ENUM,
    OPTIONS_GROUP /* no option: a heading of the help, in `help`; its key is "" */
};

struct options_def {
    enum options_type type;
    const char *key;  /* cell_edge_m */
    size_t offset;    /* in the config struct */
    const char *def;  /* default as text; "true"/"false" for BOOL; "" = unset for TEXT */
    double lo, hi;    /* NUM and INT: inclusive range */
    const char *unit; /* "m"; for ENUM the choices; for TEXT what it is: "FILE" */
    const char *help;
};
#define OPTIONS_ROW(st, type, key, def, lo, hi, unit, help)                                        \
    {OPTIONS_##type, #key, offsetof(st, key), def, lo, hi, unit, help},

/* Of a table that several commands share, whose struct is member `in` of theirs. */
/* NOLINTBEGIN(bugprone-macro-parentheses): names of members */
#define OPTIONS_ROW_IN(st, in, type, key, def, lo, hi, unit, help)                                 \
    {OPTIONS_##type, #key, offsetof(st, in.key), def, lo, hi, unit, help},
/* NOLINTEND(bugprone-macro-parentheses) */

#define OPTIONS_GROUP_ROW(title) {OPTIONS_GROUP, "", 0, "", 0, 0, "", title},

struct options_spec {
    const char *command; /* "train" */
    const char *usage;   /* "citysplat train SCENE [options]" */
    const char *about;   /* one paragraph for --help */
    const char *example; /* one or more command lines for --help; may be NULL */
    const struct options_def *defs;
    size_t n_defs;
    size_t min_args, max_args; /* positional arguments */
};

#endif
