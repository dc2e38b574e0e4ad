/* front_city OUT.tiles [GAUSSIANS [SIDE]]: a small city for tests of programs in front of the
 * server, or one of SIDE x SIDE tiles at the finest zoom. front_city OUT.tiles lit: one tile with
 * appearances.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/server/lit.h"

#include <math.h>
#include <stdlib.h>

/* As the tiler writes them: the origin in whole metres, the error what the sigma says. */
static void city_put(struct store *s, struct key key, size_t n)
{
    struct err e = {0};
    struct gauss g = {0};
    struct store_entry t = served_gauss(key, n, &g);
    for (size_t k = 0; k < 3; k++)
        g.origin_enu_m[k] = round(g.origin_enu_m[k]);
    kit_ok(store_put(s, &t, &g, &e), e);
    gauss_free(&g);
}

/* A pyramid without gaps: SIDE x SIDE tiles at the finest zoom, and above them all that have one of
 * these below. */
static void city_square(const char *path, size_t n, uint32_t side)
{
    struct err e = {0};
    struct store *s = NULL;
    const struct store_meta meta = {.name = "toy", .origin = served_origin, .sh_degree = 1};
    uint8_t up = 0;
    kit_ok(store_create(path, &meta, &s, &e), e);
    while ((side - 1) >> up)
        up++;
    const struct key at = served_key(SERVED_ZOOM_MAX);
    const uint32_t x0 = at.x >> up << up, y0 = at.y >> up << up; /* below one tile */
    for (; up < UINT8_MAX; up--)
        for (uint32_t y = 0; y <= (side - 1) >> up; y++)
            for (uint32_t x = 0; x <= (side - 1) >> up; x++)
                city_put(s, (struct key){(uint8_t)(at.z - up), (x0 >> up) + x, (y0 >> up) + y}, n);
    kit_ok(store_commit(&s, &e), e);
}

int main(int argc, char **argv)
{
    if (argc == 3 && !strcmp(argv[2], "lit")) {
        lit_by_five(argv[1], 5);
        return 0;
    }
    const long n = argc > 2 ? strtol(argv[2], NULL, 10) : 2000,
               side = argc > 3 ? strtol(argv[3], NULL, 10) : 0;
    if (argc < 2 || argc > 4 || n < 1 || n > 1000000 || side < 0 || side > 2000)
        return 2;
    if (side)
        city_square(argv[1], (size_t)n, (uint32_t)side);
    else
        served_city(argv[1], "toy", (size_t)n);
    return 0;
}
