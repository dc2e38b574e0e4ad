/* Where a command writes: files are not replaced without --overwrite, and stdout is written whole.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_OUTPUT_H
#define CLI_OUTPUT_H

#include <stdbool.h>

#include "core/err.h"

/* Call it before the work begins. What killed runs left of the file is removed (file_sweep). path
 * may be NULL. ERR_ARG: there is such a file, and --overwrite was not given; or there is something
 * else of this name: a folder, a pipe or a device. */
enum err_code output_check(const char *path, bool overwrite, struct err *e) ERR_USE;
/* As output_check, of a file that the command cannot do without: path NULL is ERR_ARG, too. */
enum err_code output_needed(const char *path, bool overwrite, struct err *e) ERR_USE;
/* ERR_ARG: both are one file, so the output would replace what is read. Either may be NULL. */
enum err_code output_apart(const char *path, const char *input, struct err *e) ERR_USE;
/* At the end of a command. ERR_IO: stdout could not be written, as on a full disk. A pipe whose
 * reader has left is ERR_OK. */
enum err_code output_flush(struct err *e) ERR_USE;

#endif
