/* See output.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/output.h"

#include <sys/stat.h>

enum err_code output_check(const char *path, bool overwrite, struct err *e)
{
    struct stat st;
    return !path || overwrite || stat(path, &st) || !S_ISREG(st.st_mode)
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "%s: exists; choose another name, or replace it with --overwrite", path);
}

enum err_code output_needed(const char *path, bool overwrite, struct err *e)
{
    return path ? output_check(path, overwrite, e)
                : err_set(e, ERR_ARG, "-o FILE is missing: where to write");
}
