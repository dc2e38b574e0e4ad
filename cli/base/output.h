/* Output files of a command are not replaced without --overwrite.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_OUTPUT_H
#define CLI_OUTPUT_H

#include <stdbool.h>

#include "core/err.h"

/* Call it before the work begins. path may be NULL. A pipe or a device is always allowed. ERR_ARG:
 * there is such a file, and --overwrite was not given. */
enum err_code output_check(const char *path, bool overwrite, struct err *e) ERR_USE;
/* As output_check, of a file that the command cannot do without: path NULL is ERR_ARG, too. */
enum err_code output_needed(const char *path, bool overwrite, struct err *e) ERR_USE;

#endif
