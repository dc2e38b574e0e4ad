/* See output.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/output.h"

#include <poll.h>
#include <stdio.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base.h"

/* Files are written under another name and renamed, and that would replace a pipe or a device. */
enum err_code output_check(const char *path, bool overwrite, struct err *e)
{
    struct stat st;
    if (path)
        file_sweep(path);
    if (!path || stat(path, &st))
        return ERR_OK;
    if (S_ISDIR(st.st_mode))
        return err_set(e, ERR_ARG, "%s: a folder of this name exists, and a file is written", path);
    if (!S_ISREG(st.st_mode))
        return err_set(e, ERR_ARG,
                       "%s: no file, but a pipe or a device; name a file, which is put in place "
                       "when it is complete",
                       path);
    return overwrite
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "%s: exists; choose another name, or replace it with --overwrite", path);
}

enum err_code output_needed(const char *path, bool overwrite, struct err *e)
{
    return path ? output_check(path, overwrite, e)
                : err_set(e, ERR_ARG, "-o FILE is missing: where to write");
}

enum err_code output_apart(const char *path, const char *input, struct err *e)
{
    return path && input && file_same(path, input)
               ? err_set(e, ERR_ARG,
                         "%s: is what this command reads, and would be replaced; choose another "
                         "name",
                         path)
               : ERR_OK;
}

/* A reader that has seen enough, as `head`, is no fault. An earlier write may have met it, so errno
 * does not tell. */
static bool output_reader_left(void)
{
    struct pollfd p = {.fd = STDOUT_FILENO, .events = POLLOUT};
    return poll(&p, 1, 0) > 0 && (p.revents & POLLERR);
}

enum err_code output_flush(struct err *e)
{
    const bool before = ferror(stdout), now = fflush(stdout) != 0;
    if ((!before && !now) || output_reader_left())
        return ERR_OK;
    return now ? err_errno(e, ERR_IO, "stdout: cannot write")
               : err_set(e, ERR_IO, "stdout: cannot write all: is the disk full?");
}
