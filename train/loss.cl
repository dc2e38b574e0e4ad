/* Stage: L1 + SSIM loss, forward (maps and partial sums) and backward (dL/dx).
 *
 *   in   color  float [3][h][w], target uchar [h][w][3], mask uchar [h][w] or absent
 *   mid  maps   float [3 maps][3 channels][h][pitch], pitch = MARGIN + round_up(w, STRIP) + MARGIN:
 * the derivatives of S with respect to Kx, Kx^2 and K(xy); zero beyond the picture out  parts float
 * [pieces][3][4]: |x-y|, S and (x-y)^2 summed over a piece; grad float [3][h][w]
 *
 * CPU shape (VW 16): one work-item = one band of BAND rows of one channel. It walks strips of STRIP
 * columns, blurs each row horizontally into a ring of 11 rows (private memory, 22 KiB: every row is
 * there twice, so that a window is 11 rows in a row) and the ring vertically. GPU shape (VW 1): one
 * work-group = one tile of 16x16 pixels of one channel, one work-item = one pixel; the tile and 5
 * pixels around it are staged in local memory and blurred there. All sums are taken in a fixed
 * order. The only products needed are x^2 + y^2 and xy, because the two variances enter S as their
 * sum.
 *
 * Reference: loss_ref.c (which has the formulas). Tolerance: float rounding, 1e-5 relative.
 */
#define BAND 32
#define STRIP 64
#define MARGIN 16
#define RADIUS 5
#define TAPS 11
#define VECS (STRIP / 16)
#define ROW (STRIP + 2 * MARGIN)

#define SSIM_C1 0.0001f
#define SSIM_C2 0.0009f

__constant float taps[TAPS] = {0.00102838008f, 0.00759875814f, 0.0360007721f, 0.10936069f,
                               0.213005538f,   0.266011725f,   0.213005538f,  0.10936069f,
                               0.0360007721f,  0.00759875814f, 0.00102838008f};

#if VW == 16
typedef float16 V;
#else
typedef float V;
#endif

/* S and its three derivatives. */
static V ssim_of(V m1, V m2, V qq, V xy, V *pm, V *ps, V *pc)
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

/* 16 pixels of channel c out of 48 interleaved bytes. */
static float16 pixels_channel(const __global uchar *p, int c)
{
    uchar16 a = vload16(0, p), b = vload16(1, p), d = vload16(2, p);
    uchar16 v;
    if (c == 0)
        v = (uchar16)(a.s0369, a.scf, b.s258b, b.se, d.s147a, d.sd);
    else if (c == 1)
        v = (uchar16)(a.s147a, a.sd, b.s0369, b.scf, d.s258b, d.se);
    else
        v = (uchar16)(a.s258b, a.se, b.s147a, b.sd, d.s0369, d.scf);
    return convert_float16(v) * (1.0f / 255.0f);
}

/* One row of x and y, columns [col0, col0 + 16 * n), zero outside the picture and where masked. */
static void row_load(const __global float *color, const __global uchar *target,
                     const __global uchar *mask, int has_mask, int w, int h, int c, int row,
                     int col0, int n, float *x, float *y)
{
    const __global float *cp = color + ((size_t)c * h + row) * w;
    const __global uchar *tp = target + (size_t)row * w * 3;
    const __global uchar *mp = mask + (has_mask ? (size_t)row * w : 0);
    for (int j = 0; j < n; j++) {
        int col = col0 + 16 * j;
        if (col >= 0 && col + 16 <= w) {
            float16 xv = vload16(0, cp + col), yv = pixels_channel(tp + 3 * col, c);
            if (has_mask) {
                int16 used = convert_int16(vload16(0, mp + col)) != 0;
                xv = used ? xv : (float16)(0.0f);
                yv = used ? yv : (float16)(0.0f);
            }
            vstore16(xv, j, x);
            vstore16(yv, j, y);
        } else {
            for (int i = 0; i < 16; i++) {
                int q = col + i;
                int used = q >= 0 && q < w;
                if (used && has_mask)
                    used = mp[q] != 0;
                x[16 * j + i] = used ? cp[q] : 0.0f;
                y[16 * j + i] = used ? (float)tp[3 * q + c] * (1.0f / 255.0f) : 0.0f;
            }
        }
    }
}

static float sum16(float16 v)
{
    float8 a = v.lo + v.hi;
    float4 b = a.lo + a.hi;
    float2 d = b.lo + b.hi;
    return d.x + d.y;
}

/* sum over k of taps[k] * p[k * step], 16 columns. */
static float16 blur_steps(const float *p, int step)
{
    float16 a = vload16(0, p) * taps[0];
    a = vload16(0, p + step) * taps[1] + a;
    a = vload16(0, p + 2 * step) * taps[2] + a;
    a = vload16(0, p + 3 * step) * taps[3] + a;
    a = vload16(0, p + 4 * step) * taps[4] + a;
    a = vload16(0, p + 5 * step) * taps[5] + a;
    a = vload16(0, p + 6 * step) * taps[6] + a;
    a = vload16(0, p + 7 * step) * taps[7] + a;
    a = vload16(0, p + 8 * step) * taps[8] + a;
    a = vload16(0, p + 9 * step) * taps[9] + a;
    return vload16(0, p + 10 * step) * taps[10] + a;
}

/* The vector that begins k lanes into a followed by b. A load from there would cross a cache line
 * and take twice as long as an aligned one; two aligned vectors in registers shift in one step. */
#define SHIFT(a, b, k)                                                                             \
    __builtin_shufflevector(a, b, k, k + 1, k + 2, k + 3, k + 4, k + 5, k + 6, k + 7, k + 8,       \
                            k + 9, k + 10, k + 11, k + 12, k + 13, k + 14, k + 15)

/* Horizontal blur: 16 columns of b, a and c the vectors on either side. */
static float16 blur_row(float16 a, float16 b, float16 c)
{
    float16 s = SHIFT(a, b, 11) * taps[0];
    s = SHIFT(a, b, 12) * taps[1] + s;
    s = SHIFT(a, b, 13) * taps[2] + s;
    s = SHIFT(a, b, 14) * taps[3] + s;
    s = SHIFT(a, b, 15) * taps[4] + s;
    s = b * taps[5] + s;
    s = SHIFT(b, c, 1) * taps[6] + s;
    s = SHIFT(b, c, 2) * taps[7] + s;
    s = SHIFT(b, c, 3) * taps[8] + s;
    s = SHIFT(b, c, 4) * taps[9] + s;
    return SHIFT(b, c, 5) * taps[10] + s;
}

/* Horizontal blur of x, y, x^2 + y^2, xy of one row into ring rows `to` and `twin` ([4][STRIP]). */
static void row_blur_products(const float *x, const float *y, float *to, float *twin)
{
    float16 x0 = vload16(0, x), x1 = vload16(1, x), y0 = vload16(0, y), y1 = vload16(1, y);
    float16 q0 = x0 * x0 + y0 * y0, q1 = x1 * x1 + y1 * y1, p0 = x0 * y0, p1 = x1 * y1;
    for (int j = 0; j < VECS; j++) {
        float16 x2 = vload16(j + 2, x), y2 = vload16(j + 2, y);
        float16 q2 = x2 * x2 + y2 * y2, p2 = x2 * y2;
        float16 m1 = blur_row(x0, x1, x2), m2 = blur_row(y0, y1, y2);
        float16 qq = blur_row(q0, q1, q2), xy = blur_row(p0, p1, p2);
        vstore16(m1, 0 * VECS + j, to);
        vstore16(m2, 1 * VECS + j, to);
        vstore16(qq, 2 * VECS + j, to);
        vstore16(xy, 3 * VECS + j, to);
        vstore16(m1, 0 * VECS + j, twin);
        vstore16(m2, 1 * VECS + j, twin);
        vstore16(qq, 2 * VECS + j, twin);
        vstore16(xy, 3 * VECS + j, twin);
        x0 = x1, x1 = x2, y0 = y1, y1 = y2, q0 = q1, q1 = q2, p0 = p1, p1 = p2;
    }
}

__kernel void loss_forward(const __global float *color, const __global uchar *target,
                           const __global uchar *mask, int has_mask, int w, int h, int pitch,
                           int with_ssim, __global float *maps, __global float *parts)
{
    int band = get_global_id(0) / 3, c = get_global_id(0) % 3;
    int y0 = band * BAND, y1 = min(y0 + BAND, h);
    float xb[ROW], yb[ROW], ring[2 * TAPS * 4 * STRIP];
    float16 sum_l1 = 0.0f, sum_s = 0.0f, sum_sq = 0.0f;
    int halo = with_ssim ? RADIUS : 0;
    size_t plane = (size_t)3 * h * pitch;
    for (int x0 = 0; x0 < w; x0 += STRIP) {
        for (int r = y0 - halo; r < y1 + halo; r++) {
            float *to = ring + ((r + TAPS) % TAPS) * 4 * STRIP, *twin = to + TAPS * 4 * STRIP;
            if (r >= 0 && r < h) {
                row_load(color, target, mask, has_mask, w, h, c, r, x0 - MARGIN, ROW / 16, xb, yb);
                if (with_ssim)
                    row_blur_products(xb, yb, to, twin);
            } else {
                for (int j = 0; j < 4 * VECS; j++) {
                    vstore16((float16)(0.0f), j, to);
                    vstore16((float16)(0.0f), j, twin);
                }
            }
            if (r >= y0 && r < y1)
                for (int j = 0; j < VECS; j++) {
                    float16 d = vload16(j, xb + MARGIN) - vload16(j, yb + MARGIN);
                    sum_l1 += fabs(d);
                    sum_sq = d * d + sum_sq;
                }
            int out = r - RADIUS; /* this row's window is complete */
            if (!with_ssim || out < y0)
                continue;
            const float *from = ring + ((out - RADIUS + TAPS) % TAPS) * 4 * STRIP;
            __global float *mp = maps + ((size_t)c * h + out) * pitch + MARGIN + x0;
            for (int j = 0; j < VECS; j++) {
                float16 pm, ps, pc;
                float16 s =
                    ssim_of(blur_steps(from + 16 * j, 4 * STRIP),
                            blur_steps(from + 16 * (VECS + j), 4 * STRIP),
                            blur_steps(from + 16 * (2 * VECS + j), 4 * STRIP),
                            blur_steps(from + 16 * (3 * VECS + j), 4 * STRIP), &pm, &ps, &pc);
                if (x0 + 16 * (j + 1) > w) { /* windows centred beyond the edge do not exist */
                    int16 lane = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
                    int16 in = lane + (x0 + 16 * j) < w;
                    s = in ? s : (float16)(0.0f);
                    pm = in ? pm : (float16)(0.0f);
                    ps = in ? ps : (float16)(0.0f);
                    pc = in ? pc : (float16)(0.0f);
                }
                sum_s += s;
                vstore16(pm, j, mp);
                vstore16(ps, j, mp + plane);
                vstore16(pc, j, mp + 2 * plane);
            }
        }
    }
    __global float *p = parts + get_global_id(0) * 4;
    p[0] = sum16(sum_l1);
    p[1] = sum16(sum_s);
    p[2] = sum16(sum_sq);
    p[3] = 0.0f;
}

/* Horizontal blur of one row of the three maps into ring rows `to` and `twin` ([3][STRIP]). */
static void row_blur_maps(const __global float *from, size_t plane, float *to, float *twin)
{
    for (int m = 0; m < 3; m++) {
        const __global float *p = from + m * plane;
        float16 a = vload16(0, p - 16), b = vload16(0, p);
        for (int j = 0; j < VECS; j++) {
            float16 c = vload16(j + 1, p), s = blur_row(a, b, c);
            vstore16(s, m * VECS + j, to);
            vstore16(s, m * VECS + j, twin);
            a = b, b = c;
        }
    }
}

/* scale_l1 = l1_weight / 3hw, scale_ssim = -ssim_weight / 3hw. */
__kernel void loss_backward(const __global float *color, const __global uchar *target,
                            const __global uchar *mask, int has_mask, int w, int h, int pitch,
                            int with_ssim, const __global float *maps, float scale_l1,
                            float scale_ssim, __global float *grad)
{
    int band = get_global_id(0) / 3, c = get_global_id(0) % 3;
    int y0 = band * BAND, y1 = min(y0 + BAND, h);
    float xb[STRIP], yb[STRIP], gb[16], ring[2 * TAPS * 3 * STRIP];
    int halo = with_ssim ? RADIUS : 0;
    size_t plane = (size_t)3 * h * pitch;
    for (int x0 = 0; x0 < w; x0 += STRIP)
        for (int r = y0 - halo; r < y1 + halo; r++) {
            float *to = ring + ((r + TAPS) % TAPS) * 3 * STRIP, *twin = to + TAPS * 3 * STRIP;
            if (with_ssim && r >= 0 && r < h) {
                row_blur_maps(maps + ((size_t)c * h + r) * pitch + MARGIN + x0, plane, to, twin);
            } else {
                for (int j = 0; j < 3 * VECS; j++) {
                    vstore16((float16)(0.0f), j, to);
                    vstore16((float16)(0.0f), j, twin);
                }
            }
            int out = r - halo;
            if (out < y0)
                continue;
            const float *from = ring + ((out - halo + TAPS) % TAPS) * 3 * STRIP;
            row_load(color, target, mask, has_mask, w, h, c, out, x0, VECS, xb, yb);
            __global float *gp = grad + ((size_t)c * h + out) * w;
            for (int j = 0; j < VECS; j++) {
                float16 x = vload16(j, xb), y = vload16(j, yb), d = x - y;
                float16 up = d > 0.0f ? (float16)(scale_l1) : (float16)(0.0f);
                float16 down = d < 0.0f ? (float16)(scale_l1) : (float16)(0.0f);
                float16 ks = 0.0f;
                if (with_ssim) {
                    ks = blur_steps(from + 16 * j, 3 * STRIP);
                    ks = 2.0f * x * blur_steps(from + 16 * (VECS + j), 3 * STRIP) + ks;
                    ks = y * blur_steps(from + 16 * (2 * VECS + j), 3 * STRIP) + ks;
                }
                float16 g = ks * scale_ssim + (up - down);
                int col = x0 + 16 * j;
                if (col + 16 <= w && !has_mask) {
                    vstore16(g, 0, gp + col);
                } else {
                    const __global uchar *mp = mask + (has_mask ? (size_t)out * w : 0);
                    vstore16(g, 0, gb);
                    for (int i = 0; i < 16 && col + i < w; i++)
                        gp[col + i] = !has_mask || mp[col + i] ? gb[i] : 0.0f;
                }
            }
        }
}

#else

#define TILE 16
#define PIXELS (TILE * TILE)
#define WIDE (TILE + 2 * RADIUS)

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
    int piece = get_group_id(0) / 3, across = (w + TILE - 1) / TILE;
    *x0 = piece % across * TILE;
    *y0 = piece / across * TILE;
    return get_group_id(0) % 3;
}

__kernel __attribute__((reqd_work_group_size(PIXELS, 1, 1))) void
loss_forward(const __global float *color, const __global uchar *target, const __global uchar *mask,
             int has_mask, int w, int h, int pitch, int with_ssim, __global float *maps,
             __global float *parts)
{
    int x0, y0, c = tile_origin(w, &x0, &y0), lane = get_local_id(0), lx = lane % TILE,
                ly = lane / TILE;
    __local float xs[WIDE * WIDE], ys[WIDE * WIDE], rows[4][WIDE * TILE], sums[3][PIXELS];
    for (int i = lane; i < WIDE * WIDE; i += PIXELS) {
        int x = x0 + i % WIDE - RADIUS, y = y0 + i / WIDE - RADIUS;
        int used = pixel_used(mask, has_mask, w, h, x, y);
        xs[i] = used ? color[((size_t)c * h + y) * w + x] : 0.0f;
        ys[i] = used ? (float)target[((size_t)y * w + x) * 3 + c] * (1.0f / 255.0f) : 0.0f;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = lane; i < WIDE * TILE; i += PIXELS) {
        const __local float *a = xs + i / TILE * WIDE + i % TILE,
                            *b = ys + i / TILE * WIDE + i % TILE;
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
        __global float *mp = maps + ((size_t)c * h + y0 + ly) * pitch + MARGIN + x0 + lx;
        s = ssim_of(blur_one(rows[0] + lane, TILE), blur_one(rows[1] + lane, TILE),
                    blur_one(rows[2] + lane, TILE), blur_one(rows[3] + lane, TILE), &pm, &ps, &pc);
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
loss_backward(const __global float *color, const __global uchar *target, const __global uchar *mask,
              int has_mask, int w, int h, int pitch, int with_ssim, const __global float *maps,
              float scale_l1, float scale_ssim, __global float *grad)
{
    int x0, y0, c = tile_origin(w, &x0, &y0), lane = get_local_id(0), lx = lane % TILE,
                ly = lane / TILE;
    __local float near[3][WIDE * WIDE], rows[3][WIDE * TILE];
    size_t plane = (size_t)3 * h * pitch;
    for (int i = lane; i < WIDE * WIDE; i += PIXELS) {
        int x = x0 + i % WIDE - RADIUS, y = y0 + i / WIDE - RADIUS;
        int in = with_ssim && x >= 0 && y >= 0 && x < w && y < h;
        for (int m = 0; m < 3; m++)
            near[m][i] = in ? maps[m * plane + ((size_t)c * h + y) * pitch + MARGIN + x] : 0.0f;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = lane; i < WIDE * TILE; i += PIXELS)
        for (int m = 0; m < 3; m++)
            rows[m][i] = blur_one(near[m] + i / TILE * WIDE + i % TILE, 1);
    barrier(CLK_LOCAL_MEM_FENCE);
    int px = x0 + lx, py = y0 + ly;
    if (px >= w || py >= h)
        return;
    size_t at = (size_t)py * w + px;
    float g = 0.0f;
    if (pixel_used(mask, has_mask, w, h, px, py)) {
        float x = color[(size_t)c * h * w + at], y = (float)target[at * 3 + c] * (1.0f / 255.0f);
        g = blur_one(rows[0] + lane, TILE);
        g = 2.0f * x * blur_one(rows[1] + lane, TILE) + g;
        g = y * blur_one(rows[2] + lane, TILE) + g;
        g = g * scale_ssim + (x > y ? scale_l1 : x < y ? -scale_l1 : 0.0f);
    }
    grad[(size_t)c * h * w + at] = g;
}

#endif
