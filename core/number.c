/* Numbers in texts of people: see base.h. strtod alone would take "nan", "inf" and "0x10" as well.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"

bool number_read(const char **p, double *out)
{
    const char *s = *p + strspn(*p, " \t\r\n"), *first = s + (*s == '-' || *s == '+');
    char *end;
    *out = 0.0;
    if ((!isdigit((unsigned char)*first) && *first != '.') ||
        (first[0] == '0' && first[1] == 'x') || (first[0] == '0' && first[1] == 'X'))
        return false;
    const double v = strtod(s, &end);
    if (end == s || !isfinite(v))
        return false;
    *out = v;
    *p = end;
    return true;
}

bool number_list(const char *text, size_t n, double *out)
{
    for (size_t i = 0; i < n; i++) {
        if (!number_read(&text, &out[i]) || *text != (i + 1 < n ? ',' : '\0'))
            return false;
        text++;
    }
    return true;
}
