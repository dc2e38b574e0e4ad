/* Stage: importance of splats in a frame, for density control. Replays the blending of the last frame and adds
 * up, for every Gaussian, over the pixels it was blended into:
 *
 *   in   splats, tile_start, entry_splat, entry_slot, slot_first, tiles_of, depth_key: the frame
 *        weight float [h][w]: what a pixel counts
 *   out  slots float [entries][4] (cleared by the host): weight, 1, alpha T, distance of the pixel from the mean
 *        sums  float [n][8]: those four, then depth in m, half-size in px, 0, 0; all 0 where invisible
 *
 * Shape and order as blend_backward.cl, whose masks, loads and sums over lanes it uses: one writer a slot, fixed
 * order, same bits. Source of the sums: Taming 3DGS, Mallick et al. 2024, section 4.
 */

#if VW == 16

struct score_pixels {
    float16 transmit[BLOCKS], weight[BLOCKS];
};

static uint score_load(struct score_pixels *s, __constant struct layout_view *v,
                       __global const float *weight, int x0, int y0)
{
    int w = v->width, h = v->height;
    uint active = 0;
    for (int b = 0; b < BLOCKS; b++) {
        int x = x0 + 4 * (b & 3), y = y0 + 4 * (b >> 2);
        int16 in = (x + (LANE & 3) < w) & (y + (LANE >> 2) < h);
        s->weight[b] = block_load(weight, w, h, x, y);
        s->transmit[b] = in ? (float16)(1.0f) : (float16)(0.0f);
        active |= any(in) ? 1u << b : 0;
    }
    return active;
}

static void score_splat(struct score_pixels *s, const struct layout_splat *e, uint mask, float x0, float y0,
                        __global float *slot)
{
    float16 weight = 0.0f, count = 0.0f, share = 0.0f, dist = 0.0f;
    const float16 lane_x = e->mean_x - x0 - 0.5f - convert_float16(LANE & 3);
    const float16 lane_y = e->mean_y - y0 - 0.5f - convert_float16(LANE >> 2);
    do {
        uint b = 31 - clz(mask & -mask);
        mask &= mask - 1;
        float16 dx = lane_x - (float)(4 * (b & 3)), dy = lane_y - (float)(4 * (b >> 2));
        float16 raw = splat_raw(dx, dy, e->p, e->x_of_y, e->r, e->opacity_log2);
        float16 t = s->transmit[b], alpha = MIN_(raw, ALPHA_MAX);
        int16 hit = (t > T_STOP) & (raw > 0.0f);
        alpha = hit ? alpha : (float16)(0.0f);
        float16 one = hit ? (float16)(1.0f) : (float16)(0.0f);
        s->transmit[b] = t - alpha * t;
        weight += one * s->weight[b];
        count += one;
        share += alpha * t;
        dist += one * sqrt(dx * dx + dy * dy);
    } while (mask);
    vstore4(fold16(fold4(fold2(weight, count), fold2(share, dist))), 0, slot);
}

static uint score_alive(const struct score_pixels *s, uint active)
{
    uint alive = 0;
    for (uint b = 0; b < BLOCKS; b++)
        if (active >> b & 1)
            alive |= any(s->transmit[b] > T_STOP) ? 1u << b : 0;
    return alive;
}

__kernel void score_tiles(__constant struct layout_view *v, __global const struct layout_splat *splats,
                          __global const uint *tile_start, __global const uint *entry_splat,
                          __global const uint *entry_slot, __global const float *weight,
                          __global float *slots)
{
    uint tile = get_global_id(0);
    if (tile >= v->tiles_x * v->tiles_y)
        return;
    int x0 = tile % v->tiles_x * LAYOUT_TILE, y0 = tile / v->tiles_x * LAYOUT_TILE;
    uint begin = tile_start[tile], end = tile_start[tile + 1];
    struct layout_splat batch[BATCH];
    struct score_pixels pixels;
    if (begin == end)
        return;
    uint active = score_load(&pixels, v, weight, x0, y0);
    for (uint at = begin; at < end && active; at += BATCH) {
        uint n = min(end - at, (uint)BATCH);
        for (uint i = 0; i < n; i++)
            batch[i] = splats[entry_splat[at + i]];
        for (uint i = 0; i < n && active; i++) {
            uint m = block_mask(&batch[i], (float)x0, (float)y0) & active;
            if (m)
                score_splat(&pixels, &batch[i], m, (float)x0, (float)y0,
                            slots + 4 * (size_t)entry_slot[at + i]);
            if ((i & 15) == 15)
                active = score_alive(&pixels, active);
        }
    }
}

#else

/* GPU shape: one work-group = one tile, one work-item = one pixel; each entry is summed by a tree of fixed shape. */
__kernel __attribute__((reqd_work_group_size(LAYOUT_TILE *LAYOUT_TILE, 1, 1))) void
score_tiles(__constant struct layout_view *v, __global const struct layout_splat *splats,
            __global const uint *tile_start, __global const uint *entry_splat,
            __global const uint *entry_slot, __global const float *weight, __global float *slots)
{
    uint tile = get_group_id(0), lane = get_local_id(0);
    uint x = tile % v->tiles_x * LAYOUT_TILE + lane % LAYOUT_TILE;
    uint y = tile / v->tiles_x * LAYOUT_TILE + lane / LAYOUT_TILE;
    int in = tile < v->tiles_x * v->tiles_y && x < v->width && y < v->height;
    float t = in ? 1.0f : 0.0f, own = in ? weight[(size_t)y * v->width + x] : 0.0f;
    uint begin = tile_start[tile], end = tile_start[tile + 1];
    __local float4 part[LAYOUT_TILE * LAYOUT_TILE];
    for (uint at = begin; at < end; at++) {
        __global const struct layout_splat *e = splats + entry_splat[at];
        float dx = e->mean_x - (float)x - 0.5f, dy = e->mean_y - (float)y - 0.5f;
        float raw = splat_raw(dx, dy, e->p, e->x_of_y, e->r, e->opacity_log2);
        float alpha = MIN_(raw, ALPHA_MAX);
        int hit = t > T_STOP && raw > 0.0f;
        part[lane] = hit ? (float4)(own, 1.0f, alpha * t, sqrt(dx * dx + dy * dy)) : (float4)(0.0f);
        t = hit ? t - alpha * t : t;
        for (uint half_n = LAYOUT_TILE * LAYOUT_TILE / 2; half_n; half_n /= 2) {
            barrier(CLK_LOCAL_MEM_FENCE);
            if (lane < half_n)
                part[lane] += part[lane + half_n];
        }
        if (lane == 0)
            vstore4(part[0], 0, slots + 4 * (size_t)entry_slot[at]);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

#endif

/* Half-size of the box around a splat where it reaches 1/255, px: the larger of width and height. */
static float score_radius(const struct layout_splat *e)
{
    float s11 = 0.5f * LOG2E / (e->r * e->r);
    float s00 = 0.5f * LOG2E / (e->p * e->p) + e->x_of_y * e->x_of_y * s11;
    float reach = 2.0f * (e->opacity_log2 - ALPHA_MIN_LOG2) / LOG2E;
    reach = MIN_(reach, LAYOUT_EXTENT_MAX * LAYOUT_EXTENT_MAX);
    float largest = MAX_(s00, s11);
    return reach > 0.0f ? sqrt(reach * largest) : 0.0f;
}

__kernel void score_gather(uint n, __global const struct layout_splat *splats,
                           __global const uint *depth_key, __global const uint *tiles_of,
                           __global const uint *slot_first, __global const float *slots,
                           __global float *sums)
{
    uint i = get_global_id(0);
    if (i >= n)
        return;
    float4 sum = (float4)(0.0f), shape = (float4)(0.0f);
    uint tiles = tiles_of[i], first = slot_first[i];
    if (tiles) {
        struct layout_splat e = splats[i];
        shape.x = as_float(depth_key[i]);
        shape.y = score_radius(&e);
    }
    for (uint k = 0; k < tiles; k++)
        sum += vload4(first + k, slots);
    vstore4(sum, 2 * (size_t)i, sums);
    vstore4(shape, 2 * (size_t)i + 1, sums);
}
