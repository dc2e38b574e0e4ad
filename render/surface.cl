// Stage: where the surface of the last frame lies. Replays the blending of the frame and keeps, for
// every pixel, the depth of the Gaussian's centre at which transmittance falls to 1/2, the mean
// depth, and how much of the colour comes from in front of a given depth.
//   in   splats, tile_start, intersection_splat, depth_key: the frame
//        limit [h][w]: m; not read without
//   out  maps [LAYOUT_SURFACE_MAPS][h][w]: median depth in m, 0 where transmittance stays above 1/2; mean depth
//        sum alpha T z / sum alpha T, 0 where nothing is; sum alpha T of what is nearer than limit
// VW 16: a work-item is a row of a tile, VW 1: a pixel.

__kernel void surface_rows(__constant struct layout_view *view,
                           __global const struct layout_splat *splats,
                           __global const uint *tile_start, __global const uint *intersection_splat,
                           __global const uint *depth_key, __global const float *limit,
                           uint limited, __global float *maps)
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
      front = (V)(0.0f);
    for (uint i = tile_start[tile], end = tile_start[tile + 1]; i < end; i++) {
        __global const struct layout_splat *s = splats + intersection_splat[i];
        float z = as_float(depth_key[intersection_splat[i]]), dy = s->mean_y - ((float)y + 0.5f);
        V a = splat_raw(s->mean_x - px, (V)(dy), s->p, s->x_of_y, s->r, s->opacity_log2);
        a = MIN_(a, LAYOUT_ALPHA_MAX);
        a = t > LAYOUT_TRANSMITTANCE_MIN ? a : (V)(0.0f);
        V share = a * t, left = t - share;
        median = ((t > 0.5f) & (left <= 0.5f)) ? (V)(z) : median;
        sum += share * z;
        front += (V)(z) < far ? share : (V)(0.0f);
        t = left;
        if ((i & 15) == 15 && !ANY(t > LAYOUT_TRANSMITTANCE_MIN))
            break;
    }
    V drawn = 1.0f - t;
    V mean = drawn > 0.0f ? sum / drawn : (V)(0.0f);
#if VW == 16
    vstore16(median, 0, row_maps[LAYOUT_SURFACE_MEDIAN]);
    vstore16(mean, 0, row_maps[LAYOUT_SURFACE_MEAN]);
    vstore16(front, 0, row_maps[LAYOUT_SURFACE_FRONT]);
#else
    row_maps[LAYOUT_SURFACE_MEDIAN][0] = median;
    row_maps[LAYOUT_SURFACE_MEAN][0] = mean;
    row_maps[LAYOUT_SURFACE_FRONT][0] = front;
#endif
    for (uint m = 0; m < LAYOUT_SURFACE_MAPS; m++)
        for (uint k = 0; k < n; k++)
            maps[m * plane + at + k] = row_maps[m][k];
}
