/* The headers that make an answer conditional, partial or negotiated (RFC 9110 sections 12.5, 13,
 * 14). Each function reads foreign text and answers one question; what it does not understand it
 * ignores, as the RFC asks. Nothing here allocates.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/condition.h"

#include <string.h>
#include <strings.h>

static const char *condition_skip_space(const char *p)
{
    return p + strspn(p, " \t");
}

bool condition_none_match(const char *header, const char *etag)
{
    size_t n = strlen(etag);
    if (!header || !n)
        return false;
    const char *p = condition_skip_space(header);
    if (*p == '*')
        return !*condition_skip_space(p + 1);
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
        p += strspn(p, ", \t");
    }
    return false;
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

bool condition_gzip(const char *header)
{
    if (!header)
        return false;
    int weight = condition_list_weight(header, "gzip");
    return weight >= 0 ? weight > 0 : condition_list_weight(header, "*") > 0;
}

bool condition_html(const char *header)
{
    return header && condition_list_weight(header, "text/html") >
                         condition_list_weight(header, "application/json");
}
