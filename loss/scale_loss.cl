// The scale regularizer: counts axes and needles that are too long, then computes their gradients.
//   in   params [groups][planes][16]
//        parts uchar [ny][nx], the grid of the ground: where it has LIMITED the limit is s_near,
//        elsewhere s_max; where it has FLAT Gaussians shall be flat, where it has LEVEL they
//        shall lie level
//        list [groups], if listed: which groups of params these are
//   mid  pieces [LAYOUT_LOSS_PIECES] counts and sums of a piece
//   out  extra [groups][LAYOUT_PLANES_GEOMETRY][16] or [groups][LAYOUT_PLANES_SHAPE][16]; every
//        plane is written, with 0 where nothing pulls
// Counts are integers over fixed pieces: the same input gives the same bits. Reference:
// scale_loss_ref_run. VW 16: a work-item has a piece, or LAYOUT_PROJECT_GROUPS groups. VW 1: a
// work-group has a piece, and its items take every LAYOUT_SCALE_ITEMSth Gaussian of it; for
// gradients an item has one Gaussian.
#define RATIO_EPS 1e-8f
#define SCALE_AHEAD 8
#define LIMITED 1 // enum scale_loss_part
#define FLAT 2
#define LEVEL 4

struct limits {
    float s_max, r_max;
    float s_near, corner_x, corner_y, per_m; // smaller limit, its grid; INFINITY: none
    uint nx, ny;
    __global const uchar *parts; // [ny][nx]
    float per_flat;              // 1 / flat_m, or 0
    float level;                 // weight of 1 - n_z^2, or 0
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
    for (uint k = 0; k < LAYOUT_PLANES_SHAPE; k++)
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

// The parts of the ground on which Gaussians lie: FLAT everywhere without a grid.
INLINE VI axes_parts(__global const float *g, VI real, const struct limits *l)
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

INLINE struct press axes_press(__global const float *g, VI real, const struct limits *l)
{
    struct press p = {(V)(0.0f), (V)(0.0f)};
    if (!(l->per_flat > 0.0f || l->level > 0.0f))
        return p;
    VI parts = axes_parts(g, real, l);
    p.per_flat = (parts & FLAT) != 0 ? (V)(l->per_flat) : (V)(0.0f);
    p.level = (parts & LEVEL) != 0 ? (V)(l->level) : (V)(0.0f);
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

// What is too long of one group (VW 1: of one Gaussian), added to what was found before.
struct found {
    VU n, m;
    V size, ratio, flat, tilt;
};

INLINE void axes_find(__global const float *g, const struct axes *a, VI real,
                      const struct limits *l, struct found *f)
{
    struct press p = axes_press(g, real, l);
    V thick = a->least * p.per_flat, s_max = axes_limit(g, a, real, l), d[4];
    if (l->per_flat > 0.0f)
        f->flat += log(1.0f + thick * thick);
    if (l->level > 0.0f) {
        V up = axes_upright(g, a, d);
        f->tilt += p.level > 0.0f ? 1.0f - up * up : (V)(0.0f);
    }
    for (uint k = 0; k < 3; k++) {
        VI over = real & (a->s[k] > s_max);
        f->n += over ? (VU)(1) : (VU)(0);
        f->size += over ? a->s[k] : (V)(0.0f);
    }
    VI needle = real & (a->ratio > l->r_max);
    f->m += needle ? (VU)(1) : (VU)(0);
    f->ratio += needle ? a->ratio : (V)(0.0f);
}

// The gradients of one group (Gaussian) into `out`. only: shapes are all that acts, `out` has those
// planes alone.
INLINE void axes_grad(__global const float *g, const struct axes *a, VI real,
                      const struct limits *l, float per_n, float per_m, float flat, uint only,
                      __global float *out)
{
    uint first = only ? 0 : LAYOUT_PLANE_SCALE; // plane of the first size
    uint out_planes = only ? LAYOUT_PLANES_SHAPE : LAYOUT_PLANES_GEOMETRY;
    struct press p = axes_press(g, real, l);
    V s_max = axes_limit(g, a, real, l);
    VI needle = real & (a->ratio > l->r_max), left = needle, also = needle, thin = real;
    V q = a->middle + RATIO_EPS, thick = a->least * p.per_flat, pull = thick * thick, d[4], up = 0;
    pull = flat * pull / (1.0f + pull);
    for (uint k = 0; k < first; k++)
        ST(out, k, (V)(0.0f));
    for (uint k = 0; k < 3; k++) {
        V h = (real & (a->s[k] > s_max)) ? per_n * a->s[k] : (V)(0.0f);
        VI is_largest = left & (a->s[k] == a->largest);
        left &= !is_largest; // the first of equals
        h += is_largest ? per_m * a->ratio : (V)(0.0f);
        VI is_middle = also & !is_largest & (a->s[k] == a->middle);
        also &= !is_middle;
        h -= is_middle ? per_m * a->ratio * (a->s[k] / q) : (V)(0.0f);
        VI is_least = thin & (a->s[k] == a->least);
        thin &= !is_least;
        h += is_least ? pull : (V)(0.0f);
        ST(out, first + k, h);
    }
    if (l->level > 0.0f)
        up = axes_upright(g, a, d);
    for (uint k = 0; k < 4; k++) {
        V h = l->level > 0.0f ? -2.0f * p.level * up * d[k] : (V)(0.0f);
        ST(out, first + LAYOUT_PLANES_SCALE + k, p.level > 0.0f ? h : (V)(0.0f));
    }
    for (uint k = first + LAYOUT_PLANES_SHAPE; k < out_planes; k++)
        ST(out, k, (V)(0.0f));
}

#define LIMITS_ARGS                                                                                \
    float s_max, float r_max, float s_near, float corner_x, float corner_y, float per_m, uint nx,  \
        uint ny, __global const uchar *parts, float per_flat, float level
#define LIMITS                                                                                     \
    {                                                                                              \
        s_max, r_max, s_near, corner_x, corner_y, per_m, nx, ny, parts, per_flat, level            \
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
    struct found f = {(VU)(0), (VU)(0), (V)(0.0f), (V)(0.0f), (V)(0.0f), (V)(0.0f)};
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
    pieces[item].flat = lanes_sum(f.flat);
    pieces[item].tilt = lanes_sum(f.tilt);
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
        axes_grad(g, &a, real, &l, per_long, per_needle, flat, only,
                  extra + group_at(group, only ? LAYOUT_PLANES_SHAPE : LAYOUT_PLANES_GEOMETRY));
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
    __local float size[ITEMS], ratio[ITEMS], flat[ITEMS], tilt[ITEMS];
    uint piece = (uint)get_group_id(0), lane = (uint)get_local_id(0);
    uint from = PIECE_FROM(piece, LAYOUT_LOSS_PIECES, groups) * LAYOUT_LANES,
         to = min(PIECE_FROM(piece + 1, LAYOUT_LOSS_PIECES, groups) * LAYOUT_LANES, n);
    struct found f = {0, 0, 0.0f, 0.0f, 0.0f, 0.0f};
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
    flat[lane] = f.flat;
    tilt[lane] = f.tilt;
    for (uint half_way = ITEMS / 2; half_way > 0; half_way /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < half_way) {
            all_n[lane] += all_n[lane + half_way];
            all_m[lane] += all_m[lane + half_way];
            size[lane] += size[lane + half_way];
            ratio[lane] += ratio[lane + half_way];
            flat[lane] += flat[lane + half_way];
            tilt[lane] += tilt[lane + half_way];
        }
    }
    if (lane == 0) {
        pieces[piece].n = all_n[0];
        pieces[piece].m = all_m[0];
        pieces[piece].size = size[0];
        pieces[piece].ratio = ratio[0];
        pieces[piece].flat = flat[0];
        pieces[piece].tilt = tilt[0];
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
        axes_grad(g, &a, i < n, &l, weight / ((float)all_n[0] + 1.0f),
                  weight / ((float)all_m[0] + 1.0f), flat, only,
                  extra + group_at(group, only ? LAYOUT_PLANES_SHAPE : LAYOUT_PLANES_GEOMETRY) +
                      in);
    }
}
#endif
