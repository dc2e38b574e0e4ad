/* An index of photographs: see search_index.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/search_index.h"

#include <math.h>

void search_index_close(struct search_index **s)
{
    if (*s) {
        mem_free((*s)->photo);
        mem_free((*s)->sample);
    }
    mem_free(*s);
    *s = NULL;
}

static double search_index_linear(double v)
{
    return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

static double search_index_cube_root(double t)
{
    return t > 216.0 / 24389 ? cbrt(t) : (t * 24389 / 27 + 16) / 116;
}

void search_index_lab(const uint8_t rgb[3], double lab[3])
{
    static const double to_xyz[3][3] = {{0.4124564, 0.3575761, 0.1804375},
                                        {0.2126729, 0.7151522, 0.0721750},
                                        {0.0193339, 0.1191920, 0.9503041}};
    static const double white[3] = {0.95047, 1, 1.08883};
    double f[3];
    for (int i = 0; i < 3; i++) {
        double sum = 0;
        for (int k = 0; k < 3; k++)
            sum += to_xyz[i][k] * search_index_linear(rgb[k] / 255.0);
        f[i] = search_index_cube_root(sum / white[i]);
    }
    lab[0] = 116 * f[1] - 16;
    lab[1] = 500 * (f[0] - f[1]);
    lab[2] = 200 * (f[1] - f[2]);
}
