/* One line an event on stderr, composed first and written by one call, so that threads do not mix
 * lines.
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

static size_t log_vcompose(char *line, size_t room, enum log_level level, const char *module,
                           const char *fmt, va_list ap) ERR_PRINTF(5, 0);
static size_t log_vcompose(char *line, size_t room, enum log_level level, const char *module,
                           const char *fmt, va_list ap)
{
    static const char *const names[] = {"error", "warn", "info", "debug"};
    if (level > log_level)
        return 0;
    int n = snprintf(line, room, "%.2f %s %s ", clock_s(), names[level], module);
    if (n < 0 || (size_t)n + 1 >= room)
        return 0;
    int m = vsnprintf(line + n, room - (size_t)n - 1, fmt, ap);
    size_t len = m < 0 ? (size_t)n : strlen(line);
    line[len++] = '\n';
    return len;
}

size_t log_compose(char *line, size_t room, enum log_level level, const char *module,
                   const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    size_t len = log_vcompose(line, room, level, module, fmt, ap);
    va_end(ap);
    return len;
}

void log_write(const char *lines, size_t n)
{
    for (size_t at = 0; at < n;) {
        ssize_t put = write(STDERR_FILENO, lines + at, n - at);
        if (put <= 0)
            return; /* stderr is gone: nothing sensible is left to do */
        at += (size_t)put;
    }
}

void log_line(enum log_level level, const char *module, const char *fmt, ...)
{
    char line[1024];
    va_list ap;
    va_start(ap, fmt);
    size_t len = log_vcompose(line, sizeof line, level, module, fmt, ap);
    va_end(ap);
    log_write(line, len);
}
