/* Runs another program as a step of a command. Its output goes to a log, and its progress to a
 * progress bar.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_ALIGN_RUN_H
#define CLI_ALIGN_RUN_H

#include "core/base.h"

struct align_run {
    const char *const *argv; /* NULL after the last; argv[0] is sought in PATH */
    const char *log;         /* appended to */
    const char *what;        /* of the progress bar; NULL: none */
    uint64_t total;
    uint64_t (*count)(void *user); /* how much of it is done; asked every two seconds */
    void *user;
};
/* Checks that there is such a program, in PATH or as a path. ERR_NOENT: there is none; the message
 * has the package to install. */
enum err_code align_run_find(const char *program, struct err *e) ERR_USE;
/* Runs the program to its end. If the calling process ends, the program is killed. ERR_NOENT: there
 * is no such program. ERR_DATA: it failed; the message has its last line and the log. ERR_CANCEL:
 * we were asked to stop, and the program was stopped. ERR_IO, ERR_MEM. */
enum err_code align_run(const struct align_run *r, struct err *e) ERR_USE;

#endif
