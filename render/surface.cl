// Stage: where the surface of the last frame lies. Replays the blending of the frame and keeps, for
// every pixel, the depth at which transmittance falls to 1/2, the mean depth, how much of the
// colour comes from in front of a given depth, and how thick the surface is.
//   in   splats, tile_start, intersection_splat, depth_key: the frame
//        tilts: what surface_tilts made of its Gaussians
//        limit [h][w]: m; not read without
//        median_alone: the other maps are not wanted; they come out wrong
//   out  maps [LAYOUT_SURFACE_MAPS][h][w]: median depth in m, 0 where transmittance stays above
//        1/2; mean depth sum alpha T z / sum alpha T, 0 where nothing is; sum alpha T of what is
//        nearer than limit; depths at which transmittance falls to LAYOUT_SURFACE_OPEN and
//        LAYOUT_SURFACE_OPAQUE, 0 where it stays above; how many Gaussians are met until it is
//        opaque, that one included
// VW 16: a work-item is a row of a tile, VW 1: a pixel.
//
// The depth of a Gaussian at a pixel is where the pixel's ray meets the most of it. With A =
// sigma^-1 in the camera frame, the ray t r of the pixel, the Gaussian's centre on the ray z r0 and
// d = r0 - r:
//     t = r^T A (z r0) / r^T A r = z (1 + r^T A d / r^T A r)
// Of a flat disc that is where the ray goes through its plane. Centres' own depths are wrong by the
// size of a Gaussian where a surface is seen aslant, along a street by tens of per cent. t stays
// within the Gaussian's own depth: rays that miss a disc seen edge-on cross its plane anywhere.

// Of the Gaussians that are visible, tilts [groups][LAYOUT_SURFACE_TILT][16]: A as 00 01 02 11 12
// 22 over the largest of its eigenvalues, and half of the Gaussian's own depth, m.
INLINE void tilt_of(__constant struct layout_view *v, __global const float *g, __global float *out)
{
    struct seen s;
    V tilt[LAYOUT_SURFACE_TILT], own[3], least, depth2 = (V)(0.0f);
    (void)seen_mean(v, g, &s);
    (void)seen_ellipse(v, g, &s);
    for (int k = 0; k < 3; k++)
        own[k] = MAX_(s.scale[k], 1e-12f) * MAX_(s.scale[k], 1e-12f);
    least = MIN_(own[0], own[1]);
    least = MIN_(least, own[2]);
    for (int i = 0; i < LAYOUT_SURFACE_TILT; i++)
        tilt[i] = (V)(0.0f);
    for (int k = 0; k < 3; k++) {
        V axis[3], w = least / own[k];
        for (int c = 0; c < 3; c++)
            axis[c] = v->rot[3 * c] * s.rot[k] +
                      (v->rot[3 * c + 1] * s.rot[3 + k] + v->rot[3 * c + 2] * s.rot[6 + k]);
        for (int i = 0, at = 0; i < 3; i++)
            for (int j = i; j < 3; j++, at++)
                tilt[at] += w * axis[i] * axis[j];
        depth2 += own[k] * axis[2] * axis[2];
    }
    tilt[LAYOUT_SURFACE_TILT - 1] = LAYOUT_EXTENT_MAX * sqrt(depth2);
    for (int i = 0; i < LAYOUT_SURFACE_TILT; i++)
        ST(out, i, tilt[i]);
}

__kernel void surface_tilts(__constant struct layout_view *view, __global const float *params,
                            __global const uint *list, __global const uint *depth_key,
                            __global float *tilts)
{
    size_t item = get_global_id(0);
#if VW == 16
    size_t end = min((item + 1) * LAYOUT_PROJECT_GROUPS, (size_t)view->groups);
    for (size_t group = item * LAYOUT_PROJECT_GROUPS; group < end; group++) {
        size_t from = view->listed ? list[group] : group;
        VU key = LAYOUT_WIDE(const __global, uint, depth_key + LAYOUT_LANES * group);
        if (ANY(key != 0xFFFFFFFFu))
            tilt_of(view, params + from * view->planes * LAYOUT_LANES,
                    tilts + group_at((uint)group, LAYOUT_SURFACE_TILT));
    }
#else
    if (item >= (size_t)view->groups * LAYOUT_LANES || depth_key[item] == 0xFFFFFFFFu)
        return;
    size_t group = item / LAYOUT_LANES, lane = item % LAYOUT_LANES;
    size_t from = view->listed ? list[group] : group;
    tilt_of(view, params + from * view->planes * LAYOUT_LANES + lane,

            tilts + group_at((uint)group, LAYOUT_SURFACE_TILT) + lane);
#endif
}

// Depth of a Gaussian along the rays of some pixels. d: mean - pixel, px.
INLINE V tilt_depth(__constant struct layout_view *v, __global const float *tilts, uint splat,
                    float z, V px, float py, V dx_px, float dy_px)
{
    __global const float *a =
        tilts + group_at(splat / LAYOUT_LANES, LAYOUT_SURFACE_TILT) + splat % LAYOUT_LANES;
    float a00 = a[0], a01 = a[LAYOUT_LANES], a02 = a[2 * LAYOUT_LANES], a11 = a[3 * LAYOUT_LANES],
          a12 = a[4 * LAYOUT_LANES], a22 = a[5 * LAYOUT_LANES], reach = a[6 * LAYOUT_LANES];
    float y = v->orthographic ? 0.0f : (py - v->cy) / v->fy, dy = dy_px / v->fy;
    V x = v->orthographic ? (V)(0.0f) : (px - v->cx) / v->fx, dx = dx_px / v->fx;
    V rx = a00 * x + (a01 * y + a02), ry = a01 * x + (a11 * y + a12), // r^T A
        rz = a02 * x + (a12 * y + a22);
    V len = x * rx + (y * ry + rz);
    len = MAX_(len, 1e-20f);
    V off = (v->orthographic ? 1.0f : z) * (rx * dx + ry * dy) / len;
    V t = z + CLAMP_(off, -reach, reach);
    return MAX_(t, v->near_m);
}

__kernel void surface_rows(__constant struct layout_view *view,
                           __global const struct layout_splat *splats,
                           __global const uint *tile_start, __global const uint *intersection_splat,
                           __global const uint *depth_key, __global const float *tilts,
                           __global const float *limit, uint limited, uint median_alone,
                           __global float *maps)
{
#if VW == 16
    uint item = (uint)get_global_id(0), tile = item / LAYOUT_TILE, row = item % LAYOUT_TILE;
    uint column = 0;
#else
    uint item = (uint)get_global_id(0), tile = item / LAYOUT_TILE_PIXELS;
    uint row = item / LAYOUT_TILE % LAYOUT_TILE, column = item % LAYOUT_TILE;
#endif
    if (tile >= view->tiles_x * view->tiles_y)
        return;
    uint x = tile % view->tiles_x * LAYOUT_TILE + column;
    uint y = tile / view->tiles_x * LAYOUT_TILE + row;
    if (x >= view->width || y >= view->height)
        return;
    size_t at = (size_t)y * view->width + x, plane = (size_t)view->width * view->height;
    uint n = min((uint)VW, view->width - x);
    float row_limit[VW], row_maps[LAYOUT_SURFACE_MAPS][VW];
    for (uint k = 0; k < VW; k++)
        row_limit[k] = limited && k < n ? limit[at + k] : 0.0f;
#if VW == 16
    V far = vload16(0, row_limit);
#else
    V far = row_limit[0];
#endif
    V px = (float)x + 0.5f + TO_V(LANE), t = (V)(1.0f), median = (V)(0.0f), sum = (V)(0.0f),
      front = (V)(0.0f), opening = (V)(0.0f), opaque = (V)(0.0f), met = (V)(0.0f);
    // Beyond it nothing is wanted.
    const float last = median_alone ? 0.5f : LAYOUT_TRANSMITTANCE_MIN;
    for (uint i = tile_start[tile], end = tile_start[tile + 1]; i < end; i++) {
        if ((i & 15) == 0 && !ANY(t > last))
            break;
        __global const struct layout_splat *s = splats + intersection_splat[i];
        float dy = s->mean_y - ((float)y + 0.5f);
        V dx = s->mean_x - px;
        V a = splat_raw(dx, (V)(dy), s->p, s->x_of_y, s->r, s->opacity_log2);
        a = MIN_(a, LAYOUT_ALPHA_MAX);
        a = t > LAYOUT_TRANSMITTANCE_MIN ? a : (V)(0.0f);
        if (!ANY(a > 0.0f))
            continue;
        V share = a * t, left = t - share;
        if (median_alone && !ANY((t > 0.5f) & (left <= 0.5f))) {
            t = left; // most Gaussians are the median of no pixel, and depth is what costs
            continue;
        }
        V z = tilt_depth(view, tilts, intersection_splat[i],
                         as_float(depth_key[intersection_splat[i]]), px, (float)y + 0.5f, dx, dy);
        median = ((t > 0.5f) & (left <= 0.5f)) ? z : median;
        sum += share * z;
        front += z < far ? share : (V)(0.0f);
        opening = ((t > LAYOUT_SURFACE_OPEN) & (left <= LAYOUT_SURFACE_OPEN)) ? z : opening;
        opaque = ((t > LAYOUT_SURFACE_OPAQUE) & (left <= LAYOUT_SURFACE_OPAQUE)) ? z : opaque;
        met += ((t > LAYOUT_SURFACE_OPAQUE) & (a > 0.0f)) ? (V)(1.0f) : (V)(0.0f);
        t = left;
    }
    V drawn = 1.0f - t;
    V mean = drawn > 0.0f ? sum / drawn : (V)(0.0f);
#if VW == 16
    vstore16(median, 0, row_maps[LAYOUT_SURFACE_MEDIAN]);
    vstore16(mean, 0, row_maps[LAYOUT_SURFACE_MEAN]);
    vstore16(front, 0, row_maps[LAYOUT_SURFACE_FRONT]);
    vstore16(opening, 0, row_maps[LAYOUT_SURFACE_NEAR]);
    vstore16(opaque, 0, row_maps[LAYOUT_SURFACE_FAR]);
    vstore16(met, 0, row_maps[LAYOUT_SURFACE_MET]);
#else
    row_maps[LAYOUT_SURFACE_MEDIAN][0] = median;
    row_maps[LAYOUT_SURFACE_MEAN][0] = mean;
    row_maps[LAYOUT_SURFACE_FRONT][0] = front;
    row_maps[LAYOUT_SURFACE_NEAR][0] = opening;
    row_maps[LAYOUT_SURFACE_FAR][0] = opaque;
    row_maps[LAYOUT_SURFACE_MET][0] = met;
#endif
    for (uint m = 0; m < LAYOUT_SURFACE_MAPS; m++)
        for (uint k = 0; k < n; k++)
            maps[m * plane + at + k] = row_maps[m][k];
}
