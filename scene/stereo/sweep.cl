// Plane sweep: photographs -> costs of heights -> one height a pixel. scene/stereo/sweep.h has the
// equations.
//   sweep_cost  reference and neighbours -> cost uchar [planes][h][w]
//   sweep_turn  costs of level and upright planes -> the lesser, [h][w][planes]
//   sweep_path  cost -> sum ushort [h][w][planes]: adds the costs of paths in one direction
//   sweep_pick  sum -> plane of least sum, float [h][w], and its correlation [h][w]
// VW 16 (CPUs): a work-item of sweep_cost has a tile and SLAB planes in its private memory, one of
// sweep_path a line of pixels, one of the others a row. VW 1 (GPUs): a work-item of sweep_cost has
// a pixel and a plane and keeps its window in registers, a work-group of sweep_path has a line with
// one item for each plane, and an item of the others has a pixel.
// Reference: sweep_ref.c.

#define SIDE (2 * RADIUS + 1)
// A window is every other pixel of a square, as on a chessboard: half of the work, and no less
// certain. This is the first of row j.
#define FIRST(j) ((j)&1)
#define ROW_TAPS (RADIUS + 1)
#define TILES_OF(width) (((width) + TILE_W - 1) / TILE_W)
#define TILE_NUMBERS 5 // direction, 1 / rho, first plane, end of planes

#if VW == 16
typedef ushort16 S;
#define LOAD(p) LAYOUT_WIDE(const __private, float, p)
#define STORE(x, p) LAYOUT_WIDE(__private, float, p) = (x)
#define TO_S convert_ushort16
#define TO_BYTE convert_uchar16
#else
typedef ushort S;
#define LOAD(p) (*(p))
#define STORE(x, p) (*(p) = (x))
#define TO_S convert_ushort
#define TO_BYTE convert_uchar
#endif

INLINE VU take(__global const uint *p, VI at)
{
#if VW == 16
    return (VU)(p[at.s0], p[at.s1], p[at.s2], p[at.s3], p[at.s4], p[at.s5], p[at.s6], p[at.s7],
                p[at.s8], p[at.s9], p[at.sa], p[at.sb], p[at.sc], p[at.sd], p[at.se], p[at.sf]);
#else
    return p[at];
#endif
}

INLINE uint tile_first(__global const float *tiles, uint tile)
{
    return (uint)tiles[TILE_NUMBERS * tile + 3];
}

INLINE uint tile_end(__global const float *tiles, uint tile)
{
    return (uint)tiles[TILE_NUMBERS * tile + 4];
}

// Where pixels of the reference fall in a neighbour. Returns the third coordinate.
INLINE V map_at(const float *h, V px, float py, V *u, V *v)
{
    V q = h[6] * px + (h[7] * py + h[8]), inv = 1.0f / q;
    *u = (h[0] * px + (h[1] * py + h[2])) * inv;
    *v = (h[3] * px + (h[4] * py + h[5])) * inv;
    return q;
}

// The neighbour as the reference would see it if all lay in the plane. Outside of it: its edge.
// quads: a pixel, its right neighbour, and the two below, 8 bits each.
INLINE V sample_at(__global const uint *quads, int width, float right, float bottom, const float *h,
                   V px, float py)
{
    V u, v;
    (void)map_at(h, px, py, &u, &v);
    u = CLAMP_(u - 0.5f, (V)(0.0f), (V)(right));
    v = CLAMP_(v - 0.5f, (V)(0.0f), (V)(bottom));
    VI i = TO_VI(u), j = TO_VI(v);
    V fu = u - TO_V(i), fv = v - TO_V(j);
    VU four = take(quads, j * width + i);
    V a = TO_V(four & 255u), b = TO_V((four >> 8) & 255u), c = TO_V((four >> 16) & 255u),
      d = TO_V(four >> 24);
    V top = a + fu * (b - a), low = c + fu * (d - c);
    return (top + fv * (low - top)) * (1.0f / 255.0f);
}

// 1 minus the mean of the best correlations, best first, of neighbours that show the place.
INLINE V best_cost(V a, V b, V c, uint best)
{
    V n = (V)(1.0f);
    VI two = (b > -1.5f) & (best > 1 ? (VI)(-1) : (VI)(0));
    VI three = (c > -1.5f) & (best > 2 ? (VI)(-1) : (VI)(0));
    a += two ? b : (V)(0.0f);
    n += two ? (V)(1.0f) : (V)(0.0f);
    a += three ? c : (V)(0.0f);
    n += three ? (V)(1.0f) : (V)(0.0f);
    return COST_MOST * CLAMP_(1.0f - a / n, (V)(0.0f), (V)(1.0f));
}

#if VW == 16

#define ROW (TILE_W + 16) // of a tile and its margins
#define ROWS (TILE_H + 2 * RADIUS)
#define TILE (TILE_H * TILE_W)

// The part of the reference that a tile needs.
static void tile_read(__global const uchar *grey, int width, int height, int x0, int y0, float *out)
{
    for (int y = 0; y < ROWS; y++) {
        __global const uchar *row = grey + clamp(y0 + y - RADIUS, 0, height - 1) * width;
        for (int x = 0; x < ROW; x++)
            out[y * ROW + x] = (float)row[clamp(x0 + x - RADIUS, 0, width - 1)] * (1.0f / 255.0f);
    }
}

static void tile_warp(__global const uint *quads, int width, int height, const float *h, int x0,
                      int y0, float *out)
{
    float right = (float)width - 1.001f, bottom = (float)height - 1.001f;
    for (int y = 0; y < ROWS; y++) {
        float py = (float)(y0 + y - RADIUS) + 0.5f;
        for (int x = 0; x < ROW; x += VW) {
            V px = (float)(x0 + x - RADIUS) + 0.5f + TO_V(LANE);
            STORE(sample_at(quads, width, right, bottom, h, px, py), out + y * ROW + x);
        }
    }
}

// Of the reference: weights of a window's pixels, 1 / their sum, the mean, and 1 / the standard
// deviation with noise.
struct tile_own {
    float weight[SIDE * ROW_TAPS * TILE], share[TILE], mean[TILE], inverse[TILE];
};

static void tile_own(const float *ref, struct tile_own *out)
{
    for (int y = 0; y < TILE_H; y++)
        for (int x = 0; x < TILE_W; x += VW) {
            int at = y * TILE_W + x;
            V middle = LOAD(ref + (y + RADIUS) * ROW + x + RADIUS);
            V all = (V)(0.0f), one = all, two = all;
            for (int j = 0; j < SIDE; j++)
                for (int i = FIRST(j); i < SIDE; i += 2) {
                    V a = LOAD(ref + (y + j) * ROW + x + i), d = (a - middle) * (1.0f / LIKE);
                    V like = 1.0f / (1.0f + d * d), w = like * like;
                    STORE(w, out->weight + (j * ROW_TAPS + i / 2) * TILE + at);
                    all += w;
                    one += w * a;
                    two += w * a * a;
                }
            V share = 1.0f / all, m = one * share, v = two * share - m * m;
            STORE(share, out->share + at);
            STORE(m, out->mean + at);
            STORE(1.0f / sqrt(MAX_(v, (V)(0.0f)) + NOISE), out->inverse + at);
        }
}

// Correlation of the windows of a vector of pixels from (x, y) of the tile on.
INLINE V tile_correlation(const float *ref, const struct tile_own *own, const float *near, int x,
                          int y)
{
    int at = y * TILE_W + x;
    V one = (V)(0.0f), two = one, both = one;
    for (int j = 0; j < SIDE; j++)
        for (int i = FIRST(j); i < SIDE; i += 2) {
            int tap = (y + j) * ROW + x + i;
            V b = LOAD(near + tap);
            V w = b * LOAD(own->weight + (j * ROW_TAPS + i / 2) * TILE + at);
            one += w;
            two += w * b;
            both += w * LOAD(ref + tap);
        }
    V share = LOAD(own->share + at), m = one * share, var = two * share - m * m;
    return (both * share - m * LOAD(own->mean + at)) * LOAD(own->inverse + at) /
           sqrt(MAX_(var, (V)(0.0f)) + NOISE);
}

// The three best correlations so far, best first.
struct tile_best {
    float first[TILE], second[TILE], third[TILE];
};

static void tile_score(const float *ref, const struct tile_own *own, const float *near,
                       const float *h, int width, int height, int x0, int y0, struct tile_best *t)
{
    float right = (float)width - 1.0f, bottom = (float)height - 1.0f;
    for (int y = 0; y < TILE_H; y++) {
        float py = (float)(y0 + y) + 0.5f;
        for (int x = 0; x < TILE_W; x += VW) {
            int at = y * TILE_W + x;
            V u, v, px = (float)(x0 + x) + 0.5f + TO_V(LANE), q = map_at(h, px, py, &u, &v);
            V c = tile_correlation(ref, own, near, x, y);
            VI inside = (q > 0.0f) & (u >= 1.0f) & (v >= 1.0f) & (u <= right) & (v <= bottom);
            c = inside ? c : (V)(-2.0f);
            V a = LOAD(t->first + at), b = LOAD(t->second + at), d = LOAD(t->third + at);
            STORE(MAX_(a, c), t->first + at);
            c = MIN_(a, c);
            STORE(MAX_(b, c), t->second + at);
            c = MIN_(b, c);
            STORE(MAX_(d, c), t->third + at);
        }
    }
}

INLINE V tile_cost(const struct tile_best *t, int at, uint best)
{
    return best_cost(LOAD(t->first + at), LOAD(t->second + at), LOAD(t->third + at), best);
}

// Whether a neighbour shows nothing of a tile: its corners all lie beyond one of its edges.
static bool tile_is_beside(const float *h, int width, int height, int x0, int y0)
{
    int beyond = 15;
    for (int k = 0; k < 4; k++) {
        float x = (float)(x0 + (k & 1) * TILE_W), y = (float)(y0 + (k >> 1) * TILE_H),
              q = h[6] * x + h[7] * y + h[8], u = h[0] * x + h[1] * y + h[2],
              v = h[3] * x + h[4] * y + h[5];
        if (!(q > 0.0f))
            return false;
        beyond &= (u < 0.0f) | (v < 0.0f) << 1 | (u > q * (float)width) << 2 |
                  (v > q * (float)height) << 3;
    }
    return beyond;
}

// quads: pictures of the neighbours; sizes [n_near]: width, height, first pixel of each.
// homography [planes][n_near][9], of a tile `each` behind that of the tile before. Where each is
// not 0, a tile has its own planes, and costs of others are not written.
__kernel void sweep_cost(__global const uchar *ref, __global const uint *quads,
                         __global const uint *sizes, __global const float *homography, uint each,
                         __global const float *tiles, uint n_near, uint best, uint planes,
                         uint width, uint height, __global uchar *cost)
{
    uint across = TILES_OF(width), down = (height + TILE_H - 1) / TILE_H;
    uint tile = (uint)get_global_id(0) % (across * down),
         slab = (uint)get_global_id(0) / (across * down);
    if (slab * SLAB >= planes)
        return;
    int x0 = (int)(tile % across) * TILE_W, y0 = (int)(tile / across) * TILE_H;
    uint first = slab * SLAB, end = min(planes, first + SLAB);
    if (each) {
        first = max(first, tile_first(tiles, tile));
        end = min(end, tile_end(tiles, tile));
    }
    if (first >= end)
        return;
    float here[ROWS * ROW], there[ROWS * ROW];
    struct tile_own own;
    struct tile_best t;
    tile_read(ref, (int)width, (int)height, x0, y0, here);
    tile_own(here, &own);
    for (uint p = first; p < end; p++) {
        for (int i = 0; i < TILE; i++)
            t.first[i] = t.second[i] = t.third[i] = -2.0f;
        for (uint k = 0; k < n_near; k++) {
            float h[9];
            for (int i = 0; i < 9; i++)
                h[i] = homography[tile * each + (p * n_near + k) * 9 + i];
            int w = (int)sizes[3 * k], n = (int)sizes[3 * k + 1];
            if (tile_is_beside(h, w, n, x0, y0))
                continue;
            tile_warp(quads + sizes[3 * k + 2], w, n, h, x0, y0, there);
            tile_score(here, &own, there, h, w, n, x0, y0, &t);
        }
        for (int y = 0; y < TILE_H && y0 + y < (int)height; y++)
            for (int x = 0; x < TILE_W && x0 + x < (int)width; x += VW) {
                uchar c[VW];
                LAYOUT_WIDE(__private, uchar, c) =
                    TO_BYTE(tile_cost(&t, y * TILE_W + x, best) + 0.5f);
                size_t at = ((size_t)p * height + y0 + y) * width + x0 + x;
                for (int i = 0; i < VW && x0 + x + i < (int)width; i++)
                    cost[at + i] = c[i];
            }
    }
}

#else

// Of the reference, around a pixel: as struct tile_own.
struct own {
    float ref[SIDE * ROW_TAPS], weight[SIDE * ROW_TAPS], share, mean, inverse;
};

INLINE void own_of(__global const uchar *grey, int width, int height, int x, int y, struct own *out)
{
    float middle = (float)grey[y * width + x] * (1.0f / 255.0f), all = 0.0f, one = 0.0f, two = 0.0f;
#pragma unroll
    for (int j = 0; j < SIDE; j++) {
        __global const uchar *row = grey + clamp(y + j - RADIUS, 0, height - 1) * width;
#pragma unroll
        for (int i = FIRST(j); i < SIDE; i += 2) {
            float a = (float)row[clamp(x + i - RADIUS, 0, width - 1)] * (1.0f / 255.0f);
            float d = (a - middle) * (1.0f / LIKE), like = 1.0f / (1.0f + d * d), w = like * like;
            out->ref[j * ROW_TAPS + i / 2] = a;
            out->weight[j * ROW_TAPS + i / 2] = w;
            all += w;
            one += w * a;
            two += w * a * a;
        }
    }
    out->share = 1.0f / all;
    out->mean = one * out->share;
    float v = two * out->share - out->mean * out->mean;
    out->inverse = 1.0f / sqrt(MAX_(v, 0.0f) + NOISE);
}

// -2 where the neighbour does not show the place.
INLINE float own_correlation(const struct own *own, __global const uint *quads, int width,
                             int height, const float *h, int x, int y)
{
    float right = (float)width - 1.001f, bottom = (float)height - 1.001f, u, v;
    float q = map_at(h, (float)x + 0.5f, (float)y + 0.5f, &u, &v), one = 0.0f, two = 0.0f,
          both = 0.0f;
    if (!((q > 0.0f) & (u >= 1.0f) & (v >= 1.0f) & (u <= (float)width - 1.0f) &
          (v <= (float)height - 1.0f)))
        return -2.0f;
#pragma unroll
    for (int j = 0; j < SIDE; j++)
#pragma unroll
        for (int i = FIRST(j); i < SIDE; i += 2) {
            float b = sample_at(quads, width, right, bottom, h, (float)(x + i - RADIUS) + 0.5f,
                                (float)(y + j - RADIUS) + 0.5f);
            float w = b * own->weight[j * ROW_TAPS + i / 2];
            one += w;
            two += w * b;
            both += w * own->ref[j * ROW_TAPS + i / 2];
        }
    float m = one * own->share, var = two * own->share - m * m;
    return (both * own->share - m * own->mean) * own->inverse / sqrt(MAX_(var, 0.0f) + NOISE);
}

// Arguments as above.
__kernel void sweep_cost(__global const uchar *ref, __global const uint *quads,
                         __global const uint *sizes, __global const float *homography, uint each,
                         __global const float *tiles, uint n_near, uint best, uint planes,
                         uint width, uint height, __global uchar *cost)
{
    size_t pixels = (size_t)width * height, item = get_global_id(0);
    if (item >= pixels * planes)
        return;
    uint p = (uint)(item / pixels), at = (uint)(item % pixels);
    int x = (int)(at % width), y = (int)(at / width);
    uint tile = y / TILE_H * TILES_OF(width) + x / TILE_W;
    if (each && (p < tile_first(tiles, tile) || p >= tile_end(tiles, tile)))
        return;
    struct own own;
    float first = -2.0f, second = -2.0f, third = -2.0f;
    own_of(ref, (int)width, (int)height, x, y, &own);
    for (uint k = 0; k < n_near; k++) {
        float h[9];
#pragma unroll
        for (int i = 0; i < 9; i++)
            h[i] = homography[tile * each + (p * n_near + k) * 9 + i];
        float c = own_correlation(&own, quads + sizes[3 * k + 2], (int)sizes[3 * k],
                                  (int)sizes[3 * k + 1], h, x, y);
        float a = MIN_(first, c), b = MIN_(second, a);
        first = MAX_(first, c);
        second = MAX_(second, a);
        third = MAX_(third, b);
    }
    cost[item] = TO_BYTE(best_cost(first, second, third, best) + 0.5f);
}

#endif

// The pixels of a work-item.
#if VW == 16
#define PIXELS_EACH(at, width, height)                                                             \
    for (size_t at = get_global_id(0) * (width),                                                   \
                end_ = get_global_id(0) < (height) ? at + (width) : at;                            \
         at < end_; at++)
#else
#define PIXELS_EACH(at, width, height)                                                             \
    for (size_t at = get_global_id(0), end_ = (size_t)(width) * (height); at < end_; at = end_)
#endif

struct sweep_rays {
    float m[9], from;
};

// Upright plane of a pixel for height p: scale p + shift; scale 0: there is none.
INLINE float2 upright_at(struct sweep_rays k, __global const float *tile, float px, float py)
{
    float d[3];
    for (int i = 0; i < 3; i++)
        d[i] = k.m[3 * i] * px + k.m[3 * i + 1] * py + k.m[3 * i + 2];
    float scale = (tile[0] * d[0] + tile[1] * d[1]) / d[2] * tile[2];
    if (!(d[2] < -DOWN) | !(scale > 0.0f))
        return (float2)(0.0f);
    return (float2)(scale, k.from * (1.0f - scale)) / WALL_EVERY + (float2)(0.0f, WALL_MORE);
}

// The cost of a pixel between two upright planes, costs [planes][h][w]; COST_MOST outside of them.
INLINE float upright_cost(__global const uchar *costs, __global const float *tile, size_t pixels,
                          float p)
{
    if (!((p >= tile[3]) & (p < tile[4] - 1.0f)))
        return COST_MOST;
    uint low = (uint)p;
    float a = (float)costs[low * pixels], b = (float)costs[(low + 1) * pixels];
    return a + (p - (float)low) * (b - a) + WALL_COST;
}

// walls [planes of walls][h][w]; upright 0: there are none.
__kernel void sweep_turn(__global const uchar *in, __global const uchar *walls,
                         __global const float *tiles, struct sweep_rays rays, uint upright,
                         uint planes, uint width, uint height, __global uchar *out)
{
    size_t pixels = (size_t)width * height;
    PIXELS_EACH(at, width, height)
    {
        uint x = (uint)(at % width), y = (uint)(at / width);
        __global const float *tile =
            tiles + TILE_NUMBERS * (y / TILE_H * TILES_OF(width) + x / TILE_W);
        float2 to = (float2)(0.0f);
        if (upright)
            to = upright_at(rays, tile, (float)x + 0.5f, (float)y + 0.5f);
        for (uint p = 0; p < PLANES; p++) {
            float c = p < planes ? (float)in[p * pixels + at] : COST_MOST;
            if ((to.x > 0.0f) & (p < planes))
                c = min(c, upright_cost(walls + at, tile, pixels, to.x * (float)p + to.y));
            out[at * PLANES + p] = (uchar)(c + 0.5f);
        }
    }
}

#if VW == 16

#define COSTS(p) LAYOUT_WIDE(__private, ushort, p)

INLINE ushort next_least(S x)
{
    ushort8 a = min(x.lo, x.hi);
    ushort4 b = min(a.lo, a.hi);
    return min(min(b.x, b.y), min(b.z, b.w));
}

// A line of pixels: first pixel, step between pixels, number of pixels.
__kernel void sweep_path(__global const uchar *cost, __global const uchar *ref, uint lines,
                         int first_base, int first_step, int step, uint count, uint jump_low,
                         uint jump_high, float edge, __global ushort *sum)
{
    uint line = (uint)get_global_id(0);
    if (line >= lines)
        return;
    ushort before[PLANES + 2 * VW]; // plane p at VW + p, with walls on both sides
    int at = first_base + (int)line * first_step;
    ushort least = 0;
    for (int p = 0; p < PLANES + 2 * VW; p++)
        before[p] = p >= VW && p < PLANES + VW ? 0 : (ushort)60000;
    uchar grey = ref[at];
    for (uint i = 0; i < count; i++, at += step) {
        __global const uchar *c = cost + (size_t)at * PLANES;
        __global ushort *s = sum + (size_t)at * PLANES;
        float change = fabs((float)ref[at] - (float)grey) * (edge / 255.0f);
        ushort jump = (ushort)((float)jump_low + (float)(jump_high - jump_low) / (1.0f + change));
        grey = ref[at];
        S most = (S)((ushort)(least + jump)), less = (S)(least), next = (S)((ushort)60000);
        S left = COSTS(before + VW - 1), step_cost = (S)((ushort)STEP_COST);
        for (int p = 0; p < PLANES; p += VW) {
            S mid = COSTS(before + VW + p), right = COSTS(before + VW + p + 1);
            S m = min(min(mid, most), (S)(min(left, right) + step_cost));
            S v = (S)(m - less + TO_S(LAYOUT_WIDE(const __global, uchar, c + p)));
            left = COSTS(before + VW + p + VW - 1);
            COSTS(before + VW + p) = v;
            LAYOUT_WIDE(__global, ushort, s + p) += v;
            next = min(next, v);
        }
        least = next_least(next);
    }
}

#else

// Arguments as above. Every step ends with the least of all planes, by halves.
__kernel __attribute__((reqd_work_group_size(PLANES, 1, 1))) void
sweep_path(__global const uchar *cost, __global const uchar *ref, uint lines, int first_base,
           int first_step, int step, uint count, uint jump_low, uint jump_high, float edge,
           __global ushort *sum)
{
    __local ushort before[PLANES + 2], low[PLANES]; // plane p at 1 + p, with walls on both sides
    uint p = (uint)get_local_id(0);
    int at = first_base + (int)get_group_id(0) * first_step;
    ushort least = 0;
    before[1 + p] = 0;
    if (p == 0)
        before[0] = before[PLANES + 1] = 60000;
    uchar grey = ref[at];
    for (uint i = 0; i < count; i++, at += step) {
        size_t own = (size_t)at * PLANES + p;
        float change = fabs((float)ref[at] - (float)grey) * (edge / 255.0f);
        ushort jump = (ushort)((float)jump_low + (float)(jump_high - jump_low) / (1.0f + change));
        grey = ref[at];
        barrier(CLK_LOCAL_MEM_FENCE);
        ushort beside = (ushort)(min(before[p], before[p + 2]) + STEP_COST);
        ushort m = min(min(before[1 + p], (ushort)(least + jump)), beside);
        ushort v = (ushort)(m - least + cost[own]);
        barrier(CLK_LOCAL_MEM_FENCE);
        before[1 + p] = low[p] = v;
        sum[own] += v;
        for (uint half_way = 128; half_way > 0; half_way /= 2) { // PLANES is 192 at most
            barrier(CLK_LOCAL_MEM_FENCE);
            if (p < half_way && p + half_way < PLANES)
                low[p] = min(low[p], low[p + half_way]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        least = low[0];
    }
}

#endif

__kernel void sweep_pick(__global const uchar *cost, __global const ushort *sum, uint planes,
                         uint width, uint height, __global float *plane, __global float *score)
{
    PIXELS_EACH(at, width, height)
    {
        __global const ushort *s = sum + at * PLANES;
        ushort least = 65535;
        for (uint p = 0; p < planes; p++)
            least = min(least, s[p]);
        uint best = 0;
        while (s[best] != least)
            best++;
        float sub = 0.0f;
        if (best > 0 && best + 1 < planes) {
            float a = (float)s[best - 1], b = (float)s[best], c = (float)s[best + 1];
            float bend = a - 2.0f * b + c;
            sub = bend > 0.0f ? 0.5f * (a - c) / bend : 0.0f;
        }
        plane[at] = (float)best + sub;
        score[at] = 1.0f - (float)cost[at * PLANES + best] / COST_MOST;
    }
}
