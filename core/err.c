/* Errors as values: fill, prefix, text. See err.h for the rules.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/err.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define ERR_CASE_TEXT(name, text) text,
static const char *const err_texts[] = {ERR_LIST(ERR_CASE_TEXT)};
enum { ERR_COUNT = sizeof err_texts / sizeof err_texts[0] };

enum err_code err_set(struct err *e, enum err_code code, const char *fmt, ...)
{
    if (!e)
        return code;
    /* Formatted aside first: an argument may point into e->msg. */
    char text[sizeof e->msg];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(text, sizeof text, fmt, ap);
    va_end(ap);
    e->code = code;
    memcpy(e->msg, text, sizeof text);
    return code;
}

enum err_code err_errno(struct err *e, enum err_code code, const char *fmt, ...)
{
    int saved = errno;
    if (!e)
        return code;
    char text[sizeof e->msg];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(text, sizeof text, fmt, ap);
    va_end(ap);
    char why[128] = "unknown reason";
    (void)strerror_r(saved, why, sizeof why);
    return err_set(e, code, "%s: %s", text, why);
}

enum err_code err_add(struct err *e, const char *fmt, ...)
{
    if (!e)
        return ERR_INTERNAL;
    char text[sizeof e->msg];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(text, sizeof text, fmt, ap);
    va_end(ap);
    return err_set(e, e->code, "%s: %s", text, e->msg);
}

const char *err_text(enum err_code code)
{
    return (unsigned)code < ERR_COUNT ? err_texts[code] : "unknown error";
}
