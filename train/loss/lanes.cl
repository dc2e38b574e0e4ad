// Follows core/device/vector.cl in programs of train/loss/ over Gaussians: lanes of a group, fixed
// pieces of the groups, sums.

// VW 16: a work-item walks whole groups; VW 1: it walks the lanes of its groups one by one.
#if VW == 16
#define LANES_EACH(lane) for (uint lane = 0; lane < 1; lane++)
#else
#define LANES_EACH(lane) for (uint lane = 0; lane < LAYOUT_LANES; lane++)
#endif

// Groups [from, to) of piece i of n: fixed pieces, whatever the number of threads.
#define PIECE_FROM(i, n, groups) ((uint)((ulong)(i) * (groups) / (n)))

inline uint lanes_add(VU x)
{
#if VW == 16
    uint8 a = x.lo + x.hi;
    uint4 b = a.lo + a.hi;
    return (b.x + b.y) + (b.z + b.w);
#else
    return x;
#endif
}

inline float lanes_sum(V x) // in a fixed order
{
#if VW == 16
    float8 a = x.lo + x.hi;
    float4 b = a.lo + a.hi;
    return (b.x + b.y) + (b.z + b.w);
#else
    return x;
#endif
}

inline float lanes_max(V x)
{
#if VW == 16
    float8 a = fmax(x.lo, x.hi);
    float4 b = fmax(a.lo, a.hi);
    return fmax(fmax(b.x, b.y), fmax(b.z, b.w));
#else
    return x;
#endif
}
