/* Stage: L1 + SSIM loss, forward (maps and partial sums) and backward (dL/dx).
 *
 *   in   color  float [3][h][w], target uchar [h][w][3], mask uchar [h][w] or absent
 *
 *   mid  maps   float [3 maps][3 channels][h][pitch], pitch = MARGIN + round_up(w, STRIP) + MARGIN
 *               (LAYOUT_LOSS_*): the derivatives of S with respect to Kx, Kx^2 and K(xy); zero
 *               beyond the picture
 *
 *   out  parts  float [pieces][3][4]: |x-y|, S and (x-y)^2 summed over a piece
 *        grad   float [3][h][w]
 *
 * CPU shape (VW 16): one work-item = one piece of STRIP x BAND pixels of one channel. ROWS rows at
 * a time are blurred horizontally into a window in private memory (26 KiB, of the size of a cache),
 * then vertically, two rows at once. GPU shape (VW 1): one work-group = one tile of 16x16 pixels of
 * one channel, one work-item = one pixel; the tile and 5 pixels around it are staged in local
 * memory and blurred there. All sums are taken in a fixed order. The only products needed are
 * x^2 + y^2 and xy, because the two variances enter S as their sum.
 *
 * Reference: photometric_ref.c (which has the formulas). Tolerance: float rounding, 1e-5 relative.
 */
#define RADIUS 5
#define TAPS 11
#define VECS (LAYOUT_LOSS_STRIP / 16)
#define ROWS 16 /* even */

#define SSIM_C1 0.0001f
#define SSIM_C2 0.0009f

__constant float taps[TAPS] = {0.00102838008f, 0.00759875814f, 0.0360007721f, 0.10936069f,
                               0.213005538f,   0.266011725f,   0.213005538f,  0.10936069f,
                               0.0360007721f,  0.00759875814f, 0.00102838008f};

#if VW == 16
typedef float16 V;
#define INLINE static inline __attribute__((always_inline))
#ifdef HAS_PREFETCH
#define PREFETCH(p) __builtin_prefetch(p)
#else
#define PREFETCH(p) (void)(p)
#endif
#else
typedef float V;
#define INLINE static inline
#endif

/* S and its three derivatives. */
INLINE V ssim_of(V m1, V m2, V qq, V xy, V *pm, V *ps, V *pc)
{
    V mm = m1 * m2, m11 = m1 * m1 + m2 * m2;
    V a1 = 2.0f * mm + SSIM_C1, a2 = 2.0f * (xy - mm) + SSIM_C2;
    V b1 = m11 + SSIM_C1, b2 = (qq - m11) + SSIM_C2;
    V r = 1.0f / (b1 * b2), r1 = r * b2, r2 = r * b1;
    V s = a1 * a2 * r;
    *pc = 2.0f * a1 * r;
    *ps = -s * r2;
    *pm = 2.0f * m2 * a2 * r - 2.0f * m1 * s * r1 - 2.0f * m1 * *ps - m2 * *pc;
    return s;
}

#if VW == 16

/* 16 pixels of channel c out of 48 interleaved bytes: byte 3 i + c is in word (3 i + c) / 4. */
INLINE float16 pixels_channel(const __global uchar *p, int c)
{
    uint4 first = as_uint4(LAYOUT_WIDE(const __global, uchar, p)),
          middle = as_uint4(LAYOUT_WIDE(const __global, uchar, p + 16)),
          last = as_uint4(LAYOUT_WIDE(const __global, uchar, p + 32));
    uint16 v = (uint16)(first, middle, last, last);
    if (c == 0)
        v = __builtin_shufflevector(v, v, 0, 0, 1, 2, 3, 3, 4, 5, 6, 6, 7, 8, 9, 9, 10, 11) >>
            (uint16)(0, 24, 16, 8, 0, 24, 16, 8, 0, 24, 16, 8, 0, 24, 16, 8);
    else if (c == 1)
        v = __builtin_shufflevector(v, v, 0, 1, 1, 2, 3, 4, 4, 5, 6, 7, 7, 8, 9, 10, 10, 11) >>
            (uint16)(8, 0, 24, 16, 8, 0, 24, 16, 8, 0, 24, 16, 8, 0, 24, 16);
    else
        v = __builtin_shufflevector(v, v, 0, 1, 2, 2, 3, 4, 5, 5, 6, 7, 8, 8, 9, 10, 11, 11) >>
            (uint16)(16, 8, 0, 24, 16, 8, 0, 24, 16, 8, 0, 24, 16, 8, 0, 24);
    return convert_float16(as_int16(v & 255u)) * (1.0f / 255.0f);
}

struct picture {
    const __global float *color;
    const __global uchar *target, *mask;
    int has_mask, w, h, c;
};

/* x and y of 16 columns of a row, zero outside the picture and where masked. */
INLINE void pixels_load(const struct picture *p, int row, int col, float16 *x, float16 *y)
{
    const __global float *cp = p->color + ((size_t)p->c * p->h + row) * p->w;
    const __global uchar *tp = p->target + (size_t)row * p->w * 3;
    const __global uchar *mp = p->mask + (p->has_mask ? (size_t)row * p->w : 0);
    if (col >= 0 && col + 16 <= p->w) {
        *x = LAYOUT_WIDE(const __global, float, cp + col);
        *y = pixels_channel(tp + 3 * col, p->c);
        PREFETCH(cp + p->w + col);
        PREFETCH(tp + 3 * (p->w + col));
        if (p->has_mask) {
            int16 used = convert_int16(LAYOUT_WIDE(const __global, uchar, mp + col)) != 0;
            *x = used ? *x : (float16)(0.0f);
            *y = used ? *y : (float16)(0.0f);
        }
        return;
    }
    float xs[16], ys[16];
    for (int i = 0; i < 16; i++) {
        int q = col + i, used = q >= 0 && q < p->w;
        if (used && p->has_mask)
            used = mp[q] != 0;
        xs[i] = used ? cp[q] : 0.0f;
        ys[i] = used ? (float)tp[3 * q + p->c] * (1.0f / 255.0f) : 0.0f;
    }
    *x = LAYOUT_WIDE(const __private, float, xs);
    *y = LAYOUT_WIDE(const __private, float, ys);
}

static float sum16(float16 v)
{
    float8 a = v.lo + v.hi;
    float4 b = a.lo + a.hi;
    float2 d = b.lo + b.hi;
    return d.x + d.y;
}

/* Vertical blurs of one column of vectors `step` apart, for the rows in the middle of w[0..10] and
 * of w[1..11]. Taps are symmetric: additions run beside multiplications where half of those do. */
INLINE void blur_column(const float16 *w, int step, float16 *upper, float16 *lower)
{
    float16 v[TAPS + 1];
#pragma unroll
    for (int k = 0; k <= TAPS; k++)
        v[k] = w[k * step];
    float16 a = v[RADIUS] * taps[RADIUS], b = v[RADIUS + 1] * taps[RADIUS];
#pragma unroll
    for (int k = 1; k <= RADIUS; k++) {
        a = (v[RADIUS - k] + v[RADIUS + k]) * taps[RADIUS - k] + a;
        b = (v[RADIUS + 1 - k] + v[RADIUS + 1 + k]) * taps[RADIUS - k] + b;
    }
    *upper = a;
    *lower = b;
}

/* The vector that begins k lanes into a followed by b. A load from there would cross a cache line
 * and take twice as long as an aligned one; two aligned vectors in registers shift in one step,
 * which the compiler knows of integers only. */
#define SHIFT(a, b, k)                                                                             \
    as_float16(__builtin_shufflevector(as_int16(a), as_int16(b), k, k + 1, k + 2, k + 3, k + 4,    \
                                       k + 5, k + 6, k + 7, k + 8, k + 9, k + 10, k + 11, k + 12,  \
                                       k + 13, k + 14, k + 15))

/* Horizontal blurs of n rows of 48 columns, of the 16 in the middle; tap by tap, because one row
 * alone is a chain of additions that wait for each other. */
#define BLUR_TAP(k)                                                                                \
    _Pragma("unroll") for (int i = 0; i < n; i++) s[i] =                                           \
        (SHIFT(v[i][0], v[i][1], 16 - k) + SHIFT(v[i][1], v[i][2], k)) * taps[RADIUS - k] + s[i];
INLINE void blur_rows(float16 v[][3], const int n, float16 *s)
{
#pragma unroll
    for (int i = 0; i < n; i++)
        s[i] = v[i][1] * taps[RADIUS];
    BLUR_TAP(1)
    BLUR_TAP(2)
    BLUR_TAP(3)
    BLUR_TAP(4)
    BLUR_TAP(5)
}

/* Which piece a work-item is. */
INLINE int piece_origin(int w, int h, int *x0, int *y0, int *y1)
{
    int piece = get_global_id(0) / 3, across = (w + LAYOUT_LOSS_STRIP - 1) / LAYOUT_LOSS_STRIP;
    *x0 = piece % across * LAYOUT_LOSS_STRIP;
    *y0 = piece / across * LAYOUT_LOSS_BAND;
    *y1 = min(*y0 + LAYOUT_LOSS_BAND, h);
    return get_global_id(0) % 3;
}

/* Horizontal blurs of x, y, x^2 + y^2 and xy of one row of a strip into to[4][VECS]; adds up what
 * is counted of the row. */
INLINE void forward_row(const struct picture *p, int row, int x0, int counted, int with_ssim,
                        float16 *to, float16 *sum_l1, float16 *sum_sq)
{
    float16 v[4][3], blurred[4]; /* x, y, x^2 + y^2, xy */
    for (int j = -1; j <= VECS; j++) {
        float16 x, y;
        pixels_load(p, row, x0 + 16 * j, &x, &y);
        if (counted && j >= 0 && j < VECS) {
            float16 d = x - y;
            *sum_l1 += fabs(d);
            *sum_sq = d * d + *sum_sq;
        }
        v[0][2] = x;
        v[1][2] = y;
        v[2][2] = x * x + y * y;
        v[3][2] = x * y;
        if (with_ssim && j > 0) {
            blur_rows(v, 4, blurred);
#pragma unroll
            for (int k = 0; k < 4; k++)
                to[k * VECS + j - 1] = blurred[k];
        }
#pragma unroll
        for (int k = 0; k < 4; k++)
            v[k][0] = v[k][1], v[k][1] = v[k][2];
    }
}

/* SSIM of one row of a vector's columns, and its derivatives into the maps. */
INLINE float16 forward_ssim(const float16 *mean, int left, size_t plane, __global float *to)
{
    float16 pm, ps, pc, s = ssim_of(mean[0], mean[1], mean[2], mean[3], &pm, &ps, &pc);
    if (left < 16) { /* windows centred beyond the edge do not exist */
        int16 in = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15) < left;
        s = in ? s : (float16)(0.0f);
        pm = in ? pm : (float16)(0.0f);
        ps = in ? ps : (float16)(0.0f);
        pc = in ? pc : (float16)(0.0f);
    }
    LAYOUT_WIDE(__global, float, to) = pm;
    LAYOUT_WIDE(__global, float, to + plane) = ps;
    LAYOUT_WIDE(__global, float, to + 2 * plane) = pc;
    return s;
}

/* Move the last rows of the window, which the next rows need as well, to its front. */
INLINE void window_move(float16 *window, int rows, int width)
{
    for (int i = 0; i < 2 * RADIUS * width; i++)
        window[i] = window[rows * width + i];
}

__kernel void photometric_forward(const __global float *color, const __global uchar *target,
                                  const __global uchar *mask, int has_mask, int w, int h, int pitch,
                                  int with_ssim, __global float *maps, __global float *parts)
{
    enum { WIDTH = 4 * VECS };
    int x0, y0, y1, c = piece_origin(w, h, &x0, &y0, &y1), halo = with_ssim ? RADIUS : 0;
    struct picture p = {color, target, mask, has_mask, w, h, c};
    float16 window[(ROWS + 2 * RADIUS) * WIDTH], sum_l1 = 0.0f, sum_s = 0.0f, sum_sq = 0.0f;
    size_t plane = (size_t)3 * h * pitch;
    /* rows [out - 5, out + 5) are in the window, ROWS more come in, ROWS are written */
    for (int out = y0 - ROWS; out < y1; out += ROWS) {
        int first = out < y0 ? ROWS - 2 * halo : 0;
        for (int i = first; i < ROWS && out + i - halo < y1; i++) {
            int row = out + halo + i;
            float16 *to = window + (2 * RADIUS + i) * WIDTH;
            if (row >= 0 && row < min(h, y1 + halo))
                forward_row(&p, row, x0, row >= y0 && row < y1, with_ssim, to, &sum_l1, &sum_sq);
            else
                for (int j = 0; j < WIDTH; j++)
                    to[j] = (float16)(0.0f);
        }
        for (int i = 0; with_ssim && out >= y0 && i < ROWS && out + i < y1; i += 2)
            for (int j = 0; j < VECS; j++) {
                float16 upper[4], lower[4];
                __global float *to =
                    maps + ((size_t)c * h + out + i) * pitch + LAYOUT_LOSS_MARGIN + x0 + 16 * j;
                for (int k = 0; k < 4; k++)
                    blur_column(window + i * WIDTH + k * VECS + j, WIDTH, upper + k, lower + k);
                sum_s += forward_ssim(upper, w - x0 - 16 * j, plane, to);
                if (out + i + 1 < y1)
                    sum_s += forward_ssim(lower, w - x0 - 16 * j, plane, to + pitch);
            }
        if (with_ssim)
            window_move(window, ROWS, WIDTH);
    }
    __global float *part = parts + get_global_id(0) * 4;
    part[0] = sum16(sum_l1);
    part[1] = sum16(sum_s);
    part[2] = sum16(sum_sq);
    part[3] = 0.0f;
}

/* Horizontal blurs of one row of the three maps into to[3][VECS]. A strip's rows are too short for
 * the hardware to see them coming. */
INLINE void backward_row(const __global float *from, size_t plane, int pitch, float16 *to)
{
    float16 v[3][3], blurred[3];
#pragma unroll
    for (int m = 0; m < 3; m++) {
        v[m][0] = LAYOUT_WIDE(const __global, float, from + m * plane - 16);
        v[m][1] = LAYOUT_WIDE(const __global, float, from + m * plane);
    }
    for (int j = 0; j < VECS; j++) {
#pragma unroll
        for (int m = 0; m < 3; m++) {
            PREFETCH(from + m * plane + 2 * pitch + 16 * j);
            v[m][2] = LAYOUT_WIDE(const __global, float, from + m * plane + 16 * (j + 1));
        }
        blur_rows(v, 3, blurred);
#pragma unroll
        for (int m = 0; m < 3; m++) {
            to[m * VECS + j] = blurred[m];
            v[m][0] = v[m][1], v[m][1] = v[m][2];
        }
    }
}

/* The gradient of 16 columns of a row; k: the blurred maps. */
INLINE void backward_write(const struct picture *p, int row, int col, const float16 *k,
                           int with_ssim, float scale_l1, float scale_ssim, __global float *grad)
{
    float16 x, y, ks = 0.0f;
    if (col >= p->w)
        return;
    pixels_load(p, row, col, &x, &y);
    float16 d = x - y;
    float16 up = d > 0.0f ? (float16)(scale_l1) : (float16)(0.0f);
    float16 down = d < 0.0f ? (float16)(scale_l1) : (float16)(0.0f);
    if (with_ssim) {
        ks = 2.0f * x * k[1] + k[0];
        ks = y * k[2] + ks;
    }
    float16 g = ks * scale_ssim + (up - down);
    __global float *to = grad + ((size_t)p->c * p->h + row) * p->w;
    const __global uchar *mp = p->mask + (p->has_mask ? (size_t)row * p->w : 0);
    if (col + 16 <= p->w && !p->has_mask) {
        LAYOUT_WIDE(__global, float, to + col) = g;
    } else {
        float gs[16];
        LAYOUT_WIDE(__private, float, gs) = g;
        for (int i = 0; i < 16 && col + i < p->w; i++)
            to[col + i] = !p->has_mask || mp[col + i] ? gs[i] : 0.0f;
    }
}

/* scale_l1 = l1_weight / 3hw, scale_ssim = -ssim_weight / 3hw. */
__kernel void photometric_backward(const __global float *color, const __global uchar *target,
                                   const __global uchar *mask, int has_mask, int w, int h,
                                   int pitch, int with_ssim, const __global float *maps,
                                   float scale_l1, float scale_ssim, __global float *grad)
{
    enum { WIDTH = 3 * VECS };
    int x0, y0, y1, c = piece_origin(w, h, &x0, &y0, &y1);
    struct picture p = {color, target, mask, has_mask, w, h, c};
    float16 window[(ROWS + 2 * RADIUS) * WIDTH];
    size_t plane = (size_t)3 * h * pitch;
    for (int out = y0 - ROWS; out < y1; out += ROWS) {
        int first = out < y0 ? ROWS - 2 * RADIUS : 0;
        for (int i = first; with_ssim && i < ROWS && out + i - RADIUS < y1; i++) {
            int row = out + RADIUS + i;
            float16 *to = window + (2 * RADIUS + i) * WIDTH;
            if (row >= 0 && row < min(h, y1 + RADIUS))
                backward_row(maps + ((size_t)c * h + row) * pitch + LAYOUT_LOSS_MARGIN + x0, plane,
                             pitch, to);
            else
                for (int j = 0; j < WIDTH; j++)
                    to[j] = (float16)(0.0f);
        }
        for (int i = 0; out >= y0 && i < ROWS && out + i < y1; i += 2)
            for (int j = 0; j < VECS; j++) {
                float16 upper[3], lower[3];
                int col = x0 + 16 * j;
                for (int k = 0; with_ssim && k < 3; k++)
                    blur_column(window + i * WIDTH + k * VECS + j, WIDTH, upper + k, lower + k);
                backward_write(&p, out + i, col, upper, with_ssim, scale_l1, scale_ssim, grad);
                if (out + i + 1 < y1)
                    backward_write(&p, out + i + 1, col, lower, with_ssim, scale_l1, scale_ssim,
                                   grad);
            }
        if (with_ssim)
            window_move(window, ROWS, WIDTH);
    }
}

#else

#define PIXELS LAYOUT_TILE_PIXELS
#define WIDE (LAYOUT_TILE + 2 * RADIUS)

/* x or y of one channel at a pixel, 0 beyond the picture and where masked. */
static int pixel_used(const __global uchar *mask, int has_mask, int w, int h, int x, int y)
{
    if (x < 0 || y < 0 || x >= w || y >= h)
        return 0;
    return !has_mask || mask[(size_t)y * w + x];
}

/* sum over k of taps[k] * p[k * step]. */
static float blur_one(const __local float *p, int step)
{
    float a = 0.0f;
    for (int k = 0; k < TAPS; k++)
        a = p[k * step] * taps[k] + a;
    return a;
}

/* Where this work-group's tile is. */
static int tile_origin(int w, int *x0, int *y0)
{
    int piece = get_group_id(0) / 3, across = (w + LAYOUT_TILE - 1) / LAYOUT_TILE;
    *x0 = piece % across * LAYOUT_TILE;
    *y0 = piece / across * LAYOUT_TILE;
    return get_group_id(0) % 3;
}

__kernel __attribute__((reqd_work_group_size(PIXELS, 1, 1))) void
photometric_forward(const __global float *color, const __global uchar *target,
                    const __global uchar *mask, int has_mask, int w, int h, int pitch,
                    int with_ssim, __global float *maps, __global float *parts)
{
    int x0, y0, c = tile_origin(w, &x0, &y0), lane = get_local_id(0), lx = lane % LAYOUT_TILE,
                ly = lane / LAYOUT_TILE;
    __local float xs[WIDE * WIDE], ys[WIDE * WIDE], rows[4][WIDE * LAYOUT_TILE], sums[3][PIXELS];
    for (int i = lane; i < WIDE * WIDE; i += PIXELS) {
        int x = x0 + i % WIDE - RADIUS, y = y0 + i / WIDE - RADIUS;
        int used = pixel_used(mask, has_mask, w, h, x, y);
        xs[i] = used ? color[((size_t)c * h + y) * w + x] : 0.0f;
        ys[i] = used ? (float)target[((size_t)y * w + x) * 3 + c] * (1.0f / 255.0f) : 0.0f;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = lane; i < WIDE * LAYOUT_TILE; i += PIXELS) {
        const __local float *a = xs + i / LAYOUT_TILE * WIDE + i % LAYOUT_TILE,
                            *b = ys + i / LAYOUT_TILE * WIDE + i % LAYOUT_TILE;
        float m1 = 0.0f, m2 = 0.0f, qq = 0.0f, xy = 0.0f;
        for (int k = 0; k < TAPS; k++) {
            m1 = a[k] * taps[k] + m1;
            m2 = b[k] * taps[k] + m2;
            qq = (a[k] * a[k] + b[k] * b[k]) * taps[k] + qq;
            xy = (a[k] * b[k]) * taps[k] + xy;
        }
        rows[0][i] = m1;
        rows[1][i] = m2;
        rows[2][i] = qq;
        rows[3][i] = xy;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    int inside = x0 + lx < w && y0 + ly < h, at = (ly + RADIUS) * WIDE + lx + RADIUS;
    float d = xs[at] - ys[at], s = 0.0f, pm, ps, pc;
    if (with_ssim && inside) {
        size_t plane = (size_t)3 * h * pitch;
        __global float *mp =
            maps + ((size_t)c * h + y0 + ly) * pitch + LAYOUT_LOSS_MARGIN + x0 + lx;
        s = ssim_of(blur_one(rows[0] + lane, LAYOUT_TILE), blur_one(rows[1] + lane, LAYOUT_TILE),
                    blur_one(rows[2] + lane, LAYOUT_TILE), blur_one(rows[3] + lane, LAYOUT_TILE),
                    &pm, &ps, &pc);
        mp[0] = pm;
        mp[plane] = ps;
        mp[2 * plane] = pc;
    }
    sums[0][lane] = fabs(d);
    sums[1][lane] = s;
    sums[2][lane] = d * d;
    for (int half_n = PIXELS / 2; half_n > 0; half_n /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int k = 0; k < 3 && lane < half_n; k++)
            sums[k][lane] += sums[k][lane + half_n];
    }
    if (lane == 0) {
        __global float *p = parts + get_group_id(0) * 4;
        p[0] = sums[0][0];
        p[1] = sums[1][0];
        p[2] = sums[2][0];
        p[3] = 0.0f;
    }
}

__kernel __attribute__((reqd_work_group_size(PIXELS, 1, 1))) void
photometric_backward(const __global float *color, const __global uchar *target,
                     const __global uchar *mask, int has_mask, int w, int h, int pitch,
                     int with_ssim, const __global float *maps, float scale_l1, float scale_ssim,
                     __global float *grad)
{
    int x0, y0, c = tile_origin(w, &x0, &y0), lane = get_local_id(0), lx = lane % LAYOUT_TILE,
                ly = lane / LAYOUT_TILE;
    __local float near[3][WIDE * WIDE], rows[3][WIDE * LAYOUT_TILE];
    size_t plane = (size_t)3 * h * pitch;
    for (int i = lane; i < WIDE * WIDE; i += PIXELS) {
        int x = x0 + i % WIDE - RADIUS, y = y0 + i / WIDE - RADIUS;
        int in = with_ssim && x >= 0 && y >= 0 && x < w && y < h;
        for (int m = 0; m < 3; m++)
            near[m][i] =
                in ? maps[m * plane + ((size_t)c * h + y) * pitch + LAYOUT_LOSS_MARGIN + x] : 0.0f;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = lane; i < WIDE * LAYOUT_TILE; i += PIXELS)
        for (int m = 0; m < 3; m++)
            rows[m][i] = blur_one(near[m] + i / LAYOUT_TILE * WIDE + i % LAYOUT_TILE, 1);
    barrier(CLK_LOCAL_MEM_FENCE);
    int px = x0 + lx, py = y0 + ly;
    if (px >= w || py >= h)
        return;
    size_t at = (size_t)py * w + px;
    float g = 0.0f;
    if (pixel_used(mask, has_mask, w, h, px, py)) {
        float x = color[(size_t)c * h * w + at], y = (float)target[at * 3 + c] * (1.0f / 255.0f);
        g = blur_one(rows[0] + lane, LAYOUT_TILE);
        g = 2.0f * x * blur_one(rows[1] + lane, LAYOUT_TILE) + g;
        g = y * blur_one(rows[2] + lane, LAYOUT_TILE) + g;
        g = g * scale_ssim + (x > y ? scale_l1 : x < y ? -scale_l1 : 0.0f);
    }
    grad[(size_t)c * h * w + at] = g;
}

#endif
