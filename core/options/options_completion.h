/* Shell completion for the options of one command.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_OPTIONS_COMPLETION_H
#define CORE_OPTIONS_COMPLETION_H

#include <stdio.h>

#include "core/options/options_help.h"

/* Writes the completion of one command: a branch of `case` for bash and zsh, lines of `complete`
 * for fish. `format` is one of these three. It offers all options, the choices of an ENUM, and file
 * names for a TEXT of FILE or DIR. Other values get no proposals. */
void options_completion_print(FILE *f, const struct options_spec *spec, enum options_format format);
/* Write the text before the first command and the text after the last. `names` are all commands. */
void options_completion_head(FILE *f, const char *const *names, size_t n,
                             enum options_format format);
void options_completion_tail(FILE *f, enum options_format format);

#endif
