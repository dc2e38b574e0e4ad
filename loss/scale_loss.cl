// The scale regularizer: how many axes and needles are too long, then their gradients.
//   in   params [groups][planes][16]
//   mid  pieces [SCALE_PIECES] counts and sums of a piece
//   out  extra [groups][11][16] or [groups][3][16], every plane written, 0 where nothing is wrong
// Counts are whole numbers over fixed pieces: same input, same bits. Reference: scale_loss_ref_run.
#define SCALE_PIECES 256
#define RATIO_EPS 1e-8f
#define SCALE_AHEAD 8

struct scale_piece {
    uint n, m; // axes longer than s_max, Gaussians with a ratio above r_max
    float size, ratio;
};

struct axes { // sigmas, and the ratio of the largest to the middle one
    V s[3], largest, middle, ratio;
};

// Groups lie further apart than the hardware looks ahead.
inline void axes_ahead(__global const float *params, uint group, uint planes)
{
    for (uint k = 3; k < 6; k++)
        PREFETCH(params + ((size_t)group * planes + k) * LAYOUT_LANES);
}

inline void axes_load(__global const float *g, struct axes *a)
{
    for (uint k = 0; k < 3; k++)
        a->s[k] = exp(LD(g, 3 + k));
    V ab = MIN_(a->s[0], a->s[1]), top = MAX_(a->s[0], a->s[1]), below = MIN_(top, a->s[2]);
    a->largest = MAX_(top, a->s[2]);
    a->middle = MAX_(ab, below);
    a->ratio = a->largest / (a->middle + RATIO_EPS);
}

__kernel void scale_count(__global const float *params, uint n, uint planes, uint groups,
                          float s_max, float r_max, __global struct scale_piece *pieces)
{
    uint item = (uint)get_global_id(0);
    if (item >= SCALE_PIECES)
        return;
    uint from = PIECE_FROM(item, SCALE_PIECES, groups),
         to = PIECE_FROM(item + 1, SCALE_PIECES, groups);
    VU count_n = (VU)(0), count_m = (VU)(0);
    V size = (V)(0.0f), ratio = (V)(0.0f);
    for (uint group = from; group < to; group++)
        LANES_EACH(lane)
        {
            struct axes a;
            VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
            axes_ahead(params, min(group + SCALE_AHEAD, groups - 1), planes);
            axes_load(params + (size_t)group * planes * LAYOUT_LANES + lane, &a);
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

inline struct scale_piece scale_total(__global const struct scale_piece *pieces)
{
    struct scale_piece t = {0, 0, 0.0f, 0.0f};
    for (uint i = 0; i < SCALE_PIECES; i++) {
        t.n += pieces[i].n;
        t.m += pieces[i].m;
    }
    return t;
}

// only: sizes are all that acts, out is float [groups][3][16].
__kernel void scale_grad(__global const float *params, uint n, uint planes, uint groups,
                         float s_max, float r_max, float weight,
                         __global const struct scale_piece *pieces, uint only,
                         __global float *extra)
{
    uint item = (uint)get_global_id(0), from = item * LAYOUT_PROJECT_GROUPS,
         to = min(from + LAYOUT_PROJECT_GROUPS, groups);
    struct scale_piece total = scale_total(pieces);
    float per_n = weight / ((float)total.n + 1.0f), per_m = weight / ((float)total.m + 1.0f);
    for (uint group = from; group < to; group++)
        LANES_EACH(lane)
        {
            struct axes a;
            uint first = only ? 0 : 3; // plane of the first size
            __global float *out = extra + (size_t)group * (only ? 3 : 11) * LAYOUT_LANES + lane;
            VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
            axes_ahead(params, min(group + SCALE_AHEAD, groups - 1), planes);
            axes_load(params + (size_t)group * planes * LAYOUT_LANES + lane, &a);
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
            for (uint p = 6; p < 11 && !only; p++)
                ST(out, p, (V)(0.0f));
        }
}
