// Stage: the appearance network, backward, where it is not part of project_backward.cl: with VW 1,
// a work-group is a fixed chunk of the Gaussians. Its items put what they know of a Gaussian each
// into local memory, then every item adds products of two columns of it for the sums it owns, so
// that nothing is added by atomics. And for any VW: the sum of all chunks.
//   in   look [groups][4][16] (dL/dy, where visible), params, tiles_of, frame (see appearance.cl)
//   out  the embedding's planes of grads (appearance_backward), or of params and both moments
//        (appearance_step); parts [LAYOUT_APPEARANCE_CHUNKS][APPEARANCE_ROW]
// `each` is added to dL/dy3 of all that are visible: the weight of the mean opacity offset over
// their number. Formulas and reference: appearance.cl.

#if VW == 1
// Columns of the tile, one row a Gaussian: g^, g_s, a, g_z, y3, 1.
#define APPEARANCE_G_ACT APPEARANCE_LEN
#define APPEARANCE_ACT (APPEARANCE_G_ACT + APPEARANCE_HIDDEN)
#define APPEARANCE_OUT (APPEARANCE_ACT + APPEARANCE_HIDDEN)
#define APPEARANCE_OFFSET (APPEARANCE_OUT + 4)
#define APPEARANCE_ONE (APPEARANCE_OFFSET + 1)
#define APPEARANCE_STRIDE ((APPEARANCE_ONE + 1) | 1) // odd: rows begin in different banks
#define APPEARANCE_ITEMS (APPEARANCE_STRIDE > 128 ? 32 : 64)
#define APPEARANCE_SUMS_EACH ((APPEARANCE_SUMS + APPEARANCE_ITEMS - 1) / APPEARANCE_ITEMS)

// Sum `i` adds products of these two columns.
INLINE uint2 render_appearance_columns(uint i)
{
    if (i < APPEARANCE_BIAS)
        return (uint2)(APPEARANCE_G_ACT + i / APPEARANCE_LEN, i % APPEARANCE_LEN);
    if (i < APPEARANCE_W2)
        return (uint2)(APPEARANCE_G_ACT + i - APPEARANCE_BIAS, APPEARANCE_ONE);
    if (i < APPEARANCE_B2)
        return (uint2)(APPEARANCE_OUT + (i - APPEARANCE_W2) / APPEARANCE_HIDDEN,
                       APPEARANCE_ACT + (i - APPEARANCE_W2) % APPEARANCE_HIDDEN);
    if (i < APPEARANCE_FLOATS)
        return (uint2)(APPEARANCE_OUT + i - APPEARANCE_B2, APPEARANCE_ONE);
    return (uint2)(APPEARANCE_OFFSET, APPEARANCE_ONE);
}

INLINE void render_appearance_row(const struct render_appearance_terms *t, __local float *row)
{
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        row[k] = t->unit[k];
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        row[APPEARANCE_G_ACT + h] = t->g_act[h];
        row[APPEARANCE_ACT + h] = t->act[h];
    }
    for (uint o = 0; o < 4; o++)
        row[APPEARANCE_OUT + o] = t->g_out[o];
    row[APPEARANCE_OFFSET] = t->offset;
    row[APPEARANCE_ONE] = 1.0f;
}

INLINE void render_appearance_chunk(__constant struct layout_view *v, __constant float *frame,
                                    __global float *params, __global const uint *tiles_of,
                                    __global const float *look, float each, __global float *grads,
                                    __global float *m1, __global float *m2, float8 k, float2 embed,
                                    bool step, __global float *parts, __local float *tile)
{
    size_t chunk = get_group_id(0);
    uint item = (uint)get_local_id(0), first = v->planes - APPEARANCE_LEN;
    size_t from = chunk * v->groups / LAYOUT_APPEARANCE_CHUNKS * LAYOUT_LANES,
           to = (chunk + 1) * v->groups / LAYOUT_APPEARANCE_CHUNKS * LAYOUT_LANES;
    float sum[APPEARANCE_SUMS_EACH];
    for (uint s = 0; s < APPEARANCE_SUMS_EACH; s++)
        sum[s] = 0.0f;
    for (size_t base = from; base < to; base += APPEARANCE_ITEMS) {
        size_t i = base + item;
        __local float *row = tile + item * APPEARANCE_STRIDE;
        bool here = i < to, visible = here && tiles_of[i] != 0;
        struct render_appearance_terms t;
        for (uint p = 0; p < APPEARANCE_LEN; p++)
            t.embed[p] = 0.0f;
        size_t group = i / LAYOUT_LANES, lane = i % LAYOUT_LANES,
               at = group * v->planes * LAYOUT_LANES + lane;
        if (visible) {
            V g_y[4];
            for (uint o = 0; o < 4; o++)
                g_y[o] = LD(look + group * 4 * LAYOUT_LANES + lane, o);
            render_appearance_terms(frame, params + at + first * LAYOUT_LANES, g_y, each, visible,
                                    &t);
            render_appearance_row(&t, row);
        } else {
            for (uint c = 0; c < APPEARANCE_STRIDE; c++)
                row[c] = 0.0f;
        }
        if (here && step) {
            struct adam a = {params + at, m1 + at, m2 + at, (float8)(0.0f), k};
            adam_embed(&a, embed, first, t.embed, i < v->n);
        } else if (here) {
            for (uint p = 0; p < APPEARANCE_LEN; p++)
                ST(grads + at, first + p, t.embed[p]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint s = 0; s < APPEARANCE_SUMS_EACH; s++) {
            uint2 c =
                render_appearance_columns(min(s * APPEARANCE_ITEMS + item, APPEARANCE_SUMS - 1u));
            for (uint r = 0; r < APPEARANCE_ITEMS; r++)
                sum[s] =
                    tile[r * APPEARANCE_STRIDE + c.x] * tile[r * APPEARANCE_STRIDE + c.y] + sum[s];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    for (uint s = 0; s < APPEARANCE_SUMS_EACH; s++)
        if (s * APPEARANCE_ITEMS + item < APPEARANCE_SUMS)
            parts[chunk * APPEARANCE_ROW + s * APPEARANCE_ITEMS + item] = sum[s];
}

#define APPEARANCE_GROUP __attribute__((reqd_work_group_size(APPEARANCE_ITEMS, 1, 1)))

__kernel APPEARANCE_GROUP void appearance_backward(__constant struct layout_view *v,
                                                   __constant float *frame, __global float *params,
                                                   __global const uint *tiles_of,
                                                   __global const float *look, float each,
                                                   __global float *parts, __global float *grads)
{
    __local float tile[APPEARANCE_ITEMS * APPEARANCE_STRIDE];
    render_appearance_chunk(v, frame, params, tiles_of, look, each, grads, params, params,
                            (float8)(0.0f), (float2)(0.0f), false, parts, tile);
}

__kernel APPEARANCE_GROUP void appearance_step(__constant struct layout_view *v,
                                               __constant float *frame, __global float *params,
                                               __global const uint *tiles_of,
                                               __global const float *look, float each,
                                               __global float *parts, __global float *m1,
                                               __global float *m2, float8 k, float2 embed)
{
    __local float tile[APPEARANCE_ITEMS * APPEARANCE_STRIDE];
    render_appearance_chunk(v, frame, params, tiles_of, look, each, params, m1, m2, k, embed, true,
                            parts, tile);
}
#endif

// Rows of `parts`, added in order: VW sums an item.
__kernel void appearance_sum(__global const float *parts, uint rows, __global float *sums)
{
    uint i = (uint)get_global_id(0);
    V sum = (V)(0.0f);
    if (i >= APPEARANCE_ROW / VW)
        return;
    for (uint r = 0; r < rows; r++) {
        __global const float *row = parts + (size_t)r * APPEARANCE_ROW + i * VW;
        sum += LD(row, 0);
    }
    ST(sums + i * VW, 0, sum);
}
