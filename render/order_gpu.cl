// Stages sort and bin, GPU shape: the same results as sort.cl and bin.cl, bit for bit, by thousands
// of work-items.
//   sort: sums of tiles_of -> slot_first, intersections; stable radix passes over the depth keys
//         -> ids
//   bin:  sums of tiles_of in depth order -> first; intersections from there on; stable radix
//         passes over their tiles; gather -> tile_start, intersection_splat, intersection_slot
// A work-group has a block of LAYOUT_ORDER_BLOCK values, and an item has EACH consecutive values of
// it. The order of equal keys is then that of the items, and no atomics are needed (Satish, Harris
// and Garland 2009, with digits of 5 bits). Sums are of integers, so the division into blocks does
// not change them.
//   sums [blocks], or [digit][block] for a radix pass: totals; after sum_scan the sum before each
// `ordered`: values are read through order[], and there are counts->visible of them. Barriers are
// only in the kernels' own bodies, because PoCL, with which this is tested, does not split a
// work-group at barriers in called functions.

#define ITEMS LAYOUT_ORDER_ITEMS
#define EACH (LAYOUT_ORDER_BLOCK / ITEMS)
#define DIGITS (1 << LAYOUT_ORDER_BITS)
#define COLUMN (ITEMS + 2) // of local counts: an odd number of words, so that banks do not collide
#define GROUP __attribute__((reqd_work_group_size(ITEMS, 1, 1)))
#define CULLED 0xFFFFFFFFu

// The values of this item.
inline uint2 order_range(uint n)
{
    ulong from = (ulong)get_group_id(0) * LAYOUT_ORDER_BLOCK + (ulong)get_local_id(0) * EACH;
    return (uint2)((uint)min(from, (ulong)n), (uint)min(from + EACH, (ulong)n));
}

// This item's column of counts, [digit]: how many of its keys have each digit.
inline void order_tally(__global const uint *keys, uint2 range, uint shift, uint culls,
                        __local ushort *column)
{
    for (uint d = 0; d < DIGITS; d++)
        column[d * COLUMN] = 0;
    for (uint i = range.x; i < range.y; i++) {
        uint key = keys[i];
        if (!culls || key != CULLED)
            column[((key >> shift) & (DIGITS - 1)) * COLUMN]++;
    }
}

__kernel GROUP void sum_blocks(__global const uint *values, __global const uint *order,
                               uint ordered, uint n, __global const struct layout_counts *counts,
                               __global uint *sums)
{
    __local uint part[ITEMS];
    uint lane = (uint)get_local_id(0), sum = 0;
    uint2 range = order_range(ordered ? counts->visible : n);
    for (uint i = range.x; i < range.y; i++)
        sum += values[ordered ? order[i] : i];
    part[lane] = sum;
    for (uint half_way = ITEMS / 2; half_way > 0; half_way /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < half_way)
            part[lane] += part[lane + half_way];
    }
    if (lane == 0)
        sums[get_group_id(0)] = part[0];
}

// One work-group: exclusive sums in place, and their total into counts.
__kernel GROUP void sum_scan(uint n, uint total_is, __global uint *sums,
                             __global struct layout_counts *counts)
{
    __local ulong part[ITEMS];
    uint lane = (uint)get_local_id(0), each = (n + ITEMS - 1) / ITEMS;
    uint from = min(each * lane, n), to = min(from + each, n);
    ulong at = 0;
    for (uint i = from; i < to; i++)
        at += sums[i];
    part[lane] = at;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lane == 0) {
        ulong sum = 0;
        for (uint i = 0; i < ITEMS; i++) {
            ulong here = part[i];
            part[i] = sum;
            sum += here;
        }
        if (total_is == LAYOUT_TOTAL_INTERSECTIONS)
            counts->intersections = sum;
        if (total_is == LAYOUT_TOTAL_VISIBLE)
            counts->visible = (uint)sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    at = part[lane];
    for (uint i = from; i < to; i++) {
        uint here = sums[i];
        sums[i] = (uint)at;
        at += here;
    }
}

// out [i]: the sum of all values before i. Beyond 32 bits it is garbage, and
// counts->intersections tells.
__kernel GROUP void sum_apply(__global const uint *values, __global const uint *order, uint ordered,
                              uint n, __global const struct layout_counts *counts,
                              __global const uint *sums, __global uint *out)
{
    __local uint part[2][ITEMS];
    uint lane = (uint)get_local_id(0), sum = 0, side = 0;
    uint2 range = order_range(ordered ? counts->visible : n);
    for (uint i = range.x; i < range.y; i++)
        sum += values[ordered ? order[i] : i];
    part[0][lane] = sum;
    for (uint step = 1; step < ITEMS; step *= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        part[1 - side][lane] = part[side][lane] + (lane >= step ? part[side][lane - step] : 0);
        side = 1 - side;
    }
    uint at = sums[get_group_id(0)] + part[side][lane] - sum;
    for (uint i = range.x; i < range.y; i++) {
        out[i] = at;
        at += values[ordered ? order[i] : i];
    }
}

// How many keys of each digit the block has. In the first pass over depth keys (`culls`) those of
// what was culled are not counted.
__kernel GROUP void radix_count(__global const uint *keys, uint ordered, uint n,
                                __global const struct layout_counts *counts, uint shift, uint culls,
                                __global uint *sums)
{
    __local ushort count[DIGITS * COLUMN];
    uint lane = (uint)get_local_id(0);
    uint2 range = order_range(ordered ? counts->visible : n);
    order_tally(keys, range, shift, culls, count + lane);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lane < DIGITS) {
        uint sum = 0;
        for (uint i = 0; i < ITEMS; i++)
            sum += count[lane * COLUMN + i];
        sums[lane * get_num_groups(0) + get_group_id(0)] = sum;
    }
}

// `first`: there are no ids yet, a key's own place is its id.
__kernel GROUP void radix_scatter(__global const uint *keys, __global const uint *ids, uint first,
                                  uint ordered, uint n, __global const struct layout_counts *counts,
                                  uint shift, uint culls, __global const uint *sums,
                                  __global uint *keys_out, __global uint *ids_out)
{
    __local ushort count[DIGITS * COLUMN];
    __local uint base[DIGITS];
    uint lane = (uint)get_local_id(0);
    uint2 range = order_range(ordered ? counts->visible : n);
    order_tally(keys, range, shift, culls, count + lane);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lane < DIGITS) {
        ushort sum = 0;
        for (uint i = 0; i < ITEMS; i++) {
            ushort here = count[lane * COLUMN + i];
            count[lane * COLUMN + i] = sum;
            sum += here;
        }
        base[lane] = sums[lane * get_num_groups(0) + get_group_id(0)];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = range.x; i < range.y; i++) {
        uint key = keys[i];
        if (culls && key == CULLED)
            continue;
        uint d = (key >> shift) & (DIGITS - 1);
        uint to = base[d] + count[d * COLUMN + lane]++;
        keys_out[to] = key;
        ids_out[to] = first ? i : ids[i];
    }
}

// One work-item, one splat in depth order: its intersections, from first[i] on. `cap` is the room
// for them; nothing is written beyond.
__kernel void bin_expand(__constant struct layout_view *view, __global const uint *order,
                         __global const struct layout_splat *splats,
                         __global const uint *slot_first,
                         __global const struct layout_counts *counts, __global const uint *first,
                         uint cap, __global uint *expanded_tile, __global uint *expanded_splat,
                         __global uint *expanded_slot)
{
    uint i = (uint)get_global_id(0), tiles_x = view->tiles_x;
    if (i >= counts->visible)
        return;
    uint id = order[i], slot = slot_first[id], k = first[i];
    __global const struct layout_splat *s = splats + id;
    uint cover = s->cover, row0 = cover & 1023, col0 = (cover >> 10) & 1023;
    uint rows = ((cover >> 20) & 1023) + 1, shift = cover >> 30;
    uint step = rows <= LAYOUT_BANDS ? 1 : (rows + LAYOUT_BANDS - 1) / LAYOUT_BANDS;
    for (uint row = 0; row < rows; row++) {
        uint band = row / step, columns = (s->bands[band >> 1] >> (16 * (band & 1))) & 0xFFFF;
        uint from = columns & 255, last = columns >> 8, left = col0 + (from << shift);
        uint n = from <= last ? min(col0 + ((last + 1) << shift), tiles_x) - left : 0;
        for (uint j = 0; j < n && k < cap; j++, k++) {
            expanded_tile[k] = (row0 + row) * tiles_x + left + j;
            expanded_splat[k] = id;
            expanded_slot[k] = slot++;
        }
    }
}

// One work-item, one intersection in the order of tiles; where a tile begins, the starts of it and
// of the empty ones before.
__kernel void bin_gather(uint n, uint tiles, __global const uint *tile_of,
                         __global const uint *expanded_at, __global const uint *expanded_splat,
                         __global const uint *expanded_slot, __global uint *tile_start,
                         __global uint *intersection_splat, __global uint *intersection_slot)
{
    uint i = (uint)get_global_id(0);
    if (i >= max(n, 1u))
        return;
    uint from = n && i ? tile_of[i - 1] + 1 : 0, to = n ? tile_of[i] + 1 : 0;
    for (uint t = from; t < to; t++)
        tile_start[t] = i;
    if (i + 1 >= n) // the last
        for (uint t = to; t <= tiles; t++)
            tile_start[t] = n;
    if (i < n) {
        uint k = expanded_at[i];
        intersection_splat[i] = expanded_splat[k];
        intersection_slot[i] = expanded_slot[k];
    }
}
