// The scale regularizer: how many axes and needles are too long, then their gradients.
//   in   params [groups][planes][16]
//   mid  pieces [LAYOUT_LOSS_PIECES] counts and sums of a piece
//   out  extra [groups][LAYOUT_PLANES_GEOMETRY][16] or [groups][LAYOUT_PLANES_SCALE][16], every
//        plane written, 0 where nothing is wrong
// Counts are whole numbers over fixed pieces: same input, same bits. Reference: scale_loss_ref_run.
#define RATIO_EPS 1e-8f
#define SCALE_AHEAD 8

struct axes { // sigmas, and the ratio of the largest to the middle one
    V s[3], largest, middle, ratio;
};

// Groups lie further apart than the hardware looks ahead.
inline void axes_ahead(__global const float *params, uint group, uint planes)
{
    for (uint k = 0; k < LAYOUT_PLANES_SCALE; k++)
        PREFETCH(params + group_at(group, planes) + (LAYOUT_PLANE_SCALE + k) * LAYOUT_LANES);
}

inline void axes_load(__global const float *g, struct axes *a)
{
    for (uint k = 0; k < 3; k++)
        a->s[k] = exp(LD(g, LAYOUT_PLANE_SCALE + k));
    V ab = MIN_(a->s[0], a->s[1]), top = MAX_(a->s[0], a->s[1]), below = MIN_(top, a->s[2]);
    a->largest = MAX_(top, a->s[2]);
    a->middle = MAX_(ab, below);
    a->ratio = a->largest / (a->middle + RATIO_EPS);
}

__kernel void scale_count(__global const float *params, uint n, uint planes, uint groups,
                          float s_max, float r_max, __global struct layout_scale_piece *pieces)
{
    uint item = (uint)get_global_id(0);
    if (item >= LAYOUT_LOSS_PIECES)
        return;
    uint from = PIECE_FROM(item, LAYOUT_LOSS_PIECES, groups),
         to = PIECE_FROM(item + 1, LAYOUT_LOSS_PIECES, groups);
    VU count_n = (VU)(0), count_m = (VU)(0);
    V size = (V)(0.0f), ratio = (V)(0.0f);
    for (uint group = from; group < to; group++)
        LANES_EACH(lane)
        {
            struct axes a;
            VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
            axes_ahead(params, min(group + SCALE_AHEAD, groups - 1), planes);
            axes_load(params + group_at(group, planes) + lane, &a);
            for (uint k = 0; k < 3; k++) {
                VI over = real & (a.s[k] > s_max);
                count_n += over ? (VU)(1) : (VU)(0);
                size += over ? a.s[k] : (V)(0.0f);
            }
            VI needle = real & (a.ratio > r_max);
            count_m += needle ? (VU)(1) : (VU)(0);
            ratio += needle ? a.ratio : (V)(0.0f);
        }
    pieces[item].n = lanes_add(count_n);
    pieces[item].m = lanes_add(count_m);
    pieces[item].size = lanes_sum(size);
    pieces[item].ratio = lanes_sum(ratio);
}

inline struct layout_scale_piece scale_total(__global const struct layout_scale_piece *pieces)
{
    struct layout_scale_piece t = {0, 0, 0.0f, 0.0f};
    for (uint i = 0; i < LAYOUT_LOSS_PIECES; i++) {
        t.n += pieces[i].n;
        t.m += pieces[i].m;
    }
    return t;
}

// only: sizes are all that acts, extra is float [groups][LAYOUT_PLANES_SCALE][16].
__kernel void scale_grad(__global const float *params, uint n, uint planes, uint groups,
                         float s_max, float r_max, float weight,
                         __global const struct layout_scale_piece *pieces, uint only,
                         __global float *extra)
{
    uint item = (uint)get_global_id(0), from = item * LAYOUT_PROJECT_GROUPS,
         to = min(from + LAYOUT_PROJECT_GROUPS, groups);
    struct layout_scale_piece total = scale_total(pieces);
    float per_n = weight / ((float)total.n + 1.0f), per_m = weight / ((float)total.m + 1.0f);
    for (uint group = from; group < to; group++)
        LANES_EACH(lane)
        {
            struct axes a;
            uint first = only ? 0 : LAYOUT_PLANE_SCALE; // plane of the first size
            uint out_planes = only ? LAYOUT_PLANES_SCALE : LAYOUT_PLANES_GEOMETRY;
            __global float *out = extra + group_at(group, out_planes) + lane;
            VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
            axes_ahead(params, min(group + SCALE_AHEAD, groups - 1), planes);
            axes_load(params + group_at(group, planes) + lane, &a);
            VI needle = real & (a.ratio > r_max), left = needle, also = needle;
            V q = a.middle + RATIO_EPS;
            for (uint p = 0; p < first; p++)
                ST(out, p, (V)(0.0f));
            for (uint k = 0; k < 3; k++) {
                V g = (real & (a.s[k] > s_max)) ? per_n * a.s[k] : (V)(0.0f);
                VI is_largest = left & (a.s[k] == a.largest);
                left &= !is_largest; // the first of equals
                g += is_largest ? per_m * a.ratio : (V)(0.0f);
                VI is_middle = also & !is_largest & (a.s[k] == a.middle);
                also &= !is_middle;
                g -= is_middle ? per_m * a.ratio * (a.s[k] / q) : (V)(0.0f);
                ST(out, first + k, g);
            }
            for (uint p = first + LAYOUT_PLANES_SCALE; p < out_planes; p++)
                ST(out, p, (V)(0.0f));
        }
}
