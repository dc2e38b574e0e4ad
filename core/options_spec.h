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

/* A list of values, of which the last belongs to the finest level. Without a value of the user `v`
 * is the default and n = 0. One value goes to `one`, and `v` stays the default: the option's help
 * says what it means. Of n > 1 values the last stands in the last place of the default, so that
 * v[length of the default - n] is the first; who reads the list checks that n is the number of
 * levels. A list that equals the default counts as not given. */
enum { OPTIONS_LIST_MAX = 3 };
struct options_ints {
    int64_t v[OPTIONS_LIST_MAX], one; /* one: 0 = not given */
    size_t n;
};
struct options_nums {
    double v[OPTIONS_LIST_MAX], one; /* one: 0 = not given */
    size_t n;
};
typedef struct options_ints OPTIONS_C_INTS;
typedef struct options_nums OPTIONS_C_NUMS;

enum options_type {
    OPTIONS_NUM,
    OPTIONS_INT,
    OPTIONS_BOOL,
    OPTIONS_TEXT,
    OPTIONS_ENUM,
    OPTIONS_INTS, /* lists: the default has as many values as there can be */
    OPTIONS_NUMS,
    OPTIONS_GROUP /* no option: a heading of the help, in `help`; its key is "" */
};

/* EVERYDAY options are shown by --help, MORE by --help=all. */
enum options_tier { OPTIONS_EVERYDAY, OPTIONS_MORE };

struct options_def {
    enum options_type type;
    enum options_tier tier;
    const char *key;  /* cell_edge_m */
    size_t offset;    /* in the config struct */
    const char *def;  /* default as text; "true"/"false" for BOOL; "" = unset for TEXT */
    double lo, hi;    /* NUM, INT and lists: inclusive range of a value */
    const char *unit; /* "m"; for ENUM the choices; for TEXT what it is: "FILE" */
    const char *help;
};
#define OPTIONS_ROW(st, type, tier, key, def, lo, hi, unit, help)                                  \
    {OPTIONS_##type, OPTIONS_##tier, #key, offsetof(st, key), def, lo, hi, unit, help},

/* Of a table that several commands share, whose struct is member `in` of theirs. */
/* NOLINTBEGIN(bugprone-macro-parentheses): names of members */
#define OPTIONS_ROW_IN(st, in, type, tier, key, def, lo, hi, unit, help)                           \
    {OPTIONS_##type, OPTIONS_##tier, #key, offsetof(st, in.key), def, lo, hi, unit, help},
/* NOLINTEND(bugprone-macro-parentheses) */

#define OPTIONS_GROUP_ROW(title) {OPTIONS_GROUP, OPTIONS_EVERYDAY, "", 0, "", 0, 0, "", title},

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
