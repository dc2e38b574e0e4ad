// Stage: gather and project, backward. Fourteen sums of every intersection -> gradients of the raw
// parameters of every Gaussian, written out (project_backward) or put into Adam at once
// (project_step).
//   in   params [groups][planes][16], tiles_of, slot_first, slots, marks (see blend_backward.cl)
//        list [groups], with view->listed and of project_step alone: which groups of params,
//        moments and statistics these are; settled and owed are settled and table of
//        defer.cl, whose steps before rates.step the moments have not made
//   out  grads, same layout; or params and moments (adam.cl) in place, and the densification
//        statistics
// One work-item: LAYOUT_PROJECT_GROUPS groups when VW is 16, one Gaussian when VW is 1. Slots of a
// Gaussian are added in slot order, so the sum does not depend on who ran when.
//
// With P = J W R diag(s) (2 x 3), S = P P^T + eps I, L = [[p, 0], [-p x_of_y, r]] and d the pixel
// offset, (u, v) = L^T d and S^-1 = 2 ln2 L L^T. From the sums M = [[q u^2, q u v], [q u v, q v^2]]
//     dL/dP = L B N,    N = L^T P,    B = (2 ln2)^2 M - [compensated] 2 ln2 q I.
// Everything that hangs on P is taken through N, whose elements are at most 1: for needles L is
// large and P is large, but N is not. Compensation multiplies alpha by rho = sqrt(det S0 / det S):
// det S is in B, and
//     det S0 = sum_k m_k^2,  m_k = (product of the other two sigmas) (R_k . n),  n = (J W)_0 x (J
//     W)_1
// has simple derivatives of its own: d(1/2 ln det S0) = 1 - m_k^2 / det S0 for ln s_k.
// Rotations: V_k = dL/dR_k gives the torque a = sum_k R_k x V_k, and dL/dq = 2 (0, a) q, which is
// already tangent. The view direction of SH is held fixed.
// With sums along rays a splat's depth at a pixel is z + k . d in units of view.depth_unit_m (see
// moments.cl), k = L k', k' = -2 ln2 N p_z. From H = sum h, (h_u, h_v) = sum h (u, v) and b = 2 ln2
// N^T (h_u, h_v)
//     dL/dP = L (..  - 2 ln2 (h_u, h_v) (p_z + N^T k')^T - k' b^T),   dL/dp_z = -b,
//     dL/dz = H, dL/d of the mean in pixels = k H.
//
// With APPEARANCE_LEN (appearance.cl) opacity is min(o + y3, 1) and colour clamp(SH + 0.5 + 2 y -
// 1, 0, 1): nothing passes where they were cut. VW 16 goes on through the network at once, so that
// the embeddings pass through the cache with the other planes: in `frame` and `each`, out a row of
// sums a work-item. VW 1 leaves dL/dy in `y_grads` [groups][4][16] for appearance_backward.cl.
//
// Reference: render_ref_backward. Adam: Kingma and Ba 2015, every parameter every frame, also where
// the gradient is 0.

#define GRAD_LIMIT 1e18f // its square is still a float

// ---- sums of the slots

struct sums {
    V rgb[3], q, qu, qv, quu, quv, qvv, abs[2], h, hu, hv;
};

// What forward and blend_backward left for one group (VW 16) or Gaussian (VW 1).
struct left {
    __global const struct layout_splat *splats;
    __global const uint *tiles, *first;
    __global const float *slots; // of all Gaussians
    __global const uchar *marks;
};

#if VW == 16
inline void sums_slots(const struct left *in, V t[LAYOUT_SLOT_FLOATS])
{
    __global const float *slots = in->slots;
    __global const uchar *marks = in->marks;
    float rows[LAYOUT_LANES * 16];
    for (uint lane = 0; lane < LAYOUT_LANES; lane++) {
        uint from = in->first[lane], n = in->tiles[lane];
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
}
#else
inline void sums_slots(const struct left *in, V t[LAYOUT_SLOT_FLOATS])
{
    uint from = in->first[0], n = in->tiles[0];
    for (uint k = 0; k < LAYOUT_SLOT_FLOATS; k++)
        t[k] = 0.0f;
    for (uint i = from; i < from + n; i++)
        if (in->marks[i])
            for (uint k = 0; k < LAYOUT_SLOT_FLOATS; k++)
                t[k] += in->slots[(size_t)i * LAYOUT_SLOT_FLOATS + k];
}
#endif

inline void sums_gather(const struct left *in, struct sums *s)
{
    V t[LAYOUT_SLOT_FLOATS];
    sums_slots(in, t);
    for (uint c = 0; c < 3; c++)
        s->rgb[c] = t[LAYOUT_SLOT_RGB + c];
    s->q = t[LAYOUT_SLOT_Q];
    s->qu = t[LAYOUT_SLOT_QU];
    s->qv = t[LAYOUT_SLOT_QV];
    s->quu = t[LAYOUT_SLOT_QUU];
    s->quv = t[LAYOUT_SLOT_QUV];
    s->qvv = t[LAYOUT_SLOT_QVV];
    s->abs[0] = t[LAYOUT_SLOT_ABS];
    s->abs[1] = t[LAYOUT_SLOT_ABS + 1];
    s->h = t[LAYOUT_SLOT_DEPTH];
    s->hu = t[LAYOUT_SLOT_DEPTH_U];
    s->hv = t[LAYOUT_SLOT_DEPTH_V];
}

// ---- the chain rule

struct gradient {
    V geometry[LAYOUT_PLANES_GEOMETRY];
    V rgb[3];        // of the colour, 0 where it was clamped
    V px[2], apx[2]; // of the mean in pixels; sum of moduli
    V radius;        // larger half-size, px
    V opacity;       // as it was drawn, before compensation
#ifdef APPEARANCE_LEN
    V y[LAYOUT_APPEARANCE_OUT]; // of the network's outputs
#endif
};

#ifdef APPEARANCE_LEN
#define EFFECTIVE_ARG , __global const float *effective
#define EFFECTIVE(at) , effective + (at)
#else
#define EFFECTIVE_ARG
#define EFFECTIVE(at)
#endif

// What the parts of the chain rule share of one splat, in the terms of the head.
struct ellipse {
    V axes[9];         // W R: the axes of the Gaussian in the camera frame
    V p, x_of_y, r;    // of struct layout_splat
    V act;             // dL/d ln rho
    V b00, b01, b11;   // B
    V fx, fy;          // px a metre at its depth
    V nz, cx, cy;      // n in the camera frame is nz (cx, cy, 1), (cx, cy) the clamped position
    V m[3], per_det0;  // m_k; act / det S0
    V along, h02, h12; // sums over the axes: tr(N^T B N), third column of dL/dP (W R s)^T,
    V gn0, gn1;        // dL/dn,
    V torque[3];       // and a, in the camera frame
    V k0, k1, h0, h1;  // k' and 2 ln2 (h_u, h_v), both in units of depth; 0 without moments
};

INLINE V sigmas_but(const struct seen *s, int k) // the product of the other two
{
    return k == 0   ? s->scale[1] * s->scale[2]
           : k == 1 ? s->scale[0] * s->scale[2]
                    : s->scale[0] * s->scale[1];
}

// The Cholesky form, B, n and det S0.
INLINE void ellipse_of(__constant struct layout_view *v, const struct seen *s, const struct sums *m,
                       struct ellipse *e)
{
    for (int row = 0; row < 3; row++)
        for (int k = 0; k < 3; k++)
            e->axes[3 * row + k] =
                v->rot[3 * row] * s->rot[k] +
                (v->rot[3 * row + 1] * s->rot[3 + k] + v->rot[3 * row + 2] * s->rot[6 + k]);
    e->x_of_y = s->s01 / s->s11;
    e->r = sqrt((0.5f * LOG2E) / s->s11);
    e->p = sqrt((0.5f * LOG2E) * s->s11 / s->det);
    V rho2 = s->det0 / s->det, det0 = (V)(0.0f);
    e->act = (V)(0.0f);
    if (v->compensate)
        e->act = rho2 > LAYOUT_RHO2_MIN ? m->q : (V)(0.0f);
    V bq = LN2_2 * e->act;
    e->b00 = (LN2_2 * LN2_2) * m->quu - bq;
    e->b01 = (LN2_2 * LN2_2) * m->quv;
    e->b11 = (LN2_2 * LN2_2) * m->qvv - bq;
    e->fx = v->fx * s->inv_z;
    e->fy = v->fy * s->inv_z;
    e->nz = e->fx * e->fy;
    e->cx = s->clamped[0];
    e->cy = s->clamped[1];
    for (int k = 0; k < 3; k++) {
        e->m[k] = sigmas_but(s, k) *
                  (e->nz * (e->axes[k] * e->cx + (e->axes[3 + k] * e->cy + e->axes[6 + k])));
        det0 = e->m[k] * e->m[k] + det0;
    }
    e->per_det0 = e->act / (e->act != 0.0f ? det0 : (V)(1.0f));
}

// What the plane of the splat needs, see moments.cl.
INLINE void ellipse_plane(__constant struct layout_view *v, const struct seen *s,
                          const struct sums *m, struct ellipse *e)
{
    e->k0 = e->k1 = e->h0 = e->h1 = (V)(0.0f);
    if (!(v->depth_unit_m > 0.0f))
        return;
    float unit = 1.0f / v->depth_unit_m;
    for (int k = 0; k < 3; k++) {
        V p0 = s->pr[k] * s->scale[k], p1 = s->pr[3 + k] * s->scale[k],
          z = e->axes[6 + k] * s->scale[k];
        e->k0 -= LN2_2 * (e->p * (p0 - e->x_of_y * p1)) * z;
        e->k1 -= LN2_2 * (e->r * p1) * z;
    }
    e->h0 = LN2_2 * unit * m->hu;
    e->h1 = LN2_2 * unit * m->hv;
}

// Axis by axis: dL/d ln s_k, and the sums over the axes.
INLINE void ellipse_axes(const struct seen *s, struct ellipse *e, V scale[3])
{
    e->along = e->h02 = e->h12 = e->gn0 = e->gn1 = (V)(0.0f);
    e->torque[0] = e->torque[1] = e->torque[2] = (V)(0.0f);
    for (int k = 0; k < 3; k++) {
        V p0 = s->pr[k] * s->scale[k], p1 = s->pr[3 + k] * s->scale[k];
        V n0 = e->p * (p0 - e->x_of_y * p1), n1 = e->r * p1;
        V z3 = e->axes[6 + k] * s->scale[k]; // p_z, and b:
        V left = z3 + (n0 * e->k0 + n1 * e->k1), b = n0 * e->h0 + n1 * e->h1;
        V t0 = e->b00 * n0 + (e->b01 * n1 - (e->h0 * left + e->k0 * b)),
          t1 = e->b01 * n0 + (e->b11 * n1 - (e->h1 * left + e->k1 * b));
        V e0 = e->p * t0, e1 = e->r * t1 - e->x_of_y * e0; // dL/dP, column k
        V own = n0 * t0 + n1 * t1;
        e->along += own;
        scale[k] = own + (e->act - e->per_det0 * (e->m[k] * e->m[k])) - b * z3;
        V x = e->axes[k], y = e->axes[3 + k], z = e->axes[6 + k];
        V e0s = e0 * s->scale[k], e1s = e1 * s->scale[k];
        e->h02 = e0s * z + e->h02;
        e->h12 = e1s * z + e->h12;
        V w = e->per_det0 * e->m[k] * sigmas_but(s, k);
        e->gn0 = w * x + e->gn0;
        e->gn1 = w * y + e->gn1;
        w *= e->nz;
        V v0 = e->fx * e0s + w * e->cx, v1 = e->fy * e1s + w * e->cy,
          v2 = w - (e->fx * e->cx * e0s + e->fy * e->cy * e1s) - b * s->scale[k];
        e->torque[0] += y * v2 - z * v1;
        e->torque[1] += z * v0 - x * v2;
        e->torque[2] += x * v1 - y * v0;
    }
}

// Mean: through the pixel (px: of it), through J at the clamped position, through n.
INLINE void ellipse_mean(__constant struct layout_view *v, const struct seen *s,
                         const struct sums *m, const struct ellipse *e, V px[2], V mean[3])
{
    V gu = -LN2_2 * (e->p * m->qu), gv = -LN2_2 * (e->r * m->qv - e->p * e->x_of_y * m->qu);
    V x = s->cam[0] * s->inv_z, y = s->cam[1] * s->inv_z;
    px[0] = gu; // densification looks at colours alone
    px[1] = gv;
    V depth = v->depth_unit_m > 0.0f ? m->h / v->depth_unit_m : (V)(0.0f);
    gu += depth * (e->p * e->k0);
    gv += depth * (e->r * e->k1 - e->x_of_y * (e->p * e->k0));
    V gx = e->nz * e->gn0 - e->fx * e->h02, gy = e->nz * e->gn1 - e->fy * e->h12; // of (cx, cy)
    gx = x == e->cx ? gx : (V)(0.0f);
    gy = y == e->cy ? gy : (V)(0.0f);
    V tx = (e->fx * gu + gx * s->inv_z), ty = (e->fy * gv + gy * s->inv_z);
    V tz = depth - (tx * x + ty * y) - s->inv_z * (e->along + 2.0f * e->act);
    for (int k = 0; k < 3; k++)
        mean[k] = v->rot[k] * tx + (v->rot[3 + k] * ty + v->rot[6 + k] * tz);
}

// The torque to the world, then to the quaternion.
INLINE void ellipse_quat(__constant struct layout_view *v, const struct seen *s,
                         const struct ellipse *e, V quat[4])
{
    V ax = e->torque[0], ay = e->torque[1], az = e->torque[2];
    V wx = v->rot[0] * ax + (v->rot[3] * ay + v->rot[6] * az),
      wy = v->rot[1] * ax + (v->rot[4] * ay + v->rot[7] * az),
      wz = v->rot[2] * ax + (v->rot[5] * ay + v->rot[8] * az), two = 2.0f / s->quat_len;
    quat[0] = -two * (wx * s->qx + (wy * s->qy + wz * s->qz));
    quat[1] = two * (s->qw * wx + (wy * s->qz - wz * s->qy));
    quat[2] = two * (s->qw * wy + (wz * s->qx - wx * s->qz));
    quat[3] = two * (s->qw * wz + (wx * s->qy - wy * s->qx));
}

// Half of the larger side of the box around the splat, px.
INLINE V ellipse_radius(const struct seen *s)
{
    V reach = s->opacity * s->rho * 255.0f, largest = MAX_(s->s00, s->s11);
    reach = MAX_(reach, 1.0f);
    reach = sqrt(2.0f * log(reach));
    return MIN_(reach, LAYOUT_EXTENT_MAX) * sqrt(largest);
}

// Gradient of mean, scale, rotation and opacity. Lanes that were culled hold anything.
inline void gradient_geometry(__constant struct layout_view *v, __global const float *g,
                              const struct sums *m, struct gradient *out EFFECTIVE_ARG)
{
    struct seen s;
    struct ellipse e;
    (void)seen_mean(v, g, &s);
    (void)seen_ellipse(v, g, &s);
    ellipse_of(v, &s, m, &e);
    ellipse_plane(v, &s, m, &e);
    ellipse_axes(&s, &e, out->geometry + LAYOUT_PLANE_SCALE);
    ellipse_mean(v, &s, m, &e, out->px, out->geometry + LAYOUT_PLANE_MEAN);
    ellipse_quat(v, &s, &e, out->geometry + LAYOUT_PLANE_QUAT);
#ifdef APPEARANCE_LEN
    V drawn = LD(effective, 0), pass = drawn < 1.0f ? m->q / drawn : (V)(0.0f);
    out->geometry[LAYOUT_PLANE_OPACITY] = s.opacity * (1.0f - s.opacity) * pass;
    out->y[LAYOUT_APPEARANCE_OPACITY] = pass;
    s.opacity = drawn;
#else
    out->geometry[LAYOUT_PLANE_OPACITY] = (1.0f - s.opacity) * m->q;
#endif
    out->opacity = s.opacity;
    out->apx[0] = LN2_2 * e.p * m->abs[0];
    out->apx[1] = LN2_2 * m->abs[1];
    out->radius = ellipse_radius(&s);
}

// One channel of the colours of a group: 0 where the record's was clamped at 0.
inline V record_rgb(__global const struct layout_splat *splats, uint c)
{
#if VW == 16
    __global const float *f = (__global const float *)splats + LAYOUT_SPLAT_RGB + c;
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
                         const struct left *in, VI visible, struct gradient *out EFFECTIVE_ARG)
{
    struct sums s;
    sums_gather(in, &s);
    gradient_geometry(v, g, &s, out EFFECTIVE(0));
    for (uint k = 0; k < LAYOUT_PLANES_GEOMETRY; k++)
        out->geometry[k] = visible ? out->geometry[k] : (V)(0.0f);
    for (uint c = 0; c < 3; c++) {
        V rgb = record_rgb(in->splats, c);
        VI inside = visible & (rgb > 0.0f);
#ifdef APPEARANCE_LEN
        inside &= rgb < 1.0f;
#endif
        out->rgb[c] = inside ? s.rgb[c] : (V)(0.0f);
    }
#ifdef APPEARANCE_LEN
    V y3 = out->y[LAYOUT_APPEARANCE_OPACITY];
    out->y[LAYOUT_APPEARANCE_OPACITY] = visible ? y3 : (V)(0.0f);
    for (uint c = 0; c < 3; c++)
        out->y[c] = 2.0f * out->rgb[c];
#endif
}

// Of a group that was not seen.
inline void gradient_none(struct gradient *out)
{
    for (uint k = 0; k < LAYOUT_PLANES_GEOMETRY; k++)
        out->geometry[k] = (V)(0.0f);
    for (uint c = 0; c < 3; c++)
        out->rgb[c] = (V)(0.0f);
#ifdef APPEARANCE_LEN
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        out->y[o] = (V)(0.0f);
#endif
}

// Add what terms of the loss on Gaussians ask for, see LAYOUT_STEP_EXTRA.
inline void gradient_extra(struct gradient *d, __global const float *extra, uint group, uint lane,
                           uint wants)
{
    if (wants & LAYOUT_STEP_EXTRA)
        for (uint k = 0; k < LAYOUT_PLANES_SHAPE; k++)
            d->geometry[LAYOUT_PLANE_SCALE + k] +=
                LD(extra + group_at(group, LAYOUT_PLANES_SHAPE) + lane, k);
}

// Lanes whose gradient is usable: finite, and small enough to be squared.
inline VI gradient_usable(const struct gradient *d)
{
    V worst = (V)(0.0f);
    VI ok = worst == worst;
    for (uint k = 0; k < LAYOUT_PLANES_GEOMETRY; k++)
        ok &= fabs(d->geometry[k]) < GRAD_LIMIT;
    for (uint c = 0; c < 3; c++)
        ok &= fabs(d->rgb[c]) < GRAD_LIMIT;
#ifdef APPEARANCE_LEN
    ok &= fabs(d->y[LAYOUT_APPEARANCE_OPACITY]) < GRAD_LIMIT;
#endif
    return ok;
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

struct adam {
    __global float *p; // of this group, as are the moments
    __global uint *moments;
    const struct layout_adam *rates;
    float inv_bias2;    // of the planes at hand
    float owed1, owed2; // what steps that were owed leave of the moments: render/defer.h
    VU key;             // by which moments are rounded: adam.cl
};

// One plane. Lanes outside `keep` stay as they are. Returns the new value, which is that of moments
// that were not rounded.
inline V adam_plane(const struct adam *a, uint plane, float lr, V g, VI keep)
{
    VU was = LD_WORD(a->moments, plane);
    V p = LD(a->p, plane), m1 = a->owed1 * adam_first(was), m2 = a->owed2 * adam_second(was);
    float b1 = a->rates->beta1, b2 = a->rates->beta2;
    V n1 = b1 * m1 + (1.0f - b1) * g, n2 = b2 * m2 + (1.0f - b2) * (g * g);
    V q = p - lr * n1 / (sqrt(n2) * a->inv_bias2 + a->rates->eps);
    ST_WORD(a->moments, plane, adam_word(a->key, plane, keep ? n1 : m1, keep ? n2 : m2));
    return keep ? q : p;
}

// Rotation: four planes, and what must never be: a quaternion near 0 or not finite becomes the
// identity and starts over. Returns the lanes that were repaired; lanes that are not real stay as
// they are.
inline VI adam_quat(const struct adam *a, const struct gradient *d, VI keep, VI real)
{
    V q[4], n = (V)(0.0f);
    for (uint k = 0; k < 4; k++) {
        V x = LD(a->p, LAYOUT_PLANE_QUAT + k);
        n = x * x + n;
    }
    VI good = ((n >= 1e-12f) & (n < 1e30f)) | !real; // NaN is not good; padding is nobody's
    VI use = keep & good;
    n = (V)(0.0f);
    for (uint k = 0; k < 4; k++) {
        uint plane = LAYOUT_PLANE_QUAT + k;
        q[k] = adam_plane(a, plane, a->rates->lr_quat, d->geometry[plane], use);
        n = q[k] * q[k] + n;
    }
    good &= ((n >= 1e-12f) & (n < 1e30f)) | !real;
    for (uint k = 0; k < 4; k++)
        ST(a->p, LAYOUT_PLANE_QUAT + k, good ? q[k] : (k == 0 ? (V)(1.0f) : (V)(0.0f)));
    if (ANY(!good))
        for (uint plane = LAYOUT_PLANE_QUAT; plane < LAYOUT_PLANE_QUAT + 4; plane++)
            ST_WORD(a->moments, plane, good ? LD_WORD(a->moments, plane) : (VU)(0));
    return !good;
}

inline void adam_geometry(const struct adam *a, const struct gradient *d, VI keep)
{
    const struct layout_adam *r = a->rates;
    for (uint k = LAYOUT_PLANE_MEAN; k < LAYOUT_PLANE_MEAN + 3; k++)
        ST(a->p, k, adam_plane(a, k, r->lr_mean, d->geometry[k], keep));
    for (uint k = LAYOUT_PLANE_SCALE; k < LAYOUT_PLANE_SCALE + 3; k++) {
        V x = adam_plane(a, k, r->lr_scale, d->geometry[k], keep);
        x = MAX_(x, r->scale_log_min); // NaN becomes the lower limit
        ST(a->p, k, MIN_(x, r->scale_log_max));
    }
    uint k = LAYOUT_PLANE_OPACITY;
    ST(a->p, k, adam_plane(a, k, r->lr_opacity, d->geometry[k], keep));
}

// The first `used` coefficients.
inline void adam_sh(const struct adam *a, const struct gradient *d, const V basis[LAYOUT_SH_MAX],
                    uint used, VI keep)
{
    for (uint p = 0; p < 3 * used; p++) {
        float lr = p < 3 ? a->rates->lr_sh_dc : a->rates->lr_sh_rest;
        ST(a->p, LAYOUT_PLANE_SH + p,
           adam_plane(a, LAYOUT_PLANE_SH + p, lr, basis[p / 3] * d->rgb[p % 3], keep));
    }
}

// Densification statistics of all Gaussians: struct render_density_stats.
struct stats {
    __global float *grad, *absg, *count, *radius, *opacity;
};

inline void stats_add(const struct stats *to, uint i, const struct gradient *d,
                      const struct layout_adam *k, VI counted)
{
    V x = d->px[0] * k->half_width, y = d->px[1] * k->half_height, ax = d->apx[0] * k->half_width,
      ay = d->apx[1] * k->half_height;
    V g = sqrt(x * x + y * y), a = sqrt(ax * ax + ay * ay), old = LD(to->radius + i, 0);
    ST(to->grad + i, 0, LD(to->grad + i, 0) + (counted ? g : (V)(0.0f)));
    if (k->wants & LAYOUT_STEP_ABS)
        ST(to->absg + i, 0, LD(to->absg + i, 0) + (counted ? a : (V)(0.0f)));
    ST(to->count + i, 0, LD(to->count + i, 0) + (counted ? (V)(1.0f) : (V)(0.0f)));
    ST(to->radius + i, 0, (counted & (d->radius > old)) ? d->radius : old);
    if (k->wants & LAYOUT_STEP_OPACITY) {
        V most = LD(to->opacity + i, 0);
        ST(to->opacity + i, 0, (counted & (d->opacity > most)) ? d->opacity : most);
    }
}

// ---- appearance

#ifdef APPEARANCE_LEN
// The embedding's planes, which start at `first`.
INLINE void adam_embed(const struct adam *a, uint first, const V g[APPEARANCE_LEN], VI real)
{
    struct adam b = *a;
    VI keep = real;
    b.inv_bias2 = a->rates->inv_bias2_embed;
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        keep &= fabs(g[k]) < GRAD_LIMIT;
    for (uint k = 0; k < APPEARANCE_LEN; k++)
        ST(b.p, first + k, adam_plane(&b, first + k, b.rates->lr_embed, g[k], keep));
}
#endif

#if defined(APPEARANCE_LEN) && VW == 16
#define APPEARANCE_ARG , __constant float *frame, float each, __global float *parts
#define APPEARANCE_OPEN                                                                            \
    struct render_appearance_terms terms;                                                          \
    struct render_appearance_sums appearance_sums;                                                 \
    render_appearance_clear(&appearance_sums);
#define APPEARANCE_CLOSE                                                                           \
    if (get_global_id(0) * LAYOUT_PROJECT_GROUPS < v->groups)                                      \
        render_appearance_write(&appearance_sums, parts + get_global_id(0) * APPEARANCE_ROW);
#elif defined(APPEARANCE_LEN)
#define APPEARANCE_ARG , __global float *y_grads
#define APPEARANCE_OPEN
#define APPEARANCE_CLOSE

// For appearance_backward.cl.
inline void appearance_leave(const struct gradient *d, uint group, uint lane,
                             __global float *y_grads)
{
    for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
        ST(y_grads + group_at(group, LAYOUT_APPEARANCE_OUT) + lane, o, d->y[o]);
}
#else
#define APPEARANCE_ARG
#define APPEARANCE_OPEN
#define APPEARANCE_CLOSE
#endif

// ---- kernels

// Planes but the embedding's of the gradients of a group.
inline void gradient_store(const struct gradient *d, const V basis[LAYOUT_SH_MAX], uint used,
                           uint planes, __global float *out)
{
    for (uint p = 0; p < LAYOUT_PLANES_GEOMETRY; p++)
        ST(out, p, d->geometry[p]);
    for (uint k = 0; k < used; k++)
        for (uint c = 0; c < 3; c++)
            ST(out, LAYOUT_PLANE_SH + 3 * k + c, basis[k] * d->rgb[c]);
    for (uint p = LAYOUT_PLANE_SH + 3 * used; p < planes; p++)
        ST(out, p, (V)(0.0f));
}

__kernel void project_backward(__constant struct layout_view *v, __global const float *params,
                               __global const struct layout_splat *splats,
                               __global const uint *tiles_of, __global const uint *slot_first,
                               __global const float *slots, __global const uchar *marks,
                               __global float *grads EFFECTIVE_ARG APPEARANCE_ARG)
{
    uint to, lane, used = (v->sh_degree + 1) * (v->sh_degree + 1);
    APPEARANCE_OPEN
    for (uint group = item_groups(v, &to, &lane); group < to; group++) {
        size_t at = group_at(group, v->planes) + lane;
        uint i = group * LAYOUT_LANES + lane;
        VI visible = tiles_some(tiles_of + i);
        __global float *out = grads + at;
        if (!ANY(visible)) {
            for (uint p = 0; p < v->planes; p++)
                ST(out, p, (V)(0.0f));
            continue;
        }
        struct left in = {splats + i, tiles_of + i, slot_first + i, slots, marks};
        struct gradient d;
        V dir[3], basis[LAYOUT_SH_MAX];
        gradient_all(v, params + at, &in, visible, &d EFFECTIVE(i));
#if defined(APPEARANCE_LEN) && VW == 1
        appearance_leave(&d, group, lane, y_grads);
#endif
        seen_direction(v, params + at, dir);
        sh_basis(dir, v->sh_degree, basis);
        gradient_store(&d, basis, used, v->planes, out);
#if defined(APPEARANCE_LEN) && VW == 16
        uint first = v->planes - APPEARANCE_LEN;
        render_appearance_terms(frame, params + at + first * LAYOUT_LANES, d.y, each, visible,
                                &terms);
        render_appearance_add(&terms, &appearance_sums);
        for (uint p = 0; p < APPEARANCE_LEN; p++)
            ST(out, first + p, terms.embed[p]);
#endif
    }
    APPEARANCE_CLOSE
}

__kernel void project_step(__constant struct layout_view *v, __global float *params,
                           __global const uint *list, __global const struct layout_splat *splats,
                           __global const uint *tiles_of, __global const uint *slot_first,
                           __global const float *slots, __global const uchar *marks,
                           __global uint *moments, struct layout_adam rates,
                           __global const float *extra, __global float *stat_grad,
                           __global float *stat_absg, __global float *stat_count,
                           __global float *stat_radius, __global float *stat_opacity,
                           __global uint *repaired, __global const uint *settled,
                           __global const float *owed EFFECTIVE_ARG APPEARANCE_ARG)
{
    uint to, lane, used = (v->sh_degree + 1) * (v->sh_degree + 1), wants = rates.wants;
    struct stats stats = {stat_grad, stat_absg, stat_count, stat_radius, stat_opacity};
    APPEARANCE_OPEN
    for (uint group = item_groups(v, &to, &lane); group < to; group++) {
        uint own = v->listed ? list[group] : group, row = own * LAYOUT_LANES + lane;
        size_t at = group_at(own, v->planes) + lane;
        uint i = group * LAYOUT_LANES + lane;
        VI visible = tiles_some(tiles_of + i), real = LANE + (int)i < (int)v->n;
        struct adam a = {params + at,
                         moments + at,
                         &rates,
                         rates.inv_bias2,
                         1.0f,
                         1.0f,
                         adam_key(row, rates.step)};
        if (v->listed) {
            __global const float *left =
                owed + (size_t)(rates.step - 1 - settled[own]) * LAYOUT_DEFER_ROW;
            a.owed1 = left[LAYOUT_DEFER_DECAY];
            a.owed2 = left[LAYOUT_DEFER_DECAY + 1];
        }
        struct left in = {splats + i, tiles_of + i, slot_first + i, slots, marks};
        struct gradient d;
        V dir[3], basis[LAYOUT_SH_MAX];
#if VW == 16
        if (group + 1 < to) // records of the next group, for their colours
            for (uint k = 0; k < LAYOUT_LANES; k++)
                PREFETCH(splats + i + LAYOUT_LANES + k);
#endif
        if (ANY(visible)) {
            gradient_all(v, a.p, &in, visible, &d EFFECTIVE(i));
            seen_direction(v, a.p, dir); // before the mean moves
            sh_basis(dir, v->sh_degree, basis);
        } else {
            gradient_none(&d);
            for (uint p = 0; p < LAYOUT_SH_MAX; p++)
                basis[p] = (V)(0.0f);
        }
        gradient_extra(&d, extra, group, lane, wants);
        VI usable = gradient_usable(&d) & real;
#ifdef APPEARANCE_LEN
        for (uint o = 0; o < LAYOUT_APPEARANCE_OUT; o++)
            d.y[o] = usable ? d.y[o] : (V)(0.0f);
#if VW == 1
        if (visible)
            appearance_leave(&d, group, lane, y_grads);
#endif
#endif
        if ((wants & LAYOUT_STEP_STATS) && ANY(visible))
            stats_add(&stats, row, &d, &rates, usable & visible);
        VI bad = adam_quat(&a, &d, usable, real);
        adam_geometry(&a, &d, usable);
        adam_sh(&a, &d, basis, used, usable);
#if defined(APPEARANCE_LEN) && VW == 16
        uint plane = v->planes - APPEARANCE_LEN;
        if (ANY(visible)) {
            render_appearance_terms(frame, a.p + plane * LAYOUT_LANES, d.y, each, visible, &terms);
            render_appearance_add(&terms, &appearance_sums);
        } else {
            for (uint p = 0; p < APPEARANCE_LEN; p++)
                terms.embed[p] = (V)(0.0f);
        }
        adam_embed(&a, plane, terms.embed, real);
#endif
        bad |= real & !usable;
        if ((wants & LAYOUT_STEP_STATS) && ANY(bad))
            atomic_add(repaired, lanes_count(bad)); // whole numbers: any order gives the same sum
    }
    APPEARANCE_CLOSE
}
