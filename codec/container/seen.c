/* The blob `seen`: see seen.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/seen.h"

#include <math.h>
#include <string.h>

#include "core/base.h"

static const char seen_magic[8] = {'C', 'S', 'S', 'E', 'E', 'N', '0', '1'};

enum err_code seen_encode(const struct seen_grid *s, struct buf *out, struct err *e)
{
    if (s->nx < 1 || s->ny < 1 || s->nx > SEEN_SIDE_MAX || s->ny > SEEN_SIDE_MAX)
        return err_set(e, ERR_ARG, "a grid of %u x %u places: 1 to %d", s->nx, s->ny,
                       SEEN_SIDE_MAX);
    buf_add(out, seen_magic, sizeof seen_magic);
    buf_f64(out, s->corner_m[0]);
    buf_f64(out, s->corner_m[1]);
    buf_f64(out, s->cell_m);
    buf_u32(out, s->nx);
    buf_u32(out, s->ny);
    buf_add(out, s->views, (size_t)s->nx * s->ny);
    return buf_check(out, e);
}

enum err_code seen_decode(const void *bytes, size_t n, struct seen_grid *out, struct err *e)
{
    struct cursor c = cursor_over(bytes, n);
    const uint8_t *magic = cursor_take(&c, sizeof seen_magic);
    struct seen_grid s = {0};
    *out = s;
    s.corner_m[0] = cursor_f64(&c);
    s.corner_m[1] = cursor_f64(&c);
    s.cell_m = cursor_f64(&c);
    s.nx = cursor_u32(&c);
    s.ny = cursor_u32(&c);
    if (c.bad || memcmp(magic, seen_magic, sizeof seen_magic) != 0 || !isfinite(s.corner_m[0]) ||
        !isfinite(s.corner_m[1]) || !(s.cell_m > 0.0) || !isfinite(s.cell_m) || s.nx < 1 ||
        s.ny < 1 || s.nx > SEEN_SIDE_MAX || s.ny > SEEN_SIDE_MAX ||
        cursor_left(&c) != (size_t)s.nx * s.ny)
        return err_set(e, ERR_FORMAT, "no grid of what photographs see");
    s.views = mem_array(cursor_left(&c), 1);
    if (!s.views)
        return err_set(e, ERR_MEM, "out of memory for %u x %u places", s.nx, s.ny);
    memcpy(s.views, c.p, (size_t)s.nx * s.ny);
    for (size_t i = 0; i < (size_t)s.nx * s.ny; i++)
        if (s.views[i] > SEEN_VIEWS_MAX)
            s.views[i] = SEEN_VIEWS_MAX;
    *out = s;
    return ERR_OK;
}

void seen_free(struct seen_grid *s)
{
    mem_free(s->views);
    *s = (struct seen_grid){0};
}

double seen_at(const struct seen_grid *s, double east_m, double north_m)
{
    double x = (east_m - s->corner_m[0]) / s->cell_m - 0.5,
           y = (north_m - s->corner_m[1]) / s->cell_m - 0.5;
    if (!s->views || !(x > -1.0 && y > -1.0 && x < (double)s->nx && y < (double)s->ny))
        return SEEN_VIEWS_MAX;
    double low_x = floor(x), low_y = floor(y), fx = x - low_x, fy = y - low_y;
    size_t x0 = low_x < 0.0 ? 0 : (size_t)low_x, y0 = low_y < 0.0 ? 0 : (size_t)low_y;
    size_t x1 = (size_t)(low_x + 1.0), y1 = (size_t)(low_y + 1.0);
    x1 = x1 < s->nx ? x1 : s->nx - 1;
    y1 = y1 < s->ny ? y1 : s->ny - 1;
    const uint8_t *a = s->views + y0 * s->nx, *b = s->views + y1 * s->nx;
    return (1.0 - fy) * ((1.0 - fx) * a[x0] + fx * a[x1]) + fy * ((1.0 - fx) * b[x0] + fx * b[x1]);
}
