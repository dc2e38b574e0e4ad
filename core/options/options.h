/* Options: every command has one table of options, an X-macro (core/options/options_spec.h). These
 * come from the table: the config struct, the flags, the keys of config files, the range checks,
 * --help, docs/commands.md, the manual pages, shell completion and --print-config. A default
 * therefore stands in one place.
 *
 *     train/base/options.def:
 *       OPT(NUM, MORE, near_m, "0", 0, 1000, "m", "near plane")
 *       OPT(ENUM, EVERYDAY, aa, "2d", 0, 0, "none|2d|mip", "anti-aliasing")
 *       #undef OPT
 *     train/base/config.h:
 *       struct train_config {
 *       #define OPT OPTIONS_MEMBER
 *       #include "train/base/options.def"
 *       };
 *     train/base/config.c:
 *       static const struct options_def train_defs[] = {
 *       #define GROUP(title) OPTIONS_GROUP_ROW(title)
 *       #define OPT(...) OPTIONS_ROW(struct train_config, __VA_ARGS__)
 *       #include "train/base/options.def"
 *       };
 *
 * GROUP("title") begins a heading of the help; the options after it stand under that heading. A
 * table with groups begins with `#ifndef GROUP`, an empty definition of GROUP and `#endif`, and
 * ends with `#undef GROUP`. The config struct can then include it without knowing about groups.
 *
 * - The flag of near_m is --near-m VALUE or --near-m=VALUE.
 * - BOOL has --key and --no-key. --help shows the flag that changes the default: "--no-masks  Turn
 *   off: " and the help text.
 * - Whole numbers take k, M and G. They mean thousands, or powers of 1024 where the unit is KB, MB
 *   or MiB: 4G of MiB is 4096.
 * - Lists are written A,B,C. In config files they may also be arrays.
 * - Flags override config files, and a later --config FILE overrides an earlier one. Both override
 *   defaults.
 * - An unknown flag or key is an error that names the nearest known one.
 * - core/options/options_rules.def says which options exclude each other.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_H
#define CORE_OPTIONS_H

#include "core/base.h"
#include "core/options/options_spec.h"

struct options_args {       /* positional arguments, borrowed from argv */
    const char *const *arg; /* [n], in the arena */
    size_t n;
    bool done; /* --help or --print-config was answered on stdout; the command returns ERR_OK */
};

/* Fills `config` from defaults, config files and argv[1..]. It zeroes `config` first. TEXT values
 * live in the arena. Every command accepts -h, --help, --config FILE, --print-config, -v (debug
 * log) and -q (no progress, warnings only). -o X means --output X where that key exists. ERR_ARG:
 * the user made a mistake. ERR_MEM. */
enum err_code options_parse(const struct options_spec *spec, int argc, char **argv, void *config,
                            struct options_args *args, struct arena *a, struct err *e) ERR_USE;
/* Fills `config` with the defaults alone, for tests and use as a library. ERR_MEM. */
enum err_code options_defaults(const struct options_spec *spec, void *config, struct arena *a,
                               struct err *e) ERR_USE;
/* Returns the values as a JSON object. --print-config prints it, and a run stores it beside its
 * output. Release it with json_decref. ERR_MEM. */
enum err_code options_to_json(const struct options_spec *spec, const void *config,
                              struct json_t **out, struct err *e) ERR_USE;
/* Sets values of `config` from a JSON object. Keys that are missing keep their values. ERR_ARG: a
 * key is unknown, or a value is out of range. */
enum err_code options_from_json(const struct options_spec *spec, const struct json_t *o,
                                void *config, struct arena *a, struct err *e) ERR_USE;

/* Parses the number of a TEXT option, whose default is no number. `option` is for the message. text
 * NULL gives `none`. ERR_ARG: it is no number. */
enum err_code options_number_of(const char *option, const char *text, double none, double *out,
                                struct err *e) ERR_USE;
/* Levenshtein distance of two names, for "did you mean". SIZE_MAX where b is longer than a name. */
size_t options_distance(const char *a, const char *b);

#endif
