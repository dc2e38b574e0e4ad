/* Records of receivers.
 *
 * DJI's .MRK has a line for each photograph of a flight: number, seconds and week of GPS time,
 * vector from the antenna to the camera (already added), latitude, longitude, ellipsoidal height,
 * their standard deviations, kind of solution (user manuals of Zenmuse P1 and Matrice 4: "after
 * compensation"). RTKLIB's .pos has a line for each moment, with times in GPS or UTC. A file of
 * camera events has one line for each photograph, without names.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/positions_rows.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "scene/control/positions.h"
#include "scene/control/table.h"

/* ---- RTKLIB ---- */

static enum err_code positions_pos_row(const struct table *t, char *line, struct positions *p,
                                       struct err *e)
{
    char *field[TABLE_FIELDS];
    double v[8];
    struct position one = {.line = t->line, .time_s = positions_time(line)};
    size_t n = table_split(line, '\0', field);
    bool known = n >= 10;
    for (size_t k = 0; known && k < 8; k++) /* lat lon height Q ns sdn sde sdu */
        known = table_number(field[2 + k], &v[k]);
    double week = 0, of_week = 0;
    if (known && !isfinite(one.time_s) && table_number(field[0], &week) &&
        table_number(field[1], &of_week))
        one.time_s = positions_week(week, of_week);
    if (!known || !isfinite(one.time_s) || fabs(v[0]) > 90 || fabs(v[1]) > 360)
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: expected is time, latitude, longitude, height, Q, ns, sdn, "
                       "sde, sdu (RTKLIB, degrees)",
                       t->path, t->line);
    one.at[0] = v[1];
    one.at[1] = v[0];
    one.at[2] = v[2];
    one.sigma_m[0] = sqrt(0.5 * (v[5] * v[5] + v[6] * v[6]));
    one.sigma_m[1] = fabs(v[7]);
    return positions_add(p, &one, e);
}

enum err_code positions_pos(struct table *t, char *line, struct positions *p, struct err *e)
{
    bool more = true;
    enum err_code rc = ERR_OK;
    p->by = POSITION_BY_TIME;
    p->epsg = POSITIONS_LONLAT;
    snprintf(p->heights, sizeof p->heights, "ellipsoid");
    for (; !rc && more; rc = rc ? rc : table_next(t, line, &more, e)) {
        if (*line != '%') {
            rc = positions_pos_row(t, line, p, e);
            continue;
        }
        if (strstr(line, "/geodetic"))
            snprintf(p->heights, sizeof p->heights, "sea");
        if (strstr(line, "x-ecef") || strstr(line, "e-baseline") || strstr(line, "(d'\")"))
            rc = err_set(e, ERR_FORMAT,
                         "%s: line %zu: coordinates of another kind; write latitude, longitude and "
                         "height in degrees (RTKLIB: out-solformat llh, out-outdegform deg)",
                         t->path, t->line);
    }
    return rc;
}

/* ---- DJI ---- */

/* The number before ",Lat" and its like; NAN: none. */
static double positions_mrk_value(const char *line, const char *mark)
{
    const char *at = strstr(line, mark);
    if (!at)
        return (double)NAN;
    const char *p = at;
    while (p > line && strchr("0123456789+-.eE", p[-1]))
        p--;
    char *end;
    double v = strtod(p, &end);
    return end == at && p < at ? v : (double)NAN;
}

static enum err_code positions_mrk_row(const struct table *t, const char *line, const char *prefix,
                                       struct positions *p, struct err *e)
{
    struct position one = {.line = t->line};
    double number, seconds, week, north, east, up;
    const char *sigma = strstr(line, ",Ellh");
    one.at[1] = positions_mrk_value(line, ",Lat");
    one.at[0] = positions_mrk_value(line, ",Lon");
    one.at[2] = positions_mrk_value(line, ",Ellh");
    bool known = sscanf(line, "%lf %lf [%lf]", &number, &seconds, &week) == 3 && number >= 0 &&
                 number < 1e9 && isfinite(seconds) && isfinite(week) && fabs(one.at[0]) <= 180 &&
                 fabs(one.at[1]) <= 90 && isfinite(one.at[2]);
    if (!known)
        return err_set(
            e, ERR_FORMAT,
            "%s: line %zu: expected is number, seconds, [week], offsets, Lat, Lon, Ellh, "
            "three accuracies, Q (DJI)",
            t->path, t->line);
    if (sscanf(sigma + 5, " %lf , %lf , %lf", &north, &east, &up) == 3 &&
        isfinite(north + east + up)) {
        one.sigma_m[0] = sqrt(0.5 * (north * north + east * east));
        one.sigma_m[1] = fabs(up);
    }
    one.number = (size_t)number;
    one.time_s = positions_week(week, seconds);
    snprintf(one.image, sizeof one.image, "%s", prefix);
    return positions_add(p, &one, e);
}

enum err_code positions_mrk(struct table *t, char *line, struct positions *p, struct err *e)
{
    char prefix[POSITION_IMAGE_MAX];
    const char *slash = strrchr(t->path, '/'), *name = slash ? slash + 1 : t->path;
    bool more = true;
    enum err_code rc = ERR_OK;
    const char *end = strstr(name, "_Timestamp"), *dot = strrchr(name, '.');
    end = end ? end : dot ? dot : name + strlen(name);
    snprintf(prefix, sizeof prefix, "%.*s", (int)(end - name), name);
    p->by = POSITION_BY_NUMBER;
    p->epsg = POSITIONS_LONLAT;
    snprintf(p->heights, sizeof p->heights, "ellipsoid");
    for (; !rc && more; rc = rc ? rc : table_next(t, line, &more, e))
        rc = positions_mrk_row(t, line, prefix, p, e);
    return rc;
}
