// Stage: the appearance network, backward. dL/dy of every Gaussian (`look`, left by
// project_backward.cl) -> gradients of the embeddings, written out (appearance_backward) or put
// into Adam at once (appearance_step), and of the frame's constants, summed over the Gaussians.
//   in   look [groups][4][16] (where visible), params, tiles_of, frame (see appearance.cl)
//   out  the embedding's planes of grads; or of params and both moments
//        parts [LAYOUT_APPEARANCE_CHUNKS][APPEARANCE_SUMS]: sums over fixed chunks of groups, added
//        in order by appearance_sum; the last is the sum of y3
//
// With s = W1 g^ + bias, a = max(0, s), z = W2 a + b2:  g_z = g_y y (1 - y),  g_a = W2^T g_z,
// g_s = g_a where s > 0,  g_g^ = W1^T g_s,  and g_g = (g_g^ - g^ (g^ . g_g^)) / |g|. The sums are
// g_s g^T, g_s, g_z a^T, g_z. `each` is added to dL/dy3 of all that are visible: the weight of the
// mean opacity offset over their number.
//
// VW 16: a work-item is a chunk; 16 Gaussians share a vector, except that for g_s g^T lanes run
// over the embedding: 16 Gaussians, transposed, are added to one row of it. VW 1: a work-group is a
// chunk; its items put what they know of a Gaussian each into local memory, then add products of
// two columns of it, every sum its own item.
//
// Reference: ref_appearance_backward in render/render_ref_backward.c.

#define APPEARANCE_SUMS (APPEARANCE_FLOATS + 1)

// One group or Gaussian: what the sums are made of, all 0 where it was not seen.
struct look_terms {
    V unit[APPEARANCE_LEN];
    V act[APPEARANCE_HIDDEN], g_act[APPEARANCE_HIDDEN]; // a and g_s
    V g_out[4], offset;                                 // g_z and y3
    V embed[APPEARANCE_LEN];                            // gradient of the embedding
};

INLINE void look_terms(__constant float *frame, __global const float *g, __global const float *look,
                       VI visible, float each, struct look_terms *t)
{
    V y[4], g_unit[APPEARANCE_LEN], along = (V)(0.0f);
    V len = appearance_unit(g, t->unit);
#pragma unroll
    for (uint o = 0; o < 4; o++)
        y[o] = (V)(frame[APPEARANCE_B2 + o]);
    for (uint h = 0; h < APPEARANCE_HIDDEN; h += APPEARANCE_UNITS) {
        V s[APPEARANCE_UNITS];
        appearance_units(frame, t->unit, h, s);
#pragma unroll
        for (uint j = 0; j < APPEARANCE_UNITS; j++) {
            V a = MAX_(s[j], 0.0f);
            t->act[h + j] = a;
#pragma unroll
            for (uint o = 0; o < 4; o++)
                y[o] = frame[APPEARANCE_W2 + o * APPEARANCE_HIDDEN + h + j] * a + y[o];
        }
    }
#pragma unroll
    for (uint o = 0; o < 4; o++) {
        V p = appearance_sigmoid(y[o]), gy = LD(look, o) + (o == 3 ? each : 0.0f);
        t->g_out[o] = visible ? gy * (p * (1.0f - p)) : (V)(0.0f);
        if (o == 3)
            t->offset = visible ? p : (V)(0.0f);
    }
#pragma unroll
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        g_unit[k] = (V)(0.0f);
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        V g_a = (V)(0.0f);
#pragma unroll
        for (uint o = 0; o < 4; o++)
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

// The embedding's planes, by Adam. Every Gaussian of the model, seen or not, as all parameters.
INLINE void look_step(const struct adam *a, uint first, const V g[APPEARANCE_LEN], VI real)
{
    VI keep = real;
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        keep &= fabs(g[k]) < GRAD_LIMIT;
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        ST(a->p, first + k, adam_plane(a, first + k, a->lr.s0, g[k], keep));
}

#if VW == 16

#define LOOK_BLOCKS ((APPEARANCE_LEN + 15) / 16)

struct look_sums {
    V w1[APPEARANCE_HIDDEN][LOOK_BLOCKS]; // lanes run over the embedding
    V act[APPEARANCE_HIDDEN], w2[4][APPEARANCE_HIDDEN], out[4], offset;
};

// 16 planes of 16 lanes -> 16 lanes of 16 planes.
INLINE void look_transpose(V w[16])
{
    V t[16];
#pragma unroll
    for (int round = 0; round < 2; round++) {
#pragma unroll
        for (int i = 0; i < 8; i++) {
            t[2 * i].even = w[i].lo;
            t[2 * i].odd = w[i + 8].lo;
            t[2 * i + 1].even = w[i].hi;
            t[2 * i + 1].odd = w[i + 8].hi;
        }
#pragma unroll
        for (int i = 0; i < 8; i++) {
            w[2 * i].even = t[i].lo;
            w[2 * i].odd = t[i + 8].lo;
            w[2 * i + 1].even = t[i].hi;
            w[2 * i + 1].odd = t[i + 8].hi;
        }
    }
}

INLINE void look_add(const struct look_terms *t, struct look_sums *sums)
{
    const float *g_act = (const float *)t->g_act; // [HIDDEN][16]
#pragma unroll
    for (uint b = 0; b < LOOK_BLOCKS; b++) {
        V lane[16];
#pragma unroll
        for (uint k = 0; k < 16; k++)
            lane[k] = 16 * b + k < APPEARANCE_LEN ? t->unit[16 * b + k] : (V)(0.0f);
        look_transpose(lane);
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
        for (uint o = 0; o < 4; o++)
            sums->w2[o][h] = t->g_out[o] * t->act[h] + sums->w2[o][h];
    }
#pragma unroll
    for (uint o = 0; o < 4; o++)
        sums->out[o] += t->g_out[o];
    sums->offset += t->offset;
}

INLINE float look_lanes(V v) // always in this order
{
    float8 a = v.lo + v.hi;
    float4 b = a.lo + a.hi;
    return (b.x + b.y) + (b.z + b.w);
}

INLINE void look_write(const struct look_sums *s, __global float *out)
{
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        const float *row = (const float *)s->w1[h];
        for (uint k = 0; k < APPEARANCE_LEN; k++)
            out[h * APPEARANCE_LEN + k] = row[k];
        out[APPEARANCE_BIAS + h] = look_lanes(s->act[h]);
        for (uint o = 0; o < 4; o++)
            out[APPEARANCE_W2 + o * APPEARANCE_HIDDEN + h] = look_lanes(s->w2[o][h]);
    }
    for (uint o = 0; o < 4; o++)
        out[APPEARANCE_B2 + o] = look_lanes(s->out[o]);
    out[APPEARANCE_FLOATS] = look_lanes(s->offset);
}

// The groups of chunk c, and the whole of it; `grads` NULL means Adam.
INLINE void look_chunk(__constant struct layout_view *v, __constant float *frame,
                       __global float *params, __global const uint *tiles_of,
                       __global const float *look, float each, __global float *grads,
                       __global float *m1, __global float *m2, float8 lr, float8 k, bool step,
                       __global float *parts)
{
    size_t chunk = get_global_id(0);
    uint first = v->planes - APPEARANCE_LEN;
    size_t from = chunk * v->groups / LAYOUT_APPEARANCE_CHUNKS,
           to = (chunk + 1) * v->groups / LAYOUT_APPEARANCE_CHUNKS;
    struct look_sums sums;
    struct look_terms t;
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        for (uint b = 0; b < LOOK_BLOCKS; b++)
            sums.w1[h][b] = (V)(0.0f);
        sums.act[h] = sums.w2[0][h] = sums.w2[1][h] = sums.w2[2][h] = sums.w2[3][h] = (V)(0.0f);
    }
    sums.out[0] = sums.out[1] = sums.out[2] = sums.out[3] = sums.offset = (V)(0.0f);
    for (size_t group = from; group < to; group++) {
        size_t at = group * v->planes * LAYOUT_LANES;
        VI visible = tiles_some(tiles_of + group * LAYOUT_LANES);
        if (ANY(visible)) {
            look_terms(frame, params + at + first * LAYOUT_LANES, look + group * 4 * LAYOUT_LANES,
                       visible, each, &t);
            look_add(&t, &sums);
        } else {
            for (uint p = 0; p < APPEARANCE_LEN; p++)
                t.embed[p] = (V)(0.0f);
        }
        if (step) {
            struct adam a = {params + at, m1 + at, m2 + at, lr, k};
            look_step(&a, first, t.embed, LANE + (int)(group * LAYOUT_LANES) < (int)v->n);
        } else {
            for (uint p = 0; p < APPEARANCE_LEN; p++)
                ST(grads + at, first + p, t.embed[p]);
        }
    }
    look_write(&sums, parts + chunk * APPEARANCE_SUMS);
}

#define LOOK_LOCAL
#define LOOK_TILE
#define LOOK_GROUP
#else

// Columns of the tile, one row a Gaussian: g^, g_s, a, g_z, y3, 1.
#define LOOK_G_ACT APPEARANCE_LEN
#define LOOK_ACT (LOOK_G_ACT + APPEARANCE_HIDDEN)
#define LOOK_OUT (LOOK_ACT + APPEARANCE_HIDDEN)
#define LOOK_OFFSET (LOOK_OUT + 4)
#define LOOK_ONE (LOOK_OFFSET + 1)
#define LOOK_STRIDE ((LOOK_ONE + 1) | 1) // odd: rows begin in different banks
#define LOOK_ITEMS (LOOK_STRIDE > 128 ? 32 : 64)
#define LOOK_SUMS ((APPEARANCE_SUMS + LOOK_ITEMS - 1) / LOOK_ITEMS)

// Sum `i` adds products of these two columns.
INLINE uint2 look_columns(uint i)
{
    if (i < APPEARANCE_BIAS)
        return (uint2)(LOOK_G_ACT + i / APPEARANCE_LEN, i % APPEARANCE_LEN);
    if (i < APPEARANCE_W2)
        return (uint2)(LOOK_G_ACT + i - APPEARANCE_BIAS, LOOK_ONE);
    if (i < APPEARANCE_B2)
        return (uint2)(LOOK_OUT + (i - APPEARANCE_W2) / APPEARANCE_HIDDEN,
                       LOOK_ACT + (i - APPEARANCE_W2) % APPEARANCE_HIDDEN);
    if (i < APPEARANCE_FLOATS)
        return (uint2)(LOOK_OUT + i - APPEARANCE_B2, LOOK_ONE);
    return (uint2)(LOOK_OFFSET, LOOK_ONE);
}

INLINE void look_row(const struct look_terms *t, __local float *row)
{
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        row[k] = t->unit[k];
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        row[LOOK_G_ACT + h] = t->g_act[h];
        row[LOOK_ACT + h] = t->act[h];
    }
    for (uint o = 0; o < 4; o++)
        row[LOOK_OUT + o] = t->g_out[o];
    row[LOOK_OFFSET] = t->offset;
    row[LOOK_ONE] = 1.0f;
}

INLINE void look_chunk(__constant struct layout_view *v, __constant float *frame,
                       __global float *params, __global const uint *tiles_of,
                       __global const float *look, float each, __global float *grads,
                       __global float *m1, __global float *m2, float8 lr, float8 k, bool step,
                       __global float *parts, __local float *tile)
{
    size_t chunk = get_group_id(0);
    uint item = (uint)get_local_id(0), first = v->planes - APPEARANCE_LEN;
    size_t from = chunk * v->groups / LAYOUT_APPEARANCE_CHUNKS * LAYOUT_LANES,
           to = (chunk + 1) * v->groups / LAYOUT_APPEARANCE_CHUNKS * LAYOUT_LANES;
    float sum[LOOK_SUMS];
    for (uint s = 0; s < LOOK_SUMS; s++)
        sum[s] = 0.0f;
    for (size_t base = from; base < to; base += LOOK_ITEMS) {
        size_t i = base + item;
        __local float *row = tile + item * LOOK_STRIDE;
        bool here = i < to, visible = here && tiles_of[i] != 0;
        struct look_terms t;
        for (uint p = 0; p < APPEARANCE_LEN; p++)
            t.embed[p] = 0.0f;
        size_t group = i / LAYOUT_LANES, lane = i % LAYOUT_LANES,
               at = group * v->planes * LAYOUT_LANES + lane;
        if (visible) {
            look_terms(frame, params + at + first * LAYOUT_LANES,
                       look + group * 4 * LAYOUT_LANES + lane, visible, each, &t);
            look_row(&t, row);
        } else {
            for (uint c = 0; c < LOOK_STRIDE; c++)
                row[c] = 0.0f;
        }
        if (here && step) {
            struct adam a = {params + at, m1 + at, m2 + at, lr, k};
            look_step(&a, first, t.embed, i < v->n);
        } else if (here) {
            for (uint p = 0; p < APPEARANCE_LEN; p++)
                ST(grads + at, first + p, t.embed[p]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint s = 0; s < LOOK_SUMS; s++) {
            uint2 c = look_columns(min(s * LOOK_ITEMS + item, APPEARANCE_SUMS - 1u));
            for (uint r = 0; r < LOOK_ITEMS; r++)
                sum[s] = tile[r * LOOK_STRIDE + c.x] * tile[r * LOOK_STRIDE + c.y] + sum[s];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    for (uint s = 0; s < LOOK_SUMS; s++)
        if (s * LOOK_ITEMS + item < APPEARANCE_SUMS)
            parts[chunk * APPEARANCE_SUMS + s * LOOK_ITEMS + item] = sum[s];
}

#define LOOK_LOCAL __local float tile[LOOK_ITEMS * LOOK_STRIDE];
#define LOOK_TILE , tile
#define LOOK_GROUP __attribute__((reqd_work_group_size(LOOK_ITEMS, 1, 1)))
#endif

__kernel LOOK_GROUP void appearance_backward(__constant struct layout_view *v,
                                             __constant float *frame, __global float *params,
                                             __global const uint *tiles_of,
                                             __global const float *look, float each,
                                             __global float *parts, __global float *grads)
{
    LOOK_LOCAL
    look_chunk(v, frame, params, tiles_of, look, each, grads, params, params, (float8)(0.0f),
               (float8)(0.0f), false, parts LOOK_TILE);
}

__kernel LOOK_GROUP void appearance_step(__constant struct layout_view *v, __constant float *frame,
                                         __global float *params, __global const uint *tiles_of,
                                         __global const float *look, float each,
                                         __global float *parts, __global float *m1,
                                         __global float *m2, float8 lr, float8 k)
{
    LOOK_LOCAL
    look_chunk(v, frame, params, tiles_of, look, each, params, m1, m2, lr, k, true,
               parts LOOK_TILE);
}

// One sum an item, over the chunks in order.
__kernel void appearance_sum(__global const float *parts, __global float *sums)
{
    uint i = (uint)get_global_id(0);
    if (i >= APPEARANCE_SUMS)
        return;
    float sum = 0.0f;
    for (uint c = 0; c < LAYOUT_APPEARANCE_CHUNKS; c++)
        sum += parts[c * APPEARANCE_SUMS + i];
    sums[i] = sum;
}
