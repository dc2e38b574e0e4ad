// Appearance: a photograph's light and weather as offsets of colour and opacity, by a small network
// on every Gaussian's embedding. Compiled, before project.cl and project_backward.cl, into programs
// of their own: with APPEARANCE_LEN defined those take the offsets in, without it they are as if
// this file did not exist.
//   frame  W1's columns of the embedding [HIDDEN][LEN], bias [HIDDEN] with the photograph's part,
//          W2 [4][HIDDEN], b2 [4]: constants of a frame
//   y = sigmoid(W2 max(0, W1 g^ + bias) + b2),   g^ = g / max(|g|, 1e-12)
// A vector of lanes runs through the network at once: LEN and HIDDEN are compile-time constants, so
// an embedding stays in registers and every weight is one broadcast of a constant.
//
// Reference: appearance_eval in core/appearance.c, ref_appearance in render/render_ref.c.

#ifndef APPEARANCE_LEN // defined by look.c for the model at hand
#define APPEARANCE_LEN 16
#define APPEARANCE_HIDDEN 32
#endif
#define APPEARANCE_BIAS (APPEARANCE_HIDDEN * APPEARANCE_LEN)
#define APPEARANCE_W2 (APPEARANCE_BIAS + APPEARANCE_HIDDEN)
#define APPEARANCE_B2 (APPEARANCE_W2 + 4 * APPEARANCE_HIDDEN)
#define APPEARANCE_FLOATS (APPEARANCE_B2 + 4)
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

INLINE void appearance_eval(__constant float *frame, __global const float *g, V y[4])
{
    V unit[APPEARANCE_LEN];
    (void)appearance_unit(g, unit);
#pragma unroll
    for (uint o = 0; o < 4; o++)
        y[o] = (V)(frame[APPEARANCE_B2 + o]);
    for (uint h = 0; h < APPEARANCE_HIDDEN; h += APPEARANCE_UNITS) {
        V act[APPEARANCE_UNITS];
        appearance_units(frame, unit, h, act);
#pragma unroll
        for (uint j = 0; j < APPEARANCE_UNITS; j++) {
            V a = MAX_(act[j], 0.0f);
#pragma unroll
            for (uint o = 0; o < 4; o++)
                y[o] = frame[APPEARANCE_W2 + o * APPEARANCE_HIDDEN + h + j] * a + y[o];
        }
    }
#pragma unroll
    for (uint o = 0; o < 4; o++)
        y[o] = appearance_sigmoid(y[o]);
}
