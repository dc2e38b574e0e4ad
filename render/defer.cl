// Stage: defer. Which groups a view may show, and the steps of Adam that groups are owed: see
// render/defer.h.
//   table [rows][LAYOUT_DEFER_ROW]: row s - base has W_s, one a learning rate, and how far momentum
//         can go from step s on; row k has beta1^k and beta2^k

// Lanes of a group, or of 16 groups, one by one where V is one of them.
#if VW == 16
#define DEFER_EACH(lane) for (uint lane = 0; lane < 1; lane++)

INLINE float defer_most(V x)
{
    float8 a = MAX_(x.lo, x.hi);
    float4 b = MAX_(a.lo, a.hi);
    float2 c = MAX_(b.lo, b.hi);
    return MAX_(c.x, c.y);
}
#else
#define DEFER_EACH(lane) for (uint lane = 0; lane < LAYOUT_LANES; lane++)

INLINE float defer_most(V x)
{
    return x;
}
#endif

// One side of the picture: whether a group lies beyond it altogether. (n, d) is 0 on the plane
// through the eye and that side and grows to the inside, w is how far a reach of 1 m reaches there.
struct side {
    float n[3], d, w;
};

INLINE struct side defer_side(__constant struct layout_view *v, float x, float y, float z, float w)
{
    struct side s;
    for (uint k = 0; k < 3; k++)
        s.n[k] = x * v->rot[k] + (y * v->rot[3 + k] + z * v->rot[6 + k]);
    s.d = x * v->trans[0] + (y * v->trans[1] + z * v->trans[2]);
    s.w = w;
    return s;
}

INLINE VI defer_beyond(const struct side *s, __global const float *b)
{
    V most = s->d + s->w * LD(b, 6);
    for (uint k = 0; k < 3; k++)
        most += s->n[k] * LD(b, k) + fabs(s->n[k]) * LD(b, 3 + k);
    return most <= 0.0f;
}

// The mask of groups that reach into the picture: of all that NaN is in, too. A splat reaches as
// far on the picture as its Gaussian in space times sqrt(1 + lim^2) at most (seen_ellipse), and the
// kernel's own width more.
INLINE VI defer_in_view(__constant struct layout_view *v, __global const float *b)
{
    float pad = LAYOUT_DEFER_SIGMAS * sqrt(v->kernel_px2) + 1.0f;
    float lx = max(v->lim_neg_x, v->lim_pos_x), ly = max(v->lim_neg_y, v->lim_pos_y);
    float wx = 1.001f * v->fx * sqrt(1.0f + lx * lx), wy = 1.001f * v->fy * sqrt(1.0f + ly * ly);
    struct side front = defer_side(v, 0.0f, 0.0f, 1.0f, 1.0f),
                left = defer_side(v, v->fx, 0.0f, v->cx + pad, wx),
                right = defer_side(v, -v->fx, 0.0f, (float)v->width - v->cx + pad, wx),
                top = defer_side(v, 0.0f, v->fy, v->cy + pad, wy),
                bottom = defer_side(v, 0.0f, -v->fy, (float)v->height - v->cy + pad, wy);
    return !(defer_beyond(&front, b) | defer_beyond(&left, b) | defer_beyond(&right, b) |
             defer_beyond(&top, b) | defer_beyond(&bottom, b));
}

// The mask of those of 16 groups, or of one, that a view may show. The first is always listed: a
// frame of nothing is no frame.
INLINE VI defer_seen(__constant struct layout_view *v, __global const float *bounds, uint first,
                     uint groups)
{
    VI at = LANE + (int)first;
    return (at < (int)groups) &
           (defer_in_view(v, bounds + group_at(first / LAYOUT_LANES, LAYOUT_DEFER_BOUND) +
                                 first % LAYOUT_LANES) |
            (at == 0));
}

#define DEFER_FROM(i, n) ((uint)((ulong)(i) * (n) / LAYOUT_DEFER_CHUNKS))

// counts [LAYOUT_DEFER_CHUNKS + 1]: groups listed of each chunk; whether the last group is
__kernel void defer_count(__constant struct layout_view *view, __global const float *bounds,
                          uint groups, __global uint *counts)
{
    uint chunk = (uint)get_global_id(0), vectors = (groups + LAYOUT_LANES - 1) / LAYOUT_LANES;
    if (chunk >= LAYOUT_DEFER_CHUNKS)
        return;
    uint n = 0;
    for (uint i = DEFER_FROM(chunk, vectors); i < DEFER_FROM(chunk + 1, vectors); i++)
        DEFER_EACH(lane)
        {
            uint first = i * LAYOUT_LANES + lane;
            VI seen = defer_seen(view, bounds, first, groups);
            n += lanes_count(seen);
            if (i + 1 == vectors && first / LAYOUT_LANES == (groups - 1) / LAYOUT_LANES) {
                VI last = seen & (LANE + (int)first == (int)groups - 1);
                if (VW == 16 || first == groups - 1)
                    counts[LAYOUT_DEFER_CHUNKS] = lanes_count(last);
            }
        }
    counts[chunk] = n;
}

// list: the groups that defer_count counted, ascending
__kernel void defer_list(__constant struct layout_view *view, __global const float *bounds,
                         uint groups, __global const uint *counts, __global uint *list)
{
    uint chunk = (uint)get_global_id(0), vectors = (groups + LAYOUT_LANES - 1) / LAYOUT_LANES;
    if (chunk >= LAYOUT_DEFER_CHUNKS)
        return;
    uint to = 0;
    for (uint i = 0; i < chunk; i++)
        to += counts[i];
    for (uint i = DEFER_FROM(chunk, vectors); i < DEFER_FROM(chunk + 1, vectors); i++)
        DEFER_EACH(lane)
        {
            uint first = i * LAYOUT_LANES + lane;
            VI seen = defer_seen(view, bounds, first, groups);
#if VW == 16
            int is[VW];
            if (!ANY(seen))
                continue;
            vstore16(seen, 0, is);
            for (uint k = 0; k < VW; k++) {
                if (is[k])
                    list[to++] = first + k;
            }
#else
            if (seen)
                list[to++] = first;
#endif
        }
}

// One kind of planes: [from, to) of a group.
struct owed {
    __global float *p;
    __global uint *moments;
    float decay1, decay2, eps;
    bool keeps; // moments are stored, too
    VU key;     // by which they are rounded: adam.cl
};

INLINE V owed_plane(const struct owed *o, uint plane, float w, VI real)
{
    VU was = LD_WORD(o->moments, plane);
    V p = LD(o->p, plane), m1 = adam_first(was), m2 = adam_second(was);
    V q = p - w * (m1 / (sqrt(m2) + o->eps));
    if (o->keeps)
        ST_WORD(o->moments, plane,
                real ? adam_word(o->key, plane, o->decay1 * m1, o->decay2 * m2) : was);
    return real ? q : p;
}

// Steps that were owed up to `to`, of `groups` groups of a list, or of [from, groups) of all. The
// moments of listed groups are left to project_step, which passes them through memory anyway.
__kernel void defer_settle(__global const uint *list, uint listed, uint from, uint groups, uint n,
                           uint planes, uint to, uint base, float eps, float scale_log_min,
                           float scale_log_max, __global const uint *settled,
                           __global const float *table, __global float *params,
                           __global uint *moments)
{
    uint id = (uint)get_global_id(0);
#if VW == 16
    uint lane = 0, first = from + id * LAYOUT_PROJECT_GROUPS,
         end = min(first + LAYOUT_PROJECT_GROUPS, groups);
#else
    uint lane = id % LAYOUT_LANES, first = from + id / LAYOUT_LANES, end = min(first + 1, groups);
#endif
    for (uint i = first; i < end; i++) {
        uint group = listed ? list[i] : i, since = settled[group];
        if (since >= to)
            continue;
        size_t at = group_at(group, planes) + lane;
        VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
        __global const float *w = table + (size_t)(since - base) * LAYOUT_DEFER_ROW,
                             *k = table + (size_t)(to - since) * LAYOUT_DEFER_ROW;
        struct owed o = {params + at,
                         moments + at,
                         k[LAYOUT_DEFER_DECAY],
                         k[LAYOUT_DEFER_DECAY + 1],
                         eps,
                         !listed,
                         adam_key(group * LAYOUT_LANES + lane, to)};
        for (uint p = 0; p < planes; p++) {
            uint rate = p < LAYOUT_PLANE_SCALE     ? LAYOUT_DEFER_MEAN
                        : p < LAYOUT_PLANE_QUAT    ? LAYOUT_DEFER_SCALE
                        : p < LAYOUT_PLANE_OPACITY ? LAYOUT_DEFER_QUAT
                        : p < LAYOUT_PLANE_SH      ? LAYOUT_DEFER_OPACITY
                        : p < LAYOUT_PLANE_SH + 3  ? LAYOUT_DEFER_SH_DC
                                                   : LAYOUT_DEFER_SH_REST;
            V q = owed_plane(&o, p, w[rate], real);
            if (rate == LAYOUT_DEFER_SCALE) {
                V cut = CLAMP_(q, scale_log_min, scale_log_max);
                q = real ? cut : q;
            }
            ST(o.p, p, q);
        }
    }
}

// How far momentum can take plane `plane` until the group is in view again, in units of its rate.
INLINE V defer_speed(__global const uint *moments, uint plane, float eps)
{
    VU word = LD_WORD(moments, plane);
    return fabs(adam_first(word)) / (sqrt(adam_second(word)) + eps);
}

// How far a Gaussian then reaches from its mean, m: where its alpha falls below 1/255.
INLINE V defer_reach(__global const float *g, __global const uint *moments,
                     __global const float *row, float eps)
{
    V wide = (V)(-1e30f);
    for (uint k = LAYOUT_PLANE_SCALE; k < LAYOUT_PLANE_SCALE + 3; k++) {
        V s = LD(g, k) + row[LAYOUT_DEFER_DRIFT + 1] * defer_speed(moments, k, eps);
        wide = MAX_(s, wide);
    }
    V sigma = exp(wide);
    V logit = LD(g, LAYOUT_PLANE_OPACITY) +
              row[LAYOUT_DEFER_DRIFT + 2] * defer_speed(moments, LAYOUT_PLANE_OPACITY, eps);
    V over = log(256.0f / (1.0f + exp(-logit))); // a little more than 255
    return sqrt(2.0f * MAX_(over, 0.01f)) * sigma;
}

#if VW == 16
#define BOUND_AHEAD 2

// Asks for what defer_bound reads of a group: a line each of planes that the hardware does not see
// coming, because groups lie far apart.
INLINE void defer_ask(__global const float *g, __global const uint *moments)
{
    for (uint k = LAYOUT_PLANE_MEAN; k < LAYOUT_PLANE_SCALE + 3; k++) {
        PREFETCH(g + k * LAYOUT_LANES);
        PREFETCH(moments + k * LAYOUT_LANES);
    }
    PREFETCH(g + LAYOUT_PLANE_OPACITY * LAYOUT_LANES);
    PREFETCH(moments + LAYOUT_PLANE_OPACITY * LAYOUT_LANES);
}
#endif

// Where the groups of a list, or [from, groups) of all, can draw. step: it was just made; 0:
// settled says.
__kernel void defer_bound(__global const uint *list, uint listed, uint from, uint groups, uint n,
                          uint planes, uint step, uint base, float eps, __global const float *table,
                          __global const float *params, __global const uint *moments,
                          __global uint *settled, __global float *bounds)
{
    uint id = (uint)get_global_id(0);
#if VW == 16
    uint first = from + id * LAYOUT_PROJECT_GROUPS,
         end = min(first + LAYOUT_PROJECT_GROUPS, groups);
#else
    uint first = from + id, end = min(first + 1, groups);
#endif
    for (uint i = first; i < end; i++) {
        uint group = listed ? list[i] : i, last = step ? step : settled[group];
        size_t at = group_at(group, planes);
        __global const float *row = table + (size_t)(last - base) * LAYOUT_DEFER_ROW;
        __global float *b =
            bounds + group_at(group / LAYOUT_LANES, LAYOUT_DEFER_BOUND) + group % LAYOUT_LANES;
        V lo[3], hi[3], most = (V)(0.0f);
#if VW == 16
        uint next = min(i + BOUND_AHEAD, end - 1);
        size_t ahead = group_at(listed ? list[next] : next, planes);
        defer_ask(params + ahead, moments + ahead);
#endif
        for (uint k = 0; k < 3; k++)
            lo[k] = hi[k] = (V)(-1e30f); // lo: of the negative
        DEFER_EACH(lane)
        {
            size_t own = at + lane;
            VI real = LANE + (int)(group * LAYOUT_LANES + lane) < (int)n;
            for (uint k = 0; k < 3; k++) {
                V x = LD(params + own, LAYOUT_PLANE_MEAN + k),
                  drift = row[LAYOUT_DEFER_DRIFT] *
                          defer_speed(moments + own, LAYOUT_PLANE_MEAN + k, eps);
                V below = drift - x, above = drift + x;
                lo[k] = (real & (below > lo[k])) ? below : lo[k];
                hi[k] = (real & (above > hi[k])) ? above : hi[k];
            }
            V reach = defer_reach(params + own, moments + own, row, eps);
            reach = reach < 1e30f ? reach : (V)(1e30f); // NaN, too
            most = (real & (reach > most)) ? reach : most;
        }
        for (uint k = 0; k < 3; k++) {
            float below = -defer_most(lo[k]), above = defer_most(hi[k]);
            b[k * LAYOUT_LANES] = 0.5f * below + 0.5f * above;
            b[(3 + k) * LAYOUT_LANES] = 0.5f * above - 0.5f * below;
        }
        b[6 * LAYOUT_LANES] = defer_most(most);
        if (step)
            settled[group] = step;
    }
}
