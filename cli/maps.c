/* What the commands that make maps share: see maps.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/maps.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum err_code maps_number(const char *option, const char *text, double *out, struct err *e)
{
    char *end;
    *out = (double)NAN;
    if (!text)
        return ERR_OK;
    *out = strtod(text, &end);
    return end != text && !*end && isfinite(*out)
               ? ERR_OK
               : err_set(e, ERR_ARG, "%s: '%s': a number is expected", option, text);
}

enum err_code maps_bbox(const char *text, double out[4], struct err *e)
{
    const char *p = text;
    for (size_t i = 0; i < 4; i++) {
        char *end;
        out[i] = strtod(p, &end);
        if (end == p || *end != (i < 3 ? ',' : '\0') || !(fabs(out[i]) <= (i % 2 ? 90 : 180)))
            return err_set(e, ERR_ARG,
                           "--bbox: '%s': west,south,east,north in degrees is expected, e.g. "
                           "8.68,50.10,8.69,50.12",
                           text);
        p = end + 1;
    }
    return out[0] < out[2] && out[1] < out[3]
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "--bbox: '%s': the area is empty: west must be less than east and south "
                         "less than north",
                         text);
}

enum err_code maps_make(enum geotiff_kind kind, const struct maps_options *o, struct err *e)
{
    struct nadir *n = NULL;
    struct map_report report;
    double bbox[4];
    struct nadir_options no = {.device = o->device, .appearance = o->appearance};
    const struct map_request request = {
        .kind = kind, .epsg = o->epsg, .gsd_m = o->gsd_m, .bbox_deg = o->bbox ? bbox : NULL};
    enum err_code rc = ERR_OK;
    signals_catch();
    if (!o->output)
        rc = err_set(e, ERR_ARG, "-o is missing: where to write");
    if (!rc && o->bbox)
        rc = maps_bbox(o->bbox, bbox, e);
    if (!rc)
        rc = maps_number("--ceiling-m", o->ceiling, &no.ceiling_m, e);
    if (!rc)
        rc = nadir_open(o->store, &no, &n, e);
    if (!rc)
        rc = map_write(n, &request, o->output, &report, e);
    nadir_close(&n);
    if (rc)
        return rc;
    double pixels = (double)report.grid.width * report.grid.height;
    printf("%s: %u x %u px of %g m, EPSG:%d, %.1f %% with a surface", o->output, report.grid.width,
           report.grid.height, report.grid.pixel_m, report.grid.epsg,
           100 * (double)report.pixels_held / pixels);
    if (kind == GEOTIFF_HEIGHT)
        printf(", heights %.2f to %.2f m above the ellipsoid", report.height_min_m,
               report.height_max_m);
    printf("; %.1f s, %.2f Mpx/s\n", report.seconds, 1e-6 * pixels / report.seconds);
    return ERR_OK;
}
