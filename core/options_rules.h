/* Which options do not go together: core/options_rules.def, checked after every command line.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_RULES_H
#define CORE_OPTIONS_RULES_H

#include "core/base.h"
#include "core/options_spec.h"

/* `now` are the resolved values as JSON, `defaults` those of the table. ERR_ARG names both options
 * of the first rule that is broken and what to do; rules that only warn write to the log.
 * ERR_INTERNAL for a rule that names no option of `spec`. */
enum err_code options_rules_check(const struct options_spec *spec, const struct json_t *now,
                                  const struct json_t *defaults, struct err *e) ERR_USE;

#endif
