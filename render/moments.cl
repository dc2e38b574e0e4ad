// Stage: planes of splats, between the tile lists and blend, in frames with sums along rays.
//   in   params, tiles_of
//   out  splats: words LAYOUT_SPLAT_DEPTH and the two behind it, of those that are visible
//
// How deep does a pixel's ray meet a Gaussian? Under the local affine map of EWA splatting the
// pixel (u, v) and the depth z of a point of the Gaussian are jointly normal. So the depth at which
// the ray meets the most of it is the regression of z on the pixel:
//     z(pixel) = z - c^T S^-1 d,   c = cov((u, v), z) = P p_z^T,   d = mean - pixel
// with P = J W R diag(s), p_z the third row of W R diag(s), S = P P^T + eps I (Zwicker et al. 2001;
// RaDe-GS, Zhang et al. 2024, has the same plane without eps). Of a flat disc it is the disc's own
// plane. |z(pixel) - z| is never more than the Gaussian's own depth, also where it is seen edge-on.
// In Cholesky form S^-1 = 2 ln2 L L^T, N = L^T P: the tilt is -2 ln2 L (N p_z).
// Reference: ref_plane in render_ref.c.

INLINE void plane_of(__constant struct layout_view *v, __global const float *g, V out[3])
{
    struct seen s;
    (void)seen_mean(v, g, &s);
    (void)seen_ellipse(v, g, &s);
    V x_of_y = s.s01 / s.s11, r = sqrt((0.5f * LOG2E) / s.s11),
      p = sqrt((0.5f * LOG2E) * s.s11 / s.det), n0 = (V)(0.0f), n1 = (V)(0.0f);
    for (int k = 0; k < 3; k++) {
        V p0 = s.pr[k] * s.scale[k], p1 = s.pr[3 + k] * s.scale[k];
        V axis_z = v->rot[6] * s.rot[k] + (v->rot[7] * s.rot[3 + k] + v->rot[8] * s.rot[6 + k]);
        V z = axis_z * s.scale[k];
        n0 = p * (p0 - x_of_y * p1) * z + n0;
        n1 = r * p1 * z + n1;
    }
    float unit = 1.0f / v->depth_unit_m;
    V k0 = -LN2_2 * n0, k1 = -LN2_2 * n1;
    out[0] = (s.cam[2] - v->depth_unit_m) * unit;
    out[1] = unit * (p * k0);
    out[2] = unit * (r * k1 - x_of_y * (p * k0));
}

__kernel void planes(__constant struct layout_view *view, __global const float *params,
                     __global const uint *list, __global const uint *tiles_of,
                     __global struct layout_splat *splats)
{
    size_t item = get_global_id(0);
#if VW == 16
    size_t end = min((item + 1) * LAYOUT_PROJECT_GROUPS, (size_t)view->groups);
    for (size_t group = item * LAYOUT_PROJECT_GROUPS; group < end; group++) {
        VU tiles = LAYOUT_WIDE(const __global, uint, tiles_of + LAYOUT_LANES * group);
        size_t from = view->listed ? list[group] : group;
        V plane[3];
        float rows[3][LAYOUT_LANES];
        if (!ANY(tiles != 0))
            continue;
        plane_of(view, params + from * view->planes * LAYOUT_LANES, plane);
        for (int k = 0; k < 3; k++)
            vstore16(plane[k], 0, rows[k]);
        for (int lane = 0; lane < LAYOUT_LANES; lane++) {
            __global float *w = (__global float *)(splats + group * LAYOUT_LANES + lane);
            if (tiles_of[group * LAYOUT_LANES + lane])
                vstore3((float3)(rows[0][lane], rows[1][lane], rows[2][lane]), 0,
                        w + LAYOUT_SPLAT_DEPTH);
        }
    }
#else
    if (item >= (size_t)view->groups * LAYOUT_LANES || !tiles_of[item])
        return;
    size_t group = item / LAYOUT_LANES, lane = item % LAYOUT_LANES;
    size_t from = view->listed ? list[group] : group;
    V plane[3];
    plane_of(view, params + from * view->planes * LAYOUT_LANES + lane, plane);
    for (int k = 0; k < 3; k++)
        ((__global float *)(splats + item))[LAYOUT_SPLAT_DEPTH + k] = plane[k];
#endif
}
