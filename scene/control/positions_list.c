/* The list of positions, and moments as numbers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include "core/base.h"
#include "scene/control/positions.h"
#include "scene/control/positions_rows.h"

void positions_free(struct positions *p)
{
    mem_free(p->list);
    *p = (struct positions){0};
}

enum err_code positions_add(struct positions *p, const struct position *one, struct err *e)
{
    struct position *list = mem_room(p->list, p->n, &p->cap, 64, sizeof *list);
    if (!list)
        return err_set(e, ERR_MEM, "out of memory for positions of photographs");
    p->list = list;
    p->list[p->n] = *one;
    p->list[p->n++].file = p->files;
    return ERR_OK;
}

static double positions_seconds(int y, int mo, int d, double of_day)
{
    /* Days of the proleptic Gregorian calendar, March first so that leap days come last. */
    int a = mo < 3, yy = y - a, mm = mo + 12 * a - 3;
    return (365.0 * yy + yy / 4 - yy / 100 + yy / 400 + (153 * mm + 2) / 5 + d) * 86400 + of_day;
}

double positions_time(const char *text)
{
    int y, mo, d, h, mi;
    double s;
    if ((sscanf(text, "%4d:%2d:%2d %2d:%2d:%lf", &y, &mo, &d, &h, &mi, &s) != 6 &&
         sscanf(text, "%4d/%2d/%2d%*[ \t,;]%2d:%2d:%lf", &y, &mo, &d, &h, &mi, &s) != 6) ||
        y < 1900 || mo < 1 || mo > 12 || !(s >= 0 && s < 61))
        return (double)NAN;
    return positions_seconds(y, mo, d, h * 3600 + mi * 60 + s);
}

double positions_week(double week, double seconds)
{
    return positions_seconds(1980, 1, 6, 0) + week * 604800 + seconds;
}
