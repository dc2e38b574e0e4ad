// First source of train/'s kernels over Gaussians: the vector type and the AoSoA-16 layout, as in
// render/common.cl.
//
// VW 16 (CPUs): V is float16 and a work-item walks whole groups of 16 Gaussians. VW 1 (GPUs): V is
// float and a work-item walks the lanes of its groups one by one. Masks are what comparisons return
// (-1 in vectors, 1 in scalars): combine them with & and |, choose with ?:.
#if VW == 16
typedef float16 V;
typedef int16 VI;
typedef uint16 VU;
// p: first float of the group
#define LD(p, plane) LAYOUT_WIDE(const __global, float, (p) + 16 * (plane))
#define ST(p, plane, v) LAYOUT_WIDE(__global, float, (p) + 16 * (plane)) = (v)
#define LANE ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#define LANES_EACH(lane) for (uint lane = 0; lane < 1; lane++)
#else
typedef float V;
typedef int VI;
typedef uint VU;
#define LD(p, plane) ((p)[(plane)*LAYOUT_LANES])
#define ST(p, plane, v) ((p)[(plane)*LAYOUT_LANES] = (v))
#define LANE 0
#define LANES_EACH(lane) for (uint lane = 0; lane < LAYOUT_LANES; lane++)
#endif
#ifdef HAS_PREFETCH
#define PREFETCH(p) __builtin_prefetch(p)
#else
#define PREFETCH(p) (void)(p)
#endif
#define MIN_(a, b) ((a) < (b) ? (a) : (b))
#define MAX_(a, b) ((a) > (b) ? (a) : (b))

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
