/* The commands of the program. Each command has a file NAME.c, in a room of cli/, with the function
 * cli_NAME().
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_CLI_H
#define CLI_CLI_H

#include "core/base.h"
#include "core/options/options.h"

/* argv[0] is the command's own name. ERR_ARG becomes exit code 2, any other error 1. `serve` has
 * the exit codes of sysexits.h. */
#define COMMAND(name, about) enum err_code cli_##name(int argc, char **argv, struct err *e) ERR_USE;
#define COMMAND_AS(function, name, about) COMMAND(function, about)
#include "cli/base/commands.def"
#undef COMMAND_AS
#undef COMMAND

#endif
