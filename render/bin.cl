// Stage: bin. Splats in depth order -> the list of each tile, in depth order.
//   in   order [visible], splats, slot_first
//   out  tile_start [tiles + 1], entry_splat and entry_slot [entries]
// A counting sort by tile: LAYOUT_BIN_CHUNKS fixed chunks of the depth order count their splats per tile,
// sums over chunks and tiles tell each chunk where its part of each list begins, and a second walk writes.
// The walks read one cache line per splat in depth order, that is at random; they fetch ahead.
//   bin_offset [chunk][stride], stride = tiles rounded up to 16
// Local size 1: one work-item is one chunk.

#define AHEAD 12

inline uint2 bin_range(uint n, uint chunk)
{
    uint each = (n + LAYOUT_BIN_CHUNKS - 1) / LAYOUT_BIN_CHUNKS;
    return min((uint2)(each * chunk, each * (chunk + 1)), (uint2)(n));
}

// Runs BODY with `tile` for every tile of splat s, row by row.
#define FOR_TILES(s, tiles_x, BODY)                                                                \
    {                                                                                              \
        uint cover = (s)->cover, row = cover & 1023, col0 = (cover >> 10) & 1023;                  \
        uint rows = ((cover >> 20) & 1023) + 1, shift = cover >> 30;                               \
        uint step = (rows + LAYOUT_BANDS - 1) / LAYOUT_BANDS, end_row = row + rows;                \
        for (uint band = 0; row < end_row; band++) {                                               \
            uint pair = ((s)->bands[band >> 1] >> (16 * (band & 1))) & 0xFFFF;                     \
            uint first = pair & 255, last = pair >> 8, stop = min(row + step, end_row);            \
            uint left = col0 + (first << shift);                                                   \
            uint right = min(col0 + ((last + 1) << shift), (uint)(tiles_x));                       \
            for (; row < stop; row++)                                                              \
                if (first <= last)                                                                 \
                    for (uint tile = row * (tiles_x) + left; tile < row * (tiles_x) + right; tile++) { \
                        BODY                                                                       \
                    }                                                                              \
        }                                                                                          \
    }

__kernel void bin_count(__constant struct layout_view *view, __global const uint *order,
                        __global const struct layout_splat *splats,
                        __global const struct layout_counts *counts, uint stride,
                        __global uint *bin_offset)
{
    uint chunk = (uint)get_global_id(0), tiles_x = view->tiles_x;
    uint2 range = bin_range(counts->visible, chunk);
    __global uint *count = bin_offset + (size_t)chunk * stride;
    for (uint t = 0; t < stride; t += 16)
        vstore16((uint16)(0), 0, count + t);
    for (uint i = range.x; i < range.y; i++) {
        __global const struct layout_splat *s = splats + order[i];
        PREFETCH(splats + order[min(i + AHEAD, range.y - 1)]);
        FOR_TILES(s, tiles_x, count[tile]++;)
    }
}

// One work-item per 16 tiles: sums over the chunks; tile_start holds the length of each list afterwards.
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

// `cap` is the room in the lists. The host has made enough; nothing is written beyond it whatever happens.
__kernel void bin_scatter(__constant struct layout_view *view, __global const uint *order,
                          __global const struct layout_splat *splats,
                          __global const struct layout_counts *counts, uint stride,
                          __global uint *bin_offset, __global const uint *tile_start,
                          __global const uint *slot_first, uint cap, __global uint *entry_splat,
                          __global uint *entry_slot)
{
    uint chunk = (uint)get_global_id(0), tiles_x = view->tiles_x;
    uint2 range = bin_range(counts->visible, chunk);
    __global uint *next = bin_offset + (size_t)chunk * stride;
    for (uint t = 0; t < stride; t += 16)
        vstore16(vload16(0, next + t) + vload16(0, tile_start + t), 0, next + t);
    for (uint i = range.x; i < range.y; i++) {
        uint id = order[i], slot = slot_first[id], ahead = order[min(i + AHEAD, range.y - 1)];
        __global const struct layout_splat *s = splats + id;
        PREFETCH(splats + ahead);
        PREFETCH(slot_first + ahead);
        FOR_TILES(s, tiles_x, {
            uint at = next[tile]++;
            if (at < cap) {
                entry_splat[at] = id;
                entry_slot[at] = slot;
            }
            slot++;
        })
    }
}
