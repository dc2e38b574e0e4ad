/* One line an event on stderr, composed first and written by one call, so that threads do not mix lines.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "core/base.h"

static enum log_level log_level = LOG_INFO; /* set before threads start */

void log_set_level(enum log_level level)
{
    log_level = level;
}

void log_line(enum log_level level, const char *module, const char *fmt, ...)
{
    static const char *const names[] = {"error", "warn", "info", "debug"};
    if (level > log_level)
        return;
    char line[1024];
    int n = snprintf(line, sizeof line, "%.2f %s %s ", clock_s(), names[level], module);
    if (n < 0 || (size_t)n >= sizeof line)
        return;
    va_list ap;
    va_start(ap, fmt);
    int m = vsnprintf(line + n, sizeof line - (size_t)n - 1, fmt, ap);
    va_end(ap);
    size_t len = m < 0 ? (size_t)n : strlen(line);
    line[len++] = '\n';
    for (size_t at = 0; at < len;) {
        ssize_t put = write(STDERR_FILENO, line + at, len - at);
        if (put <= 0)
            return; /* stderr is gone: nothing sensible is left to do */
        at += (size_t)put;
    }
}
