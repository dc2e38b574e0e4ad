// The scale regularizer: counts axes and needles that are too long, then computes their gradients.
//   in   params [groups][planes][16]
//        parts uchar [ny][nx], the grid of the ground: where it has LIMITED the limit is s_near,
//        elsewhere s_max; where it has FLAT Gaussians shall be flat
//        list [groups], if listed: which groups of params these are
//   mid  pieces [LAYOUT_LOSS_PIECES] counts and sums of a piece
//   out  extra [groups][LAYOUT_PLANES_GEOMETRY][16] or [groups][LAYOUT_PLANES_SCALE][16]; every
//        plane is written, with 0 where nothing pulls
// Counts are integers over fixed pieces: the same input gives the same bits. Reference:
// scale_loss_ref_run. VW 16: a work-item has a piece, or LAYOUT_PROJECT_GROUPS groups. VW 1: a
// work-group has a piece, and its items take every LAYOUT_SCALE_ITEMSth Gaussian of it; for
// gradients an item has one Gaussian.
#define RATIO_EPS 1e-8f
#define SCALE_AHEAD 8
#define LIMITED 1 // enum scale_loss_part
#define FLAT 2

struct limits {
    float s_max, r_max;
    float s_near, corner_x, corner_y, per_m; // smaller limit, its grid; INFINITY: none
    uint nx, ny;
    __global const uchar *parts; // [ny][nx]
    float per_flat;              // 1 / flat_m, or 0
};

struct axes { // sigmas, and the ratio of the largest to the middle one
    V s[3], largest, middle, least, ratio;
};

#if VW == 16
// Which group of params that is. Groups lie further apart than the hardware looks ahead.
inline uint axes_group(__global const float *params, uint group, uint groups, uint planes,
                       __global const uint *list, uint listed)
{
    uint next = min(group + SCALE_AHEAD, groups - 1), ahead = listed ? list[next] : next;
    for (uint k = 0; k < LAYOUT_PLANES_SCALE; k++)
        PREFETCH(params + group_at(ahead, planes) + (LAYOUT_PLANE_SCALE + k) * LAYOUT_LANES);
    return listed ? list[group] : group;
}
#endif

inline void axes_load(__global const float *g, struct axes *a)
{
    for (uint k = 0; k < 3; k++)
        a->s[k] = exp(LD(g, LAYOUT_PLANE_SCALE + k));
    V ab = MIN_(a->s[0], a->s[1]), top = MAX_(a->s[0], a->s[1]), below = MIN_(top, a->s[2]);
    a->largest = MAX_(top, a->s[2]);
    a->middle = MAX_(ab, below);
    a->least = MIN_(ab, a->s[2]);
    a->ratio = a->largest / (a->middle + RATIO_EPS);
}

inline float limit_at(const struct limits *l, float x, float y)
{
    float column = floor((x - l->corner_x) * l->per_m), row = floor((y - l->corner_y) * l->per_m);
    if (!(column >= 0.0f && row >= 0.0f && column < (float)l->nx && row < (float)l->ny))
        return l->s_max;
    uint part = l->parts[(uint)row * l->nx + (uint)column];
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

// All bits where Gaussians shall be flat: everywhere without a grid.
INLINE VI axes_over_flat(__global const float *g, VI real, const struct limits *l)
{
    V column = floor((LD(g, LAYOUT_PLANE_MEAN) - l->corner_x) * l->per_m),
      row = floor((LD(g, LAYOUT_PLANE_MEAN + 1) - l->corner_y) * l->per_m);
    VI known =
        real & (column >= 0.0f) & (row >= 0.0f) & (column < (float)l->nx) & (row < (float)l->ny);
    if (!l->nx)
        return real;
#if VW == 16
    int at[VW], is[VW], out[VW];
    vstore16(known ? TO_VI(row) * (int)l->nx + TO_VI(column) : (VI)(0), 0, at);
    vstore16(known, 0, is);
    for (uint i = 0; i < VW; i++)
        out[i] = is[i] && (l->parts[at[i]] & FLAT) ? -1 : 0;
    return vload16(0, out);
#else
    return known && (l->parts[(uint)row * l->nx + (uint)column] & FLAT);
#endif
}

// 1 / flat_m where Gaussians shall be flat, 0 elsewhere.
INLINE V axes_flat(__global const float *g, VI real, const struct limits *l)
{
    if (!(l->per_flat > 0.0f))
        return (V)(0.0f);
    return axes_over_flat(g, real, l) ? (V)(l->per_flat) : (V)(0.0f);
}

// What is too long of one group (VW 1: of one Gaussian), added to what was found before.
struct found {
    VU n, m;
    V size, ratio, flat;
};

INLINE void axes_find(const struct axes *a, VI real, V s_max, float r_max, V per_flat,
                      struct found *f)
{
    V thick = a->least * per_flat;
    f->flat += log(1.0f + thick * thick);
    for (uint k = 0; k < 3; k++) {
        VI over = real & (a->s[k] > s_max);
        f->n += over ? (VU)(1) : (VU)(0);
        f->size += over ? a->s[k] : (V)(0.0f);
    }
    VI needle = real & (a->ratio > r_max);
    f->m += needle ? (VU)(1) : (VU)(0);
    f->ratio += needle ? a->ratio : (V)(0.0f);
}

// The gradients of one group (Gaussian) into `out`. only: sizes are all that acts, `out` has those
// planes alone.
INLINE void axes_grad(const struct axes *a, VI real, V s_max, float r_max, float per_n, float per_m,
                      float flat, V per_flat, uint only, __global float *out)
{
    uint first = only ? 0 : LAYOUT_PLANE_SCALE; // plane of the first size
    uint out_planes = only ? LAYOUT_PLANES_SCALE : LAYOUT_PLANES_GEOMETRY;
    VI needle = real & (a->ratio > r_max), left = needle, also = needle, thin = real;
    V q = a->middle + RATIO_EPS, thick = a->least * per_flat, pull = thick * thick;
    pull = flat * pull / (1.0f + pull);
    for (uint p = 0; p < first; p++)
        ST(out, p, (V)(0.0f));
    for (uint k = 0; k < 3; k++) {
        V g = (real & (a->s[k] > s_max)) ? per_n * a->s[k] : (V)(0.0f);
        VI is_largest = left & (a->s[k] == a->largest);
        left &= !is_largest; // the first of equals
        g += is_largest ? per_m * a->ratio : (V)(0.0f);
        VI is_middle = also & !is_largest & (a->s[k] == a->middle);
        also &= !is_middle;
        g -= is_middle ? per_m * a->ratio * (a->s[k] / q) : (V)(0.0f);
        VI is_least = thin & (a->s[k] == a->least);
        thin &= !is_least;
        g += is_least ? pull : (V)(0.0f);
        ST(out, first + k, g);
    }
    for (uint p = first + LAYOUT_PLANES_SCALE; p < out_planes; p++)
        ST(out, p, (V)(0.0f));
}

#define LIMITS_ARGS                                                                                \
    float s_max, float r_max, float s_near, float corner_x, float corner_y, float per_m, uint nx,  \
        uint ny, __global const uchar *parts, float per_flat
#define LIMITS                                                                                     \
    {                                                                                              \
        s_max, r_max, s_near, corner_x, corner_y, per_m, nx, ny, parts, per_flat                   \
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
    struct found f = {(VU)(0), (VU)(0), (V)(0.0f), (V)(0.0f), (V)(0.0f)};
    const struct limits l = LIMITS;
    for (uint group = from; group < to; group++) {
        struct axes a;
        uint own = axes_group(params, group, groups, planes, list, listed);
        __global const float *g = params + group_at(own, planes);
        VI real = LANE + (int)(group * LAYOUT_LANES) < (int)n;
        axes_load(g, &a);
        axes_find(&a, real, axes_limit(g, &a, real, &l), r_max, axes_flat(g, real, &l), &f);
    }
    pieces[item].n = lanes_add(f.n);
    pieces[item].m = lanes_add(f.m);
    pieces[item].size = lanes_sum(f.size);
    pieces[item].ratio = lanes_sum(f.ratio);
    pieces[item].flat = lanes_sum(f.flat);
}

__kernel void scale_grad(__global const float *params, uint n, uint planes, uint groups,
                         LIMITS_ARGS, float weight, float flat,
                         __global const struct layout_scale_piece *pieces, uint only,
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
        axes_grad(&a, real, axes_limit(g, &a, real, &l), r_max, per_long, per_needle, flat,
                  axes_flat(g, real, &l), only,
                  extra + group_at(group, only ? LAYOUT_PLANES_SCALE : LAYOUT_PLANES_GEOMETRY));
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
    __local float size[ITEMS], ratio[ITEMS], flat[ITEMS];
    uint piece = (uint)get_group_id(0), lane = (uint)get_local_id(0);
    uint from = PIECE_FROM(piece, LAYOUT_LOSS_PIECES, groups) * LAYOUT_LANES,
         to = min(PIECE_FROM(piece + 1, LAYOUT_LOSS_PIECES, groups) * LAYOUT_LANES, n);
    struct found f = {0, 0, 0.0f, 0.0f, 0.0f};
    const struct limits l = LIMITS;
    for (uint i = from + lane; i < to; i += ITEMS) {
        struct axes a;
        uint group = i / LAYOUT_LANES, own = listed ? list[group] : group;
        __global const float *g = params + group_at(own, planes) + i % LAYOUT_LANES;
        axes_load(g, &a);
        axes_find(&a, 1, axes_limit(g, &a, 1, &l), r_max, axes_flat(g, 1, &l), &f);
    }
    all_n[lane] = f.n;
    all_m[lane] = f.m;
    size[lane] = f.size;
    ratio[lane] = f.ratio;
    flat[lane] = f.flat;
    for (uint half_way = ITEMS / 2; half_way > 0; half_way /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < half_way) {
            all_n[lane] += all_n[lane + half_way];
            all_m[lane] += all_m[lane + half_way];
            size[lane] += size[lane + half_way];
            ratio[lane] += ratio[lane + half_way];
            flat[lane] += flat[lane + half_way];
        }
    }
    if (lane == 0) {
        pieces[piece].n = all_n[0];
        pieces[piece].m = all_m[0];
        pieces[piece].size = size[0];
        pieces[piece].ratio = ratio[0];
        pieces[piece].flat = flat[0];
    }
}

__kernel GROUP void scale_grad(__global const float *params, uint n, uint planes, uint groups,
                               LIMITS_ARGS, float weight, float flat,
                               __global const struct layout_scale_piece *pieces, uint only,
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
        axes_grad(&a, i < n, axes_limit(g, &a, i < n, &l), r_max, weight / ((float)all_n[0] + 1.0f),
                  weight / ((float)all_m[0] + 1.0f), flat, axes_flat(g, i < n, &l), only,
                  extra + group_at(group, only ? LAYOUT_PLANES_SCALE : LAYOUT_PLANES_GEOMETRY) +
                      in);
    }
}
#endif
