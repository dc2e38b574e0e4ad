/* See config.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/config.h"

enum err_code config_defaults(struct server_config *out, struct arena *a, struct err *e)
{
    static const struct options_def defs[] = {
#define OPT(type, tier, key, def, lo, hi, unit, help)                                              \
    OPTIONS_ROW(struct server_config, type, tier, key, def, lo, hi, unit, help)
#include "server/options.def"
#undef OPT
    };
    const struct options_spec spec = {
        .command = "serve", .defs = defs, .n_defs = sizeof defs / sizeof *defs};
    return options_defaults(&spec, out, a, e);
}
