// Stage: bin. Splats in depth order -> the list of each tile, in depth order.
//   in   order [visible], keys [visible] (tile counts, see sort.cl), splats, slot_first, tiles_of
//   out  tile_start [tiles + 1], intersection_splat and intersection_slot [intersections]; no slots
//        for a frame that is only a picture
// It is a counting sort by tile. First bin_expand writes the intersections in depth order, one row
// of tiles after another. Only this pass reads records, at random, and only it has short loops.
// Then two linear passes count and place the intersections. LAYOUT_BIN_CHUNKS fixed chunks of the
// depth order are processed in parallel. Sums over chunks and tiles give each chunk its part of
// each list.
//   expanded_tile, expanded_splat, expanded_slot [intersections]: in depth order
//   bin_offset [chunk][stride], stride = tiles rounded up to 16
// `cap` is the room for intersections. The host has made enough; nothing is ever written beyond it.
// Neighbours in the depth order lie in different tiles: bin_scatter writes a few words to each of
// thousands of lines, and asks for them before.
// Local size 1: one work-item is one chunk.

#define AHEAD 16
#define BURST 8 // intersections written at once; what is too many is overwritten by the next

inline uint2 bin_range(uint n, uint chunk)
{
    uint each = (n + LAYOUT_BIN_CHUNKS - 1) / LAYOUT_BIN_CHUNKS;
    return min((uint2)(each * chunk, each * (chunk + 1)), (uint2)(n));
}

// Intersections of each chunk, from the tile counts that the sort carried along.
__kernel void bin_total(__global const uint *order, __global const uint *keys,
                        __global const uint *tiles_of, __global struct layout_counts *counts)
{
    uint chunk = (uint)get_global_id(0), sum = 0;
    uint2 range = bin_range(counts->visible, chunk);
    for (uint i = range.x; i < range.y; i++) {
        uint here = keys[i] & LAYOUT_KEY_TILES;
        sum += here == LAYOUT_KEY_TILES ? tiles_of[order[i]] : here;
    }
    counts->bin_intersections[chunk] = sum;
}

// Intersections before this chunk and up to its end, within cap.
inline uint2 bin_span(__global const struct layout_counts *counts, uint chunk, uint cap)
{
    uint2 range = (uint2)(0, 0);
    for (uint c = 0; c <= chunk; c++) {
        range.x = range.y;
        range.y += counts->bin_intersections[c];
    }
    return min(range, (uint2)(cap));
}

__kernel void bin_expand(__constant struct layout_view *view, __global const uint *order,
                         __global const struct layout_splat *splats,
                         __global const uint *slot_first,
                         __global const struct layout_counts *counts, uint cap, uint stride,
                         __global uint *expanded_tile, __global uint *expanded_splat,
                         __global uint *expanded_slot, __global uint *bin_offset)
{
    uint chunk = (uint)get_global_id(0), tiles_x = view->tiles_x, slots = !view->picture;
    uint2 range = bin_range(counts->visible, chunk), span = bin_span(counts, chunk, cap);
    const uint8 burst = (uint8)(0, 1, 2, 3, 4, 5, 6, 7);
    uint k = span.x;
    for (uint i = range.x; i < range.y; i++) {
        uint id = order[i], ahead = order[min(i + AHEAD, range.y - 1)], slot = 0;
        PREFETCH(splats + ahead);
        if (slots) {
            PREFETCH(slot_first + ahead);
            slot = slot_first[id];
        }
        __global const struct layout_splat *s = splats + id;
        uint cover = s->cover, row = cover & 1023, col0 = (cover >> 10) & 1023;
        uint rows = ((cover >> 20) & 1023) + 1, shift = cover >> 30;
        uint step = rows <= LAYOUT_BANDS ? 1 : (rows + LAYOUT_BANDS - 1) / LAYOUT_BANDS;
        for (uint end_row = row + rows, left = 0, n = 0, in_band = 0, band = 0; row < end_row;
             row++) {
            if (in_band == 0) {
                uint columns = (s->bands[band >> 1] >> (16 * (band & 1))) & 0xFFFF;
                uint first = columns & 255, last = columns >> 8;
                left = col0 + (first << shift);
                n = first <= last ? min(col0 + ((last + 1) << shift), tiles_x) - left : 0;
                in_band = step;
                band++;
            }
            in_band--;
            uint tile = row * tiles_x + left;
            if (n <= BURST && k + BURST <= span.y) {
                vstore8(tile + burst, 0, expanded_tile + k);
                vstore8((uint8)(id), 0, expanded_splat + k);
                if (slots)
                    vstore8(slot + burst, 0, expanded_slot + k);
            } else {
                for (uint j = 0; j < n && k + j < span.y; j++) {
                    expanded_tile[k + j] = tile + j;
                    expanded_splat[k + j] = id;
                    if (slots)
                        expanded_slot[k + j] = slot + j;
                }
            }
            k += n;
            slot += n;
        }
    }
    __global uint *count = bin_offset + (size_t)chunk * stride;
    for (uint t = 0; t < stride; t += 16)
        vstore16((uint16)(0), 0, count + t);
    for (k = span.x; k < span.y; k++)
        count[expanded_tile[k]]++;
}

// One work-item per 16 tiles: sums over the chunks; tile_start holds the length of each list
// afterwards.
__kernel void bin_sum(uint stride, __global uint *bin_offset, __global uint *tile_start)
{
    uint t = (uint)get_global_id(0) * 16;
    uint16 sum = (uint16)(0);
    if (t >= stride)
        return;
    for (uint c = 0; c < LAYOUT_BIN_CHUNKS; c++) {
        __global uint *at = bin_offset + (size_t)c * stride + t;
        uint16 here = vload16(0, at);
        vstore16(sum, 0, at);
        sum += here;
    }
    vstore16(sum, 0, tile_start + t);
}

// One work-item: lengths -> starts.
__kernel void bin_scan(uint tiles, __global uint *tile_start)
{
    uint sum = 0;
    for (uint t = 0; t < tiles; t++) {
        uint here = tile_start[t];
        tile_start[t] = sum;
        sum += here;
    }
    tile_start[tiles] = sum;
}

__kernel void bin_scatter(__constant struct layout_view *view,
                          __global const struct layout_counts *counts, uint cap, uint stride,
                          __global const uint *expanded_tile, __global const uint *expanded_splat,
                          __global const uint *expanded_slot, __global const uint *tile_start,
                          __global uint *bin_offset, __global uint *intersection_splat,
                          __global uint *intersection_slot)
{
    uint chunk = (uint)get_global_id(0);
    uint2 span = bin_span(counts, chunk, cap);
    __global uint *next = bin_offset + (size_t)chunk * stride;
    for (uint t = 0; t < stride; t += 16)
        vstore16(vload16(0, next + t) + vload16(0, tile_start + t), 0, next + t);
    if (view->picture) {
        for (uint k = span.x; k < span.y; k++) {
            uint ahead = next[expanded_tile[min(k + AHEAD, span.y - 1)]];
            PREFETCH(intersection_splat + ahead);
            intersection_splat[next[expanded_tile[k]]++] = expanded_splat[k];
        }
        return;
    }
    for (uint k = span.x; k < span.y; k++) {
        uint ahead = next[expanded_tile[min(k + AHEAD, span.y - 1)]];
        PREFETCH(intersection_splat + ahead);
        PREFETCH(intersection_slot + ahead);
        uint at = next[expanded_tile[k]]++;
        intersection_splat[at] = expanded_splat[k];
        intersection_slot[at] = expanded_slot[k];
    }
}
