/* Headers of conditional and partial requests and of content negotiation (RFC 9110 sections 12.5,
 * 13, 14). Each function reads untrusted text and answers one question. It ignores what it does not
 * understand, as the RFC asks. Nothing here allocates.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/condition.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <time.h>

static const char *condition_skip_space(const char *p)
{
    return p + strspn(p, " \t");
}

/* To the next element of a list: empty ones count for nothing (RFC 9110, section 5.6.1.2). */
static const char *condition_skip_empty(const char *p)
{
    return p + strspn(p, ", \t");
}

bool condition_none_match(const char *header, const char *etag)
{
    size_t n = strlen(etag);
    if (!header || !n)
        return false;
    const char *p = condition_skip_space(header);
    if (*p == '*')
        return !*condition_skip_space(p + 1);
    p = condition_skip_empty(p);
    while (*p) {
        if (!strncmp(p, "W/", 2)) /* weak comparison: the opaque tags alone */
            p += 2;
        if (*p != '"')
            return false; /* malformed: the condition is ignored */
        const char *close = strchr(p + 1, '"');
        if (!close)
            return false;
        if ((size_t)(close + 1 - p) == n && !memcmp(p, etag, n))
            return true;
        p = condition_skip_space(close + 1);
        if (*p && *p != ',')
            return false;
        p = condition_skip_empty(p);
    }
    return false;
}

/* Well formed: *, or entity tags by commas. */
static bool condition_is_tags(const char *header)
{
    const char *p = condition_skip_space(header);
    if (*p == '*')
        return !*condition_skip_space(p + 1);
    p = condition_skip_empty(p);
    while (*p) {
        p += strncmp(p, "W/", 2) ? 0 : 2;
        const char *close = *p == '"' ? strchr(p + 1, '"') : NULL;
        if (!close)
            return false;
        p = condition_skip_space(close + 1);
        if (*p && *p != ',')
            return false;
        p = condition_skip_empty(p);
    }
    return true;
}

bool condition_may_write(const char *match, const char *none_match, const char *etag)
{
    const bool any = match && *condition_skip_space(match) == '*';
    /* If-Match compares strongly: a weak tag is nobody's. */
    if (match && (!condition_is_tags(match) || !etag ||
                  (!any && (strstr(match, "W/\"") || !condition_none_match(match, etag)))))
        return false;
    return !none_match ||
           (condition_is_tags(none_match) && !(etag && condition_none_match(none_match, etag)));
}

/* Decimal digits; saturates far above any size. False when there are none. */
static bool condition_take_size(const char **p, uint64_t *out)
{
    const char *start = *p;
    uint64_t v = 0;
    for (; **p >= '0' && **p <= '9'; (*p)++)
        v = v > UINT64_MAX / 20 ? UINT64_MAX / 2 : v * 10 + (uint64_t)(**p - '0');
    *out = v;
    return *p != start;
}

enum condition_range condition_range(const char *header, uint64_t size, uint64_t *first,
                                     uint64_t *length)
{
    uint64_t a = 0, b = UINT64_MAX;
    *first = 0;
    *length = size;
    if (!header || strncasecmp(header, "bytes=", 6) != 0)
        return RANGE_ALL;
    const char *p = condition_skip_space(header + 6);
    bool has_a = condition_take_size(&p, &a);
    if (*p++ != '-')
        return RANGE_ALL;
    bool has_b = condition_take_size(&p, &b);
    if (*condition_skip_space(p) || (!has_a && !has_b) || (has_a && has_b && b < a))
        return RANGE_ALL; /* several ranges, or not a range */
    if (!has_a) {         /* the last b bytes */
        if (b == 0 || size == 0)
            return RANGE_BAD;
        *length = b < size ? b : size;
        *first = size - *length;
        return RANGE_PART;
    }
    if (a >= size)
        return RANGE_BAD;
    uint64_t last = has_b && b < size ? b : size - 1;
    *first = a;
    *length = last - a + 1;
    return RANGE_PART;
}

/* The weight of `name` in a list like "a;q=0.5, b, *;q=0", in thousandths; -1 when it is not
 * listed. */
static int condition_list_weight(const char *header, const char *name)
{
    size_t n_name = strlen(name);
    for (const char *p = header; *p;) {
        p += strspn(p, " \t,");
        size_t n = strcspn(p, " \t,;");
        bool match = n == n_name && !strncasecmp(p, name, n);
        const char *end = p + strcspn(p, ",");
        int weight = 1000;
        for (const char *q = p + n; q < end;) {
            q += strspn(q, " \t;");
            if ((*q | 32) == 'q' && q[1] == '=') {
                weight = q[2] == '1' ? 1000 : 0;
                if (q[2] == '0' && q[3] == '.')
                    for (int i = 4, unit = 100; i < 7 && q[i] >= '0' && q[i] <= '9';
                         i++, unit /= 10)
                        weight += (q[i] - '0') * unit;
            }
            q += strcspn(q, ";,");
            if (*q == ',')
                break;
        }
        if (match)
            return weight;
        p = end;
    }
    return -1;
}

/* The weight of a coding, in thousandths: its own, or that of everything not listed. */
static int condition_coding(const char *header, const char *name)
{
    if (!header)
        return 0;
    int weight = condition_list_weight(header, name);
    return weight >= 0 ? weight : condition_list_weight(header, "*");
}

bool condition_gzip(const char *header)
{
    return condition_coding(header, "gzip") > 0;
}

bool condition_brotli(const char *header)
{
    int weight = condition_coding(header, "br");
    return weight > 0 && weight >= condition_coding(header, "gzip");
}

bool condition_html(const char *header)
{
    const int weight = header ? condition_list_weight(header, "text/html") : -1;
    return weight > 0 && weight > condition_list_weight(header, "application/json");
}

static const char condition_days[7][4] = {"Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat"};
static const char condition_months[12][4] = {"Jan", "Feb", "Mar", "Apr", "May", "Jun",
                                             "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"};

void condition_date(int64_t at_s, char out[CONDITION_DATE])
{
    time_t at = (time_t)at_s;
    struct tm t;
    gmtime_r(&at, &t);
    snprintf(out, CONDITION_DATE, "%s, %02u %s %04u %02u:%02u:%02u GMT", condition_days[t.tm_wday],
             (unsigned)t.tm_mday % 100, condition_months[t.tm_mon],
             (unsigned)(t.tm_year + 1900) % 10000, (unsigned)t.tm_hour % 100,
             (unsigned)t.tm_min % 100, (unsigned)t.tm_sec % 100);
}

/* "Sun, 06 Nov 1994 08:49:37 GMT" */
static bool condition_take_date(const char *p, int64_t *out)
{
    static const char form[] = "aaa, dd aaa dddd dd:dd:dd GMT";
    int month = 0;
    if (strlen(p) != sizeof form - 1)
        return false;
    for (size_t i = 0; form[i]; i++)
        if (form[i] == 'd' ? p[i] < '0' || p[i] > '9' : form[i] != 'a' && p[i] != form[i])
            return false;
    while (month < 12 && memcmp(p + 8, condition_months[month], 3) != 0)
        month++;
    int year = (p[12] - '0') * 1000 + (p[13] - '0') * 100 + (p[14] - '0') * 10 + p[15] - '0';
    if (month == 12 || year < 1970)
        return false;
    const int day = (p[5] - '0') * 10 + p[6] - '0', hour = (p[17] - '0') * 10 + p[18] - '0',
              minute = (p[20] - '0') * 10 + p[21] - '0', second = (p[23] - '0') * 10 + p[24] - '0';
    *out = ((clock_days(year, month + 1, day) * 24 + hour) * 60 + minute) * 60 + second;
    return true;
}

bool condition_not_modified(const char *header, int64_t modified_s)
{
    int64_t since = 0;
    return header && modified_s && condition_take_date(condition_skip_space(header), &since) &&
           modified_s == since;
}

bool condition_modified(const char *header, int64_t modified_s)
{
    int64_t since = 0;
    return header && modified_s && condition_take_date(condition_skip_space(header), &since) &&
           modified_s > since;
}
