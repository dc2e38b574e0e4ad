/* The options of the server, as `citysplat serve` reads them (server/base/options.def), and
 * constants.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_CONFIG_H
#define SERVER_CONFIG_H

#include "codec/splat/quant.h"
#include "core/options/options.h"

struct server_config { /* texts are borrowed and live as long as the server */
#define OPT OPTIONS_MEMBER
#include "server/base/options.def"
#define FIXED(type, key, value) OPTIONS_C_##type key;
#include "server/base/fixed.def"
#undef FIXED
};
/* Sets what is no option (fixed.def). */
void config_fix(struct server_config *out);
/* Sets every member to its default. Texts live in the arena. ERR_MEM. */
enum err_code config_defaults(struct server_config *out, struct arena *a, struct err *e) ERR_USE;

#endif
