/* citysplat ingest: photographs and COLMAP poses to a scene in metres.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "ingest/ingest.h"
#include "cli/cli.h"

enum err_code cli_ingest(int argc, char **argv, struct err *e)
{
    struct arena a = {0};
    struct ingest_config cfg;
    struct options_args args;
    enum err_code rc = options_parse(ingest_options(), argc, argv, &cfg, &args, &a, e);
    if (!rc && !args.done) {
        signals_catch();
        rc = ingest_run(args.arg[0], args.arg[1], &cfg, e);
    }
    arena_free(&a);
    return rc;
}
