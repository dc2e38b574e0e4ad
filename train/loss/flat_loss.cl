// The term on the least axis of Gaussians: they are flat where the ground has FLAT
// (train/loss/flat_loss.h).
//   in   params [groups][planes][16]
//        parts uchar [ny][nx], the grid of the ground; without one FLAT holds everywhere
//        list [groups], if listed: which groups of params these are
//   out  extra [groups][LAYOUT_PLANES_SCALE][16]; if fresh every plane is written
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

// The gradients of one group (Gaussian) into `out`. flat: weight over n.
INLINE void flat_grad_of(__global const float *g, VI real, const struct ground *ground,
                         float per_flat, float flat, uint fresh, __global float *out)
{
    struct axes a;
    axes_load(g, &a);
    V thick = (axes_parts(g, real, ground) & FLAT) != 0 ? a.least * per_flat : (V)(0.0f);
    V pull = thick * thick;
    VI thin = real;
    pull = flat * pull / (1.0f + pull);
    for (uint k = 0; k < LAYOUT_PLANES_SCALE; k++) {
        VI is_least = thin & (a.s[k] == a.least);
        thin &= !is_least; // the first of equals
        axes_store(out, k, is_least ? pull : (V)(0.0f), fresh);
    }
}

#if VW == 16
__kernel void flat_grad(__global const float *params, uint n, uint planes, uint groups, GROUND_ARGS,
                        float per_flat, float flat, uint fresh, __global float *extra,
                        __global const uint *list, uint listed)
{
    uint item = (uint)get_global_id(0), from = item * LAYOUT_PROJECT_GROUPS,
         to = min(from + LAYOUT_PROJECT_GROUPS, groups);
    const struct ground ground = GROUND;
    for (uint group = from; group < to; group++) {
        uint own = axes_group(params, group, groups, planes, list, listed);
        VI real = LANE + (int)(group * LAYOUT_LANES) < (int)n;
        flat_grad_of(params + group_at(own, planes), real, &ground, per_flat, flat, fresh,
                     extra + group_at(group, LAYOUT_PLANES_SCALE));
    }
}
#else
__kernel void flat_grad(__global const float *params, uint n, uint planes, uint groups, GROUND_ARGS,
                        float per_flat, float flat, uint fresh, __global float *extra,
                        __global const uint *list, uint listed)
{
    uint i = (uint)get_global_id(0), group = i / LAYOUT_LANES, in = i % LAYOUT_LANES;
    const struct ground ground = GROUND;
    if (group < groups)
        flat_grad_of(params + group_at(listed ? list[group] : group, planes) + in, i < n, &ground,
                     per_flat, flat, fresh, extra + group_at(group, LAYOUT_PLANES_SCALE) + in);
}
#endif
