/* Options: one X-macro table a command (core/options_spec.h). The config struct, the flags, the
 * keys of config files, the range checks, --help, the reference (docs/commands.md), the manual
 * pages, the shell completion and --print-config come from it. A default exists in one place.
 *
 *   train/options.def:  OPT(NUM, MORE, near_m, "0", 0, 1000, "m", "near plane")
 *                       OPT(ENUM, MORE, aa, "2d", 0, 0, "none|2d|mip", "anti-aliasing")
 *   train/config.h:     struct train_config {
 *                       #define OPT(type, tier, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
 *                       #include "train/options.def"
 *                       #undef OPT
 *                       };
 *   train/config.c:     static const struct options_def train_defs[] = {
 *                       #define GROUP(title) OPTIONS_GROUP_ROW(title)
 *                       #define OPT(type, tier, key, def, lo, hi, unit, help) \
 *                         OPTIONS_ROW(struct train_config, type, tier, key, def, lo, hi, unit,
 * help)
 *                       #include "train/options.def"
 *                       #undef OPT
 *                       };
 *
 * GROUP("title") in a table puts the options behind it under a heading of the help. A table with
 * groups begins with `#ifndef GROUP`, an empty definition and `#endif`, and ends with `#undef
 * GROUP`, so that the struct need not know of them.
 *
 * The flag of near_m is --near-m VALUE (or =VALUE). BOOL takes --key and --no-key; --help shows the
 * one that changes the default ("--no-masks  Turn off: " and the help text). Whole numbers take k,
 * M and G: thousands, or steps of 1024 where the unit is KB, MB or MiB (4G of MiB is 4096). Lists
 * are A,B,C, in config files also arrays. Precedence: default < --config FILE... in order < flags.
 * Unknown flags and keys are errors that name the nearest one. core/options_rules.def says which
 * options do not go together.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_H
#define CORE_OPTIONS_H

#include "core/base.h"
#include "core/options_spec.h"

struct options_args { /* positional arguments, borrowed from argv */
    const char *arg[16];
    size_t n;
    bool done; /* --help or --print-config was answered on stdout: the command returns ERR_OK at
                  once */
};

/* Fill `config` (zeroed by the callee) from defaults, config files and argv[1..]. TEXT values live
 * in the arena. -h/--help, --config FILE, --print-config, -v (debug log) and -q (no progress,
 * warnings only) are understood by every command; -o X is the same as --output X where that key
 * exists. ERR_ARG for anything a user mistyped. */
enum err_code options_parse(const struct options_spec *spec, int argc, char **argv, void *config,
                            struct options_args *args, struct arena *a, struct err *e) ERR_USE;
/* Fill with the defaults alone (tests, library use). ERR_MEM. */
enum err_code options_defaults(const struct options_spec *spec, void *config, struct arena *a,
                               struct err *e) ERR_USE;
/* The resolved values as a JSON object: what --print-config prints and a run stores beside its
 * output. json_decref it. ERR_MEM. */
enum err_code options_to_json(const struct options_spec *spec, const void *config,
                              struct json_t **out, struct err *e) ERR_USE;
/* Its way back, over what config holds: keys that are missing stay, unknown ones and values out of
 * range are ERR_ARG. */
enum err_code options_from_json(const struct options_spec *spec, const struct json_t *o,
                                void *config, struct arena *a, struct err *e) ERR_USE;

#endif
