/* Options that exclude each other: core/options/options_rules.def, checked after every command
 * line.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_RULES_H
#define CORE_OPTIONS_RULES_H

#include "core/base.h"
#include "core/options/options_spec.h"

/* Checks the rules. `now` has the values in use as JSON, `defaults` those of the table. ERR_ARG: a
 * rule is broken; the message names both options and what to do. Some rules only warn: they write
 * to the log. ERR_INTERNAL: a rule names no option of `spec`. */
enum err_code options_rules_check(const struct options_spec *spec, const struct json_t *now,
                                  const struct json_t *defaults, struct err *e) ERR_USE;

#endif
