/* ENU (z up) <-> glTF (y up): a quarter turn about the east axis, for means, rotations and SH
 * alike.
 *
 * p' = (E, U, -N), q' = r q with r = (w x y z) = (h, -h, 0, 0), h = sqrt(1/2). Within a band the
 * real spherical harmonics turn by an orthogonal matrix; those of this turn are mostly signs and
 * swaps and are written out below for the basis of 3D Gaussian splatting (Kerbl 2023), whose odd
 * orders carry a minus sign. Going back is the transpose. Scales, opacities, embeddings and
 * origin_enu_m (which stays ENU) do not change.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/axes.h"

#include <math.h>

#define H 0.70710678f  /* sqrt(1/2) */
#define A 0.866025404f /* sqrt(3)/2 */
#define B 0.790569415f /* sqrt(10)/4 */
#define C 0.612372436f /* sqrt(6)/4 */
#define D 0.968245837f /* sqrt(15)/4 */

enum { CH = 3 }; /* stride between coefficients of one channel */

/* v points at one channel of the first coefficient of its band. */
static void axes_band1_to_gltf(float *v)
{
    float o0 = v[0], o1 = v[CH];
    v[0] = -o1;
    v[CH] = o0;
}

static void axes_band1_to_enu(float *v)
{
    float n0 = v[0], n1 = v[CH];
    v[0] = n1;
    v[CH] = -n0;
}

static void axes_band2_to_gltf(float *v)
{
    float o0 = v[0], o1 = v[CH], o2 = v[2 * CH], o3 = v[3 * CH], o4 = v[4 * CH];
    v[0] = -o3;
    v[CH] = -o1;
    v[2 * CH] = -0.5f * o2 - A * o4;
    v[3 * CH] = o0;
    v[4 * CH] = -A * o2 + 0.5f * o4;
}

static void axes_band2_to_enu(float *v)
{
    float n0 = v[0], n1 = v[CH], n2 = v[2 * CH], n3 = v[3 * CH], n4 = v[4 * CH];
    v[0] = n3;
    v[CH] = -n1;
    v[2 * CH] = -0.5f * n2 - A * n4;
    v[3 * CH] = -n0;
    v[4 * CH] = -A * n2 + 0.5f * n4;
}

static void axes_band3_to_gltf(float *v)
{
    float o0 = v[0], o1 = v[CH], o2 = v[2 * CH], o3 = v[3 * CH];
    float o4 = v[4 * CH], o5 = v[5 * CH], o6 = v[6 * CH];
    v[0] = B * o3 - C * o5;
    v[CH] = -o1;
    v[2 * CH] = C * o3 + B * o5;
    v[3 * CH] = -B * o0 - C * o2;
    v[4 * CH] = -0.25f * o4 - D * o6;
    v[5 * CH] = C * o0 - B * o2;
    v[6 * CH] = -D * o4 + 0.25f * o6;
}

static void axes_band3_to_enu(float *v)
{
    float n0 = v[0], n1 = v[CH], n2 = v[2 * CH], n3 = v[3 * CH];
    float n4 = v[4 * CH], n5 = v[5 * CH], n6 = v[6 * CH];
    v[0] = -B * n3 + C * n5;
    v[CH] = -n1;
    v[2 * CH] = -C * n3 - B * n5;
    v[3 * CH] = B * n0 + C * n2;
    v[4 * CH] = -0.25f * n4 - D * n6;
    v[5 * CH] = -C * n0 + B * n2;
    v[6 * CH] = -D * n4 + 0.25f * n6;
}

static void axes_turn_sh(struct gauss *g, void (*band1)(float *), void (*band2)(float *),
                         void (*band3)(float *))
{
    size_t k = gauss_sh_count(g->sh_degree);
    for (size_t i = 0; i < g->n; i++)
        for (size_t c = 0; c < 3; c++) {
            float *v = g->sh + i * k * 3 + c;
            if (g->sh_degree >= 1)
                band1(v + 1 * CH);
            if (g->sh_degree >= 2)
                band2(v + 4 * CH);
            if (g->sh_degree >= 3)
                band3(v + 9 * CH);
        }
}

void axes_enu_to_gltf(struct gauss *g)
{
    for (size_t i = 0; i < g->n; i++) {
        float *p = g->mean_m + 3 * i, *q = g->quat_wxyz + 4 * i;
        float north = p[1], w = q[0], x = q[1], y = q[2], z = q[3];
        p[1] = p[2];
        p[2] = -north;
        q[0] = H * (w + x);
        q[1] = H * (x - w);
        q[2] = H * (y + z);
        q[3] = H * (z - y);
    }
    axes_turn_sh(g, axes_band1_to_gltf, axes_band2_to_gltf, axes_band3_to_gltf);
}

void axes_point_to_gltf(double p[3])
{
    const double north = p[1];
    p[1] = p[2];
    p[2] = -north;
}

void axes_point_to_enu(double p[3])
{
    const double up = p[1];
    p[1] = -p[2];
    p[2] = up;
}

void axes_gltf_to_enu(struct gauss *g)
{
    for (size_t i = 0; i < g->n; i++) {
        float *p = g->mean_m + 3 * i, *q = g->quat_wxyz + 4 * i;
        float up = p[1], w = q[0], x = q[1], y = q[2], z = q[3];
        p[1] = -p[2];
        p[2] = up;
        q[0] = H * (w - x);
        q[1] = H * (x + w);
        q[2] = H * (y - z);
        q[3] = H * (z + y);
    }
    axes_turn_sh(g, axes_band1_to_enu, axes_band2_to_enu, axes_band3_to_enu);
}

/* About z. Of a band, the coefficients of orders m and -m are those of cos and sin of m times the
 * azimuth, with the same sign. */
static void axes_turn_z(struct gauss *g, double angle)
{
    const float hw = (float)cos(0.5 * angle), hz = (float)sin(0.5 * angle);
    const size_t k = gauss_sh_count(g->sh_degree);
    float c[4], s[4];
    for (size_t m = 0; m < 4; m++) {
        c[m] = (float)cos((double)m * angle);
        s[m] = (float)sin((double)m * angle);
    }
    for (size_t i = 0; i < g->n; i++) {
        float *p = g->mean_m + 3 * i, *q = g->quat_wxyz + 4 * i, x = p[0], w = q[0], qx = q[1];
        p[0] = c[1] * x - s[1] * p[1];
        p[1] = s[1] * x + c[1] * p[1];
        q[0] = hw * w - hz * q[3];
        q[3] = hw * q[3] + hz * w;
        q[1] = hw * qx - hz * q[2];
        q[2] = hw * q[2] + hz * qx;
        for (size_t l = 1; l <= g->sh_degree; l++)
            for (size_t m = 1; m <= l; m++)
                for (size_t ch = 0; ch < CH; ch++) {
                    float *cos_m = g->sh + (i * k + l * l + l + m) * CH + ch,
                          *sin_m = g->sh + (i * k + l * l + l - m) * CH + ch, was = *cos_m;
                    *cos_m = c[m] * was - s[m] * *sin_m;
                    *sin_m = s[m] * was + c[m] * *sin_m;
                }
    }
}

/* About z, y and z (Euler). The turn about y is one about z between two quarter turns. */
void axes_turn(struct gauss *g, const double rot[9])
{
    const double side = hypot(rot[2], rot[5]);
    const bool upright = !(side > 1e-12);
    axes_turn_z(g, upright ? 0 : atan2(rot[7], -rot[6]));
    axes_gltf_to_enu(g);
    axes_turn_z(g, atan2(side, rot[8]));
    axes_enu_to_gltf(g);
    axes_turn_z(g, !upright     ? atan2(rot[5], rot[2])
                   : rot[8] > 0 ? atan2(rot[3], rot[0])
                                : atan2(-rot[3], -rot[0]));
}
