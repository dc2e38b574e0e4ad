/* See param_time.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/param_time.h"

#include <string.h>

#include "server/text.h"

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

static uint32_t param_time_month(uint32_t year, uint32_t month)
{
    static const uint8_t days[12] = {31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    const bool leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
    return days[month - 1] + (month == 2 && leap);
}

/* Days since 1970-01-01 of the Gregorian calendar. */
static int64_t param_time_days(uint32_t year, uint32_t month, uint32_t day)
{
    const int64_t before = (int64_t)year - 1;
    int64_t n = before * 365 + before / 4 - before / 100 + before / 400 - 719162;
    for (uint32_t m = 1; m < month; m++)
        n += param_time_month(year, m);
    return n + day - 1;
}

bool param_time_read(const char *text, size_t n, int64_t *from_s, int64_t *to_s)
{
    struct text t = {text, text + n};
    uint32_t year, month, day, hour = 0, minute = 0, second = 0;
    if (!param_time_digits(&t, 4, 1, 9999, &year) || !text_take(&t, "-") ||
        !param_time_digits(&t, 2, 1, 12, &month) || !text_take(&t, "-") ||
        !param_time_digits(&t, 2, 1, param_time_month(year, month), &day))
        return false;
    const bool whole_day = text_at_end(&t);
    if (!whole_day &&
        (!(text_take(&t, "T") || text_take(&t, "t")) || !param_time_digits(&t, 2, 0, 23, &hour) ||
         !(text_take(&t, ":") || text_take(&t, "%3A") || text_take(&t, "%3a")) ||
         !param_time_digits(&t, 2, 0, 59, &minute) ||
         !(text_take(&t, ":") || text_take(&t, "%3A") || text_take(&t, "%3a")) ||
         !param_time_digits(&t, 2, 0, 60, &second)))
        return false;
    if (!whole_day && text_take(&t, ".")) {
        if (!text_is_digit(&t))
            return false;
        while (text_is_digit(&t))
            t.p++;
    }
    if (!whole_day && !text_take(&t, "Z"))
        (void)text_take(&t, "z");
    *from_s = param_time_days(year, month, day) * 86400 + hour * 3600 + minute * 60 + second;
    if (to_s)
        *to_s = *from_s + (whole_day ? 86399 : 0);
    return text_at_end(&t);
}

enum err_code param_time_interval(struct text *one, int64_t time_s[2], struct err *e)
{
    int64_t unused;
    const char *slash = memchr(one->p, '/', (size_t)(one->end - one->p)), *from = one->p,
               *to = slash ? slash + 1 : one->p;
    const char *escaped = NULL;
    for (const char *p = one->p; !slash && !escaped && one->end - p >= 3; p++)
        if (p[0] == '%' && p[1] == '2' && (p[2] | 32) == 'f')
            escaped = p;
    if (escaped) {
        slash = escaped;
        to = escaped + 3;
    }
    const size_t n_from = (size_t)((slash ? slash : one->end) - from),
                 n_to = (size_t)(one->end - to);
    const bool open_from = slash && (!n_from || (n_from == 2 && !memcmp(from, "..", 2)));
    const bool open_to = slash && (!n_to || (n_to == 2 && !memcmp(to, "..", 2)));
    time_s[0] = INT64_MIN;
    time_s[1] = INT64_MAX;
    if ((!open_from && !param_time_read(from, n_from, &time_s[0], &unused)) ||
        (!open_to && !param_time_read(to, n_to, &unused, &time_s[1])))
        return ERR_NOENT;
    if (time_s[0] > time_s[1])
        return err_set(e, ERR_DATA, "datetime ends before it begins");
    one->p = one->end;
    return ERR_OK;
}

void param_time_write(int64_t s, struct buf *out)
{
    int64_t days = s / 86400 - (s % 86400 < 0), second = s - days * 86400;
    uint32_t year = 1, month = 1;
    if (s == INT64_MIN || s == INT64_MAX) {
        buf_printf(out, "..");
        return;
    }
    for (uint32_t step = 4096; step; step /= 2)
        if (year + step <= 9999 && param_time_days(year + step, 1, 1) <= days)
            year += step;
    while (month < 12 && param_time_days(year, month + 1, 1) <= days)
        month++;
    buf_printf(out, "%04u-%02u-%02uT%02u:%02u:%02uZ", year, month,
               (unsigned)(days - param_time_days(year, month, 1) + 1), (unsigned)(second / 3600),
               (unsigned)(second / 60 % 60), (unsigned)(second % 60));
}
