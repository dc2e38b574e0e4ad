// The depth loss around an ordinary frame: a copy of the model whose colour is inverse depth, the
// loss of its picture, and the gradients for the trained Gaussians.
//   depth_model  params -> shadow [groups][LAYOUT_DEPTH_PLANES][16]: the geometry (opacity replaced
//                in the hard pass), harmonics of degree 0 with red = unit / z
//   depth_loss   color, target -> grad [3][h][w], pieces: |D - t| summed over a piece
//   depth_add    grads of the shadow -> added to extra
//                [groups][LAYOUT_PLANES_GEOMETRY][16]
// z = row . mean + row.w, with row the camera's third. So the colour has a gradient for the mean
// too. Reference: depth_ref.c.
#define SH_C0 0.28209479177387814f

inline V depth_of(__global const float *g, float4 row)
{
    return row.x * LD(g, LAYOUT_PLANE_MEAN) +
           (row.y * LD(g, LAYOUT_PLANE_MEAN + 1) + (row.z * LD(g, LAYOUT_PLANE_MEAN + 2) + row.w));
}

// The groups and lanes of a work-item: LAYOUT_PROJECT_GROUPS groups, or one Gaussian.
#if VW == 16
#define GAUSSIANS_EACH(group, lane, groups)                                                        \
    for (uint group = (uint)get_global_id(0) * LAYOUT_PROJECT_GROUPS,                              \
              end_ = min(group + LAYOUT_PROJECT_GROUPS, (groups)), lane = 0;                       \
         group < end_; group++)
#else
#define GAUSSIANS_EACH(group, lane, groups)                                                        \
    for (uint group = (uint)get_global_id(0) / LAYOUT_LANES, end_ = min(group + 1, (groups)),      \
              lane = (uint)get_global_id(0) % LAYOUT_LANES;                                        \
         group < end_; group++)
#endif

__kernel void depth_model(__global const float *params, uint planes, uint groups, float4 row,
                          float unit, uint hard, float hard_logit, __global float *shadow)
{
    GAUSSIANS_EACH(group, lane, groups)
    {
        __global const float *g = params + group_at(group, planes) + lane;
        __global float *out = shadow + group_at(group, LAYOUT_DEPTH_PLANES) + lane;
        V z = depth_of(g, row), inverse = unit / (z > 0.0f ? z : (V)(INFINITY));
        for (uint p = 0; p < LAYOUT_PLANE_OPACITY; p++)
            ST(out, p, LD(g, p));
        ST(out, LAYOUT_PLANE_OPACITY, hard ? (V)(hard_logit) : LD(g, LAYOUT_PLANE_OPACITY));
        ST(out, LAYOUT_PLANE_SH, (inverse - 0.5f) / SH_C0);
        ST(out, LAYOUT_PLANE_SH + 1, (V)(-0.5f / SH_C0)); // black
        ST(out, LAYOUT_PLANE_SH + 2, (V)(-0.5f / SH_C0));
    }
}

// target: t / median, below 0 where nothing is known.
__kernel void depth_loss(__global const float *color, __global const float *target, uint pixels,
                         float per_pixel, __global float *grad, __global float *pieces)
{
    uint item = (uint)get_global_id(0);
    if (item >= LAYOUT_LOSS_PIECES)
        return;
    uint from = (uint)((ulong)item * pixels / LAYOUT_LOSS_PIECES),
         to = (uint)((ulong)(item + 1) * pixels / LAYOUT_LOSS_PIECES);
    float sum = 0.0f;
    for (uint i = from; i < to; i++) {
        float t = target[i], d = color[i] - t;
        int known = t >= 0.0f;
        sum += known ? fabs(d) : 0.0f;
        grad[i] = !known || d == 0.0f ? 0.0f : d > 0.0f ? per_pixel : -per_pixel;
        grad[pixels + i] = 0.0f;
        grad[2 * (size_t)pixels + i] = 0.0f;
    }
    pieces[item] = sum;
}

// unit_c0: unit / SH_C0; per_hard: 1 / (h (1 - h)) of the hard opacity h.
__kernel void depth_add(__global const float *params, uint planes, uint groups, float4 row,
                        float unit_c0, uint hard, float per_hard, __global const float *grads,
                        __global float *extra)
{
    GAUSSIANS_EACH(group, lane, groups)
    {
        __global const float *g = params + group_at(group, planes) + lane;
        __global const float *in = grads + group_at(group, LAYOUT_DEPTH_PLANES) + lane;
        __global float *out = extra + group_at(group, LAYOUT_PLANES_GEOMETRY) + lane;
        V z = depth_of(g, row), along = LD(in, LAYOUT_PLANE_SH) * (-unit_c0 / (z * z)); // dL/dz
        const float axis[3] = {row.x, row.y, row.z};
        along = z > 0.0f ? along : (V)(0.0f);
        for (uint k = 0; k < 3; k++) {
            uint p = LAYOUT_PLANE_MEAN + k;
            ST(out, p, LD(out, p) + (LD(in, p) + along * axis[k]));
        }
        for (uint p = LAYOUT_PLANE_SCALE; p < LAYOUT_PLANE_OPACITY; p++)
            ST(out, p, LD(out, p) + LD(in, p));
        V o = 1.0f / (1.0f + exp(-LD(g, LAYOUT_PLANE_OPACITY)));
        V own = LD(in, LAYOUT_PLANE_OPACITY);
        // Straight through: o + constant is drawn, so dL/do is that of the hard opacity.
        own = hard ? own * per_hard * (o * (1.0f - o)) : own;
        ST(out, LAYOUT_PLANE_OPACITY, LD(out, LAYOUT_PLANE_OPACITY) + own);
    }
}
