/* The commands of the program: one file a command, cli/NAME.c with cli_NAME().
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_CLI_H
#define CLI_CLI_H

#include "core/base.h"
#include "core/options.h"

/* argv[0] is the command's own name. ERR_ARG becomes exit code 2, every other error 1;
 * serve's are those of sysexits.h. */
#define COMMAND(name, about) enum err_code cli_##name(int argc, char **argv, struct err *e) ERR_USE;
#include "cli/commands.def"
#undef COMMAND

#endif
