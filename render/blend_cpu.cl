// Stage: blend, CPU shape. One work-item draws one tile of 16x16 pixels. Which one, it takes from a
// counter: a device hands out work-items in long runs, and a city seen from afar lies in few tiles.
//   in   tile_start, intersection_splat, splats
//   out  color [3][h][w] with background, transmit [h][w]; of blend_moments also two sums along
//        rays [2][h][w], for which it reads known [h][w] where the view has a known_zeta
//        hits [intersections]: bit k is set when the splat was drawn into block k (not of a frame
//        that is only a picture),
//        tile_stop [tiles]: intersections from there on were not visited. The backward pass visits
//        these and nothing else.
// The tile is 16 blocks of 4x4 pixels, a block is one float16. Splats come in batches of 64: their
// records are copied into a private array first, so that the cache misses overlap (those of the
// next batch are asked for at the same time); then, 16 splats at a time, the least exponent over
// each block's pixel centres tells which blocks a splat can touch at all; then each splat visits
// those blocks. A pixel stops when its transmittance falls to LAYOUT_TRANSMITTANCE_MIN (the splat
// that does it is still blended), a block when all its pixels have, the tile when all its blocks
// have.
//
// blend_shares also sums 1 and alpha T over the pixels of each intersection into its slot
// (LAYOUT_IMPORTANCE_*; cleared by the host), as importance.cl does.
//
// blend_moments also makes two sums along each ray (ray_values): moments of depth, or sums about
// the known depth of the pixel.
//
// Reference: render_ref_forward, render_ref_moments. Same order of blending, no atomics.

#define BATCH 64
#define CHECK_EVERY 16

// Block k is column k & 3, row k >> 2 of the tile; lane i of it column i & 3, row i >> 2 of the
// block.
__constant float16 BLOCK_X[4] = {
    (float16)(0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3),
    (float16)(4, 5, 6, 7, 4, 5, 6, 7, 4, 5, 6, 7, 4, 5, 6, 7),
    (float16)(8, 9, 10, 11, 8, 9, 10, 11, 8, 9, 10, 11, 8, 9, 10, 11),
    (float16)(12, 13, 14, 15, 12, 13, 14, 15, 12, 13, 14, 15, 12, 13, 14, 15)};
__constant float16 BLOCK_Y[4] = {
    (float16)(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3),
    (float16)(4, 4, 4, 4, 5, 5, 5, 5, 6, 6, 6, 6, 7, 7, 7, 7),
    (float16)(8, 8, 8, 8, 9, 9, 9, 9, 10, 10, 10, 10, 11, 11, 11, 11),
    (float16)(12, 12, 12, 12, 13, 13, 13, 13, 14, 14, 14, 14, 15, 15, 15, 15)};

// Offset mean - pixel in block k; the mean is relative to the tile's first pixel centre.
inline float16 block_dx(float mean, uint k)
{
    return mean - BLOCK_X[k & 3];
}

inline float16 block_dy(float mean, uint k)
{
    return mean - BLOCK_Y[k >> 2];
}

// What blending takes from a staged copy of struct layout_splat; the mean is relative to the tile's
// first pixel centre.
struct record {
    float mx, my, p, x_of_y, r, opacity_log2;
};

inline struct record record_of(const float *w, float x0, float y0)
{
    struct record s = {w[LAYOUT_SPLAT_MEAN_X] - x0, w[LAYOUT_SPLAT_MEAN_Y] - y0,
                       w[LAYOUT_SPLAT_P],           w[LAYOUT_SPLAT_X_OF_Y],
                       w[LAYOUT_SPLAT_R],           w[LAYOUT_SPLAT_OPACITY_LOG2]};
    return s;
}

// Bit b of mask[j]: splat j reaches 1/255 somewhere in the rectangle of pixel centres of block b.
// The least of the quadratic form over a rectangle is at the mean, if it is inside, or on an edge
// that faces it; the margin covers the difference in rounding to the evaluation per pixel.
inline void blend_masks(const float *records, float x0, float y0, uint tile_cull, uint *mask)
{
    float16 w[LAYOUT_SPLAT_WORDS];
#pragma unroll
    for (int j = 0; j < 16; j++)
        w[j] = LAYOUT_WIDE(const __private, float, records + LAYOUT_SPLAT_WORDS * j);
    transpose_16(w);
    float16 mx = w[LAYOUT_SPLAT_MEAN_X] - x0, my = w[LAYOUT_SPLAT_MEAN_Y] - y0;
    float16 reach = w[LAYOUT_SPLAT_OPACITY_LOG2] + (4e-3f - LAYOUT_ALPHA_MIN_LOG2);
    float16 p = w[LAYOUT_SPLAT_P], x_of_y = w[LAYOUT_SPLAT_X_OF_Y], r = w[LAYOUT_SPLAT_R],
            y_of_x = w[LAYOUT_SPLAT_Y_OF_X];
    uint16 bits = (uint16)(0);
#pragma unroll
    for (int by = 0; by < 4; by++) {
        float16 top = (float)(4 * by) - my, bottom = top + 3.0f, near_y = CLAMP_(0.0f, top, bottom);
        float16 lean = x_of_y * near_y, v2 = r * near_y;
        v2 *= v2;
#pragma unroll
        for (int bx = 0; bx < 4; bx++) {
            float16 left = (float)(4 * bx) - mx, right = left + 3.0f,
                    near_x = CLAMP_(0.0f, left, right);
            float16 y = y_of_x * near_x;
            y = CLAMP_(y, top, bottom);
            float16 x = CLAMP_(lean, left, right);
            float16 ua = p * (near_x - x_of_y * y), va = r * y, ub = p * (x - lean);
            float16 qa = ua * ua + va * va, qb = ub * ub + v2;
            int16 in = (qa <= reach) | (qb <= reach);
            bits |= as_uint16(in) & (uint16)(1u << (4 * by + bx));
        }
    }
    if (!tile_cull)
        bits = (uint16)(0xFFFF);
    LAYOUT_WIDE(__private, uint, mask) = bits;
}

struct blend_state {
    float16 t[16], r[16], g[16], b[16]; // transmittance and colour of each block
    float16 m1[16], m2[16];             // sums along the rays
    float16 scale[16], shift[16];       // of ray_known
};

// kind: a literal
enum { BLEND_PICTURE, BLEND_MOMENTS, BLEND_ABOUT, BLEND_SHARES };

inline float blend_sum(float16 v) // in the order of importance.cl
{
    float8 a = v.lo + v.hi;
    float4 b = a.lo + a.hi;
    float2 c = b.lo + b.hi;
    return c.x + c.y;
}

// One splat over some blocks: moves the pixels on, and writes the slot of shares.
INLINE void blend_splat(struct blend_state *s, const float *w, float x0, float y0, uint blocks,
                        const int kind, __global float *slot)
{
    float16 count = 0.0f, shares = 0.0f;
    struct record e = record_of(w, x0, y0);
    float red = w[LAYOUT_SPLAT_RGB], green = w[LAYOUT_SPLAT_RGB + 1],
          blue = w[LAYOUT_SPLAT_RGB + 2];
    float depth = w[LAYOUT_SPLAT_DEPTH], tilt_x = w[LAYOUT_SPLAT_DEPTH + 1],
          tilt_y = w[LAYOUT_SPLAT_DEPTH + 2];
    while (blocks) {
        uint k = 31 - clz(blocks);
        blocks ^= 1u << k;
        float16 dx = block_dx(e.mx, k), dy = block_dy(e.my, k);
        float16 a = splat_raw(dx, dy, e.p, e.x_of_y, e.r, e.opacity_log2), t = s->t[k];
        a = MIN_(a, LAYOUT_ALPHA_MAX);
        a = t > LAYOUT_TRANSMITTANCE_MIN ? a : (float16)(0.0f);
        float16 share = a * t;
        s->t[k] = t - share;
        s->r[k] = share * red + s->r[k];
        s->g[k] = share * green + s->g[k];
        s->b[k] = share * blue + s->b[k];
        if (kind == BLEND_SHARES) {
            count += a > 0.0f ? (float16)(1.0f) : (float16)(0.0f);
            shares += share;
        }
        if (kind == BLEND_MOMENTS || kind == BLEND_ABOUT) {
            float16 m = tilt_x * dx + (tilt_y * dy + depth), value[2], slope[2];
            ray_values(m, s->scale[k], s->shift[k], kind == BLEND_ABOUT, value, slope);
            s->m1[k] = share * value[0] + s->m1[k];
            s->m2[k] = share * value[1] + s->m2[k];
        }
    }
    if (kind == BLEND_SHARES)
        vstore4((float4)(0.0f, blend_sum(count), blend_sum(shares), 0.0f), 0, slot);
}

inline float blend_max(float16 v) // any() takes five times as long
{
    float8 a = MAX_(v.lo, v.hi);
    float4 b = MAX_(a.lo, a.hi);
    float2 c = MAX_(b.lo, b.hi);
    return MAX_(c.x, c.y);
}

// Those of the blocks that have a pixel which has not stopped; t: transmittances.
inline uint blend_active(const float16 t[16], uint active)
{
    for (uint left = active; left;) {
        uint k = 31 - clz(left);
        left ^= 1u << k;
        if (!(blend_max(t[k]) > LAYOUT_TRANSMITTANCE_MIN))
            active ^= 1u << k;
    }
    return active;
}

// Rows of pixels, each of 16, from the blocks of a row of blocks.
inline void blend_rows(const float16 b[4], float16 row[4])
{
    row[0] = (float16)(b[0].lo.lo, b[1].lo.lo, b[2].lo.lo, b[3].lo.lo);
    row[1] = (float16)(b[0].lo.hi, b[1].lo.hi, b[2].lo.hi, b[3].lo.hi);
    row[2] = (float16)(b[0].hi.lo, b[1].hi.lo, b[2].hi.lo, b[3].hi.lo);
    row[3] = (float16)(b[0].hi.hi, b[1].hi.hi, b[2].hi.hi, b[3].hi.hi);
}

// A row of a tile; pixels beyond the picture's edge are skipped.
inline void blend_row(uint width, uint px, float16 row, __global float *out)
{
    if (px + LAYOUT_TILE <= width) {
        LAYOUT_WIDE(__global, float, out) = row;
        return;
    }
    float v[LAYOUT_TILE];
    vstore16(row, 0, v);
    for (uint i = 0; px + i < width; i++)
        out[i] = v[i];
}

// A plane of the picture from blocks.
inline void blend_store(__constant struct layout_view *view, const float16 blocks[16], uint px,
                        uint py, __global float *plane)
{
    uint width = view->width, height = view->height;
    for (uint k = 0; k < 4 && py + 4 * k < height; k++) {
        float16 rows[4];
        blend_rows(blocks + 4 * k, rows);
#pragma unroll
        for (uint i = 0; i < 4; i++)
            if (py + 4 * k + i < height)
                blend_row(width, px, rows[i], plane + (size_t)(py + 4 * k + i) * width + px);
    }
}

// A plane of the picture where nothing is drawn.
inline void blend_fill(__constant struct layout_view *view, float value, uint px, uint py,
                       __global float *plane)
{
    uint end = min(py + LAYOUT_TILE, view->height);
    for (uint y = py; y < end; y++)
        blend_row(view->width, px, (float16)(value), plane + (size_t)y * view->width + px);
}

// One block of a planar picture, 0 beyond its edges.
inline float16 blend_block(__global const float *plane, uint w, uint h, uint x, uint y)
{
    float v[16];
    if (x + 4 <= w && y + 4 <= h) {
        for (uint row = 0; row < 4; row++)
            vstore4(vload4(0, plane + (size_t)(y + row) * w + x), row, v);
    } else {
        for (uint i = 0; i < 16; i++) {
            uint px = x + (i & 3), py = y + (i >> 2);
            v[i] = px < w && py < h ? plane[(size_t)py * w + px] : 0.0f;
        }
    }
    return vload16(0, v);
}

// moment_maps with known, and intersection_slot with slots, are of their kinds alone.
INLINE void blend_tile(__constant struct layout_view *view,
                       __global const struct layout_splat *splats, __global const uint *tile_start,
                       __global const uint *intersection_splat, __global float *color,
                       __global float *transmit, __global ushort *hits, __global uint *tile_stop,
                       __global struct layout_counts *counts, __global float *moment_maps,
                       __global const float *known, __global const uint *intersection_slot,
                       __global float *slots, const int kind)
{
    const int moments = kind == BLEND_MOMENTS || kind == BLEND_ABOUT;
    uint tile = atomic_inc(&counts->next_tile);
    if (tile >= view->tiles_x * view->tiles_y)
        return;
    uint px = (tile % view->tiles_x) * LAYOUT_TILE, py = (tile / view->tiles_x) * LAYOUT_TILE;
    float x0 = (float)px + 0.5f, y0 = (float)py + 0.5f;
    uint at = tile_start[tile], end = tile_start[tile + 1], active = 0xFFFF, hit = !view->picture;
    size_t plane = (size_t)view->width * view->height;
    if (at == end) {
        tile_stop[tile] = at;
        for (uint c = 0; c < 3; c++)
            blend_fill(view, view->background[c], px, py, color + c * plane);
        blend_fill(view, 1.0f, px, py, transmit);
        for (uint c = 0; moments && c < 2; c++)
            blend_fill(view, 0.0f, px, py, moment_maps + c * plane);
        return;
    }
    float staged[BATCH * LAYOUT_SPLAT_WORDS];
    uint mask[BATCH];
    struct blend_state s;

    for (uint k = 0; k < 16; k++) {
        float16 x = (float)px + BLOCK_X[k & 3], y = (float)py + BLOCK_Y[k >> 2];
        int16 inside = (x < (float)view->width) & (y < (float)view->height);
        s.t[k] = inside ? (float16)(1.0f) : (float16)(0.0f); // pixels beyond the edge have stopped
        s.r[k] = s.g[k] = s.b[k] = (float16)(0.0f);
        if (moments)
            s.m1[k] = s.m2[k] = (float16)(0.0f);
        if (kind == BLEND_ABOUT)
            ray_known(
                view,
                blend_block(known, view->width, view->height, px + 4 * (k & 3), py + 4 * (k >> 2)),
                s.scale + k, s.shift + k);
    }
    active = blend_active(s.t, active);
    for (uint j = 0; j < BATCH * LAYOUT_SPLAT_WORDS; j += 16)
        vstore16((float16)(0.0f), 0, staged + j); // a short last batch masks what it does not use
    while (at < end && active) {
        uint n = min(end - at, (uint)BATCH);
        for (uint j = 0; j < n; j++) {
            PREFETCH(splats + intersection_splat[min(at + BATCH + j, end - 1)]);
            LAYOUT_WIDE(__private, float, staged + LAYOUT_SPLAT_WORDS * j) =
                LAYOUT_WIDE(const __global, float, splats + intersection_splat[at + j]);
        }
        for (uint j = 0; j < n; j += 16)
            blend_masks(staged + LAYOUT_SPLAT_WORDS * j, x0, y0, view->tile_cull, mask + j);
        uint j = 0;
        for (; j < n && active; j++) {
            uint blocks = mask[j] & active;
            if (blocks)
                blend_splat(&s, staged + LAYOUT_SPLAT_WORDS * j, x0, y0, blocks, kind,
                            kind == BLEND_SHARES
                                ? slots + (size_t)intersection_slot[at + j] * LAYOUT_IMPORTANCE_SUMS
                                : slots);
            if (hit)
                hits[at + j] = (ushort)blocks;
            if (j % CHECK_EVERY == CHECK_EVERY - 1)
                active = blend_active(s.t, active);
        }
        at += j;
    }
    tile_stop[tile] = at;
    for (uint k = 0; k < 16; k++) {
        s.r[k] = s.t[k] * view->background[0] + s.r[k];
        s.g[k] = s.t[k] * view->background[1] + s.g[k];
        s.b[k] = s.t[k] * view->background[2] + s.b[k];
    }
    blend_store(view, s.r, px, py, color);
    blend_store(view, s.g, px, py, color + plane);
    blend_store(view, s.b, px, py, color + 2 * plane);
    blend_store(view, s.t, px, py, transmit);
    if (moments) {
        blend_store(view, s.m1, px, py, moment_maps);
        blend_store(view, s.m2, px, py, moment_maps + plane);
    }
}

__kernel void blend(__constant struct layout_view *view, __global const struct layout_splat *splats,
                    __global const uint *tile_start, __global const uint *intersection_splat,
                    __global float *color, __global float *transmit, __global ushort *hits,
                    __global uint *tile_stop, __global struct layout_counts *counts)
{
    blend_tile(view, splats, tile_start, intersection_splat, color, transmit, hits, tile_stop,
               counts, color, color, tile_start, color, BLEND_PICTURE);
}

__kernel void blend_shares(__constant struct layout_view *view,
                           __global const struct layout_splat *splats,
                           __global const uint *tile_start, __global const uint *intersection_splat,
                           __global float *color, __global float *transmit, __global ushort *hits,
                           __global uint *tile_stop, __global struct layout_counts *counts,
                           __global const uint *intersection_slot, __global float *slots)
{
    blend_tile(view, splats, tile_start, intersection_splat, color, transmit, hits, tile_stop,
               counts, color, color, intersection_slot, slots, BLEND_SHARES);
}

__kernel void blend_moments(__constant struct layout_view *view,
                            __global const struct layout_splat *splats,
                            __global const uint *tile_start,
                            __global const uint *intersection_splat, __global float *color,
                            __global float *transmit, __global ushort *hits,
                            __global uint *tile_stop, __global struct layout_counts *counts,
                            __global float *moment_maps, __global const float *known)
{
    if (view->known_zeta > 0.0f)
        blend_tile(view, splats, tile_start, intersection_splat, color, transmit, hits, tile_stop,
                   counts, moment_maps, known, tile_start, color, BLEND_ABOUT);
    else
        blend_tile(view, splats, tile_start, intersection_splat, color, transmit, hits, tile_stop,
                   counts, moment_maps, known, tile_start, color, BLEND_MOMENTS);
}
