/* A polygon on the ground: see outline.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/geo/outline.h"

#include <math.h>

/* Positive: c lies left of a -> b. */
static double outline_side(const double *a, const double *b, const double *c)
{
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

static bool outline_cross(const double *a, const double *b, const double *c, const double *d)
{
    double p = outline_side(a, b, c), q = outline_side(a, b, d), r = outline_side(c, d, a),
           s = outline_side(c, d, b);
    return ((p > 0 && q < 0) || (p < 0 && q > 0)) && ((r > 0 && s < 0) || (r < 0 && s > 0));
}

enum err_code outline_check(const double (*at)[2], size_t n, struct err *e)
{
    if (n < 3)
        return err_set(e, ERR_DATA, "the polygon has %zu corners: at least 3 are needed", n);
    for (size_t i = 0; i < n; i++)
        for (size_t k = i + 2; k < n; k++)
            if (!(i == 0 && k == n - 1) && outline_cross(at[i], at[i + 1], at[k], at[(k + 1) % n]))
                return err_set(e, ERR_DATA,
                               "the polygon crosses itself: the edge from corner %zu and the one "
                               "from corner %zu; give its corners in order around it",
                               i + 1, k + 1);
    if (!(outline_area(at, n) > 0))
        return err_set(e, ERR_DATA, "the polygon has no area");
    return ERR_OK;
}

bool outline_holds(const double (*at)[2], size_t n, double x, double y)
{
    bool in = false;
    for (size_t i = 0, k = n - 1; i < n; k = i++)
        if ((at[i][1] > y) != (at[k][1] > y) &&
            x < at[i][0] + (y - at[i][1]) / (at[k][1] - at[i][1]) * (at[k][0] - at[i][0]))
            in = !in;
    return in;
}

static double outline_signed_area(const double (*at)[2], size_t n)
{
    double sum = 0;
    for (size_t i = 0, k = n - 1; i < n; k = i++)
        sum += 0.5 * ((at[k][0] - at[0][0]) * (at[i][1] - at[0][1]) -
                      (at[i][0] - at[0][0]) * (at[k][1] - at[0][1]));
    return sum;
}

double outline_area(const double (*at)[2], size_t n)
{
    return fabs(outline_signed_area(at, n));
}

bool outline_is_clockwise(const double (*at)[2], size_t n)
{
    return outline_signed_area(at, n) < 0;
}

double outline_length(const double (*at)[2], size_t n)
{
    double sum = 0;
    for (size_t i = 0, k = n - 1; i < n; k = i++)
        sum += hypot(at[i][0] - at[k][0], at[i][1] - at[k][1]);
    return sum;
}
