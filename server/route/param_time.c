/* See param_time.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route/param_time.h"

#include <time.h>

#include "server/route/target.h"

/* So many digits, no more and no fewer, in [lo, hi]. */
static bool param_time_digits(struct text *t, int n, uint32_t lo, uint32_t hi, uint32_t *out)
{
    uint32_t v = 0;
    for (int i = 0; i < n; i++, t->p++) {
        if (!text_is_digit(t))
            return false;
        v = 10 * v + (uint32_t)(*t->p - '0');
    }
    *out = v;
    return v >= lo && v <= hi;
}

/* Reads a date or a time at t. */
static bool param_time_take(struct text *t, int64_t *from_s, int64_t *to_s)
{
    uint32_t year, month, day, hour = 0, minute = 0, second = 0;
    if (!param_time_digits(t, 4, 1, 9999, &year) || !text_take(t, "-") ||
        !param_time_digits(t, 2, 1, 12, &month) || !text_take(t, "-") ||
        !param_time_digits(t, 2, 1, 31, &day))
        return false;
    const int64_t days = clock_days(year, month, day);
    if (days >= clock_days(year + month / 12, month % 12 + 1, 1)) /* that month has no such day */
        return false;
    const bool whole_day = !text_take(t, "T") && !text_take(t, "t");
    if (!whole_day && (!param_time_digits(t, 2, 0, 23, &hour) || !text_take_mark(t, ':') ||
                       !param_time_digits(t, 2, 0, 59, &minute) || !text_take_mark(t, ':') ||
                       !param_time_digits(t, 2, 0, 60, &second)))
        return false;
    if (!whole_day && text_take(t, ".")) { /* parts of a second */
        if (!text_is_digit(t))
            return false;
        while (text_is_digit(t))
            t->p++;
    }
    if (!whole_day && !text_take(t, "Z"))
        (void)text_take(t, "z");
    *from_s = days * 86400 + hour * 3600 + minute * 60 + second;
    if (to_s)
        *to_s = *from_s + (whole_day ? 86399 : 0);
    return true;
}

bool param_time_read(const char *text, size_t n, int64_t *from_s, int64_t *to_s)
{
    struct text t = {text, text + n};
    return param_time_take(&t, from_s, to_s) && text_at_end(&t);
}

enum err_code param_time_interval(struct text *one, void *search, struct err *e)
{
    struct target_search *out = search;
    bool open = false;
    int n = 0;
    int64_t s[2][2] = {{INT64_MIN, INT64_MAX}, {INT64_MIN, INT64_MAX}};
    do {
        open = !text_is_digit(one);
        if (open)
            (void)text_take(one, "..");
        else if (!param_time_take(one, &s[n][0], &s[n][1]))
            return ERR_NOENT;
    } while (++n < 2 && text_take_mark(one, '/'));
    if (!text_at_end(one) || (n == 1 && open))
        return ERR_NOENT;
    out->has_time = true;
    out->time_s[0] = s[0][0];
    out->time_s[1] = s[n - 1][1];
    return s[0][0] > s[n - 1][1] ? err_set(e, ERR_DATA, "datetime ends before it begins") : ERR_OK;
}

void param_time_write(int64_t s, struct buf *out)
{
    const time_t at = (time_t)s;
    struct tm t;
    if (s == INT64_MIN || s == INT64_MAX || !gmtime_r(&at, &t))
        buf_printf(out, "..");
    else
        buf_printf(out, "%04d-%02d-%02dT%02d:%02d:%02dZ", t.tm_year + 1900, t.tm_mon + 1, t.tm_mday,
                   t.tm_hour, t.tm_min, t.tm_sec);
}
