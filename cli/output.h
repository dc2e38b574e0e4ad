/* Files that a command writes: they are not replaced unasked.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_OUTPUT_H
#define CLI_OUTPUT_H

#include <stdbool.h>

#include "core/err.h"

/* Call it before the work begins. path may be NULL. A pipe or a device is no file that is lost.
 * ERR_ARG: there is such a file, and --overwrite was not given. */
enum err_code output_check(const char *path, bool overwrite, struct err *e) ERR_USE;

#endif
