/* Stage: L1 + SSIM loss (partial sums) and its gradient dL/dx.
 *
 *   in   color  float [3][h][w], target uchar [h][w][3], mask uchar [h][w] or absent
 *
 *   out  parts  float [pieces][3][4]: |x-y|, S and (x-y)^2 summed over a piece
 *        grad   float [3][h][w]
 *
 * CPU shape (VW 16): photometric_both. One work-item = one piece of STRIP columns and a band of
 * rows of one channel. It goes down the band two rows at a time: they are blurred horizontally into
 * a ring of 12 rows, and this vertically gives two rows of the derivatives of S with respect to Kx,
 * Kx^2 and K(xy). Those are blurred horizontally into a second ring, and this vertically gives the
 * gradient of the two rows that came in 10 rows before. So derivatives never leave the cache (both
 * rings: 61 KiB), and each piece makes those of 5 pixels around it once more. Its vectors of
 * derivatives begin 5 columns left of those of the gradient: a blur needs two vectors, not three.
 *
 * GPU shape (VW 1): photometric_forward and photometric_backward. One work-group = one tile of
 * 16x16 pixels of one channel, one work-item = one pixel; the tile and 5 pixels around it are
 * staged in local memory and blurred there. Between the two kernels lie
 *
 *   mid  maps   float [3 maps][3 channels][h][pitch], pitch = MARGIN + round_up(w, 16) + MARGIN:
 *               the derivatives; zero beyond the picture
 *
 * All sums are taken in a fixed order. The only products needed are x^2 + y^2 and xy, because the
 * two variances enter S as their sum.
 *
 * Reference: photometric_ref.c (which has the formulas). Tolerance: float rounding, 1e-5 relative.
 */
#define RADIUS 5
#define TAPS 11
#define VECS (LAYOUT_LOSS_STRIP / 16)
#define WINDOW (TAPS + 1) /* rows that two rows of blurs come from */

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

struct weights {
    float l1, ssim;
    int with_ssim, with_grad;
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
    if (col + 16 <= 0 || col >= p->w) {
        *x = *y = (float16)(0.0f);
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

/* Vertical blurs of one vector's columns, for the rows in the middle of row[0..10] and of
 * row[1..11]. Taps are symmetric: additions run beside multiplications where half of those do. */
INLINE void blur_column(float16 *const *row, int at, float16 *upper, float16 *lower)
{
    float16 v[WINDOW];
#pragma unroll
    for (int k = 0; k < WINDOW; k++)
        v[k] = row[k][at];
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
 * which the compiler knows of integers only. WORDS makes integers that it cannot take for floats
 * again: `zero` is 0, which it does not know. */
#define WORDS(v) (as_int16(v) | zero)
#define SHIFT(a, b, k)                                                                             \
    as_float16(__builtin_shufflevector(a, b, k, k + 1, k + 2, k + 3, k + 4, k + 5, k + 6, k + 7,   \
                                       k + 8, k + 9, k + 10, k + 11, k + 12, k + 13, k + 14,       \
                                       k + 15))

/* Horizontal blur of a row's 32 columns, of the 16 from the sixth on. */
#define BLUR_TAP(k) s = (SHIFT(a, b, RADIUS - k) + SHIFT(a, b, RADIUS + k)) * taps[RADIUS - k] + s;
INLINE float16 blur_row(int16 a, int16 b)
{
    float16 s = SHIFT(a, b, RADIUS) * taps[RADIUS];
    BLUR_TAP(1)
    BLUR_TAP(2)
    BLUR_TAP(3)
    BLUR_TAP(4)
    BLUR_TAP(5)
    return s;
}

/* Horizontal blurs of x, y, x^2 + y^2 and xy of one row, for n vectors from column `col` on, into
 * to[4][VECS + 1]; zeros where the picture has no such row. */
INLINE void forward_row(const struct picture *p, int row, int col, int n, int zero, float16 *to)
{
    if (row < 0 || row >= p->h) {
        for (int i = 0; i < 4 * (VECS + 1); i++)
            to[i] = (float16)(0.0f);
        return;
    }
    float16 x, y;
    int16 last_x, last_y, last_qq, last_xy;
    pixels_load(p, row, col - RADIUS, &x, &y);
    last_x = WORDS(x);
    last_y = WORDS(y);
    last_qq = WORDS(x * x + y * y);
    last_xy = WORDS(x * y);
    for (int j = 0; j < n; j++) {
        pixels_load(p, row, col - RADIUS + 16 * (j + 1), &x, &y);
        int16 wx = WORDS(x), wy = WORDS(y), qq = WORDS(x * x + y * y), xy = WORDS(x * y);
        to[j] = blur_row(last_x, wx);
        to[VECS + 1 + j] = blur_row(last_y, wy);
        to[2 * (VECS + 1) + j] = blur_row(last_qq, qq);
        to[3 * (VECS + 1) + j] = blur_row(last_xy, xy);
        last_x = wx;
        last_y = wy;
        last_qq = qq;
        last_xy = xy;
    }
}

/* Lanes [from, to) of v, zero elsewhere. */
INLINE float16 lanes_between(float16 v, int from, int to)
{
    int16 lane = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    return ((lane >= from) & (lane < to)) ? v : (float16)(0.0f);
}

/* SSIM of 16 columns of a row from `col` on and its three derivatives, zero beyond the picture:
 * windows centred there do not exist. */
INLINE float16 forward_ssim(const struct picture *p, int row, int col, float16 m1, float16 m2,
                            float16 qq, float16 xy, float16 *pm, float16 *ps, float16 *pc)
{
    float16 s = ssim_of(m1, m2, qq, xy, pm, ps, pc);
    if (row < 0 || row >= p->h || col < 0 || col + 16 > p->w) {
        int from = -col, to = row < 0 || row >= p->h ? 0 : p->w - col;
        s = lanes_between(s, from, to);
        *pm = lanes_between(*pm, from, to);
        *ps = lanes_between(*ps, from, to);
        *pc = lanes_between(*pc, from, to);
    }
    return s;
}

/* What a piece adds up. */
struct sums {
    float16 l1, s, sq;
};

INLINE void sums_move(struct sums *from, struct sums *to)
{
    to->l1 += from->l1;
    to->s += from->s;
    to->sq += from->sq;
    from->l1 = from->s = from->sq = 0.0f;
}

/* The gradient of 16 columns of a row, and what is counted of them; k..: the blurred maps. */
INLINE void backward_write(const struct picture *p, int row, int col, float16 km, float16 ks,
                           float16 kc, const struct weights *by, __global float *grad,
                           struct sums *sum)
{
    float16 x, y, k = 0.0f;
    pixels_load(p, row, col, &x, &y);
    float16 d = x - y;
    sum->l1 += fabs(d);
    sum->sq = d * d + sum->sq;
    if (!by->with_grad)
        return;
    float16 up = d > 0.0f ? (float16)(by->l1) : (float16)(0.0f);
    float16 down = d < 0.0f ? (float16)(by->l1) : (float16)(0.0f);
    if (by->with_ssim) {
        k = 2.0f * x * ks + km;
        k = y * kc + k;
    }
    float16 g = k * by->ssim + (up - down);
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

/* The rows of a ring from the oldest on. */
INLINE void ring_rows(float16 *ring, int width, int oldest, float16 **row)
{
#pragma unroll
    for (int k = 0; k < WINDOW; k++)
        row[k] = ring + (oldest + k < WINDOW ? oldest + k : oldest + k - WINDOW) * width;
}

/* `rows`: of a band, even. scale_l1 = l1_weight / 3hw, scale_ssim = -ssim_weight / 3hw. */
__kernel void photometric_both(const __global float *color, const __global uchar *target,
                               const __global uchar *mask, int has_mask, int w, int h, int rows,
                               int with_ssim, __global float *parts, float scale_l1,
                               float scale_ssim, int with_grad, __global float *grad)
{
    enum { FORWARD = 4 * (VECS + 1), BACKWARD = 3 * VECS };
    int piece = get_global_id(0) / 3, across = (w + LAYOUT_LOSS_STRIP - 1) / LAYOUT_LOSS_STRIP;
    int x0 = piece % across * LAYOUT_LOSS_STRIP, y0 = piece / across * rows;
    int y1 = min(y0 + rows, h), n = min(VECS, (w - x0 + 15) / 16);
    struct picture p = {color, target, mask, has_mask, w, h, get_global_id(0) % 3};
    struct weights by = {scale_l1, scale_ssim, with_ssim, with_grad};
    struct sums sum = {0.0f, 0.0f, 0.0f}, all = sum; /* of two rows, of the piece */
    float16 blurred[WINDOW * FORWARD], maps[WINDOW * BACKWARD];
    int slot = 0, zero = has_mask >> 1;
    for (int row = y0; !with_ssim && row < y1; row++) {
        for (int j = 0; j < n; j++)
            backward_write(&p, row, x0 + 16 * j, 0.0f, 0.0f, 0.0f, &by, grad, &sum);
        sums_move(&sum, &all);
    }
    /* rows `in` come in, maps of 5 rows before are made, and the gradient of 5 rows before those */
    for (int in = y0 - 2 * RADIUS; with_ssim && in - 2 * RADIUS < y1; in += 2) {
        float16 *from[WINDOW], *map_from[WINDOW];
        int mid = in - RADIUS, out = mid - RADIUS, oldest = slot + 2 < WINDOW ? slot + 2 : 0;
        forward_row(&p, in, x0 - RADIUS, n + 1, zero, blurred + slot * FORWARD);
        forward_row(&p, in + 1, x0 - RADIUS, n + 1, zero, blurred + (slot + 1) * FORWARD);
        ring_rows(blurred, FORWARD, oldest, from);
        ring_rows(maps, BACKWARD, oldest, map_from);
        int16 pm = 0, ps = 0, pc = 0, pm1 = 0, ps1 = 0, pc1 = 0;
        for (int j = 0; in >= y0 && j <= n; j++) {
            float16 m1, m2, qq, xy, m1_1, m2_1, qq_1, xy_1, s, qm, qs, qc, qm1, qs1, qc1;
            int col = x0 - RADIUS + 16 * j, own = j == 0 ? RADIUS : 0, end = j == n ? RADIUS : 16;
            blur_column(from, j, &m1, &m1_1);
            blur_column(from, VECS + 1 + j, &m2, &m2_1);
            blur_column(from, 2 * (VECS + 1) + j, &qq, &qq_1);
            blur_column(from, 3 * (VECS + 1) + j, &xy, &xy_1);
            s = forward_ssim(&p, mid, col, m1, m2, qq, xy, &qm, &qs, &qc);
            if (mid >= y0 && mid < y1)
                sum.s += lanes_between(s, own, end);
            s = forward_ssim(&p, mid + 1, col, m1_1, m2_1, qq_1, xy_1, &qm1, &qs1, &qc1);
            if (mid + 1 >= y0 && mid + 1 < y1)
                sum.s += lanes_between(s, own, end);
            int16 wm = WORDS(qm), ws = WORDS(qs), wc = WORDS(qc);
            int16 wm1 = WORDS(qm1), ws1 = WORDS(qs1), wc1 = WORDS(qc1);
            if (j > 0) {
                float16 *to = maps + slot * BACKWARD + j - 1;
                to[0] = blur_row(pm, wm);
                to[VECS] = blur_row(ps, ws);
                to[2 * VECS] = blur_row(pc, wc);
                to[BACKWARD] = blur_row(pm1, wm1);
                to[BACKWARD + VECS] = blur_row(ps1, ws1);
                to[BACKWARD + 2 * VECS] = blur_row(pc1, wc1);
            }
            pm = wm;
            ps = ws;
            pc = wc;
            pm1 = wm1;
            ps1 = ws1;
            pc1 = wc1;
        }
        for (int j = 0; out >= y0 && j < n; j++) {
            float16 km, ks, kc, km1, ks1, kc1;
            blur_column(map_from, j, &km, &km1);
            blur_column(map_from, VECS + j, &ks, &ks1);
            blur_column(map_from, 2 * VECS + j, &kc, &kc1);
            backward_write(&p, out, x0 + 16 * j, km, ks, kc, &by, grad, &sum);
            if (out + 1 < y1)
                backward_write(&p, out + 1, x0 + 16 * j, km1, ks1, kc1, &by, grad, &sum);
        }
        sums_move(&sum, &all);
        slot = oldest;
    }
    __global float *part = parts + get_global_id(0) * 4;
    part[0] = sum16(all.l1);
    part[1] = sum16(all.s);
    part[2] = sum16(all.sq);
    part[3] = 0.0f;
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
