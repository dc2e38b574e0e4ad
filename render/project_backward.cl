// Stage: gather and project, backward. Eleven sums of every (splat, tile) pair -> gradients of the
// raw parameters of every Gaussian, written out (project_backward) or put into Adam at once
// (project_step).
//   in   params [groups][planes][16], tiles_of, slot_first, slots, marks (see blend_backward.cl)
//   out  grads, same layout; or params and both moments in place, and the densification statistics
// One work-item: LAYOUT_PROJECT_GROUPS groups when VW is 16, one Gaussian when VW is 1. Slots of a
// Gaussian are added in slot order, so the sum does not depend on who ran when.
//
// With P = J W R diag(s) (2 x 3), S = P P^T + eps I, L = [[p, 0], [-p x_of_y, r]] and d the pixel
// offset, (u, v) = L^T d and S^-1 = 2 ln2 L L^T. From the sums M = [[q u^2, q u v], [q u v, q v^2]]
//     dL/dP = L B N,    N = L^T P,    B = (2 ln2)^2 M - [compensated] 2 ln2 q I.
// Everything that hangs on P is taken through N, whose entries are at most 1: for needles L is
// large and P is large, but N is not. Compensation multiplies alpha by rho = sqrt(det S0 / det S):
// det S is in B, and
//     det S0 = sum_k m_k^2,  m_k = (product of the other two sigmas) (R_k . n),  n = (J W)_0 x (J
//     W)_1
// has simple derivatives of its own: d(1/2 ln det S0) = 1 - m_k^2 / det S0 for ln s_k.
// Rotations: V_k = dL/dR_k gives the torque a = sum_k R_k x V_k, and dL/dq = 2 (0, a) q, which is
// already tangent. The view direction of SH is held fixed.
//
// With APPEARANCE_LEN (appearance.cl) opacity is min(o + y3, 1) and colour clamp(SH + 0.5 + 2 y -
// 1, 0, 1): nothing passes where they were cut. VW 16 goes on through the network at once, so that
// the embeddings pass through the cache with the other planes: in `frame` and `each`, out a row of
// sums a work-item. VW 1 leaves dL/dy in `look` [groups][4][16] for appearance_backward.cl.
//
// Reference: render_ref_backward. Adam: Kingma and Ba 2015, every parameter every frame, also where
// the gradient is 0.

#define LN2_2 1.38629436111989f // 2 ln 2
#define GRAD_LIMIT 1e18f        // its square is still a float

struct sums {
    V rgb[3], q, qu, qv, quu, quv, qvv, abs_x, abs_y;
};

#if VW == 16
inline void sums_gather(__global const uint *tiles, __global const uint *first,
                        __global const float *slots, __global const uchar *marks, struct sums *s)
{
    float rows[16 * 16];
    V t[LAYOUT_SLOT_FLOATS];
    for (uint lane = 0; lane < 16; lane++) {
        uint from = first[lane], n = tiles[lane];
        float16 sum = (float16)(0.0f);
        for (uint i = from; i < from + n; i++)
            if (marks[i]) // the load reaches into the next slot: the buffer ends with room for that
                sum += LAYOUT_WIDE(const __global, float, slots + (size_t)i * LAYOUT_SLOT_FLOATS);
        LAYOUT_WIDE(__private, float, rows + 16 * lane) = sum;
    }
    for (uint k = 0; k < LAYOUT_SLOT_FLOATS; k++)
        t[k] =
            (float16)(rows[k], rows[16 + k], rows[32 + k], rows[48 + k], rows[64 + k], rows[80 + k],
                      rows[96 + k], rows[112 + k], rows[128 + k], rows[144 + k], rows[160 + k],
                      rows[176 + k], rows[192 + k], rows[208 + k], rows[224 + k], rows[240 + k]);
#else
inline void sums_gather(__global const uint *tiles, __global const uint *first,
                        __global const float *slots, __global const uchar *marks, struct sums *s)
{
    V t[LAYOUT_SLOT_FLOATS];
    uint from = first[0], n = tiles[0];
    for (uint k = 0; k < LAYOUT_SLOT_FLOATS; k++)
        t[k] = 0.0f;
    for (uint i = from; i < from + n; i++)
        if (marks[i])
            for (uint k = 0; k < LAYOUT_SLOT_FLOATS; k++)
                t[k] += slots[(size_t)i * LAYOUT_SLOT_FLOATS + k];
#endif
    s->rgb[0] = t[0];
    s->rgb[1] = t[1];
    s->rgb[2] = t[2];
    s->q = t[3];
    s->qu = t[4];
    s->qv = t[5];
    s->quu = t[6];
    s->quv = t[7];
    s->qvv = t[8];
    s->abs_x = t[9];
    s->abs_y = t[10];
}

struct gradient {
    V geo[11];       // planes 0-10
    V rgb[3];        // of the colour, 0 where it was clamped
    V px[2], apx[2]; // of the mean in pixels; sum of moduli
    V radius;        // larger half-size, px
    V opacity;       // as it was drawn, before compensation
#ifdef APPEARANCE_LEN
    V look[4]; // dL/dy
#endif
};

#ifdef APPEARANCE_LEN
#define EFFECTIVE_ARG , __global const float *effective
#define EFFECTIVE(at) , effective + (at)
#else
#define EFFECTIVE_ARG
#define EFFECTIVE(at)
#endif

// Gradient of mean, scale, rotation and opacity. Lanes that were culled hold anything. One piece,
// because every part uses N, B and the axes in the camera frame, which cost more to pass on than to
// use.
inline void gradient_geometry(__constant struct layout_view *v, __global const float *g,
                              __global const float *filter, const struct sums *m,
                              struct gradient *out EFFECTIVE_ARG)
{
    struct seen s;
    (void)seen_mean(v, g, &s);
    (void)seen_ellipse(v, g, filter, &s);
    // W R: the axes of the Gaussian in the camera frame.
    V rc[9];
    for (int row = 0; row < 3; row++)
        for (int k = 0; k < 3; k++)
            rc[3 * row + k] = v->rot[3 * row] * s.rot[k] + (v->rot[3 * row + 1] * s.rot[3 + k] +
                                                            v->rot[3 * row + 2] * s.rot[6 + k]);
    V x_of_y = s.s01 / s.s11, r = sqrt((0.5f * LOG2E) / s.s11),
      p = sqrt((0.5f * LOG2E) * s.s11 / s.det);
    V rho2 = s.det0 / s.det, act = (V)(0.0f);
    if (v->compensate)
        act = rho2 > LAYOUT_RHO2_MIN ? m->q : (V)(0.0f); // dL/d ln rho
    V bq = LN2_2 * act, b00 = (LN2_2 * LN2_2) * m->quu - bq, b01 = (LN2_2 * LN2_2) * m->quv,
      b11 = (LN2_2 * LN2_2) * m->qvv - bq;
    // n in the camera frame is nz (x, y, 1) with x, y the clamped position.
    V fx = v->fx * s.inv_z, fy = v->fy * s.inv_z, nz = fx * fy, cx = s.clamped[0],
      cy = s.clamped[1];
    V mk[3], det0 = (V)(0.0f);
    for (int k = 0; k < 3; k++) {
        V others = k == 0   ? s.scale[1] * s.scale[2]
                   : k == 1 ? s.scale[0] * s.scale[2]
                            : s.scale[0] * s.scale[1];
        mk[k] = others * (nz * (rc[k] * cx + (rc[3 + k] * cy + rc[6 + k])));
        det0 = mk[k] * mk[k] + det0;
    }
    V per_det0 = act / (act != 0.0f ? det0 : (V)(1.0f));
    V along = (V)(0.0f), h02 = (V)(0.0f), h12 = (V)(0.0f), gn0 = (V)(0.0f), gn1 = (V)(0.0f),
      ax = (V)(0.0f), ay = (V)(0.0f), az = (V)(0.0f);
    for (int k = 0; k < 3; k++) {
        V p0 = s.pr[k] * s.scale[k], p1 = s.pr[3 + k] * s.scale[k];
        V n0 = p * (p0 - x_of_y * p1), n1 = r * p1;
        V t0 = b00 * n0 + b01 * n1, t1 = b01 * n0 + b11 * n1;
        V e0 = p * t0, e1 = r * t1 - x_of_y * e0; // dL/dP, column k
        V own = n0 * t0 + n1 * t1;
        along += own;
        V sum = own + (act - per_det0 * (mk[k] * mk[k]));
        out->geo[3 + k] = v->smooth ? s.keep[k] * (sum - m->q) + m->q : sum;
        V x = rc[k], y = rc[3 + k], z = rc[6 + k], e0s = e0 * s.scale[k], e1s = e1 * s.scale[k];
        h02 = e0s * z + h02;
        h12 = e1s * z + h12;
        V others = k == 0   ? s.scale[1] * s.scale[2]
                   : k == 1 ? s.scale[0] * s.scale[2]
                            : s.scale[0] * s.scale[1];
        V w = per_det0 * mk[k] * others;
        gn0 = w * x + gn0;
        gn1 = w * y + gn1;
        w *= nz;
        V v0 = fx * e0s + w * cx, v1 = fy * e1s + w * cy, v2 = w - (fx * cx * e0s + fy * cy * e1s);
        ax += y * v2 - z * v1;
        ay += z * v0 - x * v2;
        az += x * v1 - y * v0;
    }
    // Mean: through the pixel, through J at the (clamped) position, through n.
    V gu = -LN2_2 * (p * m->qu), gv = -LN2_2 * (r * m->qv - p * x_of_y * m->qu);
    V px = s.cam[0] * s.inv_z, py = s.cam[1] * s.inv_z;
    V gx = nz * gn0 - fx * h02, gy = nz * gn1 - fy * h12; // of the clamped position
    gx = px == cx ? gx : (V)(0.0f);
    gy = py == cy ? gy : (V)(0.0f);
    V tx = (fx * gu + gx * s.inv_z), ty = (fy * gv + gy * s.inv_z);
    V tz = -(tx * px + ty * py) - s.inv_z * (along + 2.0f * act);
    for (int k = 0; k < 3; k++)
        out->geo[k] = v->rot[k] * tx + (v->rot[3 + k] * ty + v->rot[6 + k] * tz);
    // Torque to the world, then to the quaternion.
    V wx = v->rot[0] * ax + (v->rot[3] * ay + v->rot[6] * az),
      wy = v->rot[1] * ax + (v->rot[4] * ay + v->rot[7] * az),
      wz = v->rot[2] * ax + (v->rot[5] * ay + v->rot[8] * az), two = 2.0f / s.quat_len;
    out->geo[6] = -two * (wx * s.qx + (wy * s.qy + wz * s.qz));
    out->geo[7] = two * (s.qw * wx + (wy * s.qz - wz * s.qy));
    out->geo[8] = two * (s.qw * wy + (wz * s.qx - wx * s.qz));
    out->geo[9] = two * (s.qw * wz + (wx * s.qy - wy * s.qx));
#ifdef APPEARANCE_LEN
    V drawn = LD(effective, 0), pass = drawn < 1.0f ? m->q / drawn : (V)(0.0f);
    out->geo[10] = s.opacity * (1.0f - s.opacity) * pass;
    out->look[3] = pass;
    s.opacity = drawn;
#else
    out->geo[10] = (1.0f - s.opacity) * m->q;
#endif
    out->opacity = s.opacity;
    out->px[0] = gu;
    out->px[1] = gv;
    out->apx[0] = LN2_2 * p * m->abs_x;
    out->apx[1] = LN2_2 * m->abs_y;
    V reach = s.opacity * s.rho * 255.0f, largest = MAX_(s.s00, s.s11);
    reach = MAX_(reach, 1.0f);
    reach = sqrt(2.0f * log(reach));
    out->radius = MIN_(reach, LAYOUT_EXTENT_MAX) * sqrt(largest);
}

// Colours of 16 splats: 0 where the record's channel was clamped at 0.
inline V record_rgb(__global const struct layout_splat *splats, uint c)
{
#if VW == 16
    __global const float *f = (__global const float *)splats + 6 + c;
    return (float16)(f[0], f[16], f[32], f[48], f[64], f[80], f[96], f[112], f[128], f[144], f[160],
                     f[176], f[192], f[208], f[224], f[240]);
#else
    return splats->rgb[c];
#endif
}

inline VI tiles_some(__global const uint *tiles)
{
#if VW == 16
    return LAYOUT_WIDE(const __global, uint, tiles) != (uint16)(0);
#else
    return tiles[0] != 0;
#endif
}

// All gradients of a group, 0 in lanes that were not seen.
inline void gradient_all(__constant struct layout_view *v, __global const float *g,
                         __global const float *filter, __global const struct layout_splat *splats,
                         __global const uint *tiles, __global const uint *first,
                         __global const float *slots, __global const uchar *marks, VI visible,
                         struct gradient *out EFFECTIVE_ARG)
{
    struct sums s;
    sums_gather(tiles, first, slots, marks, &s);
    gradient_geometry(v, g, filter, &s, out EFFECTIVE(0));
    for (uint k = 0; k < 11; k++)
        out->geo[k] = visible ? out->geo[k] : (V)(0.0f);
    for (uint c = 0; c < 3; c++) {
        V rgb = record_rgb(splats, c);
        VI inside = visible & (rgb > 0.0f);
#ifdef APPEARANCE_LEN
        inside &= rgb < 1.0f;
#endif
        out->rgb[c] = inside ? s.rgb[c] : (V)(0.0f);
    }
#ifdef APPEARANCE_LEN
    out->look[3] = visible ? out->look[3] : (V)(0.0f);
    for (uint c = 0; c < 3; c++)
        out->look[c] = 2.0f * out->rgb[c];
#endif
}

// Groups of this work-item, as [from, to), and the lane.
inline uint item_groups(__constant struct layout_view *v, uint *to, uint *lane)
{
    uint id = (uint)get_global_id(0);
#if VW == 16
    *lane = 0;
    *to = min((id + 1) * LAYOUT_PROJECT_GROUPS, v->groups);
    return id * LAYOUT_PROJECT_GROUPS;
#else
    *lane = id % LAYOUT_LANES;
    *to = min(id / LAYOUT_LANES + 1, v->groups);
    return id / LAYOUT_LANES;
#endif
}

// ---- Adam
// ------------------------------------------------------------------------------------------------

// Learning rates over the first moment's bias correction: s0-s5 mean, scale, rotation, opacity, SH
// DC, rest. k: s0 beta1, s1 beta2, s2 eps, s3 1/sqrt of the second moment's bias correction, s4 s5
// limits of scale_log, s6 s7 half the picture, px (at most 1600): pixel gradients times these are
// per unit of normalised device coordinates, which is what densification thresholds are stated in.
struct adam {
    __global float *p, *m1, *m2; // of this group
    float8 lr, k;
};

// One plane. Lanes outside `keep` stay as they are. Returns the new value.
inline V adam_plane(const struct adam *a, uint plane, float lr, V g, VI keep)
{
    V p = LD(a->p, plane), m1 = LD(a->m1, plane), m2 = LD(a->m2, plane);
    V n1 = a->k.s0 * m1 + (1.0f - a->k.s0) * g, n2 = a->k.s1 * m2 + (1.0f - a->k.s1) * (g * g);
    V q = p - lr * n1 / (sqrt(n2) * a->k.s3 + a->k.s2);
    ST(a->m1, plane, keep ? n1 : m1);
    ST(a->m2, plane, keep ? n2 : m2);
    return keep ? q : p;
}

// Rotation: four planes, and what must never be: a quaternion near 0 or not finite becomes the
// identity and starts over. Returns the lanes that were repaired; lanes that are not real stay as
// they are.
inline VI adam_quat(const struct adam *a, const struct gradient *d, VI keep, VI real)
{
    V q[4], n = (V)(0.0f);
    for (uint k = 0; k < 4; k++) {
        V x = LD(a->p, 6 + k);
        n = x * x + n;
    }
    VI good = ((n >= 1e-12f) & (n < 1e30f)) | !real; // NaN is not good; padding is nobody's
    VI use = keep & good;
    n = (V)(0.0f);
    for (uint k = 0; k < 4; k++) {
        q[k] = adam_plane(a, 6 + k, a->lr.s2, d->geo[6 + k], use);
        n = q[k] * q[k] + n;
    }
    good &= ((n >= 1e-12f) & (n < 1e30f)) | !real;
    for (uint k = 0; k < 4; k++)
        ST(a->p, 6 + k, good ? q[k] : (k == 0 ? (V)(1.0f) : (V)(0.0f)));
    if (ANY(!good))
        for (uint k = 0; k < 4; k++) {
            ST(a->m1, 6 + k, good ? LD(a->m1, 6 + k) : (V)(0.0f));
            ST(a->m2, 6 + k, good ? LD(a->m2, 6 + k) : (V)(0.0f));
        }
    return !good;
}

inline void adam_geometry(const struct adam *a, const struct gradient *d, VI keep)
{
    for (uint k = 0; k < 3; k++)
        ST(a->p, k, adam_plane(a, k, a->lr.s0, d->geo[k], keep));
    for (uint k = 3; k < 6; k++) {
        V x = adam_plane(a, k, a->lr.s1, d->geo[k], keep);
        x = MAX_(x, a->k.s4); // NaN becomes the lower limit
        ST(a->p, k, MIN_(x, a->k.s5));
    }
    ST(a->p, 10, adam_plane(a, 10, a->lr.s3, d->geo[10], keep));
}

// Lanes whose gradient is usable: finite, and small enough to be squared.
inline VI gradient_usable(const struct gradient *d)
{
    V worst = (V)(0.0f);
    VI ok = worst == worst;
    for (uint k = 0; k < 11; k++)
        ok &= fabs(d->geo[k]) < GRAD_LIMIT;
    for (uint c = 0; c < 3; c++)
        ok &= fabs(d->rgb[c]) < GRAD_LIMIT;
#ifdef APPEARANCE_LEN
    ok &= fabs(d->look[3]) < GRAD_LIMIT;
#endif
    return ok;
}

#if VW == 16
inline uint lanes_count(VI mask)
{
    int16 one = mask & (VI)(1);
    int8 a = one.lo + one.hi;
    int4 b = a.lo + a.hi;
    return (uint)((b.x + b.y) + (b.z + b.w));
}
#else
inline uint lanes_count(VI mask)
{
    return mask ? 1 : 0;
}
#endif

inline void stats_add(__global float *grad, __global float *absg, uint with_abs,
                      __global float *count, __global float *radius, __global float *opacity,
                      uint with_opacity, const struct gradient *d, float8 k, VI counted)
{
    V x = d->px[0] * k.s6, y = d->px[1] * k.s7, ax = d->apx[0] * k.s6, ay = d->apx[1] * k.s7;
    V g = sqrt(x * x + y * y), a = sqrt(ax * ax + ay * ay), old = LD(radius, 0);
    ST(grad, 0, LD(grad, 0) + (counted ? g : (V)(0.0f)));
    if (with_abs)
        ST(absg, 0, LD(absg, 0) + (counted ? a : (V)(0.0f)));
    ST(count, 0, LD(count, 0) + (counted ? (V)(1.0f) : (V)(0.0f)));
    ST(radius, 0, (counted & (d->radius > old)) ? d->radius : old);
    if (with_opacity) {
        V most = LD(opacity, 0);
        ST(opacity, 0, (counted & (d->opacity > most)) ? d->opacity : most);
    }
}

// ---- appearance
// ------------------------------------------------------------------------------------------------

#ifdef APPEARANCE_LEN
// The embedding's planes, which start at `first`. embed: learning rate over the first moment's
// correction, 1/sqrt of the second's.
INLINE void adam_embed(const struct adam *a, float2 embed, uint first, const V g[APPEARANCE_LEN],
                       VI real)
{
    struct adam b = *a;
    VI keep = real;
    b.k.s3 = embed.y;
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        keep &= fabs(g[k]) < GRAD_LIMIT;
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        ST(b.p, first + k, adam_plane(&b, first + k, embed.x, g[k], keep));
}
#if VW == 16
#define APPEARANCE_ARG , __constant float *frame, float each, __global float *parts
#define EMBED_ARG , float2 embed
#define APPEARANCE_OPEN                                                                            \
    struct render_appearance_terms terms;                                                          \
    struct render_appearance_sums render_appearance_sums;                                          \
    render_appearance_clear(&render_appearance_sums);
#define APPEARANCE_CLOSE                                                                           \
    if (get_global_id(0) * LAYOUT_PROJECT_GROUPS < v->groups)                                      \
        render_appearance_write(&render_appearance_sums, parts + get_global_id(0) * APPEARANCE_ROW);
#else
#define APPEARANCE_ARG , __global float *look
#define EMBED_ARG
#define APPEARANCE_OPEN
#define APPEARANCE_CLOSE
#endif
#else
#define APPEARANCE_ARG
#define EMBED_ARG
#define APPEARANCE_OPEN
#define APPEARANCE_CLOSE
#endif

// ---- kernels
// ------------------------------------------------------------------------------------------------

__kernel void project_backward(__constant struct layout_view *v, __global const float *params,
                               __global const float *filter,
                               __global const struct layout_splat *splats,
                               __global const uint *tiles_of, __global const uint *slot_first,
                               __global const float *slots, __global const uchar *marks,
                               __global float *grads EFFECTIVE_ARG APPEARANCE_ARG)
{
    uint to, lane, used = (v->sh_degree + 1) * (v->sh_degree + 1);
    APPEARANCE_OPEN
    for (uint group = item_groups(v, &to, &lane); group < to; group++) {
        size_t at = (size_t)group * v->planes * LAYOUT_LANES + lane;
        uint i = group * LAYOUT_LANES + lane;
        VI visible = tiles_some(tiles_of + i);
        __global float *out = grads + at;
        if (!ANY(visible)) {
            for (uint p = 0; p < v->planes; p++)
                ST(out, p, (V)(0.0f));
            continue;
        }
        struct gradient d;
        V dir[3], basis[16];
        gradient_all(v, params + at, filter + i, splats + i, tiles_of + i, slot_first + i, slots,
                     marks, visible, &d EFFECTIVE(i));
#if defined(APPEARANCE_LEN) && VW == 1
        for (uint p = 0; p < 4; p++)
            ST(look + (size_t)group * 4 * LAYOUT_LANES + lane, p, d.look[p]);
#endif
        seen_direction(v, params + at, dir);
        sh_basis(dir, v->sh_degree, basis);
        for (uint p = 0; p < 11; p++)
            ST(out, p, d.geo[p]);
        for (uint k = 0; k < used; k++)
            for (uint c = 0; c < 3; c++)
                ST(out, 11 + 3 * k + c, basis[k] * d.rgb[c]);
        for (uint p = 11 + 3 * used; p < v->planes; p++)
            ST(out, p, (V)(0.0f));
#if defined(APPEARANCE_LEN) && VW == 16
        uint first = v->planes - APPEARANCE_LEN;
        render_appearance_terms(frame, params + at + first * LAYOUT_LANES, d.look, each, visible,
                                &terms);
        render_appearance_add(&terms, &render_appearance_sums);
        for (uint p = 0; p < APPEARANCE_LEN; p++)
            ST(out, first + p, terms.embed[p]);
#endif
    }
    APPEARANCE_CLOSE
}

__kernel void project_step(__constant struct layout_view *v, __global float *params,
                           __global const float *filter, __global const struct layout_splat *splats,
                           __global const uint *tiles_of, __global const uint *slot_first,
                           __global const float *slots, __global const uchar *marks,
                           __global float *m1, __global float *m2, float8 lr, float8 k,
                           uint with_extra, __global const float *extra, uint with_stats,
                           uint with_abs, uint with_opacity, __global float *stat_grad,
                           __global float *stat_absg, __global float *stat_count,
                           __global float *stat_radius, __global float *stat_opacity,
                           __global uint *repaired EFFECTIVE_ARG APPEARANCE_ARG EMBED_ARG)
{
    uint to, lane, used = (v->sh_degree + 1) * (v->sh_degree + 1);
    APPEARANCE_OPEN
    for (uint group = item_groups(v, &to, &lane); group < to; group++) {
        size_t at = (size_t)group * v->planes * LAYOUT_LANES + lane;
        uint i = group * LAYOUT_LANES + lane;
        VI visible = tiles_some(tiles_of + i), real = LANE + (int)i < (int)v->n;
        struct adam a = {params + at, m1 + at, m2 + at, lr, k};
        struct gradient d;
        V dir[3], basis[16];
        if (ANY(visible)) {
            gradient_all(v, a.p, filter + i, splats + i, tiles_of + i, slot_first + i, slots, marks,
                         visible, &d EFFECTIVE(i));
            seen_direction(v, a.p, dir); // before the mean moves
            sh_basis(dir, v->sh_degree, basis);
        } else {
            for (uint p = 0; p < 11; p++)
                d.geo[p] = (V)(0.0f);
            for (uint c = 0; c < 3; c++)
                d.rgb[c] = (V)(0.0f);
            for (uint p = 0; p < 16; p++)
                basis[p] = (V)(0.0f);
#ifdef APPEARANCE_LEN
            for (uint p = 0; p < 4; p++)
                d.look[p] = (V)(0.0f);
#endif
        }
        if (with_extra == 11)
            for (uint p = 0; p < 11; p++)
                d.geo[p] += LD(extra + (size_t)group * 11 * LAYOUT_LANES + lane, p);
        else if (with_extra)
            for (uint p = 0; p < 3; p++)
                d.geo[3 + p] += LD(extra + (size_t)group * 3 * LAYOUT_LANES + lane, p);
        VI usable = gradient_usable(&d) & real;
#ifdef APPEARANCE_LEN
        for (uint p = 0; p < 4; p++)
            d.look[p] = usable ? d.look[p] : (V)(0.0f);
#if VW == 1
        if (visible)
            for (uint p = 0; p < 4; p++)
                ST(look + (size_t)group * 4 * LAYOUT_LANES + lane, p, d.look[p]);
#endif
#endif
        if (with_stats && ANY(visible))
            stats_add(stat_grad + i, stat_absg + (with_abs ? i : 0), with_abs, stat_count + i,
                      stat_radius + i, stat_opacity + (with_opacity ? i : 0), with_opacity, &d, k,
                      usable & visible);
        VI bad = adam_quat(&a, &d, usable, real);
        adam_geometry(&a, &d, usable);
        for (uint p = 0; p < 3 * used; p++)
            ST(a.p, 11 + p,
               adam_plane(&a, 11 + p, p < 3 ? lr.s4 : lr.s5, basis[p / 3] * d.rgb[p % 3], usable));
#if defined(APPEARANCE_LEN) && VW == 16
        uint plane = v->planes - APPEARANCE_LEN;
        if (ANY(visible)) {
            render_appearance_terms(frame, a.p + plane * LAYOUT_LANES, d.look, each, visible,
                                    &terms);
            render_appearance_add(&terms, &render_appearance_sums);
        } else {
            for (uint p = 0; p < APPEARANCE_LEN; p++)
                terms.embed[p] = (V)(0.0f);
        }
        adam_embed(&a, embed, plane, terms.embed, real);
#endif
        bad |= real & !usable;
        if (with_stats && ANY(bad))
            atomic_add(repaired, lanes_count(bad)); // whole numbers: any order gives the same sum
    }
    APPEARANCE_CLOSE
}
