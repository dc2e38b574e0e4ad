/* The options of one command as a part of a shell's completion.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_COMPLETION_H
#define CORE_OPTIONS_COMPLETION_H

#include <stdio.h>

#include "core/options_help.h"

/* One branch of `case` for bash and zsh, lines of `complete` for fish; `format` is one of the
 * three. All options are offered; an ENUM offers its choices, a TEXT of FILE or DIR files, other
 * values nothing. */
void options_completion_print(FILE *f, const struct options_spec *spec, enum options_format format);
/* What stands before the first command and behind the last; `names` are all commands. */
void options_completion_head(FILE *f, const char *const *names, size_t n,
                             enum options_format format);
void options_completion_tail(FILE *f, enum options_format format);

#endif
