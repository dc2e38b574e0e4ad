/* citysplat verify: read everything in a tile store and check it against its hashes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "cli/base/cli.h"
#include "lod/store/store.h"

static const struct options_spec verify_spec = {
    .command = "verify",
    .usage = "citysplat verify CITY.tiles",
    .about = "Checks every page, index row, tile and blob of a tile store against its hash and "
             "decodes all of it, and the whole against its revision. Each fault is logged. The "
             "exit code is 1 if there is a fault.",
    .example = "citysplat verify city.tiles",
    .min_args = 1,
    .max_args = 1};

enum err_code cli_verify(int argc, char **argv, struct err *e)
{
    struct options_args args;
    struct arena arena = {0};
    struct store *s = NULL;
    size_t n, n_bad = 0;
    char none;
    enum err_code rc = options_parse(&verify_spec, argc, argv, &none, &args, &arena, e);
    if (rc || args.done)
        goto out;
    rc = store_open(args.arg[0], &s, e);
    if (rc)
        goto out;
    rc = store_verify(s, &n_bad, e);
    store_tiles(s, &n);
    if (!rc)
        printf("%s: %zu tiles are whole, revision %s\n", args.arg[0], n, store_info(s)->revision);
    else if (n_bad > 1)
        err_add(e, "%zu faults, the first", n_bad);
out:
    store_close(&s);
    arena_free(&arena);
    return rc;
}
