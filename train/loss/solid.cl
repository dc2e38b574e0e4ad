// The loss on solid surfaces: sums along the rays -> their gradients. train/loss/solid.h has the
// equations.
//   solid_grad  sums [2][h][w], transmit [h][w], supported [h][w], known [h][w]
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
    float spread, away, light, light_known, focal, soft_px, reach_px, soft_side, cover, light_t;
};

// The gradient of spread by both moments of depth and by T.
INLINE void solid_spread(V m1, V m2, V a, struct solid_weights k, V out[3])
{
    VI drawn = (a >= k.cover) & (a + m1 > 0.0f);
    V inv_a = 1.0f / (drawn ? a : (V)(1.0f)), d = m1 * inv_a, second = m2 * inv_a;
    V zeta = drawn ? 1.0f + d : (V)(1.0f), px = k.focal / zeta, e = k.soft_px / px;
    V var = drawn ? MAX_(second - d * d, (V)(0.0f)) : (V)(0.0f), sigma = sqrt(var + e * e);
    V r = px * (sigma - e) / k.reach_px, more = 1.0f + r * r;
    V w = var > 0.0f ? k.spread * px * 0.5f / (sigma * more * more) : (V)(0.0f); // A over A
    out[0] = -2.0f * w * d;
    out[1] = w;
    out[2] = w * (second - 2.0f * d * d);
}

// The gradient of balance and away by both sums about known depths and by T.
INLINE void solid_balance(V side, V a, struct solid_weights k, V out[3])
{
    VI drawn = a >= k.cover;
    V q = side / (drawn ? a : (V)(1.0f)), left = 1.0f - 4.0f * q * q;
    V slope = k.spread * 4.0f * q * left * left / sqrt(q * q + k.soft_side * k.soft_side);
    out[0] = drawn ? slope : (V)(0.0f);
    out[1] = (V)(k.away);
    out[2] = drawn ? slope * q : (V)(0.0f);
}

__kernel void solid_grad(__global const float *sums, __global const float *transmit,
                         __global const uchar *supported, uint has_support,
                         __global const float *known, uint has_known, uint pixels,
                         struct solid_weights k, __global float *grad)
{
    uint from = (uint)get_global_id(0) * BLOCK, to = min(from + BLOCK, pixels);
    for (uint at = from; at < to; at += VW) {
        uint n = to - at;
        V t = pixels_load(transmit + at, n), first = pixels_load(sums + at, n), out[3];
        VI is_known = (V)(0.0f) > 1.0f;
        if (has_known) {
            is_known = pixels_load(known + at, n) > 0.0f;
            solid_balance(first, 1.0f - t, k, out);
        } else {
            solid_spread(first, pixels_load(sums + pixels + at, n), 1.0f - t, k, out);
        }
        V where = has_support ? pixels_ask(supported + at, n) : (V)(0.0f);
        V slope = MIN_(t, (V)(k.light_t)) * (1.0f / k.light_t);
        V press = where * slope * (is_known ? (V)(k.light_known) : (V)(k.light));
        pixels_store(grad + at, out[0], n);
        pixels_store(grad + pixels + at, out[1], n);
        pixels_store(grad + 2 * pixels + at, press + out[2], n);
    }
}
