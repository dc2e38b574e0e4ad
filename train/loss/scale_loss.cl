// The loss on sizes: counts axes and needles that are too long, then computes their gradients.
//   in   params [groups][planes][16]
//        parts uchar [ny][nx], the grid of the ground: where it has LIMITED the limit is s_near,
//        elsewhere s_max
//        list [groups], if listed: which groups of params these are
//   mid  pieces [LAYOUT_LOSS_PIECES] counts and sums of a piece
//   out  extra [groups][LAYOUT_PLANES_SCALE][16]; if fresh every plane is written
// Counts are integers over fixed pieces: the same input gives the same bits. Reference:
// scale_loss_ref_run. VW 16: a work-item has a piece, or LAYOUT_PROJECT_GROUPS groups. VW 1: a
// work-group has a piece, and its items take every LAYOUT_SCALE_ITEMSth Gaussian of it; for
// gradients an item has one Gaussian.

struct limits {
    float s_max, r_max, s_near; // s_near: the smaller limit; INFINITY: none
    struct ground ground;
};

inline float limit_at(const struct limits *l, float x, float y)
{
    const struct ground *g = &l->ground;
    float column = floor((x - g->corner_x) * g->per_m), row = floor((y - g->corner_y) * g->per_m);
    if (!(column >= 0.0f && row >= 0.0f && column < (float)g->nx && row < (float)g->ny))
        return l->s_max;
    uint part = g->parts[(uint)row * g->nx + (uint)column];
    return part & LIMITED ? min(l->s_near, l->s_max) : l->s_max;
}

// The limit of each: few are so long that the grid is asked.
INLINE V axes_limit(__global const float *g, const struct axes *a, VI real, const struct limits *l)
{
    V limit = (V)(l->s_max);
    VI ask = real & (a->largest > l->s_near);
#if VW == 16
    if (any(ask)) {
        int asks[VW];
        float out[VW];
        vstore16(ask, 0, asks);
        for (uint i = 0; i < VW; i++)
            out[i] = asks[i] ? limit_at(l, g[LAYOUT_PLANE_MEAN * LAYOUT_LANES + i],
                                        g[(LAYOUT_PLANE_MEAN + 1) * LAYOUT_LANES + i])
                             : l->s_max;
        limit = vload16(0, out);
    }
#else
    if (ask)
        limit = limit_at(l, LD(g, LAYOUT_PLANE_MEAN), LD(g, LAYOUT_PLANE_MEAN + 1));
#endif
    return limit;
}

// What is too long of one group (VW 1: of one Gaussian), added to what was found before.
struct found {
    VU n, m;
    V size, ratio;
};

INLINE void axes_find(__global const float *g, const struct axes *a, VI real,
                      const struct limits *l, struct found *f)
{
    V s_max = axes_limit(g, a, real, l);
    for (uint k = 0; k < 3; k++) {
        VI over = real & (a->s[k] > s_max);
        f->n += over ? (VU)(1) : (VU)(0);
        f->size += over ? a->s[k] : (V)(0.0f);
    }
    VI needle = real & (a->ratio > l->r_max);
    f->m += needle ? (VU)(1) : (VU)(0);
    f->ratio += needle ? a->ratio : (V)(0.0f);
}

// The gradients of one group (Gaussian) into `out`.
INLINE void axes_grad(__global const float *g, const struct axes *a, VI real,
                      const struct limits *l, float per_n, float per_m, uint fresh,
                      __global float *out)
{
    V s_max = axes_limit(g, a, real, l), q = a->middle + RATIO_EPS;
    VI needle = real & (a->ratio > l->r_max), left = needle, also = needle;
    for (uint k = 0; k < 3; k++) {
        V h = (real & (a->s[k] > s_max)) ? per_n * a->s[k] : (V)(0.0f);
        VI is_largest = left & (a->s[k] == a->largest);
        left &= !is_largest; // the first of equals
        h += is_largest ? per_m * a->ratio : (V)(0.0f);
        VI is_middle = also & !is_largest & (a->s[k] == a->middle);
        also &= !is_middle;
        h -= is_middle ? per_m * a->ratio * (a->s[k] / q) : (V)(0.0f);
        axes_store(out, k, h, fresh);
    }
}

#define LIMITS_ARGS float s_max, float r_max, float s_near, GROUND_ARGS
#define LIMITS                                                                                     \
    {                                                                                              \
        s_max, r_max, s_near, GROUND                                                               \
    }

#if VW == 16
__kernel void scale_count(__global const float *params, uint n, uint planes, uint groups,
                          LIMITS_ARGS, __global struct layout_scale_piece *pieces,
                          __global const uint *list, uint listed)
{
    uint item = (uint)get_global_id(0);
    if (item >= LAYOUT_LOSS_PIECES)
        return;
    uint from = PIECE_FROM(item, LAYOUT_LOSS_PIECES, groups),
         to = PIECE_FROM(item + 1, LAYOUT_LOSS_PIECES, groups);
    struct found f = {(VU)(0), (VU)(0), (V)(0.0f), (V)(0.0f)};
    const struct limits l = LIMITS;
    for (uint group = from; group < to; group++) {
        struct axes a;
        uint own = axes_group(params, group, groups, planes, list, listed);
        __global const float *g = params + group_at(own, planes);
        VI real = LANE + (int)(group * LAYOUT_LANES) < (int)n;
        axes_load(g, &a);
        axes_find(g, &a, real, &l, &f);
    }
    pieces[item].n = lanes_add(f.n);
    pieces[item].m = lanes_add(f.m);
    pieces[item].size = lanes_sum(f.size);
    pieces[item].ratio = lanes_sum(f.ratio);
}

__kernel void scale_grad(__global const float *params, uint n, uint planes, uint groups,
                         LIMITS_ARGS, float weight,
                         __global const struct layout_scale_piece *pieces, uint fresh,
                         __global float *extra, __global const uint *list, uint listed)
{
    uint item = (uint)get_global_id(0), from = item * LAYOUT_PROJECT_GROUPS,
         to = min(from + LAYOUT_PROJECT_GROUPS, groups), all_n = 0, all_m = 0;
    for (uint i = 0; i < LAYOUT_LOSS_PIECES; i++) {
        all_n += pieces[i].n;
        all_m += pieces[i].m;
    }
    float per_long = weight / ((float)all_n + 1.0f), per_needle = weight / ((float)all_m + 1.0f);
    const struct limits l = LIMITS;
    for (uint group = from; group < to; group++) {
        struct axes a;
        uint own = axes_group(params, group, groups, planes, list, listed);
        __global const float *g = params + group_at(own, planes);
        VI real = LANE + (int)(group * LAYOUT_LANES) < (int)n;
        axes_load(g, &a);
        axes_grad(g, &a, real, &l, per_long, per_needle, fresh,
                  extra + group_at(group, LAYOUT_PLANES_SCALE));
    }
}
#else
#define ITEMS LAYOUT_SCALE_ITEMS
#define GROUP __attribute__((reqd_work_group_size(ITEMS, 1, 1)))

__kernel GROUP void scale_count(__global const float *params, uint n, uint planes, uint groups,
                                LIMITS_ARGS, __global struct layout_scale_piece *pieces,
                                __global const uint *list, uint listed)
{
    __local uint all_n[ITEMS], all_m[ITEMS];
    __local float size[ITEMS], ratio[ITEMS];
    uint piece = (uint)get_group_id(0), lane = (uint)get_local_id(0);
    uint from = PIECE_FROM(piece, LAYOUT_LOSS_PIECES, groups) * LAYOUT_LANES,
         to = min(PIECE_FROM(piece + 1, LAYOUT_LOSS_PIECES, groups) * LAYOUT_LANES, n);
    struct found f = {0, 0, 0.0f, 0.0f};
    const struct limits l = LIMITS;
    for (uint i = from + lane; i < to; i += ITEMS) {
        struct axes a;
        uint group = i / LAYOUT_LANES, own = listed ? list[group] : group;
        __global const float *g = params + group_at(own, planes) + i % LAYOUT_LANES;
        axes_load(g, &a);
        axes_find(g, &a, 1, &l, &f);
    }
    all_n[lane] = f.n;
    all_m[lane] = f.m;
    size[lane] = f.size;
    ratio[lane] = f.ratio;
    for (uint half_way = ITEMS / 2; half_way > 0; half_way /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < half_way) {
            all_n[lane] += all_n[lane + half_way];
            all_m[lane] += all_m[lane + half_way];
            size[lane] += size[lane + half_way];
            ratio[lane] += ratio[lane + half_way];
        }
    }
    if (lane == 0) {
        pieces[piece].n = all_n[0];
        pieces[piece].m = all_m[0];
        pieces[piece].size = size[0];
        pieces[piece].ratio = ratio[0];
    }
}

__kernel GROUP void scale_grad(__global const float *params, uint n, uint planes, uint groups,
                               LIMITS_ARGS, float weight,
                               __global const struct layout_scale_piece *pieces, uint fresh,
                               __global float *extra, __global const uint *list, uint listed)
{
    __local uint all_n[ITEMS], all_m[ITEMS];
    uint i = (uint)get_global_id(0), lane = (uint)get_local_id(0);
    uint sum_n = 0, sum_m = 0;
    const struct limits l = LIMITS;
    for (uint k = lane; k < LAYOUT_LOSS_PIECES; k += ITEMS) {
        sum_n += pieces[k].n;
        sum_m += pieces[k].m;
    }
    all_n[lane] = sum_n;
    all_m[lane] = sum_m;
    for (uint half_way = ITEMS / 2; half_way > 0; half_way /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < half_way) {
            all_n[lane] += all_n[lane + half_way];
            all_m[lane] += all_m[lane + half_way];
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (i < groups * LAYOUT_LANES) {
        struct axes a;
        uint group = i / LAYOUT_LANES, in = i % LAYOUT_LANES;
        __global const float *g = params + group_at(listed ? list[group] : group, planes) + in;
        axes_load(g, &a);
        axes_grad(g, &a, i < n, &l, weight / ((float)all_n[0] + 1.0f),
                  weight / ((float)all_m[0] + 1.0f), fresh,
                  extra + group_at(group, LAYOUT_PLANES_SCALE) + in);
    }
}
#endif
