// The loss on solid surfaces: moments of depth -> their gradients. train/loss/solid.h has the
// equations.
//   solid_inverse  moments [2][h][w], transmit [h][w], known [h][w] -> inverse
//                  [h + 2 MARGIN][pitch]: 1 / zeta, with a minus where other depths are known and
//                  this one is not, 0 where the pixel has no part in a bend; margins are 0 and stay
//   solid_grad     all of these -> grad [3][h][w], sums [h][8]: spread, bend, light, prior and
//                  light_known of a row, 0, 0, 0
// VW 16 (CPUs): a work-item is a row, VW pixels at a time. VW 1 (GPUs): a work-group is a row, and
// an item has every ROW_ITEMS-th pixel of it.
// Reference: solid_ref.c.

#define MARGIN 16 // at least two strides

#if VW == 16
#define ROW_GROUP
#define ROW_OF get_global_id(0)
#define ROW_FROM 0
#define ROW_STEP VW
#else
#define ROW_ITEMS 64 // as in solid.c
#define ROW_GROUP __attribute__((reqd_work_group_size(ROW_ITEMS, 1, 1)))
#define ROW_OF get_group_id(0)
#define ROW_FROM (uint) get_local_id(0)
#define ROW_STEP ROW_ITEMS
#endif

// n pixels of a row, 0 behind them.
INLINE V row_load(__global const float *p, uint n)
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

INLINE void row_store(__global float *p, V x, uint n)
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

INLINE V row_ask(__global const uchar *p, uint n) // 1 where p is not 0
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

__kernel ROW_GROUP void solid_inverse(__global const float *moments, __global const float *transmit,
                                      __global const float *known, uint has_known, uint width,
                                      uint height, uint pitch, float cover, __global float *inverse)
{
    uint y = (uint)ROW_OF;
    if (y >= height)
        return;
    size_t row = (size_t)y * width;
    __global float *out = inverse + (size_t)(y + MARGIN) * pitch + MARGIN;
    for (uint x = ROW_FROM; x < width; x += ROW_STEP) {
        uint n = width - x;
        V a = 1.0f - row_load(transmit + row + x, n), m1 = row_load(moments + row + x, n);
        V q = a / (a + m1), sign = (V)(1.0f);
        if (has_known)
            sign = row_load(known + row + x, n) > 0.0f ? (V)(1.0f) : (V)(-1.0f);
        row_store(out + x, ((a >= cover) & (q > 0.0f)) ? sign * q : (V)(0.0f), n);
    }
}

struct solid_weights { // over n
    float spread, bend, light, focal, soft_px, spread_px, bend_px, cover, prior, prior_px;
    float known_zeta, light_known, unknown, light_t;
    uint stride;
};

// b of a triplet, 0 where one of it has no part.
INLINE V bend_of(const struct solid_weights *k, V before, V q, V after)
{
    V p0 = fabs(before), p1 = fabs(q), p2 = fabs(after);
    VI all = (p0 > 0.0f) & (p1 > 0.0f) & (p2 > 0.0f);
    V b = k->focal * ((p0 - 2.0f * p1 + p2) / p1);
    return all ? b : (V)(0.0f);
}

// f of a triplet.
INLINE V bend_part(const struct solid_weights *k, V q)
{
    return q < 0.0f ? (V)(k->unknown) : (V)(1.0f);
}

// dL/d(second difference) of a triplet.
INLINE V bend_pull(const struct solid_weights *k, V before, V q, V after)
{
    V b = bend_of(k, before, q, after), r = b * (1.0f / k->bend_px), p1 = fabs(q);
    V per = p1 > 0.0f ? k->focal / p1 : (V)(0.0f);
    V more = 1.0f + r * r;
    return k->bend * bend_part(k, q) * per * (b / (more * more));
}

// dL/dq of a pixel from the three triplets of a line that it is in; adds to *sum.
INLINE V bend_line(const struct solid_weights *k, __global const float *at, int step, V *sum)
{
    V q0 = row_load(at - 2 * step, VW), q1 = row_load(at - step, VW), q2 = row_load(at, VW),
      q3 = row_load(at + step, VW), q4 = row_load(at + 2 * step, VW);
    V r = bend_of(k, q1, q2, q3) * (1.0f / k->bend_px);
    *sum += bend_part(k, q2) * (r * r / (1.0f + r * r));
    return bend_pull(k, q0, q1, q2) - 2.0f * bend_pull(k, q1, q2, q3) + bend_pull(k, q2, q3, q4);
}

__kernel ROW_GROUP void solid_grad(__global const float *moments, __global const float *transmit,
                                   __global const float *inverse, __global const uchar *supported,
                                   uint has_support, __global const float *known, uint has_known,
                                   uint width, uint height, uint pitch, struct solid_weights k,
                                   __global float *grad, __global float *sums)
{
    uint y = (uint)ROW_OF;
#if VW == 16
    if (y >= height)
        return;
#endif
    size_t row = (size_t)y * width, plane = (size_t)width * height;
    __global const float *q_row = inverse + (size_t)(y + MARGIN) * pitch + MARGIN;
    V spread = (V)(0.0f), prior = (V)(0.0f), bend = (V)(0.0f), light = (V)(0.0f);
    V light_known = (V)(0.0f);
    float part = has_known ? k.unknown : 1.0f; // f where depth is not known
    for (uint x = ROW_FROM; x < width; x += ROW_STEP) {
        uint n = width - x;
        size_t at = row + x;
        V t = row_load(transmit + at, n), a = 1.0f - t;
        V m1 = row_load(moments + at, n), m2 = row_load(moments + plane + at, n);
        V real = TO_V(LANE) < (float)n ? (V)(1.0f) : (V)(0.0f);
        VI drawn = (a >= k.cover) & (a + m1 > 0.0f) & (real > 0.0f);
        V inv_a = 1.0f / (drawn ? a : (V)(1.0f)), d = m1 * inv_a, second = m2 * inv_a;
        V zeta = drawn ? 1.0f + d : (V)(1.0f), px = k.focal / zeta, e = k.soft_px / px;
        V t_known = has_known ? row_load(known + at, n) : (V)(0.0f);
        VI is_known = drawn & (t_known > 0.0f);
        V about = is_known ? k.known_zeta / (is_known ? t_known : (V)(1.0f)) - 1.0f : d;
        V v = drawn ? MAX_(second - (2.0f * d - about) * about, (V)(0.0f)) : (V)(0.0f);
        V sigma = sqrt(v + e * e), c = is_known ? (V)(k.prior_px) : (V)(k.spread_px);
        V s = px * (sigma - e), r = s / c, more = 1.0f + r * r;
        V term = drawn ? a * (s / more + c * atan(r)) : (V)(0.0f);
        spread += is_known ? (V)(0.0f) : part * term;
        prior += is_known ? term : (V)(0.0f);
        V weight = is_known ? (V)(k.prior) : (V)(k.spread * part);
        V w = drawn ? weight * px * 0.5f / (sigma * more * more) : (V)(0.0f); // A over A
        V g1 = -2.0f * w * about, g2 = w, ga = w * (2.0f * d * about - second);
        V q = fabs(row_load(q_row + x, n));
        if (k.bend > 0.0f) {
            V gq = bend_line(&k, q_row + x, (int)k.stride, &bend) +
                   bend_line(&k, q_row + x, (int)(k.stride * pitch), &bend);
            gq = q > 0.0f ? gq * inv_a : (V)(0.0f);
            g1 -= q * q * gq;
            ga += q * (1.0f - q) * gq;
        }
        V where = has_support ? row_ask(supported + at, n) * real : (V)(0.0f);
        VI there = t_known > 0.0f;
        V over = MIN_(t, (V)(k.light_t)), slope = over * (1.0f / k.light_t);
        V through = where * (t - over + 0.5f * over * slope);
        light += there ? (V)(0.0f) : through;
        light_known += there ? through : (V)(0.0f);
        V press = where * slope * (there ? (V)(k.light_known) : (V)(k.light));
        row_store(grad + at, g1, n);
        row_store(grad + plane + at, g2, n);
        row_store(grad + 2 * plane + at, press - ga, n);
    }
    float bends = 0.5f * k.bend_px * k.bend_px * lanes_sum(bend);
    float8 sum = (float8)(0.5f * lanes_sum(spread), bends, lanes_sum(light),
                          0.5f * lanes_sum(prior), lanes_sum(light_known), 0.0f, 0.0f, 0.0f);
#if VW == 16
    vstore8(sum, y, sums);
#else
    __local float8 row_part[ROW_ITEMS]; // added by halves: the order is fixed
    uint item = (uint)get_local_id(0);
    row_part[item] = sum;
    for (uint half_way = ROW_ITEMS / 2; half_way > 0; half_way /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (item < half_way)
            row_part[item] += row_part[item + half_way];
    }
    if (item == 0)
        vstore8(row_part[0], y, sums);
#endif
}
