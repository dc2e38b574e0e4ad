/* What the end of a command is to people and to other programs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_OUTCOME_H
#define CLI_OUTCOME_H

#include "core/err.h"

/* Prints or logs the error rc of a command, with the message of e, and returns the exit code. The
 * message of ERR_OK is not printed, and its exit code is 0. argv is that of the command. */
int outcome_tell(const char *command, enum err_code rc, const struct err *e, int argc,
                 char *const *argv);

#endif
