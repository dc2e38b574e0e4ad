// The second source, after core/layout.h, of every program over groups of Gaussians: the vector
// type, and loads and stores of the AoSoA-16 layout.
//
// VW 16 (CPUs): V is float16, and one work-item handles whole groups of 16 Gaussians, or blocks of
// 4x4 pixels. VW 1 (GPUs): V is float, and one work-item is one Gaussian or one pixel. Masks are
// results of comparisons: -1 in vectors, 1 in scalars. Combine them with & and |, and choose with
// ?:, which is right for both. Write a * b + c in one expression, so that the compiler can fuse it.

#if VW == 16
typedef float16 V;
typedef int16 VI;
typedef uint16 VU;
// One plane of a group; p: first float of the group.
#define LD(p, plane) LAYOUT_WIDE(const __global, float, (p) + LAYOUT_LANES * (plane))
#define ST(p, plane, v) LAYOUT_WIDE(__global, float, (p) + LAYOUT_LANES * (plane)) = (v)
#define LD_WORD(p, plane) LAYOUT_WIDE(const __global, uint, (p) + LAYOUT_LANES * (plane))
#define ST_WORD(p, plane, v) LAYOUT_WIDE(__global, uint, (p) + LAYOUT_LANES * (plane)) = (v)
#define LD_HALF(p, plane) vload_half16(plane, p)
#define ANY(m) any_lane(m)
#define AS_V as_float16
#define AS_VI as_int16
#define AS_VU as_uint16
#define TO_V convert_float16
#define TO_VI convert_int16
#define LANE ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#else
typedef float V;
typedef int VI;
typedef uint VU;
// One plane of a Gaussian; p: its lane's place in the first plane of its group.
#define LD(p, plane) ((p)[(plane)*LAYOUT_LANES])
#define ST(p, plane, v) ((p)[(plane)*LAYOUT_LANES] = (v))
#define LD_WORD LD
#define ST_WORD ST
#define LD_HALF(p, plane) vload_half((plane)*LAYOUT_LANES, p)
#define ANY(m) (m)
#define AS_V as_float
#define AS_VI as_int
#define AS_VU as_uint
#define TO_V convert_float
#define TO_VI convert_int
#define LANE 0
#endif
// One instruction each, where fmin and fmax need several to treat NaN by the book. NaN in a gives
// b.
#define MIN_(a, b) ((a) < (b) ? (a) : (b))
#define MAX_(a, b) ((a) > (b) ? (a) : (b))
#define CLAMP_(x, lo, hi) MIN_(MAX_(x, lo), hi)
#ifdef HAS_PREFETCH
#define PREFETCH(p) __builtin_prefetch(p)
#else
#define PREFETCH(p) (void)(p)
#endif

// Vectors in registers across calls: PoCL passes them through memory otherwise.
#define INLINE inline __attribute__((always_inline))

#if VW == 16
INLINE int any_lane(int16 m) // any() of PoCL takes longer
{
    int8 a = m.lo | m.hi;
    int4 b = a.lo | a.hi;
    int2 c = b.lo | b.hi;
    return (c.x | c.y) < 0;
}
#endif

// Where group `group` of an array of `planes` planes a group begins.
INLINE size_t group_at(uint group, uint planes)
{
    return (size_t)group * planes * LAYOUT_LANES;
}
