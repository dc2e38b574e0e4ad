/* citysplat sign: signed addresses of a server with --auth, for clients that cannot send a token.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "cli/cli.h"
#include "server/auth.h"

struct sign_config {
#define OPT(type, tier, key, def, lo, hi, unit, help) OPTIONS_C_##type key;
#include "cli/sign.def"
#undef OPT
};

static const struct options_def sign_defs[] = {
#define OPT(type, tier, key, def, lo, hi, unit, help)                                              \
    OPTIONS_ROW(struct sign_config, type, tier, key, def, lo, hi, unit, help)
#include "cli/sign.def"
#undef OPT
};

static const struct options_spec sign_spec = {
    .command = "sign",
    .usage = "citysplat sign PATH... --auth FILE [options]",
    .about = "Prints signed addresses for a server that was started with --auth. A signed address "
             "opens a path until its time is over. If the path ends with /, it opens everything "
             "below the path. /d/NAME/ is a dataset with its tiles and pictures.",
    .example = "citysplat sign /d/city/ --auth auth.jsonc --for-s 86400 --url https://maps.example",
    .defs = sign_defs,
    .n_defs = sizeof sign_defs / sizeof *sign_defs,
    .min_args = 1,
    .max_args = 16,
};

enum err_code cli_sign(int argc, char **argv, struct err *e)
{
    struct sign_config cfg;
    struct options_args args;
    struct arena arena = {0};
    struct auth *auth = NULL;
    char query[AUTH_QUERY_MAX];
    enum err_code rc = options_parse(&sign_spec, argc, argv, &cfg, &args, &arena, e);
    if (rc || args.done)
        goto out;
    if (!cfg.auth)
        rc = err_set(e, ERR_ARG, "--auth FILE is missing: it has the keys");
    if (!rc)
        rc = auth_open(cfg.auth, &auth, e);
    int64_t until_s = (int64_t)time(NULL) + (int64_t)cfg.for_s;
    for (size_t i = 0; !rc && i < args.n; i++) {
        const char *url = cfg.url ? cfg.url : "";
        size_t n = strlen(url);
        rc = auth_sign(auth, cfg.key, args.arg[i], until_s, query, e);
        if (!rc)
            printf("%.*s%s?%s\n", (int)(n && url[n - 1] == '/' ? n - 1 : n), url, args.arg[i],
                   query);
    }
out:
    auth_close(&auth);
    arena_free(&arena);
    return rc;
}
