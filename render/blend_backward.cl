// Stage: blend, backward. From dL/dcolour of every pixel to fourteen sums of every intersection.
// The CPU shape is compiled after blend_cpu.cl, whose names it shares.
//   in   splats, tile_start, intersection_splat, intersection_slot; color, color_grad [3][h][w];
//        hits, tile_stop; where the view has a unit of depth also transmit [h][w], moment_maps
//        [2][h][w] and moment_grad [3][h][w]: dL/d of both sums along a ray and of the
//        transmittance; where it has a known_zeta also known [h][w]
//   out  slots [intersections][LAYOUT_SLOT_FLOATS]; marks [intersections], 1 where a slot was
//        written (the host clears them: intersections behind the stop are never visited)
// Front to back once more, so every decision is that of blend to the last bit. With g = dL/dC of a
// pixel, w = alpha T and P the colour summed so far (this splat included), the colour behind is C -
// P, hence
//     dL/dalpha = T (g.rgb) - rest / (1 - alpha),   rest = g.C - sum w (g.rgb),
// and nothing walks back through small T. What a Gaussian needs is sums over its pixels: w g for
// the colour, and with q = alpha dL/dalpha (that is dL/d ln alpha; 0 where alpha was cut to its
// maximum) the moments of q in the whitened offset (u, v), in which the falloff is exp2(-u^2 -
// v^2):
//     0-2  w g      3  q    4  q u    5  q v    6  q u^2    7  q u v    8  q v^2
//     9  |q u|     10  |q (r v - p x_of_y u)|: moduli of the two pixel gradients, up to a factor;
//                  0 without with_abs
//    11  h        12  h u      13  h v: moments of h = dL/d of the splat's depth at the pixel
// With sums along the rays (ray_values of common.cl) there are two more colours, the values of a
// splat at its depth, and transmittance is a background of 1 behind a third that is 0: they enter
// dL/dalpha as colours do, and h = w times the sum of g and the values' slopes.
// Whitened moments stay of the order of q however long and thin the splat is.
// Every slot has one writer and every sum one order: same input, same bits.
// Reference: render_ref_backward. Absolute gradients: AbsGS, Ye et al. 2024.

#if VW == 16 // CPU shape: one work-item is one tile, a block of 4x4 pixels is one vector

// Lane sums of up to twelve vectors at once: each step adds halves of two vectors side by side,
// with two shuffles and one addition, in a fixed order.
inline float16 fold_8(float16 a, float16 b) // -> a8 b8
{
    return (float16)(a.lo, b.lo) + (float16)(a.hi, b.hi);
}

inline float16 fold_4(float16 ab, float16 cd) // -> a4 b4 c4 d4
{
    return (float16)(ab.s0123, ab.s89ab, cd.s0123, cd.s89ab) +
           (float16)(ab.s4567, ab.scdef, cd.s4567, cd.scdef);
}

inline float16 fold_2(float16 x, float16 y) // abcd, efgh -> a2 e2 b2 f2 c2 g2 d2 h2
{
    return (float16)(x.s01, y.s01, x.s45, y.s45, x.s89, y.s89, x.scd, y.scd) +
           (float16)(x.s23, y.s23, x.s67, y.s67, x.sab, y.sab, x.sef, y.sef);
}

inline float16 fold_1(float16 x,
                      float16 y) // aebfcgdh, i.j.k.l. -> a b c d e f g h i j k l and four more
{
    float16 s = (float16)(x.s02, y.s02, x.s46, y.s46, x.s8a, y.s8a, x.sce, y.sce) +
                (float16)(x.s13, y.s13, x.s57, y.s57, x.s9b, y.s9b, x.sdf, y.sdf);
    return s.s048c159d26ae37bf;
}

#define AHEAD 4

struct backward_state { // of each block; pixels beyond the picture's edge have t 0
    float16 t[16], rest[16], g[16][3];
    float16 gm[16][2];            // of the sums along the rays
    float16 scale[16], shift[16]; // of ray_known
};

// Of a whole picture, see the head; the last four are read where the view has a unit of depth.
struct backward_maps {
    __global const float *color, *grad, *transmit, *moments, *moment_grad, *known;
};

inline void backward_load(struct backward_state *s, __constant struct layout_view *view,
                          const struct backward_maps *in, uint px, uint py)
{
    uint w = view->width, h = view->height;
    size_t plane = (size_t)w * h;
    for (uint k = 0; k < 16; k++) {
        uint bx = px + 4 * (k & 3), by = py + 4 * (k >> 2);
        float16 x = (float)bx + BLOCK_X[0], y = (float)by + BLOCK_Y[0];
        int16 inside = (x < (float)w) & (y < (float)h);
        float16 rest = (float16)(0.0f);
        for (uint c = 0; c < 3; c++) {
            s->g[k][c] = blend_block(in->grad + c * plane, w, h, bx, by);
            rest = s->g[k][c] * blend_block(in->color + c * plane, w, h, bx, by) + rest;
        }
        if (view->depth_unit_m > 0.0f) {
            for (uint c = 0; c < 2; c++) {
                s->gm[k][c] = blend_block(in->moment_grad + c * plane, w, h, bx, by);
                rest = s->gm[k][c] * blend_block(in->moments + c * plane, w, h, bx, by) + rest;
            }
            rest = blend_block(in->moment_grad + 2 * plane, w, h, bx, by) *
                       blend_block(in->transmit, w, h, bx, by) +
                   rest;
        }
        if (view->known_zeta > 0.0f)
            ray_known(view, blend_block(in->known, w, h, bx, by), s->scale + k, s->shift + k);
        s->rest[k] = rest;
        s->t[k] = inside ? (float16)(1.0f) : (float16)(0.0f);
    }
}

// One splat over some blocks: moves the pixels on and writes the slot. moments and about are
// literals.
INLINE void backward_splat(struct backward_state *s, const float *w, float x0, float y0,
                           uint blocks, uint with_abs, const int moments, const int about,
                           __global float *slot)
{
    float16 red = 0.0f, green = 0.0f, blue = 0.0f, m = 0.0f, mu = 0.0f, mv = 0.0f, muu = 0.0f,
            muv = 0.0f, mvv = 0.0f, abs_x = 0.0f, abs_y = 0.0f, mh = 0.0f, mhu = 0.0f, mhv = 0.0f;
    float depth = w[LAYOUT_SPLAT_DEPTH], tilt_x = w[LAYOUT_SPLAT_DEPTH + 1],
          tilt_y = w[LAYOUT_SPLAT_DEPTH + 2];
    struct record e = record_of(w, x0, y0);
    float rgb0 = w[LAYOUT_SPLAT_RGB], rgb1 = w[LAYOUT_SPLAT_RGB + 1],
          rgb2 = w[LAYOUT_SPLAT_RGB + 2], cross = e.p * e.x_of_y;
    while (blocks) {
        uint k = 31 - clz(blocks);
        blocks ^= 1u << k;
        float16 dx = block_dx(e.mx, k), dy = block_dy(e.my, k);
        float16 raw = splat_raw(dx, dy, e.p, e.x_of_y, e.r, e.opacity_log2), t = s->t[k];
        float16 a = MIN_(raw, LAYOUT_ALPHA_MAX);
        a = t > LAYOUT_TRANSMITTANCE_MIN ? a : (float16)(0.0f);
        float16 share = a * t;
        s->t[k] = t - share; // so far as blend has it
        float16 u = (dx - e.x_of_y * dy) * e.p, v = dy * e.r;
        float16 g0 = s->g[k][0], g1 = s->g[k][1], g2 = s->g[k][2];
        float16 gc = g0 * rgb0 + (g1 * rgb1 + g2 * rgb2);
        if (moments) {
            float16 z = tilt_x * dx + (tilt_y * dy + depth), value[2], slope[2];
            ray_values(z, s->scale[k], s->shift[k], about, value, slope);
            float16 gm0 = s->gm[k][0], gm1 = s->gm[k][1];
            float16 h = share * (gm1 * slope[1] + gm0 * slope[0]);
            gc = gm1 * value[1] + (gm0 * value[0] + gc);
            mh += h;
            mhu = h * u + mhu;
            mhv = h * v + mhv;
        }
        float16 rest = s->rest[k] - share * gc;
        s->rest[k] = rest;
        red = share * g0 + red;
        green = share * g1 + green;
        blue = share * g2 + blue;
        float16 q = a * (t * gc - rest / (1.0f - a));
        q = raw > LAYOUT_ALPHA_MAX ? (float16)(0.0f) : q;
        float16 qu = q * u, qv = q * v;
        m += q;
        mu += qu;
        mv += qv;
        muu = qu * u + muu;
        muv = qu * v + muv;
        mvv = qv * v + mvv;
        if (with_abs) {
            abs_x += fabs(qu);
            abs_y += fabs(e.r * qv - cross * qu);
        }
    }
    float16 x = fold_4(fold_8(red, green), fold_8(blue, m)),
            y = fold_4(fold_8(mu, mv), fold_8(muu, muv)),
            z = fold_4(fold_8(mvv, abs_x), fold_8(abs_y, mh)), last = z;
    if (moments)
        last = fold_4(fold_8(mhu, mhv), (float16)(0.0f));
    float16 sums = fold_1(fold_2(x, y), fold_2(z, last));
    vstore8(sums.lo, 0, slot);
    vstore4(sums.s89ab, 0, slot + 8);
    if (moments)
        vstore2(sums.scd, 0, slot + 12);
    else
        vstore2((float2)(0.0f), 0, slot + 12);
}

// The next BATCH splats of a tile that blend drew, or what is left: records, blocks of pixels and
// slots, which lie anywhere. Moves *at on; returns their number.
INLINE uint backward_stage(__global const struct layout_splat *splats,
                           __global const uint *intersection_splat,
                           __global const uint *intersection_slot, __global const ushort *hits,
                           uint *at, uint end, float *staged, uint *mask, uint *slot)
{
    uint n = 0, i = *at;
    for (; i < end && n < BATCH; i++) {
        PREFETCH(splats + intersection_splat[min(i + BATCH, end - 1)]);
        uint blocks = hits[i];
        if (!blocks)
            continue;
        mask[n] = blocks;
        slot[n] = intersection_slot[i];
        LAYOUT_WIDE(__private, float, staged + LAYOUT_SPLAT_WORDS * n++) =
            LAYOUT_WIDE(const __global, float, splats + intersection_splat[i]);
    }
    *at = i;
    return n;
}

__kernel void
blend_backward(__constant struct layout_view *view, __global const struct layout_splat *splats,
               __global const uint *tile_start, __global const uint *intersection_splat,
               __global const uint *intersection_slot, __global const float *color,
               __global const float *color_grad, uint with_abs, __global float *slots,
               __global uchar *marks, __global const ushort *hits, __global const uint *tile_stop,
               __global const float *transmit, __global const float *moment_maps,
               __global const float *moment_grad, __global const float *known)
{
    const struct backward_maps maps = {color,       color_grad,  transmit,
                                       moment_maps, moment_grad, known};
    const bool moments = view->depth_unit_m > 0.0f, about = view->known_zeta > 0.0f;
    uint tile = (uint)get_global_id(0);
    if (tile >= view->tiles_x * view->tiles_y)
        return;
    uint px = (tile % view->tiles_x) * LAYOUT_TILE, py = (tile / view->tiles_x) * LAYOUT_TILE;
    float x0 = (float)px + 0.5f, y0 = (float)py + 0.5f;
    uint at = tile_start[tile], end = tile_stop[tile];
    float staged[BATCH * LAYOUT_SPLAT_WORDS];
    uint mask[BATCH], slot[BATCH];
    struct backward_state s;

    if (at == end)
        return;
    backward_load(&s, view, &maps, px, py);
    while (at < end) {
        uint n = backward_stage(splats, intersection_splat, intersection_slot, hits, &at, end,
                                staged, mask, slot);
        for (uint j = 0; j < n; j++) {
            uint next = slot[min(j + AHEAD, n - 1)]; // have the lines ready when they are written
            PREFETCH(slots + (size_t)next * LAYOUT_SLOT_FLOATS);
            PREFETCH(slots + (size_t)next * LAYOUT_SLOT_FLOATS + LAYOUT_SLOT_FLOATS - 1);
            PREFETCH(marks + next);
            marks[slot[j]] = 1;
            const float *w = staged + LAYOUT_SPLAT_WORDS * j;
            __global float *to = slots + (size_t)slot[j] * LAYOUT_SLOT_FLOATS;
            if (about)
                backward_splat(&s, w, x0, y0, mask[j], with_abs, 1, 1, to);
            else if (moments)
                backward_splat(&s, w, x0, y0, mask[j], with_abs, 1, 0, to);
            else
                backward_splat(&s, w, x0, y0, mask[j], with_abs, 0, 0, to);
        }
    }
}

#else
// GPU shape: one work-group is one tile, one work-item one pixel. Barriers stay in the kernel's own
// body: in a function that is called PoCL does not divide the work-group at them.

#define PIXELS LAYOUT_TILE_PIXELS
#define STRIPES 16 // each sum is taken in 16 stripes of 16 pixels, then over the stripes

__kernel __attribute__((reqd_work_group_size(PIXELS, 1, 1))) void
blend_backward(__constant struct layout_view *view, __global const struct layout_splat *splats,
               __global const uint *tile_start, __global const uint *intersection_splat,
               __global const uint *intersection_slot, __global const float *color,
               __global const float *color_grad, uint with_abs, __global float *slots,
               __global uchar *marks, __global const ushort *hits, __global const uint *tile_stop,
               __global const float *transmit, __global const float *moment_maps,
               __global const float *moment_grad, __global const float *known)
{
    const bool moments = view->depth_unit_m > 0.0f, about = view->known_zeta > 0.0f;
    uint tile = (uint)get_group_id(0), lane = (uint)get_local_id(0);
    uint x = (tile % view->tiles_x) * LAYOUT_TILE + lane % LAYOUT_TILE;
    uint y = (tile / view->tiles_x) * LAYOUT_TILE + lane / LAYOUT_TILE;
    int inside = x < view->width && y < view->height;
    size_t plane = (size_t)view->width * view->height, at = (size_t)y * view->width + x;
    float g[3] = {0.0f, 0.0f, 0.0f}, gm[2] = {0.0f, 0.0f}, rest = 0.0f, t = inside ? 1.0f : 0.0f;
    float scale = 0.0f, shift = 0.0f;
    __local float part[LAYOUT_SLOT_FLOATS * PIXELS], stripe[LAYOUT_SLOT_FLOATS * STRIPES];
    __local uint alive;
    for (uint c = 0; c < 3 && inside; c++) {
        g[c] = color_grad[c * plane + at];
        rest = g[c] * color[c * plane + at] + rest;
    }
    if (moments && inside) {
        for (uint c = 0; c < 2; c++) {
            gm[c] = moment_grad[c * plane + at];
            rest = gm[c] * moment_maps[c * plane + at] + rest;
        }
        rest = moment_grad[2 * plane + at] * transmit[at] + rest;
        if (about)
            ray_known(view, known[at], &scale, &shift);
    }
    for (uint k = tile_start[tile], end = tile_start[tile + 1]; k < end; k++) {
        __global const struct layout_splat *e = splats + intersection_splat[k];
        float dx = e->mean_x - ((float)x + 0.5f), dy = e->mean_y - ((float)y + 0.5f);
        float raw = splat_raw(dx, dy, e->p, e->x_of_y, e->r, e->opacity_log2);
        float a = MIN_(raw, LAYOUT_ALPHA_MAX);
        a = t > LAYOUT_TRANSMITTANCE_MIN ? a : 0.0f;
        float share = a * t, gc = g[0] * e->rgb[0] + (g[1] * e->rgb[1] + g[2] * e->rgb[2]);
        float u = (dx - e->x_of_y * dy) * e->p, v = dy * e->r, h = 0.0f;
        if (moments) {
            float z = as_float(e->bands[1]) * dy + as_float(e->cover), value[2], slope[2];
            z = as_float(e->bands[0]) * dx + z;
            ray_values(z, scale, shift, about, value, slope);
            h = share * (gm[1] * slope[1] + gm[0] * slope[0]);
            gc = gm[1] * value[1] + (gm[0] * value[0] + gc);
        }
        rest -= share * gc;
        float q = raw > LAYOUT_ALPHA_MAX ? 0.0f : a * (t * gc - rest / (1.0f - a));
        t -= share;
        float qu = q * u, qv = q * v;
        float ax = with_abs ? fabs(qu) : 0.0f;
        float ay = with_abs ? fabs(e->r * qv - e->p * e->x_of_y * qu) : 0.0f;
        const float values[LAYOUT_SLOT_FLOATS] = {
            share * g[0], share * g[1], share * g[2], q,  qu, qv,    qu * u,
            qu * v,       qv * v,       ax,           ay, h,  h * u, h * v};
        for (uint i = 0; i < LAYOUT_SLOT_FLOATS; i++)
            part[i * PIXELS + lane] = values[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < LAYOUT_SLOT_FLOATS * STRIPES) {
            float sum = 0.0f;
            for (uint i = lane % STRIPES; i < PIXELS; i += STRIPES)
                sum += part[lane / STRIPES * PIXELS + i];
            stripe[lane] = sum;
        }
        if (lane == 0)
            alive = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lane < LAYOUT_SLOT_FLOATS) {
            float sum = 0.0f;
            for (uint j = 0; j < STRIPES; j++)
                sum += stripe[lane * STRIPES + j];
            slots[(size_t)intersection_slot[k] * LAYOUT_SLOT_FLOATS + lane] = sum;
        }
        if (lane == 0)
            marks[intersection_slot[k]] = 1;
        if (t > LAYOUT_TRANSMITTANCE_MIN)
            alive = 1; // whoever writes, it is the same
        barrier(CLK_LOCAL_MEM_FENCE);
        if (!alive)
            break;
    }
}

#endif
