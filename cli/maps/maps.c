/* Shared by the commands that draw a store from straight above: see maps.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/maps/maps.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "cli/base/output.h"
#include "core/geo/geo.h"
#include "survey/bare.h"
#include "survey/bare_draw.h"

enum err_code maps_bbox(const char *text, double out[4], struct err *e)
{
    bool good = number_list(text, 4, out);
    for (size_t i = 0; i < 4; i++)
        good = good && fabs(out[i]) <= (i % 2 ? 90 : 180);
    if (!good)
        return err_set(e, ERR_ARG,
                       "--bbox: '%s': west,south,east,north in degrees is expected, e.g. "
                       "8.68,50.10,8.69,50.12",
                       text);
    return out[0] < out[2] && out[1] < out[3]
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "--bbox: '%s': the area is empty: west must be less than east and south "
                         "less than north",
                         text);
}

const char *const maps_geotiff[] = {".tif", ".tiff", NULL};
const char *const maps_vector[] = {".geojson", ".gpkg", ".json", NULL};
const char *const maps_points[] = {".las", NULL};

enum err_code maps_check_output(const char *path, const char *const *ends, bool overwrite,
                                struct err *e)
{
    char list[80];
    if (!path)
        return output_needed(path, overwrite, e);
    const size_t n = strlen(path);
    size_t at = 0;
    for (size_t i = 0; ends[i]; i++) {
        size_t m = strlen(ends[i]);
        if (n > m && !strcasecmp(path + n - m, ends[i]))
            return output_check(path, overwrite, e);
        at += (size_t)snprintf(list + at, sizeof list - at, "%s%s", i ? " or " : "", ends[i]);
    }
    return err_set(e, ERR_ARG, "%s: the name must end in %s, which is what this command writes%s",
                   path, list,
                   n > 4 && !strcasecmp(path + n - 4, ".laz")
                       ? "; no library for .laz is in Debian 12, and 'pdal translate' makes it"
                       : "");
}

enum err_code maps_open(const char *store, const struct maps_options *o, const char *const *ends,
                        const struct geoid_options *g, const char *appearance, struct maps *out,
                        struct err *e)
{
    struct nadir_options no = {.device = o->device, .appearance = appearance};
    *out = (struct maps){0};
    signals_catch();
    enum err_code rc = maps_check_output(o->output, ends, o->overwrite, e);
    if (!rc)
        rc = output_apart(o->output, store, e);
    if (!rc && o->bbox)
        rc = maps_bbox(o->bbox, out->bbox, e);
    if (!rc)
        rc = options_number_of("--ceiling-m", o->ceiling_m, (double)NAN, &no.ceiling_m, e);
    if (!rc && g && g->geoid)
        rc = geoid_open(g->geoid, &out->geoid, e);
    if (!rc)
        rc = nadir_open(store, &no, &out->nadir, e);
    out->request = (struct map_request){.epsg = (int)o->epsg,
                                        .gsd_m = o->gsd_m,
                                        .bbox_deg = o->bbox ? out->bbox : NULL,
                                        .geoid = out->geoid};
    if (rc)
        maps_close(out);
    return rc;
}

void maps_close(struct maps *m)
{
    nadir_close(&m->nadir);
    geoid_close(&m->geoid);
}

void maps_print(const char *path, const struct map_report *r)
{
    double pixels = (double)r->grid.width * r->grid.height;
    printf("%s: %u x %u px of %g m, EPSG:%d, %.1f %% with a surface; %.1f s, %.2f Mpx/s", path,
           r->grid.width, r->grid.height, r->grid.pixel_m, r->grid.epsg,
           100 * (double)r->pixels_held / pixels, r->seconds, 1e-6 * pixels / r->seconds);
}

void maps_print_heights(const struct maps *m, const struct map_report *r)
{
    char what[100];
    map_heights(m->nadir, &m->request, what);
    if (m->request.ground && m->request.kind == GEOTIFF_HEIGHT)
        printf("; %s, bare earth", what);
    else
        printf("; %s, %.2f to %.2f m", what, r->height_min_m, r->height_max_m);
}

enum err_code maps_write(const char *store, const struct maps_options *o,
                         const struct maps_command *c, struct err *e)
{
    struct maps m;
    struct map_report r = {0};
    struct bare *bare = NULL;
    enum err_code rc =
        maps_open(store, o, c->ends ? c->ends : maps_geotiff, c->heights, c->appearance, &m, e);
    if (rc)
        return rc;
    m.request.kind = c->kind;
    m.request.walls = c->walls;
    if (c->bare && c->bare->ground) {
        const struct bare_rule rule = {c->bare->widest_m, c->bare->slope};
        rc = bare_draw(m.nadir, &m.request, &rule, &bare, e);
        m.request.ground = bare;
    }
    if (!rc)
        rc = c->write(m.nadir, &m.request, o->output, &r, e);
    if (!rc) {
        maps_print(o->output, &r);
        if (c->heights)
            maps_print_heights(&m, &r);
        if (c->counts)
            printf("; %" PRIu64 " %s", r.pixels_held + r.more, c->counts);
        if (c->walls)
            printf(", %" PRIu64 " of them on walls", r.more);
        printf("\n");
    }
    bare_close(&bare);
    maps_close(&m);
    return rc;
}
