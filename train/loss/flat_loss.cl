// The terms on the least axis of Gaussians: they are flat where the ground has FLAT, and lie level
// where it has LEVEL (train/loss/flat_loss.h).
//   in   params [groups][planes][16]
//        parts uchar [ny][nx], the grid of the ground; without one FLAT holds everywhere
//        list [groups], if listed: which groups of params these are
//   out  extra [groups][LAYOUT_PLANES_SHAPE][16]; if fresh every plane is written
// Reference: flat_loss_ref_run. VW 16: a work-item has LAYOUT_PROJECT_GROUPS groups. VW 1: an item
// has one Gaussian.

// The parts of the ground on which Gaussians lie: FLAT everywhere without a grid.
INLINE VI axes_parts(__global const float *g, VI real, const struct ground *l)
{
    V column = floor((LD(g, LAYOUT_PLANE_MEAN) - l->corner_x) * l->per_m),
      row = floor((LD(g, LAYOUT_PLANE_MEAN + 1) - l->corner_y) * l->per_m);
    VI known =
        real & (column >= 0.0f) & (row >= 0.0f) & (column < (float)l->nx) & (row < (float)l->ny);
    if (!l->nx)
        return real ? (VI)(FLAT) : (VI)(0);
#if VW == 16
    int at[VW], is[VW], out[VW];
    vstore16(known ? TO_VI(row) * (int)l->nx + TO_VI(column) : (VI)(0), 0, at);
    vstore16(known, 0, is);
    for (uint i = 0; i < VW; i++)
        out[i] = is[i] ? (int)l->parts[at[i]] : 0;
    return vload16(0, out);
#else
    return known ? (int)l->parts[(uint)row * l->nx + (uint)column] : 0;
#endif
}

// What acts on the least axis of each: 1 / flat_m where Gaussians shall be flat, the weight where
// they shall lie level; 0 elsewhere.
struct press {
    V per_flat, level;
};

INLINE struct press axes_press(__global const float *g, VI real, const struct ground *ground,
                               float per_flat, float level)
{
    VI parts = axes_parts(g, real, ground);
    struct press p = {(parts & FLAT) != 0 ? (V)(per_flat) : (V)(0.0f),
                      (parts & LEVEL) != 0 ? (V)(level) : (V)(0.0f)};
    return p;
}

// How upright the direction n of the least axis is, n_z, and the derivatives of n_z on the
// rotation. The rotation need not have length 1.
INLINE V axes_upright(__global const float *g, const struct axes *a, V d[4])
{
    V w = LD(g, LAYOUT_PLANE_QUAT), x = LD(g, LAYOUT_PLANE_QUAT + 1),
      y = LD(g, LAYOUT_PLANE_QUAT + 2), z = LD(g, LAYOUT_PLANE_QUAT + 3);
    V per = 1.0f / (w * w + x * x + y * y + z * z);
    VI is_0 = a->s[0] == a->least, is_1 = a->s[1] == a->least; // the first of equals
    V up = is_0 ? 2.0f * (x * z - w * y)
                : (is_1 ? 2.0f * (y * z + w * x) : w * w - x * x - y * y + z * z);
    up *= per;
    d[0] = is_0 ? -2.0f * y : (is_1 ? 2.0f * x : 2.0f * w);
    d[1] = is_0 ? 2.0f * z : (is_1 ? 2.0f * w : -2.0f * x);
    d[2] = is_0 ? -2.0f * w : (is_1 ? 2.0f * z : -2.0f * y);
    d[3] = is_0 ? 2.0f * x : (is_1 ? 2.0f * y : 2.0f * z);
    const V q[4] = {w, x, y, z};
    for (uint k = 0; k < 4; k++)
        d[k] = (d[k] - 2.0f * up * q[k]) * per;
    return up;
}

// The gradients of one group (Gaussian) into `out`. flat: weight over n.
INLINE void flat_grad_of(__global const float *g, VI real, const struct ground *ground,
                         float per_flat, float level, float flat, uint fresh, __global float *out)
{
    struct axes a;
    axes_load(g, &a);
    struct press p = axes_press(g, real, ground, per_flat, level);
    V thick = a.least * p.per_flat, pull = thick * thick, d[4], up = 0;
    VI thin = real;
    pull = flat * pull / (1.0f + pull);
    for (uint k = 0; k < 3; k++) {
        VI is_least = thin & (a.s[k] == a.least);
        thin &= !is_least; // the first of equals
        axes_store(out, k, is_least ? pull : (V)(0.0f), fresh);
    }
    if (level > 0.0f)
        up = axes_upright(g, &a, d);
    for (uint k = 0; k < 4 && (fresh || level > 0.0f); k++) {
        V h = level > 0.0f ? -2.0f * p.level * up * d[k] : (V)(0.0f);
        axes_store(out, LAYOUT_PLANES_SCALE + k, p.level > 0.0f ? h : (V)(0.0f), fresh);
    }
}

#if VW == 16
__kernel void flat_grad(__global const float *params, uint n, uint planes, uint groups, GROUND_ARGS,
                        float per_flat, float level, float flat, uint fresh, __global float *extra,
                        __global const uint *list, uint listed)
{
    uint item = (uint)get_global_id(0), from = item * LAYOUT_PROJECT_GROUPS,
         to = min(from + LAYOUT_PROJECT_GROUPS, groups);
    const struct ground ground = GROUND;
    for (uint group = from; group < to; group++) {
        uint own = axes_group(params, group, groups, planes, list, listed);
        VI real = LANE + (int)(group * LAYOUT_LANES) < (int)n;
        flat_grad_of(params + group_at(own, planes), real, &ground, per_flat, level, flat, fresh,
                     extra + group_at(group, LAYOUT_PLANES_SHAPE));
    }
}
#else
__kernel void flat_grad(__global const float *params, uint n, uint planes, uint groups, GROUND_ARGS,
                        float per_flat, float level, float flat, uint fresh, __global float *extra,
                        __global const uint *list, uint listed)
{
    uint i = (uint)get_global_id(0), group = i / LAYOUT_LANES, in = i % LAYOUT_LANES;
    const struct ground ground = GROUND;
    if (group < groups)
        flat_grad_of(params + group_at(listed ? list[group] : group, planes) + in, i < n, &ground,
                     per_flat, level, flat, fresh,
                     extra + group_at(group, LAYOUT_PLANES_SHAPE) + in);
}
#endif
