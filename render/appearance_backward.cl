// Stage: the appearance network, backward, for VW 1. With VW 16 it is part of project_backward.cl.
// A work-group has a fixed chunk of the Gaussians. Its items each write the values of a Gaussian to
// local memory. Then each item computes the sums that it owns, from products of two columns, so
// there are no atomic additions. For any VW: the sum of all chunks.
//   in   y_grads [groups][4][16] (dL/dy, where visible), params, tiles_of, frame (see
//        appearance.cl)
//   out  the embedding's planes of grads (appearance_backward), or of params and moments
//        (appearance_step); parts [LAYOUT_APPEARANCE_CHUNKS][APPEARANCE_ROW]
// `each` is added to dL/dy3 of all visible Gaussians: the weight of the mean opacity offset divided
// by their number. Formulas and reference: appearance.cl.

#if VW == 1
// Columns of the tile, one row a Gaussian: g^, g_s, a, g_z, y3, 1.
#define COLUMN_G_ACT APPEARANCE_LEN
#define COLUMN_ACT (COLUMN_G_ACT + APPEARANCE_HIDDEN)
#define COLUMN_OUT (COLUMN_ACT + APPEARANCE_HIDDEN)
#define COLUMN_OFFSET (COLUMN_OUT + LAYOUT_APPEARANCE_OUT)
#define COLUMN_ONE (COLUMN_OFFSET + 1)
#define APPEARANCE_STRIDE LAYOUT_APPEARANCE_STRIDE(APPEARANCE_LEN, APPEARANCE_HIDDEN)
#define APPEARANCE_ITEMS LAYOUT_APPEARANCE_ITEMS(APPEARANCE_LEN, APPEARANCE_HIDDEN)
#define APPEARANCE_SUMS_EACH ((APPEARANCE_SUMS + APPEARANCE_ITEMS - 1) / APPEARANCE_ITEMS)

// Sum `i` adds products of these two columns.
INLINE uint2 render_appearance_columns(uint i)
{
    if (i < APPEARANCE_BIAS)
        return (uint2)(COLUMN_G_ACT + i / APPEARANCE_LEN, i % APPEARANCE_LEN);
    if (i < APPEARANCE_W2)
        return (uint2)(COLUMN_G_ACT + i - APPEARANCE_BIAS, COLUMN_ONE);
    if (i < APPEARANCE_B2)
        return (uint2)(COLUMN_OUT + (i - APPEARANCE_W2) / APPEARANCE_HIDDEN,
                       COLUMN_ACT + (i - APPEARANCE_W2) % APPEARANCE_HIDDEN);
    if (i < APPEARANCE_FLOATS)
        return (uint2)(COLUMN_OUT + i - APPEARANCE_B2, COLUMN_ONE);
    return (uint2)(COLUMN_OFFSET, COLUMN_ONE);
}

INLINE void render_appearance_row(const struct render_appearance_terms *t, __local float *row)
{
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        row[k] = t->unit[k];
    for (uint h = 0; h < APPEARANCE_HIDDEN; h++) {
        row[COLUMN_G_ACT + h] = t->g_act[h];
        row[COLUMN_ACT + h] = t->act[h];
    }
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        row[COLUMN_OUT + o] = t->g_out[o];
    row[COLUMN_OFFSET] = t->offset;
    row[COLUMN_ONE] = 1.0f;
}

// What the embeddings' gradients are put into: planes of grads, or Adam's where rates is not 0.
struct embed_target {
    __global float *grads, *params;
    __global uint *moments;
    const struct layout_adam *rates;
};

INLINE void embed_put(const struct embed_target *to, size_t at, uint row, uint first,
                      const V g[APPEARANCE_LEN], bool real)
{
    if (to->rates) {
        struct adam a = {to->params + at,
                         to->moments + at,
                         to->rates,
                         to->rates->inv_bias2,
                         1.0f,
                         1.0f,
                         adam_key(row, to->rates->step)};
        adam_embed(&a, first, g, real);
    } else {
        for (uint p = 0; p < APPEARANCE_LEN; p++)
            ST(to->grads + at, first + p, g[p]);
    }
}

INLINE void render_appearance_chunk(__constant struct layout_view *v, __constant float *frame,
                                    __global const uint *tiles_of, __global const float *y_grads,
                                    float each, const struct embed_target *to_embed,
                                    __global float *parts, __local float *tile)
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
        uint group = (uint)(i / LAYOUT_LANES), lane = (uint)(i % LAYOUT_LANES);
        size_t at = group_at(group, v->planes) + lane;
        if (visible) {
            V g_y[LAYOUT_APPEARANCE_OUT];
            for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
                g_y[o] = LD(y_grads + group_at(group, LAYOUT_APPEARANCE_OUT) + lane, o);
            render_appearance_terms(frame, to_embed->params + at + first * LAYOUT_LANES, g_y, each,
                                    visible, &t);
            render_appearance_row(&t, row);
        } else {
            for (uint c = 0; c < APPEARANCE_STRIDE; c++)
                row[c] = 0.0f;
        }
        if (here)
            embed_put(to_embed, at, (uint)i, first, t.embed, i < v->n);
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
                                                   __global const float *y_grads, float each,
                                                   __global float *parts, __global float *grads)
{
    __local float tile[APPEARANCE_ITEMS * APPEARANCE_STRIDE];
    struct embed_target to = {grads, params, 0, 0};
    render_appearance_chunk(v, frame, tiles_of, y_grads, each, &to, parts, tile);
}

__kernel APPEARANCE_GROUP void
appearance_step(__constant struct layout_view *v, __constant float *frame, __global float *params,
                __global const uint *tiles_of, __global const float *y_grads, float each,
                __global float *parts, __global uint *moments, struct layout_adam rates)
{
    __local float tile[APPEARANCE_ITEMS * APPEARANCE_STRIDE];
    struct embed_target to = {params, params, moments, &rates};
    render_appearance_chunk(v, frame, tiles_of, y_grads, each, &to, parts, tile);
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
