/* See config.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/config.h"

void config_fix(struct server_config *out)
{
#define FIXED(type, key, value) out->key = value;
#include "server/base/fixed.def"
#undef FIXED
}

enum err_code config_defaults(struct server_config *out, struct arena *a, struct err *e)
{
    static const struct options_def defs[] = {
#define OPT(...) OPTIONS_ROW(struct server_config, __VA_ARGS__)
#include "server/base/options.def"
    };
    const struct options_spec spec = {
        .command = "serve", .defs = defs, .n_defs = sizeof defs / sizeof *defs};
    config_fix(out);
    return options_defaults(&spec, out, a, e);
}
