// Stage: importance of splats in a frame, for density control. On CPUs it is compiled after
// blend_cpu.cl and blend_backward.cl, and uses their hits and sums. It repeats the blending of the
// last frame and sums, for every Gaussian, over the pixels in which it was blended:
//   in   splats, tile_start, intersection_splat, intersection_slot, slot_first, tiles_of: the
//        frame; hits, tile_stop: what blend drew (CPUs); weight [h][w]: weight of a pixel
//   out  slots [intersections][LAYOUT_IMPORTANCE_SUMS] (cleared by the host): alpha T weight, 1,
//        alpha T, 0
//        sums [n][LAYOUT_IMPORTANCE_SUMS]: the same of all tiles; 0 where invisible
// A slot has one writer and the order is fixed: the same input gives the same bits.
//
// share_tiles (GPUs; blend_shares elsewhere) has no weights: it sums 1 and alpha T alone.
//
// removal_tiles has the frame's color [3][h][w] as well, and in place of alpha T weight sums weight
// d.d, the squared change of a pixel if this Gaussian alone were not there:
//     d = alpha T rgb - rest alpha / (1 - alpha),   rest: the colour of the pixel from behind it,
// which is what the frame has less what was summed up to here. Nothing walks back through small T.
// Reference: tests/render/test_importance.c draws without it.

#if VW == 16

enum { IMPORTANCE_ALL, IMPORTANCE_REMOVAL }; // what is summed

struct importance_state { // of each block; pixels beyond the picture's edge have t 0
    float16 t[16], weight[16];
    float16 rest[16][3]; // of removal: colour from behind what was blended so far
};

// kind is a literal, as in the functions below.
INLINE void importance_load(struct importance_state *s, __constant struct layout_view *view,
                            __global const float *weight, __global const float *color, uint px,
                            uint py, const int kind)
{
    uint w = view->width, h = view->height;
    for (uint k = 0; k < 16; k++) {
        uint bx = px + 4 * (k & 3), by = py + 4 * (k >> 2);
        float16 x = (float)bx + BLOCK_X[0], y = (float)by + BLOCK_Y[0];
        int16 inside = (x < (float)w) & (y < (float)h);
        s->weight[k] = blend_block(weight, w, h, bx, by);
        for (uint c = 0; kind == IMPORTANCE_REMOVAL && c < 3; c++)
            s->rest[k][c] = blend_block(color + c * (size_t)w * h, w, h, bx, by);
        s->t[k] = inside ? (float16)(1.0f) : (float16)(0.0f);
    }
}

// One splat over the blocks that it was drawn into: moves the pixels on and writes the slot.
INLINE void importance_splat(struct importance_state *s, const float *w, float x0, float y0,
                             uint blocks, const int kind, __global float *slot)
{
    float16 first = 0.0f, count = 0.0f, shares = 0.0f;
    struct record e = record_of(w, x0, y0);
    while (blocks) {
        uint k = 31 - clz(blocks);
        blocks ^= 1u << k;
        float16 dx = block_dx(e.mx, k), dy = block_dy(e.my, k);
        float16 raw = splat_raw(dx, dy, e.p, e.x_of_y, e.r, e.opacity_log2), t = s->t[k];
        int16 hit = (t > LAYOUT_TRANSMITTANCE_MIN) & (raw > 0.0f);
        float16 one = hit ? (float16)(1.0f) : (float16)(0.0f);
        float16 a = one * MIN_(raw, LAYOUT_ALPHA_MAX), share = a * t;
        s->t[k] = t - share;
        count += one;
        shares += share;
        if (kind == IMPORTANCE_ALL)
            first += share * s->weight[k];
        if (kind == IMPORTANCE_REMOVAL) {
            float16 sum = 0.0f, odds = a / (1.0f - a);
            for (uint c = 0; c < 3; c++) {
                float16 own = share * w[LAYOUT_SPLAT_RGB + c], rest = s->rest[k][c] - own;
                float16 d = own - rest * odds;
                s->rest[k][c] = rest;
                sum = d * d + sum;
            }
            first += s->weight[k] * sum;
        }
    }
    float16 sums = fold_4(fold_8(first, count), fold_8(shares, (float16)(0.0f)));
    sums = fold_2(sums, sums);
    vstore4(fold_1(sums, sums).s0123, 0, slot);
}

// What blend drew of a tile, as blend_backward goes over it.
INLINE void
importance_tile(__constant struct layout_view *view, __global const struct layout_splat *splats,
                __global const uint *tile_start, __global const uint *intersection_splat,
                __global const uint *intersection_slot, __global const ushort *hits,
                __global const uint *tile_stop, __global float *slots, __global const float *weight,
                __global const float *color, const int kind)
{
    uint tile = (uint)get_global_id(0);
    if (tile >= view->tiles_x * view->tiles_y)
        return;
    uint px = (tile % view->tiles_x) * LAYOUT_TILE, py = (tile / view->tiles_x) * LAYOUT_TILE;
    float x0 = (float)px + 0.5f, y0 = (float)py + 0.5f;
    uint at = tile_start[tile], end = tile_stop[tile];
    float staged[BATCH * LAYOUT_SPLAT_WORDS];
    uint mask[BATCH], slot[BATCH];
    struct importance_state s;
    if (at == end)
        return;
    importance_load(&s, view, weight, color, px, py, kind);
    while (at < end) {
        uint n = backward_stage(splats, intersection_splat, intersection_slot, hits, &at, end,
                                staged, mask, slot);
        for (uint j = 0; j < n; j++) {
            uint next = slot[min(j + AHEAD, n - 1)];
            PREFETCH(slots + (size_t)next * LAYOUT_IMPORTANCE_SUMS);
            importance_splat(&s, staged + LAYOUT_SPLAT_WORDS * j, x0, y0, mask[j], kind,
                             slots + (size_t)slot[j] * LAYOUT_IMPORTANCE_SUMS);
        }
    }
}

__kernel void importance_tiles(__constant struct layout_view *view,
                               __global const struct layout_splat *splats,
                               __global const uint *tile_start,
                               __global const uint *intersection_splat,
                               __global const uint *intersection_slot, __global const ushort *hits,
                               __global const uint *tile_stop, __global float *slots,
                               __global const float *weight)
{
    importance_tile(view, splats, tile_start, intersection_splat, intersection_slot, hits,
                    tile_stop, slots, weight, weight, IMPORTANCE_ALL);
}

__kernel void removal_tiles(__constant struct layout_view *view,
                            __global const struct layout_splat *splats,
                            __global const uint *tile_start,
                            __global const uint *intersection_splat,
                            __global const uint *intersection_slot, __global const ushort *hits,
                            __global const uint *tile_stop, __global float *slots,
                            __global const float *weight, __global const float *color)
{
    importance_tile(view, splats, tile_start, intersection_splat, intersection_slot, hits,
                    tile_stop, slots, weight, color, IMPORTANCE_REMOVAL);
}

#else

// GPU shape: one work-group is one tile, one work-item one pixel; an intersection is summed by a
// tree of fixed shape. Three kernels repeat its loop: barriers have to stay in a kernel's own body
// (blend_backward.cl).
__kernel __attribute__((reqd_work_group_size(LAYOUT_TILE_PIXELS, 1, 1))) void
importance_tiles(__constant struct layout_view *v, __global const struct layout_splat *splats,
                 __global const uint *tile_start, __global const uint *intersection_splat,
                 __global const uint *intersection_slot, __global const ushort *hits,
                 __global const uint *tile_stop, __global float *slots,
                 __global const float *weight)
{
    uint tile = get_group_id(0), lane = get_local_id(0);
    uint x = tile % v->tiles_x * LAYOUT_TILE + lane % LAYOUT_TILE;
    uint y = tile / v->tiles_x * LAYOUT_TILE + lane / LAYOUT_TILE;
    int in = tile < v->tiles_x * v->tiles_y && x < v->width && y < v->height;
    float t = in ? 1.0f : 0.0f, own = in ? weight[(size_t)y * v->width + x] : 0.0f;
    uint begin = tile_start[tile], end = tile_start[tile + 1];
    __local float4 part[LAYOUT_TILE_PIXELS];
    for (uint at = begin; at < end; at++) {
        __global const struct layout_splat *e = splats + intersection_splat[at];
        float dx = e->mean_x - (float)x - 0.5f, dy = e->mean_y - (float)y - 0.5f;
        float raw = splat_raw(dx, dy, e->p, e->x_of_y, e->r, e->opacity_log2);
        float share = MIN_(raw, LAYOUT_ALPHA_MAX) * t;
        int hit = t > LAYOUT_TRANSMITTANCE_MIN && raw > 0.0f;
        part[lane] = hit ? (float4)(own * share, 1.0f, share, 0.0f) : (float4)(0.0f);
        t = hit ? t - share : t;
        for (uint half_n = LAYOUT_TILE_PIXELS / 2; half_n; half_n /= 2) {
            barrier(CLK_LOCAL_MEM_FENCE);
            if (lane < half_n)
                part[lane] += part[lane + half_n];
        }
        if (lane == 0)
            vstore4(part[0], 0, slots + LAYOUT_IMPORTANCE_SUMS * (size_t)intersection_slot[at]);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

__kernel __attribute__((reqd_work_group_size(LAYOUT_TILE_PIXELS, 1, 1))) void
share_tiles(__constant struct layout_view *v, __global const struct layout_splat *splats,
            __global const uint *tile_start, __global const uint *intersection_splat,
            __global const uint *intersection_slot, __global const ushort *hits,
            __global const uint *tile_stop, __global float *slots)
{
    uint tile = get_group_id(0), lane = get_local_id(0);
    uint x = tile % v->tiles_x * LAYOUT_TILE + lane % LAYOUT_TILE;
    uint y = tile / v->tiles_x * LAYOUT_TILE + lane / LAYOUT_TILE;
    float t = tile < v->tiles_x * v->tiles_y && x < v->width && y < v->height ? 1.0f : 0.0f;
    uint begin = tile_start[tile], end = tile_start[tile + 1];
    __local float2 part[LAYOUT_TILE_PIXELS];
    for (uint at = begin; at < end; at++) {
        __global const struct layout_splat *e = splats + intersection_splat[at];
        float dx = e->mean_x - (float)x - 0.5f, dy = e->mean_y - (float)y - 0.5f;
        float raw = splat_raw(dx, dy, e->p, e->x_of_y, e->r, e->opacity_log2);
        float share = MIN_(raw, LAYOUT_ALPHA_MAX) * t;
        int hit = t > LAYOUT_TRANSMITTANCE_MIN && raw > 0.0f;
        part[lane] = hit ? (float2)(1.0f, share) : (float2)(0.0f);
        t = hit ? t - share : t;
        for (uint half_n = LAYOUT_TILE_PIXELS / 2; half_n; half_n /= 2) {
            barrier(CLK_LOCAL_MEM_FENCE);
            if (lane < half_n)
                part[lane] += part[lane + half_n];
        }
        if (lane == 0)
            vstore4((float4)(0.0f, part[0], 0.0f), 0,
                    slots + LAYOUT_IMPORTANCE_SUMS * (size_t)intersection_slot[at]);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

__kernel __attribute__((reqd_work_group_size(LAYOUT_TILE_PIXELS, 1, 1))) void
removal_tiles(__constant struct layout_view *v, __global const struct layout_splat *splats,
              __global const uint *tile_start, __global const uint *intersection_splat,
              __global const uint *intersection_slot, __global const ushort *hits,
              __global const uint *tile_stop, __global float *slots, __global const float *weight,
              __global const float *color)
{
    uint tile = get_group_id(0), lane = get_local_id(0);
    uint x = tile % v->tiles_x * LAYOUT_TILE + lane % LAYOUT_TILE;
    uint y = tile / v->tiles_x * LAYOUT_TILE + lane / LAYOUT_TILE;
    int in = tile < v->tiles_x * v->tiles_y && x < v->width && y < v->height;
    size_t pixel = (size_t)y * v->width + x, plane = (size_t)v->width * v->height;
    float t = in ? 1.0f : 0.0f, own = in ? weight[pixel] : 0.0f;
    float3 rest = in ? (float3)(color[pixel], color[pixel + plane], color[pixel + 2 * plane])
                     : (float3)(0.0f);
    uint begin = tile_start[tile], end = tile_start[tile + 1];
    __local float4 part[LAYOUT_TILE_PIXELS];
    for (uint at = begin; at < end; at++) {
        __global const struct layout_splat *e = splats + intersection_splat[at];
        float dx = e->mean_x - (float)x - 0.5f, dy = e->mean_y - (float)y - 0.5f;
        float raw = splat_raw(dx, dy, e->p, e->x_of_y, e->r, e->opacity_log2);
        float a = MIN_(raw, LAYOUT_ALPHA_MAX), share = a * t;
        int hit = t > LAYOUT_TRANSMITTANCE_MIN && raw > 0.0f;
        float3 rgb = share * (float3)(e->rgb[0], e->rgb[1], e->rgb[2]);
        float3 behind = rest - rgb, d = rgb - behind * (a / (1.0f - a));
        part[lane] = hit ? (float4)(own * dot(d, d), 1.0f, share, 0.0f) : (float4)(0.0f);
        t = hit ? t - share : t;
        rest = hit ? behind : rest;
        for (uint half_n = LAYOUT_TILE_PIXELS / 2; half_n; half_n /= 2) {
            barrier(CLK_LOCAL_MEM_FENCE);
            if (lane < half_n)
                part[lane] += part[lane + half_n];
        }
        if (lane == 0)
            vstore4(part[0], 0, slots + LAYOUT_IMPORTANCE_SUMS * (size_t)intersection_slot[at]);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

#endif

__kernel void importance_gather(uint n, __global const uint *tiles_of,
                                __global const uint *slot_first, __global const float *slots,
                                __global float *sums)
{
    uint i = get_global_id(0);
    if (i >= n)
        return;
    float4 sum = (float4)(0.0f);
    uint tiles = tiles_of[i], first = slot_first[i];
    for (uint k = 0; k < tiles; k++)
        sum += vload4(first + k, slots);
    vstore4(sum, i, sums);
}
