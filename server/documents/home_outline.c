/* See home_outline.h. Only what is in memory is looked at: the footprint and the index.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/home_outline.h"

#include <math.h>

#include "core/geo/geo.h"
#include "lod/store/tree.h"

void home_outline_around(const double (*points)[2], size_t n, double out[8])
{
    enum { STEP_DEG = 5 };
    static const double deg = 3.14159265358979323846 / 180;
    double least = HUGE_VAL;
    for (int turn = 0; turn < 90; turn += STEP_DEG) {
        const double c = cos(turn * deg), s = sin(turn * deg);
        double lo[2] = {HUGE_VAL, HUGE_VAL}, hi[2] = {-HUGE_VAL, -HUGE_VAL};
        for (size_t i = 0; i < n; i++) {
            const double at[2] = {c * points[i][0] + s * points[i][1],
                                  c * points[i][1] - s * points[i][0]};
            for (int k = 0; k < 2; k++) {
                lo[k] = fmin(lo[k], at[k]);
                hi[k] = fmax(hi[k], at[k]);
            }
        }
        const double size = (hi[0] - lo[0]) * (hi[1] - lo[1]);
        if (!(size < least))
            continue;
        least = size;
        const double corner[4][2] = {
            {lo[0], lo[1]}, {hi[0], lo[1]}, {hi[0], hi[1]}, {lo[0], hi[1]}};
        for (int i = 0; i < 4; i++) {
            out[2 * i] = c * corner[i][0] - s * corner[i][1];
            out[2 * i + 1] = s * corner[i][0] + c * corner[i][1];
        }
    }
}

static double home_outline_size(const double corner[8])
{
    return hypot(corner[2] - corner[0], corner[3] - corner[1]) *
           hypot(corner[4] - corner[2], corner[5] - corner[3]);
}

/* Of the footprint. False: there is none. */
static bool home_outline_of_area(const struct dataset *d, double out[8])
{
    const struct area *a = &d->area;
    const size_t n = a->by_tiles || !a->n_layers ? 0 : a->layer[1];
    double(*points)[2] = n ? mem_array(n, sizeof *points) : NULL;
    bool ok = points != NULL;
    for (size_t i = 0; ok && i < n; i++) {
        double lon, lat, enu_m[3];
        key_unplace(a->edges[i].from, &lon, &lat);
        ok = !geo_to_enu(&d->meta.origin, lon, lat, d->meta.origin.h_m, enu_m, NULL);
        points[i][0] = enu_m[0];
        points[i][1] = enu_m[1];
    }
    if (ok)
        home_outline_around((const double(*)[2])points, n, out);
    mem_free(points);
    return ok;
}

bool home_outline(const struct dataset *d, double out[HOME_OUTLINE_NUMBERS])
{
    const struct tree *tree = d->index ? store_tree(d->index) : NULL;
    if (!tree || tree->root == TREE_NONE)
        return false;
    const struct tree_bounds root = tree_bounds(tree, tree->root);
    const double *lo = root.core_min_enu_m, *hi = root.core_max_enu_m;
    const double box[8] = {lo[0], lo[1], hi[0], lo[1], hi[0], hi[1], lo[0], hi[1]};
    if (!home_outline_of_area(d, out) || home_outline_size(out) > home_outline_size(box))
        for (int i = 0; i < 8; i++)
            out[i] = box[i];
    const bool known = d->area.in != NULL; /* else a tower or a stray counts as much as the rest */
    out[8] = known ? d->area.floor_m : lo[2];
    out[9] = known ? d->area.ceiling_m : hi[2];
    return true;
}
