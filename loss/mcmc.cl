// 3DGS-MCMC: the pull on opacities and sizes, and the noise on positions.
//   in       params [groups][planes][16]
//   in, out  extra [groups][LAYOUT_PLANES_GEOMETRY][16], added to
//   in, out  params: planes of the mean
// VW 16: a work-item has LAYOUT_PROJECT_GROUPS groups. VW 1: a Gaussian.
// Reference: mcmc_ref_pull, mcmc_ref_noise.
#define MCMC_STEEP 100.0f
#define MCMC_DEAD 0.005f

#if VW == 16
#define MCMC_EACH(group, lane)                                                                     \
    const uint lane = 0;                                                                           \
    uint item = (uint)get_global_id(0), from = item * LAYOUT_PROJECT_GROUPS,                       \
         to = min(from + LAYOUT_PROJECT_GROUPS, groups);                                           \
    for (uint group = from; group < to; group++)
#else
#define MCMC_EACH(group, lane)                                                                     \
    uint item = (uint)get_global_id(0), lane = item % LAYOUT_LANES, from = item / LAYOUT_LANES;    \
    for (uint group = from; group < min(from + 1, groups); group++)
#endif

INLINE V mcmc_opacity(__global const float *g)
{
    return 1.0f / (1.0f + exp(-LD(g, LAYOUT_PLANE_OPACITY)));
}

__kernel void mcmc_pull(__global const float *params, uint n, uint planes, uint groups,
                        float per_opacity, float per_size, __global float *extra)
{
    MCMC_EACH(group, lane)
    {
        __global const float *g = params + group_at(group, planes) + lane;
        __global float *x = extra + group_at(group, LAYOUT_PLANES_GEOMETRY) + lane;
        VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
        V o = mcmc_opacity(g);
        for (uint k = 0; k < 3; k++) {
            V pull = per_size * exp(LD(g, LAYOUT_PLANE_SCALE + k));
            ST(x, LAYOUT_PLANE_SCALE + k,
               LD(x, LAYOUT_PLANE_SCALE + k) + (real ? pull : (V)(0.0f)));
        }
        V pull = per_opacity * o * (1.0f - o);
        ST(x, LAYOUT_PLANE_OPACITY, LD(x, LAYOUT_PLANE_OPACITY) + (real ? pull : (V)(0.0f)));
    }
}

// 32 bits that look random, of a counter: the last steps of MurmurHash3.
INLINE VU mcmc_mix(VU x)
{
    x ^= x >> 16;
    x *= 0x85ebca6bu;
    x ^= x >> 13;
    x *= 0xc2b2ae35u;
    return x ^ (x >> 16);
}

// Uniform in (0, 1): number k of Gaussian i.
INLINE V mcmc_unit(VU i, uint k, uint seed_lo, uint seed_hi)
{
    VU x = mcmc_mix(mcmc_mix(mcmc_mix(4u * i + k) ^ seed_lo) ^ seed_hi);
    return (TO_V(x >> 9) + 0.5f) * 0x1p-23f;
}

__kernel void mcmc_noise(__global float *params, uint n, uint planes, uint groups, float rate,
                         uint seed_lo, uint seed_hi)
{
    MCMC_EACH(group, lane)
    {
        __global float *g = params + group_at(group, planes) + lane;
        VI i = LANE + (int)(group * LAYOUT_LANES + lane), real = i < (int)n;
        V gate = rate / (1.0f + exp(MCMC_STEEP * (mcmc_opacity(g) - MCMC_DEAD)));
        V r = sqrt(-2.0f * log(mcmc_unit(AS_VU(i), 0, seed_lo, seed_hi)));
        V turn = 6.2831853f * mcmc_unit(AS_VU(i), 1, seed_lo, seed_hi);
        V r2 = sqrt(-2.0f * log(mcmc_unit(AS_VU(i), 2, seed_lo, seed_hi)));
        V turn2 = 6.2831853f * mcmc_unit(AS_VU(i), 3, seed_lo, seed_hi);
        V xi[3] = {r * cos(turn), r * sin(turn), r2 * cos(turn2)}, s[3], own[3];
        V qw = LD(g, LAYOUT_PLANE_QUAT), qx = LD(g, LAYOUT_PLANE_QUAT + 1),
          qy = LD(g, LAYOUT_PLANE_QUAT + 2), qz = LD(g, LAYOUT_PLANE_QUAT + 3);
        V t = 2.0f / (qw * qw + qx * qx + qy * qy + qz * qz);
        V rot[9] = {1.0f - t * (qy * qy + qz * qz), t * (qx * qy - qw * qz),
                    t * (qx * qz + qw * qy),        t * (qx * qy + qw * qz),
                    1.0f - t * (qx * qx + qz * qz), t * (qy * qz - qw * qx),
                    t * (qx * qz - qw * qy),        t * (qy * qz + qw * qx),
                    1.0f - t * (qx * qx + qy * qy)};
        for (uint k = 0; k < 3; k++) {
            s[k] = exp(2.0f * LD(g, LAYOUT_PLANE_SCALE + k));
            own[k] = s[k] * (rot[k] * xi[0] + rot[3 + k] * xi[1] + rot[6 + k] * xi[2]);
        }
        for (uint k = 0; k < 3; k++) {
            V add =
                gate * (rot[3 * k] * own[0] + rot[3 * k + 1] * own[1] + rot[3 * k + 2] * own[2]);
            ST(g, LAYOUT_PLANE_MEAN + k,
               LD(g, LAYOUT_PLANE_MEAN + k) + ((real & (fabs(add) < INFINITY)) ? add : (V)(0.0f)));
        }
    }
}
