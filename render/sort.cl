// Stage: sort. Depth keys -> indices of the visible Gaussians, nearest first.
//   in   depth_key [n], tiles_of [n]
//   out  ids [visible]; slot_first [n]: exclusive sum of tiles_of in index order; counts;
//        keys [visible]: min(tiles_of, 2047) in the low 11 bits, which the first pass has used
// It is a radix sort, least significant digit first: three passes of 11 bits over
// LAYOUT_SORT_CHUNKS fixed chunks. Each chunk has its own histogram, so equal keys keep their
// order, which is by index. The first pass also removes culled Gaussians and numbers the slots.
// Positive floats sort as integers.
//   histogram [chunk][digit]: after the scan, keys of that digit in the chunks before; one row more
//   [digit]: where the first key of that digit goes
// Local size 1: one work-item is one chunk.

#define DIGITS (1 << LAYOUT_SORT_BITS)

inline uint2 sort_range(uint n, uint chunk)
{
    uint each = ((n + LAYOUT_SORT_CHUNKS - 1) / LAYOUT_SORT_CHUNKS + 15u) & ~15u;
    return min((uint2)(each * chunk, each * (chunk + 1)), (uint2)(n));
}

__kernel void sort_count(__global const uint *keys, __global const uint *tiles_of, uint n,
                         uint pass, __global uint *histogram, __global struct layout_counts *counts)
{
    uint chunk = (uint)get_global_id(0), shift = pass * LAYOUT_SORT_BITS;
    uint2 range = sort_range(pass ? counts->visible : n, chunk);
    uint count[DIGITS];
    for (uint d = 0; d < DIGITS; d++)
        count[d] = 0;
    if (pass == 0) {
        ulong intersections = 0;
        for (uint i = range.x; i < range.y; i++) {
            uint key = keys[i];
            intersections += tiles_of[i];
            count[key & (DIGITS - 1)] += key != 0xFFFFFFFFu;
        }
        counts->chunk_intersections[chunk] = intersections;
    } else {
        for (uint i = range.x; i < range.y; i++)
            count[(keys[i] >> shift) & (DIGITS - 1)]++;
    }
    for (uint d = 0; d < DIGITS; d++)
        histogram[chunk * DIGITS + d] = count[d];
}

// One work-item: exclusive sums, of 16 digits over the chunks and then over the digits.
__kernel void sort_scan(__global uint *histogram, uint pass, __global struct layout_counts *counts)
{
    uint sum = 0;
    for (uint d = 0; d < DIGITS; d += 16) {
        uint16 before = (uint16)(0);
        for (uint c = 0; c <= LAYOUT_SORT_CHUNKS; c++) {
            __global uint16 *at = (__global uint16 *)(histogram + c * DIGITS + d);
            uint16 here = *at;
            *at = before;
            before += here;
        }
        for (uint i = d; i < d + 16; i++) {
            uint here = histogram[LAYOUT_SORT_CHUNKS * DIGITS + i];
            histogram[LAYOUT_SORT_CHUNKS * DIGITS + i] = sum;
            sum += here;
        }
    }
    if (pass == 0) {
        ulong at = 0;
        for (uint c = 0; c < LAYOUT_SORT_CHUNKS; c++) {
            ulong here = counts->chunk_intersections[c];
            counts->chunk_intersections[c] = at;
            at += here;
        }
        counts->intersections = at;
        counts->visible = sum;
        counts->next_tile = 0;
    }
}

__kernel void sort_scatter(__global const uint *keys, __global const uint *ids,
                           __global const uint *tiles_of, uint n, uint pass,
                           __global const uint *histogram,
                           __global const struct layout_counts *counts, __global uint *keys_out,
                           __global uint *ids_out, __global uint *slot_first)
{
    uint chunk = (uint)get_global_id(0), shift = pass * LAYOUT_SORT_BITS;
    uint2 range = sort_range(pass ? counts->visible : n, chunk);
    uint at[DIGITS];
    for (uint d = 0; d < DIGITS; d++)
        at[d] = histogram[chunk * DIGITS + d] + histogram[LAYOUT_SORT_CHUNKS * DIGITS + d];
    if (pass == 0) {
        uint slot = (uint)counts->chunk_intersections[chunk];
        for (uint i = range.x; i < range.y; i++) {
            uint key = keys[i];
            uint tiles = tiles_of[i];
            slot_first[i] = slot;
            slot += tiles;
            if (key != 0xFFFFFFFFu) {
                uint to = at[key & (DIGITS - 1)]++;
                keys_out[to] = (key & ~(uint)LAYOUT_KEY_TILES) | min(tiles, (uint)LAYOUT_KEY_TILES);
                ids_out[to] = i;
            }
        }
    } else {
        for (uint i = range.x; i < range.y; i++) {
            uint key = keys[i];
            uint to = at[(key >> shift) & (DIGITS - 1)]++;
            keys_out[to] = key;
            ids_out[to] = ids[i];
        }
    }
}
