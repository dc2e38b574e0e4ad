// Appearance: offsets of colour and opacity for the light, season and weather of a photograph, by a
// small network on the embedding of every Gaussian. It is compiled before project.cl and
// project_backward.cl, into programs of their own. With APPEARANCE_LEN defined they apply the
// offsets; without it they do not use this file.
//   frame  W1's columns of the embedding [HIDDEN][LEN], bias [HIDDEN] with the photograph's part,
//          W2 [4][HIDDEN], b2 [4]: constants of a frame
//   y = sigmoid(W2 max(0, W1 g^ + bias) + b2),   g^ = g / max(|g|, 1e-12)
// The network processes a vector of lanes at once. LEN and HIDDEN are compile-time constants, so an
// embedding stays in registers, and a weight is one broadcast of a constant.
//
// Backward: with s = W1 g^ + bias, a = max(0, s), z = W2 a + b2:
//   g_z = g_y y (1 - y),  g_a = W2^T g_z,  g_s = g_a where s > 0,  g_g^ = W1^T g_s,
//   g_g = (g_g^ - g^ (g^ . g_g^)) / |g|
// The gradients of the frame's constants are sums over the Gaussians of g_s g^T, g_s, g_z a^T and
// g_z. Each fixed piece of the Gaussians has a row of APPEARANCE_ROW floats for them, with the sum
// of y3 last. appearance_sum (appearance_backward.cl) adds the rows in order.
//
// Reference: appearance_eval in core/splat/appearance.c, ref_appearance in render/render_ref.c and
// appearance_splat in render/render_ref_backward.c.

#ifndef APPEARANCE_LEN // defined by render_appearance.c for the model at hand
#define APPEARANCE_LEN 16
#define APPEARANCE_HIDDEN 32
#endif
#define APPEARANCE_BIAS (APPEARANCE_HIDDEN * APPEARANCE_LEN)
#define APPEARANCE_W2 (APPEARANCE_BIAS + APPEARANCE_HIDDEN)
#define APPEARANCE_B2 (APPEARANCE_W2 + LAYOUT_APPEARANCE_OUT * APPEARANCE_HIDDEN)
#define APPEARANCE_FLOATS LAYOUT_APPEARANCE_FLOATS(APPEARANCE_LEN, APPEARANCE_HIDDEN)
#define APPEARANCE_SUMS (APPEARANCE_FLOATS + 1)
#define APPEARANCE_ROW LAYOUT_APPEARANCE_ROW(APPEARANCE_LEN, APPEARANCE_HIDDEN)
// Units at a time: as many independent sums as hide the latency of a fused multiply-add.
#if APPEARANCE_HIDDEN % 4
#define APPEARANCE_UNITS 1
#else
#define APPEARANCE_UNITS 4
#endif

// The embedding at `g`, normalised; returns its length, at least 1e-12. What is no number or too
// large to be squared counts as 0.
INLINE V appearance_unit(__global const float *g, V unit[APPEARANCE_LEN])
{
    V sum = (V)(0.0f);
#pragma unroll
    for (uint k = 0; k < APPEARANCE_LEN; k++) {
        unit[k] = LD(g, k);
        sum = unit[k] * unit[k] + sum;
    }
    VI good = sum < 1e30f;
    V len = sqrt(sum);
    len = good ? MAX_(len, 1e-12f) : (V)(1.0f);
    V inv = 1.0f / len;
#pragma unroll
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        unit[k] = good ? unit[k] * inv : (V)(0.0f);
    return len;
}

// Units h .. h + APPEARANCE_UNITS - 1 of the hidden layer, before the ReLU.
INLINE void appearance_units(__constant float *frame, const V unit[APPEARANCE_LEN], uint h,
                             V out[APPEARANCE_UNITS])
{
#pragma unroll
    for (uint j = 0; j < APPEARANCE_UNITS; j++)
        out[j] = (V)(frame[APPEARANCE_BIAS + h + j]);
#pragma unroll
    for (uint k = 0; k < APPEARANCE_LEN; k++)
#pragma unroll
        for (uint j = 0; j < APPEARANCE_UNITS; j++)
            out[j] = frame[(h + j) * APPEARANCE_LEN + k] * unit[k] + out[j];
}

INLINE V appearance_sigmoid(V z)
{
    V x = z * -LOG2E;
    return 1.0f / (1.0f + exp2_v(CLAMP_(x, -120.0f, 120.0f)));
}

INLINE void appearance_eval(__constant float *frame, __global const float *g,
                            V y[LAYOUT_APPEARANCE_OUT])
{
    V unit[APPEARANCE_LEN];
    (void)appearance_unit(g, unit);
#pragma unroll
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        y[o] = (V)(frame[APPEARANCE_B2 + o]);
    for (uint h = 0; h < APPEARANCE_HIDDEN; h += APPEARANCE_UNITS) {
        V act[APPEARANCE_UNITS];
        appearance_units(frame, unit, h, act);
#pragma unroll
        for (uint j = 0; j < APPEARANCE_UNITS; j++) {
            V a = MAX_(act[j], 0.0f);
#pragma unroll
            for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
                y[o] = frame[APPEARANCE_W2 + o * APPEARANCE_HIDDEN + h + j] * a + y[o];
        }
    }
#pragma unroll
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        y[o] = appearance_sigmoid(y[o]);
}

// ---- backward

// One group or Gaussian: what the sums are made of, all 0 where it was not seen.
struct render_appearance_terms {
    V unit[APPEARANCE_LEN];
    V act[APPEARANCE_HIDDEN], g_act[APPEARANCE_HIDDEN]; // a and g_s
    V g_out[LAYOUT_APPEARANCE_OUT], offset;             // g_z and y3
    V embed[APPEARANCE_LEN];                            // gradient of the embedding
};

// From dL/dy. `each` is added to that of y3.
INLINE void render_appearance_terms(__constant float *frame, __global const float *g,
                                    const V g_y[LAYOUT_APPEARANCE_OUT], float each, VI visible,
                                    struct render_appearance_terms *t)
{
    V y[LAYOUT_APPEARANCE_OUT], g_unit[APPEARANCE_LEN], along = (V)(0.0f);
    V len = appearance_unit(g, t->unit);
#pragma unroll
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        y[o] = (V)(frame[APPEARANCE_B2 + o]);
    for (uint h = 0; h < APPEARANCE_HIDDEN; h += APPEARANCE_UNITS) {
        V s[APPEARANCE_UNITS];
        appearance_units(frame, t->unit, h, s);
#pragma unroll
        for (uint j = 0; j < APPEARANCE_UNITS; j++) {
            V a = MAX_(s[j], 0.0f);
            t->act[h + j] = a;
#pragma unroll
            for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
                y[o] = frame[APPEARANCE_W2 + o * APPEARANCE_HIDDEN + h + j] * a + y[o];
        }
    }
#pragma unroll
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++) {
        V p = appearance_sigmoid(y[o]),
          gy = o == LAYOUT_APPEARANCE_OPACITY ? g_y[o] + each : g_y[o];
        t->g_out[o] = visible ? gy * (p * (1.0f - p)) : (V)(0.0f);
        if (o == LAYOUT_APPEARANCE_OPACITY)
            t->offset = visible ? p : (V)(0.0f);
    }
#pragma unroll
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        g_unit[k] = (V)(0.0f);
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        V g_a = (V)(0.0f);
#pragma unroll
        for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
            g_a = frame[APPEARANCE_W2 + o * APPEARANCE_HIDDEN + h] * t->g_out[o] + g_a;
        g_a = t->act[h] > 0.0f ? g_a : (V)(0.0f);
        t->g_act[h] = g_a;
#pragma unroll
        for (uint k = 0; k < APPEARANCE_LEN; k++)
            g_unit[k] = frame[h * APPEARANCE_LEN + k] * g_a + g_unit[k];
    }
#pragma unroll
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        along = t->unit[k] * g_unit[k] + along;
    along = len > 1e-12f ? along : (V)(0.0f); // below, the divisor is a constant
    V inv = 1.0f / len;
#pragma unroll
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        t->embed[k] = (g_unit[k] - t->unit[k] * along) * inv;
}

#if VW == 16
// 16 Gaussians share a vector, except that for g_s g^T lanes run over the embedding: 16 Gaussians,
// transposed, are added to one row of it.

#define APPEARANCE_BLOCKS ((APPEARANCE_LEN + 15) / 16)

struct render_appearance_sums {
    V w1[APPEARANCE_HIDDEN][APPEARANCE_BLOCKS]; // lanes run over the embedding
    V act[APPEARANCE_HIDDEN], w2[LAYOUT_APPEARANCE_OUT][APPEARANCE_HIDDEN];
    V out[LAYOUT_APPEARANCE_OUT], offset;
};

INLINE void render_appearance_clear(struct render_appearance_sums *s)
{
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        for (uint b = 0; b < APPEARANCE_BLOCKS; b++)
            s->w1[h][b] = (V)(0.0f);
        s->act[h] = (V)(0.0f);
        for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
            s->w2[o][h] = (V)(0.0f);
    }
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        s->out[o] = (V)(0.0f);
    s->offset = (V)(0.0f);
}

INLINE void render_appearance_add(const struct render_appearance_terms *t,
                                  struct render_appearance_sums *sums)
{
    const float *g_act = (const float *)t->g_act; // [HIDDEN][16]
#pragma unroll
    for (uint b = 0; b < APPEARANCE_BLOCKS; b++) {
        V lane[16];
#pragma unroll
        for (uint k = 0; k < 16; k++)
            lane[k] = 16 * b + k < APPEARANCE_LEN ? t->unit[16 * b + k] : (V)(0.0f);
        transpose_16(lane);
        for (uint h = 0; h < APPEARANCE_HIDDEN; h += APPEARANCE_UNITS) {
            V row[APPEARANCE_UNITS];
#pragma unroll
            for (uint j = 0; j < APPEARANCE_UNITS; j++)
                row[j] = sums->w1[h + j][b];
#pragma unroll
            for (uint i = 0; i < 16; i++)
#pragma unroll
                for (uint j = 0; j < APPEARANCE_UNITS; j++)
                    row[j] = g_act[16 * (h + j) + i] * lane[i] + row[j];
#pragma unroll
            for (uint j = 0; j < APPEARANCE_UNITS; j++)
                sums->w1[h + j][b] = row[j];
        }
    }
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        sums->act[h] += t->g_act[h];
#pragma unroll
        for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
            sums->w2[o][h] = t->g_out[o] * t->act[h] + sums->w2[o][h];
    }
#pragma unroll
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        sums->out[o] += t->g_out[o];
    sums->offset += t->offset;
}

INLINE float render_appearance_lanes(V v) // always in this order
{
    float8 a = v.lo + v.hi;
    float4 b = a.lo + a.hi;
    return (b.x + b.y) + (b.z + b.w);
}

INLINE void render_appearance_write(const struct render_appearance_sums *s, __global float *out)
{
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        const float *row = (const float *)s->w1[h];
        for (uint k = 0; k < APPEARANCE_LEN; k++)
            out[h * APPEARANCE_LEN + k] = row[k];
        out[APPEARANCE_BIAS + h] = render_appearance_lanes(s->act[h]);
        for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
            out[APPEARANCE_W2 + o * APPEARANCE_HIDDEN + h] = render_appearance_lanes(s->w2[o][h]);
    }
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        out[APPEARANCE_B2 + o] = render_appearance_lanes(s->out[o]);
    out[APPEARANCE_FLOATS] = render_appearance_lanes(s->offset);
}
#endif
