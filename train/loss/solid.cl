// The loss on solid surfaces: moments of depth -> their gradients. train/loss/solid.h has the
// equations.
//   solid_grad  moments [2][h][w], transmit [h][w], supported [h][w], known [h][w]
//               -> grad [3][h][w]
// A work-item has BLOCK pixels: many on CPUs, VW at a time, one on GPUs.
// Reference: solid_ref.c.

#if VW == 16
#define BLOCK 1024 // as in solid.c
#else
#define BLOCK 1
#endif

// n pixels, 0 behind them.
INLINE V pixels_load(__global const float *p, uint n)
{
#if VW == 16
    if (n >= 16)
        return LAYOUT_WIDE(const __global, float, p);
    float v[16];
    for (uint i = 0; i < 16; i++)
        v[i] = i < n ? p[i] : 0.0f;
    return vload16(0, v);
#else
    return p[0];
#endif
}

INLINE void pixels_store(__global float *p, V x, uint n)
{
#if VW == 16
    if (n >= 16) {
        LAYOUT_WIDE(__global, float, p) = x;
        return;
    }
    float v[16];
    vstore16(x, 0, v);
    for (uint i = 0; i < n; i++)
        p[i] = v[i];
#else
    p[0] = x;
#endif
}

INLINE V pixels_ask(__global const uchar *p, uint n) // 1 where p is not 0
{
#if VW == 16
    float v[16];
    for (uint i = 0; i < 16; i++)
        v[i] = i < n && p[i] ? 1.0f : 0.0f;
    return vload16(0, v);
#else
    return p[0] ? 1.0f : 0.0f;
#endif
}

struct solid_weights { // over n
    float spread, light, light_known, focal, free_px, soft_px, reach_px, cover, known_zeta, light_t;
};

__kernel void solid_grad(__global const float *moments, __global const float *transmit,
                         __global const uchar *supported, uint has_support,
                         __global const float *known, uint has_known, uint pixels,
                         struct solid_weights k, __global float *grad)
{
    uint from = (uint)get_global_id(0) * BLOCK, to = min(from + BLOCK, pixels);
    for (uint at = from; at < to; at += VW) {
        uint n = to - at;
        V t = pixels_load(transmit + at, n), a = 1.0f - t;
        V m1 = pixels_load(moments + at, n), m2 = pixels_load(moments + pixels + at, n);
        V t_known = has_known ? pixels_load(known + at, n) : (V)(0.0f);
        VI is_known = t_known > 0.0f, drawn = (a >= k.cover) & (a + m1 > 0.0f);
        V inv_a = 1.0f / (drawn ? a : (V)(1.0f)), d = m1 * inv_a, second = m2 * inv_a;
        V zeta = drawn ? 1.0f + d : (V)(1.0f), px = k.focal / zeta, e = k.soft_px / px;
        V b = is_known ? zeta - k.known_zeta / (is_known ? t_known : (V)(1.0f)) : (V)(0.0f);
        V own = sqrt(drawn ? MAX_(second - d * d, (V)(0.0f)) : (V)(0.0f));
        V u = MAX_(own - k.free_px / px, (V)(0.0f)), sigma = sqrt(b * b + u * u + e * e);
        V r = px * (sigma - e) / k.reach_px, more = 1.0f + r * r;
        VI pulled = has_known ? drawn & is_known : drawn;
        V w_b = pulled ? k.spread * px * 0.5f / (sigma * more * more) : (V)(0.0f); // A over A
        V w_v = own > 0.0f ? w_b * u / own : (V)(0.0f), w_bb = 2.0f * w_b * b;
        V where = has_support ? pixels_ask(supported + at, n) : (V)(0.0f);
        V slope = MIN_(t, (V)(k.light_t)) * (1.0f / k.light_t);
        V press = where * slope * (is_known ? (V)(k.light_known) : (V)(k.light));
        pixels_store(grad + at, w_bb - 2.0f * w_v * d, n);
        pixels_store(grad + pixels + at, w_v, n);
        pixels_store(grad + 2 * pixels + at, press + w_bb * d + w_v * (second - 2.0f * d * d), n);
    }
}
