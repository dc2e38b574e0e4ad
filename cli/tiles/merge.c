/* citysplat merge: tile stores of neighbouring areas -> one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "lod/make/merge.h"

struct merge_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/merge.def"
};

static const struct options_def merge_defs[] = {
#define OPT(...) OPTIONS_ROW(struct merge_options, __VA_ARGS__)
#include "cli/tiles/merge.def"
};

static const struct options_spec merge_spec = {
    .command = "merge",
    .usage = "citysplat merge A.tiles B.tiles -o C.tiles [options]",
    .about = "Merges two tile stores of neighbouring areas into one, in the frame of the first. "
             "Origins may differ. Tiles of one store alone are copied. Tiles of both stores are "
             "made again from the Gaussians of both.",
    .example = "citysplat merge north.tiles south.tiles -o city.tiles --name city",
    .defs = merge_defs,
    .n_defs = sizeof merge_defs / sizeof *merge_defs,
    .min_args = 2,
    .max_args = 2};

enum err_code cli_merge(int argc, char **argv, struct err *e)
{
    struct merge_options o = {0};
    struct options_args args;
    struct merge_report r;
    struct arena arena = {0};
    enum err_code rc = options_parse(&merge_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done)
        rc = output_needed(o.output, o.overwrite, e);
    for (size_t i = 0; !rc && i < args.n; i++)
        rc = output_apart(o.output, args.arg[i], e);
    if (!rc && !args.done) {
        signals_catch();
        rc = merge_build(args.arg[0], args.arg[1], o.name, o.output, &r, e);
        if (!rc)
            printf("%s: %zu tiles made, %zu taken over, revision %s\n", o.output, r.n_written,
                   r.n_copied, r.revision);
    }
    arena_free(&arena);
    return rc;
}
