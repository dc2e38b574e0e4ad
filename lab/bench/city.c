/* The procedural city that benchmarks draw: see city.h.
 *
 * It has a square ground of flat discs, walls and roofs of 160 blocks, round trees and a few large
 * faint floaters. The proportions are those of a trained scene of an oblique flight: about half of
 * the Gaussians are in view, each touches five tiles, most pixels are saturated. It is seeded, so
 * every run draws the same.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/city.h"

#include <math.h>
#include <string.h>

#include "core/base.h"

enum { BLOCKS = 160, SEED = 20250723 };

static double city_uniform(uint64_t stream, uint64_t i, double lo, double hi)
{
    return lo + (hi - lo) * rng_unit(SEED, stream, i);
}

/* A disc of radius sigma_m whose thin axis is `axis` (0 east, 1 north, 2 up), leaning a little. */
static void city_disc(struct gauss *g, size_t i, const double at[3], int axis, double sigma_m,
                      const double rgb[3])
{
    static const double turn[3][4] = {{0.7071, 0, 0.7071, 0}, {0.7071, 0.7071, 0, 0}, {1, 0, 0, 0}};
    for (int k = 0; k < 3; k++) {
        g->mean_m[3 * i + k] = (float)at[k];
        g->scale_log[3 * i + k] =
            (float)(log(sigma_m) + (k == 2 ? -2.5 : 0.4 * rng_normal(SEED, 20 + (unsigned)k, i)));
        g->sh[i * 3 * gauss_sh_count(g->sh_degree) + k] = (float)((rgb[k] - 0.5) / GAUSS_SH_C0);
    }
    for (int k = 0; k < 4; k++)
        g->quat_wxyz[4 * i + k] =
            (float)(turn[axis][k] + 0.08 * rng_normal(SEED, 30 + (unsigned)k, i));
    g->opacity_logit[i] = (float)(1.5 + 1.5 * rng_normal(SEED, 40, i));
    for (size_t k = 3; k < 3 * gauss_sh_count(g->sh_degree); k++)
        g->sh[i * 3 * gauss_sh_count(g->sh_degree) + k] =
            (float)(0.04 * rng_normal(SEED, 50 + k, i));
    g->n = i + 1;
}

/* One point on block b: mostly walls. Blocks stand on a grid with streets between. */
static void city_block(struct gauss *g, size_t i, double sigma_m)
{
    uint64_t b = rng_u64(SEED, 1, i) % BLOCKS;
    double cell = CITY_M / 13, half[2], at[3], height = city_uniform(2, b, 8, 45);
    double rgb[3] = {city_uniform(3, b, 0.35, 0.9), city_uniform(4, b, 0.35, 0.75),
                     city_uniform(5, b, 0.3, 0.7)};
    const double center[2] = {((double)(b % 13) - 6) * cell, ((double)(b / 13) - 6) * cell};
    int face = (int)(rng_u64(SEED, 6, i) % 10), axis = face < 2 ? 2 : face % 2;
    for (int k = 0; k < 2; k++) {
        half[k] = city_uniform(7 + (unsigned)k, b, 0.2, 0.38) * cell;
        at[k] = center[k] + half[k] * city_uniform(9 + (unsigned)k, i, -1, 1);
    }
    at[2] = axis == 2 ? height : city_uniform(11, i, 0, height);
    if (axis < 2) {
        at[axis] = center[axis] + (face < 6 ? half[axis] : -half[axis]);
        /* windows */
        double along = at[1 - axis],
               dark = fmod(fabs(along), 3.5) < 1.6 && fmod(at[2], 3.2) > 1.3 ? 0.45 : 1;
        for (int k = 0; k < 3; k++)
            rgb[k] *= dark * (axis ? 1.0 : 0.85);
    }
    city_disc(g, i, at, axis, sigma_m, rgb);
}

enum err_code city_make(size_t n, struct gauss *g, struct err *e)
{
    return city_make_degree(n, 3, g, e);
}

enum err_code city_make_degree(size_t n, uint32_t sh_degree, struct gauss *g, struct err *e)
{
    enum err_code rc = gauss_alloc(g, n, sh_degree, 0, e);
    double sigma = 1.5 * sqrt(480e3 / (double)n); /* ground and walls are 480 000 m^2 */
    if (rc)
        return rc;
    for (size_t i = 0; i < n; i++) {
        double kind = rng_unit(SEED, 0, i);
        double at[3] = {city_uniform(12, i, -0.5, 0.5) * CITY_M,
                        city_uniform(13, i, -0.5, 0.5) * CITY_M, 0};
        if (kind < 0.55) {
            city_block(g, i, sigma);
        } else if (kind < 0.90) {
            double shade =
                0.25 + 0.1 * sin(at[0] * 0.4) * sin(at[1] * 0.3) + city_uniform(14, i, 0, 0.1);
            const double grey[3] = {shade, shade, shade * 0.95};
            city_disc(g, i, at, 2, sigma, grey);
        } else if (kind < 0.998) { /* trees along the streets */
            uint64_t tree = rng_u64(SEED, 15, i) % 900;
            const double green[3] = {0.15, city_uniform(16, i, 0.25, 0.5), 0.12};
            for (unsigned k = 0; k < 3; k++)
                at[k] = (k < 2 ? city_uniform(17 + k, tree, -0.5, 0.5) * CITY_M : 5) +
                        1.6 * rng_normal(SEED, 60 + k, i);
            city_disc(g, i, at, (int)(i % 3), 0.6 * sigma, green);
        } else {
            const double haze[3] = {0.7, 0.75, 0.8};
            at[2] = city_uniform(19, i, 5, 90);
            city_disc(g, i, at, 2, 8 * sigma, haze);
            g->opacity_logit[i] = -3.5f;
        }
    }
    return ERR_OK;
}

enum err_code city_sorted(size_t n, struct gauss *out, struct err *e)
{
    return city_sorted_degree(n, 3, out, e);
}

enum err_code city_sorted_degree(size_t n, uint32_t sh_degree, struct gauss *out, struct err *e)
{
    struct gauss g = {0};
    uint32_t *order = mem_array(n, sizeof *order);
    enum err_code rc = order ? city_make_degree(n, sh_degree, &g, e)
                             : err_set(e, ERR_MEM, "city_sorted: %zu Gaussians", n);
    if (!rc)
        rc = gauss_morton_order(&g, order, e);
    if (!rc)
        rc = gauss_alloc(out, n, g.sh_degree, 0, e);
    if (!rc)
        rc = gauss_append(out, &g, order, n, e);
    mem_free(order);
    gauss_free(&g);
    return rc;
}

enum err_code city_square(const struct city_size *size, uint32_t sh_degree, uint32_t embed_len,
                          struct gauss *out, struct err *e)
{
    struct gauss one = {0};
    const size_t side = size->side, per = size->n / (side * side);
    const double middle = 0.5 * (double)(side - 1);
    enum err_code rc = city_sorted_degree(per, sh_degree, &one, e);
    if (!rc)
        rc = gauss_alloc(out, per * side * side, sh_degree, embed_len, e);
    for (size_t c = 0; !rc && c < side * side; c++)
        for (size_t i = 0; i < per; i++) {
            size_t to = out->n++;
            gauss_copy_row(out, to, &one, i);
            out->mean_m[3 * to] += (float)(CITY_M * ((double)(c % side) - middle));
            out->mean_m[3 * to + 1] += (float)(CITY_M * ((double)(c / side) - middle));
        }
    gauss_free(&one);
    return rc;
}

enum err_code city_each(struct bench *b, const struct city_size *sizes,
                        enum err_code (*run)(struct bench *b, const struct city_size *size,
                                             struct err *e),
                        struct err *e)
{
    enum err_code rc = ERR_OK;
    for (; !rc && sizes->n; sizes++)
        rc = run(b, sizes, e);
    return rc;
}

enum err_code city_appearance(const struct gauss *g, struct gauss *out, struct appearance *a,
                              float **frame, struct err *e)
{
    memset(out, 0, sizeof *out);
    memset(a, 0, sizeof *a);
    enum err_code rc = gauss_alloc(out, g->n, g->sh_degree, APPEARANCE_GAUSS_LEN, e);
    if (!rc)
        rc = gauss_append(out, g, NULL, g->n, e);
    if (!rc)
        rc = appearance_alloc(a, APPEARANCE_GAUSS_LEN, APPEARANCE_IMAGE_LEN, APPEARANCE_HIDDEN, 1,
                              e);
    *frame =
        mem_array(appearance_frame_floats(APPEARANCE_GAUSS_LEN, APPEARANCE_HIDDEN), sizeof **frame);
    if (!rc && !*frame)
        rc = err_set(e, ERR_MEM, "city: out of memory");
    if (rc)
        return rc;
    memcpy(out->origin_enu_m, g->origin_enu_m, sizeof out->origin_enu_m);
    for (size_t i = 0; i < out->n * APPEARANCE_GAUSS_LEN; i++)
        out->embed[i] = (float)rng_normal(SEED, 70, i);
    appearance_init(a, SEED);
    appearance_frame(a, a->images, *frame);
    return ERR_OK;
}

struct camera city_camera(uint32_t width_px, uint32_t height_px)
{
    const double eye[3] = {-130, -150, 95}, target[3] = {0, 0, 5};
    return camera_look_at(eye, target, 0.75, width_px, height_px);
}
