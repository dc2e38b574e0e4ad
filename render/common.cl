// Behind core/device/vector.cl in every program of render/: the maths that forward and backward
// must agree on to the last bit (what a splat is on the screen, and what it does to a pixel).

// How many lanes are set.
INLINE uint lanes_count(VI mask)
{
#if VW == 16
    int16 one = mask & (VI)(1);
    int8 a = one.lo + one.hi;
    int4 b = a.lo + a.hi;
    return (uint)((b.x + b.y) + (b.z + b.w));
#else
    return mask ? 1 : 0;
#endif
}

#if VW == 16
// 16 words of 16 lanes <-> 16 records of 16 words: four perfect shuffles.
INLINE void transpose_16(V w[16])
{
    V t[16];
#pragma unroll
    for (int round = 0; round < 2; round++) {
#pragma unroll
        for (int i = 0; i < 8; i++) {
            t[2 * i].even = w[i].lo;
            t[2 * i].odd = w[i + 8].lo;
            t[2 * i + 1].even = w[i].hi;
            t[2 * i + 1].odd = w[i + 8].hi;
        }
#pragma unroll
        for (int i = 0; i < 8; i++) {
            w[2 * i].even = t[i].lo;
            w[2 * i].odd = t[i + 8].lo;
            w[2 * i + 1].even = t[i].hi;
            w[2 * i + 1].odd = t[i + 8].hi;
        }
    }
}
#endif

#define LOG2E 1.44269504088896f
#define LN2_2 1.38629436111989f // 2 ln 2

// 2^x for x in [-126, 127], relative error 1.5e-7: rounding by adding 1.5 * 2^23, then a polynomial
// for the fraction in [-1/2, 1/2] (minimax, 7.5e-8). Needs IEEE addition, that is no fast-math.
INLINE V exp2_v(V x)
{
    V r = x + 12582912.0f, f = x - (r - 12582912.0f);
    V p = f * 0.0013276472f + 0.009675541334f;
    p = p * f + 0.05550713273f;
    p = p * f + 0.2402211972f;
    p = p * f + 0.6931469671f;
    p = p * f + 1.000000072f;
    return AS_V(AS_VI(p) + (AS_VI(r) << 23));
}

// 2^e at offset d = mean - pixel, 0 below 1/255: opacity times the falloff of one splat (struct
// layout_splat). alpha is MIN_(splat_raw, LAYOUT_ALPHA_MAX).
INLINE V splat_raw(V dx, V dy, float p, float x_of_y, float r, float opacity_log2)
{
    V u = (dx - x_of_y * dy) * p, v = dy * r;
    V e = (opacity_log2 - u * u) - v * v;
    V a = exp2_v(e);
    return e >= LAYOUT_ALPHA_MIN_LOG2 ? a : (V)(0.0f); // far away a is garbage, and not taken
}

// Where a depth is known: x = scale m + shift is how many footprints of a pixel a splat at depth m
// (core/layout.h) lies behind it. known: known_zeta / the depth; not above 0: not known, x is 0.
INLINE void ray_known(__constant struct layout_view *v, V known, V *scale, V *shift)
{
    VI is = known > 0.0f;
    *scale = is ? known * (v->fx / v->known_zeta) : (V)(0.0f);
    *shift = is ? *scale - v->fx : (V)(0.0f);
}

// What a splat at depth m adds to both sums along a ray, over its weight alpha T, and the slopes by
// m. Moments of depth: m and m^2. About a known depth: its side, from -1/2 before it to 1/2 behind
// it, and how much it is away, up to 1 before it and LAYOUT_AWAY_BEHIND behind it; see
// render_moments_buffer. about: a literal on CPUs.
INLINE void ray_values(V m, V scale, V shift, const int about, V value[2], V slope[2])
{
    if (!about) {
        value[0] = m;
        value[1] = m * m;
        slope[0] = (V)(1.0f);
        slope[1] = 2.0f * m;
        return;
    }
    V x = scale * m + shift, far = fabs(x), k = 1.0f / (LAYOUT_SIDE_PX + far);
    V steep = scale * k * k, away = far - LAYOUT_AWAY_PX;
    VI behind = x > 0.0f, is = away > 0.0f;
    value[0] = 0.5f * x * k;
    value[1] = is ? away * k * (behind ? (V)(LAYOUT_AWAY_BEHIND) : (V)(1.0f)) : (V)(0.0f);
    slope[0] = (0.5f * LAYOUT_SIDE_PX) * steep;
    slope[1] = is ? (LAYOUT_SIDE_PX + LAYOUT_AWAY_PX) * steep *
                        (behind ? (V)(LAYOUT_AWAY_BEHIND) : (V)(-1.0f))
                  : (V)(0.0f);
}

// A Gaussian as the camera sees it; names as in render_ref.h. Lanes that are culled hold anything.
struct seen {
    V cam[3];                   // t = W mu + d
    V qw, qx, qy, qz, quat_len; // normalised; length before, at least 1e-12
    V rot[9];                   // R, row-major
    V scale[3];                 // sigma
    V inv_z;
    V clamped[2];    // t'x / z, t'y / z
    V jw[6];         // J W, 2 x 3
    V pr[6];         // P = J W R, 2 x 3, before scaling by sigma
    V s00, s01, s11; // S, kernel included
    V det0, det;
    V opacity, rho; // sigmoid; compensation
};

// Camera-space mean; the mask of lanes in front of the near plane.
INLINE VI seen_mean(__constant struct layout_view *v, __global const float *g, struct seen *s)
{
    V x = LD(g, LAYOUT_PLANE_MEAN), y = LD(g, LAYOUT_PLANE_MEAN + 1),
      z = LD(g, LAYOUT_PLANE_MEAN + 2);
    s->cam[0] = v->rot[0] * x + (v->rot[1] * y + (v->rot[2] * z + v->trans[0]));
    s->cam[1] = v->rot[3] * x + (v->rot[4] * y + (v->rot[5] * z + v->trans[1]));
    s->cam[2] = v->rot[6] * x + (v->rot[7] * y + (v->rot[8] * z + v->trans[2]));
    return (s->cam[2] > v->near_m) & (s->cam[2] < LAYOUT_DEPTH_MAX);
}

INLINE void seen_rotation(__global const float *g, struct seen *s)
{
    V w = LD(g, LAYOUT_PLANE_QUAT), x = LD(g, LAYOUT_PLANE_QUAT + 1),
      y = LD(g, LAYOUT_PLANE_QUAT + 2), z = LD(g, LAYOUT_PLANE_QUAT + 3);
    V len = sqrt(w * w + (x * x + (y * y + z * z)));
    len = MAX_(len, 1e-12f);
    V k = 1.0f / len;
    w *= k;
    x *= k;
    y *= k;
    z *= k;
    s->quat_len = len;
    s->qw = w;
    s->qx = x;
    s->qy = y;
    s->qz = z;
    s->rot[0] = 1.0f - 2.0f * (y * y + z * z);
    s->rot[1] = 2.0f * (x * y - w * z);
    s->rot[2] = 2.0f * (x * z + w * y);
    s->rot[3] = 2.0f * (x * y + w * z);
    s->rot[4] = 1.0f - 2.0f * (x * x + z * z);
    s->rot[5] = 2.0f * (y * z - w * x);
    s->rot[6] = 2.0f * (x * z - w * y);
    s->rot[7] = 2.0f * (y * z + w * x);
    s->rot[8] = 1.0f - 2.0f * (x * x + y * y);
}

// Everything about the ellipse, after seen_mean; the mask of lanes with a usable one.
INLINE VI seen_ellipse(__constant struct layout_view *v, __global const float *g, struct seen *s)
{
    V z = s->cam[2], iz = v->orthographic ? (V)(1.0f) : 1.0f / z; // then the limits are 0, too
    seen_rotation(g, s);
    s->inv_z = iz;
    s->clamped[0] = CLAMP_(s->cam[0] * iz, -v->lim_neg_x, v->lim_pos_x);
    s->clamped[1] = CLAMP_(s->cam[1] * iz, -v->lim_neg_y, v->lim_pos_y);
    V fx = v->fx * iz, fy = v->fy * iz;
    for (int m = 0; m < 3; m++) {
        s->jw[m] = fx * (v->rot[m] - s->clamped[0] * v->rot[6 + m]);
        s->jw[3 + m] = fy * (v->rot[3 + m] - s->clamped[1] * v->rot[6 + m]);
    }
    V p[6];
    for (int c = 0; c < 3; c++)
        s->scale[c] = exp(LD(g, LAYOUT_PLANE_SCALE + c));
    for (int c = 0; c < 3; c++) {
        s->pr[c] = s->jw[0] * s->rot[c] + (s->jw[1] * s->rot[3 + c] + s->jw[2] * s->rot[6 + c]);
        s->pr[3 + c] = s->jw[3] * s->rot[c] + (s->jw[4] * s->rot[3 + c] + s->jw[5] * s->rot[6 + c]);
        p[c] = s->pr[c] * s->scale[c];
        p[3 + c] = s->pr[3 + c] * s->scale[c];
    }
    V c00 = p[0] * p[0] + (p[1] * p[1] + p[2] * p[2]);
    V c11 = p[3] * p[3] + (p[4] * p[4] + p[5] * p[5]);
    s->s01 = p[0] * p[3] + (p[1] * p[4] + p[2] * p[5]);
    // det S0 by Cauchy-Binet, a sum of squares: no cancellation for needles.
    V m01 = p[0] * p[4] - p[1] * p[3], m02 = p[0] * p[5] - p[2] * p[3],
      m12 = p[1] * p[5] - p[2] * p[4];
    s->det0 = m01 * m01 + (m02 * m02 + m12 * m12);
    s->det = s->det0 + v->kernel_px2 * ((c00 + c11) + v->kernel_px2);
    s->s00 = c00 + v->kernel_px2;
    s->s11 = c11 + v->kernel_px2;
    s->opacity = 1.0f / (1.0f + exp(-LD(g, LAYOUT_PLANE_OPACITY)));
    s->rho = (V)(1.0f);
    if (v->compensate) {
        V ratio = s->det0 / s->det;
        s->rho = sqrt(MAX_(ratio, LAYOUT_RHO2_MIN));
    }
    VI ok = (s->det > 0.0f) & (s->det < LAYOUT_DET_MAX);
#ifndef APPEARANCE_LEN // with it, opacity is not final yet
    ok &= s->opacity * s->rho >= LAYOUT_ALPHA_MIN;
#endif
    return ok;
}

// Normalised direction from the eye to the mean; the optical axis of an orthographic view.
INLINE void seen_direction(__constant struct layout_view *v, __global const float *g, V dir[3])
{
    V x = LD(g, LAYOUT_PLANE_MEAN) - v->eye[0], y = LD(g, LAYOUT_PLANE_MEAN + 1) - v->eye[1],
      z = LD(g, LAYOUT_PLANE_MEAN + 2) - v->eye[2];
    V len = sqrt(x * x + (y * y + z * z));
    V k = 1.0f / MAX_(len, 1e-12f);
    dir[0] = v->orthographic ? (V)(v->rot[6]) : x * k;
    dir[1] = v->orthographic ? (V)(v->rot[7]) : y * k;
    dir[2] = v->orthographic ? (V)(v->rot[8]) : z * k;
}

// Real spherical harmonics, the signs of 3D Gaussian Splatting, up to `degree`; (degree + 1)^2
// values.
INLINE void sh_basis(const V dir[3], uint degree, V out[LAYOUT_SH_MAX])
{
    V x = dir[0], y = dir[1], z = dir[2];
    out[0] = (V)(0.28209479177387814f);
    if (degree >= 1) {
        out[1] = -0.4886025119029199f * y;
        out[2] = 0.4886025119029199f * z;
        out[3] = -0.4886025119029199f * x;
    }
    if (degree >= 2) {
        V xx = x * x, yy = y * y, zz = z * z;
        out[4] = 1.0925484305920792f * (x * y);
        out[5] = -1.0925484305920792f * (y * z);
        out[6] = 0.31539156525252005f * (2.0f * zz - xx - yy);
        out[7] = -1.0925484305920792f * (x * z);
        out[8] = 0.5462742152960396f * (xx - yy);
        if (degree >= 3) {
            out[9] = -0.5900435899266435f * y * (3.0f * xx - yy);
            out[10] = 2.890611442640554f * (x * y) * z;
            out[11] = -0.4570457994644658f * y * (4.0f * zz - xx - yy);
            out[12] = 0.3731763325901154f * z * (2.0f * zz - 3.0f * xx - 3.0f * yy);
            out[13] = -0.4570457994644658f * x * (4.0f * zz - xx - yy);
            out[14] = 1.445305721320277f * z * (xx - yy);
            out[15] = -0.5900435899266435f * x * (xx - 3.0f * yy);
        }
    }
}
