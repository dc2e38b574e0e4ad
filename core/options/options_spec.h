/* The rows of a command's option table, and the texts of its help. core/options/options.h says how
 * a table is written and read, core/options/options_help.h how it is shown.
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
typedef int OPTIONS_C_ENUM;         /* index into the choices in `unit`, "none|2d|mip" */

/* A list with one value a level; the last value belongs to the finest level.
 * - Nothing given: `v` is the default and n = 0. The same holds for a list that equals the default.
 * - One value: it is in `one`, and `v` stays the default. The option's help says what one value
 *   means.
 * - n > 1 values: they fill the end of `v`, so the first is v[length of the default - n]. The code
 *   that uses the list checks that n is the number of levels. */
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
#define OPTIONS_MEMBER(type, tier, key, def, lo, hi, unit, help) OPTIONS_C_##type key;

enum options_type {
    OPTIONS_NUM,
    OPTIONS_INT,
    OPTIONS_BOOL,
    OPTIONS_TEXT,
    OPTIONS_ENUM,
    OPTIONS_INTS, /* lists: the default has the largest number of values */
    OPTIONS_NUMS,
    OPTIONS_GROUP /* no option but a heading of the help; `help` is its text, its key is "" */
};

/* --help shows EVERYDAY options, --help=all also MORE. */
enum options_tier { OPTIONS_EVERYDAY, OPTIONS_MORE };

struct options_def {
    enum options_type type;
    enum options_tier tier;
    const char *key; /* such as cell_edge_m */
    size_t offset;   /* of the member in the config struct */
    /* default as text; "true" or "false" for BOOL; "" for a TEXT that is not set */
    const char *def;
    double lo, hi;    /* NUM, INT and lists: smallest and largest value allowed */
    const char *unit; /* "m"; the choices of an ENUM; the kind of a TEXT, such as "FILE" */
    const char *help;
};
#define OPTIONS_ROW(st, type, tier, key, def, lo, hi, unit, help)                                  \
    {OPTIONS_##type, OPTIONS_##tier, #key, offsetof(st, key), def, lo, hi, unit, help},

/* A row of a table that several commands share. `in` is the member of their config struct that
 * holds the shared options. */
/* NOLINTBEGIN(bugprone-macro-parentheses): names of members */
#define OPTIONS_ROW_IN(st, in, type, tier, key, def, lo, hi, unit, help)                           \
    {OPTIONS_##type, OPTIONS_##tier, #key, offsetof(st, in.key), def, lo, hi, unit, help},
/* NOLINTEND(bugprone-macro-parentheses) */

#define OPTIONS_GROUP_ROW(title) {OPTIONS_GROUP, OPTIONS_EVERYDAY, "", 0, "", 0, 0, "", title},

struct options_spec {
    const char *command; /* "train" */
    const char *usage;   /* "citysplat train SCENE [options]" */
    const char *about;   /* one paragraph of --help */
    const char *example; /* one or more command lines of --help; may be NULL */
    const struct options_def *defs;
    size_t n_defs;
    size_t min_args, max_args; /* number of positional arguments */
};

#endif
