// Stage: project. Gaussians -> splat records, depth keys, tile counts.
//   in   params [groups][planes][16]; filter [groups][16], m, with view->smooth
//        list [groups], with view->listed: which groups of params these are
//   out  splats [groups * 16] (only where visible), depth_key (bits of depth, ~0 where culled),
//   tiles_of
// Culling comes in steps, cheapest first, and a whole group leaves as soon as no lane of it is
// left; the spherical harmonics, three quarters of the bytes, are read last.
//
// Tiles: alpha >= 1/255 inside the ellipse u^2 + v^2 <= opacity_log2 + log2(255) = L. Over a band
// of tile rows the columns that it touches are those between its leftmost and rightmost point
// within the band, which take two square roots (AccuTile, Hanson et al. 2025, in rows of tiles). A
// margin of 0.01 px covers the rounding, so that no pixel is lost that blending would have drawn.
//
// With APPEARANCE_LEN (appearance.cl) the network runs where an opaque splat would reach into the
// picture, before extents and culling:
//   in   look, constants of the frame;   out  effective [groups * 16], opacity with its offset
//
// Reference: ref_project in render_ref.c.

#define MARGIN_PX 0.01f
#ifdef APPEARANCE_LEN
#define APPEARANCE_ARGS , __constant float *look, __global float *effective
#define LOOK(at) , look, effective + (at)
#else
#define APPEARANCE_ARGS
#define LOOK(at)
#endif

// First and last tile that holds a pixel centre of [lo, hi] (px); empty when first > last.
INLINE VI tile_first(V lo, uint tiles)
{
    V t = ceil((lo - (LAYOUT_TILE - 0.5f)) * (1.0f / LAYOUT_TILE));
    return TO_VI(CLAMP_(t, 0.0f, (float)tiles));
}

INLINE VI tile_last(V hi, uint tiles)
{
    V t = floor((hi - 0.5f) * (1.0f / LAYOUT_TILE));
    return TO_VI(CLAMP_(t, -1.0f, (float)tiles - 1.0f));
}

struct coverage {
    VU cover, bands[LAYOUT_BANDS / 2];
    VI tiles;
};

// The tiles of an ellipse; `reach` is L. Lanes that are not visible hold anything.
INLINE void project_tiles(__constant struct layout_view *v, V mx, V my, V p, V x_of_y, V r,
                          V y_of_x, V reach, V hx, V hy, struct coverage *c)
{
    VI row0 = tile_first(my - hy, v->tiles_y), row1 = tile_last(my + hy, v->tiles_y);
    VI col0 = tile_first(mx - hx, v->tiles_x), col1 = tile_last(mx + hx, v->tiles_x);
    VI rows = row1 - row0 + 1, cols = col1 - col0 + 1;
    VI shift = cols > 512 ? (VI)(2) : (cols > 256 ? (VI)(1) : (VI)(0));
    VI step = TO_VI(floor(TO_V(rows + (LAYOUT_BANDS - 1)) * (1.0f / LAYOUT_BANDS) + 1e-3f));
    V inv_p = 1.0f / p, y_right = y_of_x * hx; // where the ellipse is widest, and its mirror image
    c->cover = AS_VU(row0) | (AS_VU(col0) << 10) | (AS_VU(rows - 1) << 20) | (AS_VU(shift) << 30);
    c->tiles = (VI)(0);
    for (int b = 0; b < LAYOUT_BANDS / 2; b++)
        c->bands[b] = (VU)(0);
    for (int b = 0; b < LAYOUT_BANDS; b++) {
        VI top = row0 + b * step, bottom = MIN_(top + step - 1, row1);
        if (!ANY(top <= row1))
            break;
        V y0 = TO_V(top) * LAYOUT_TILE + 0.5f - my,
          y1 = TO_V(bottom) * LAYOUT_TILE + (LAYOUT_TILE - 0.5f) - my;
        V yr = CLAMP_(y_right, y0, y1), yl = CLAMP_(-y_right, y0, y1);
        V wr = reach - (r * yr) * (r * yr), wl = reach - (r * yl) * (r * yl);
        wr = sqrt(MAX_(wr, 0.0f)) * inv_p;
        wl = sqrt(MAX_(wl, 0.0f)) * inv_p;
        VI first = tile_first(mx + (x_of_y * yl - wl) - MARGIN_PX, v->tiles_x);
        VI last = tile_last(mx + (x_of_y * yr + wr) + MARGIN_PX, v->tiles_x);
        if (!v->tile_cull) {
            first = col0;
            last = col1;
        }
        first = MAX_(first, col0) - col0; // rounding may put them just outside the box
        last = MIN_(last, col1) - col0;
        last = top <= row1 ? last : (VI)(-1);
        VI f = first >> shift, l = last >> shift,
           end = MIN_((l + 1) << shift, (VI)((int)v->tiles_x) - col0);
        VI count = (end - (f << shift)) * (bottom - top + 1), pair = f + (l << 8);
        c->tiles += first <= last ? count : (VI)(0);
        pair = first <= last ? pair : (VI)(255); // first 255, last 0: none
        c->bands[b >> 1] |= AS_VU(pair) << (16u * (b & 1));
    }
}

INLINE void project_color(__constant struct layout_view *v, __global const float *g, V rgb[3])
{
    V dir[3], basis[16];
    uint count = (v->sh_degree + 1) * (v->sh_degree + 1);
    seen_direction(v, g, dir);
    sh_basis(dir, v->sh_degree, basis);
    rgb[0] = rgb[1] = rgb[2] = (V)(0.5f);
    for (uint k = 0; k < count; k++)
        for (uint ch = 0; ch < 3; ch++)
            rgb[ch] = basis[k] * LD(g, 11 + 3 * k + ch) + rgb[ch];
#ifndef APPEARANCE_LEN
    for (uint ch = 0; ch < 3; ch++)
        rgb[ch] = CLAMP_(rgb[ch], 0.0f, 1e30f); // finite: blending multiplies it by zeros
#endif
}

#if VW == 16
INLINE void project_store(__global struct layout_splat *out, V w[16], VI visible)
{
    transpose_16(w);
    int keep[16];
    vstore16(visible, 0, keep);
    for (int i = 0; i < 16; i++)
        if (keep[i])
            LAYOUT_WIDE(__global, float, out + i) = w[i];
}
#else
INLINE void project_store(__global struct layout_splat *out, V w[16], VI visible)
{
    __global float *f = (__global float *)out;
    if (visible)
        for (int i = 0; i < 16; i++)
            f[i] = w[i];
}
#endif

// The mask of lanes within `hx`, `hy` of the picture.
INLINE VI project_within(__constant struct layout_view *v, V mx, V my, V hx, V hy)
{
    return (mx + hx > 0.0f) & (mx - hx < (float)v->width) & (my + hy > 0.0f) &
           (my - hy < (float)v->height);
}

// The group (VW 16) or lane (VW 1) whose parameters start at g and whose first index is `index`.
INLINE void project_some(__constant struct layout_view *v, __global const float *g,
                         __global const float *filter, uint index,
                         __global struct layout_splat *splats, VU *key, VU *tiles APPEARANCE_ARGS)
{
    struct seen s;
    struct coverage c;
    VI live = seen_mean(v, g, &s) & ((VI)((int)index) + LANE < (int)v->n);
    *key = (VU)(0xFFFFFFFFu);
    *tiles = (VU)(0);
    if (!ANY(live))
        return;
    live &= seen_ellipse(v, g, filter, &s);
    if (!ANY(live))
        return;
    V mx = v->fx * (s.cam[0] * s.inv_z) + v->cx, my = v->fy * (s.cam[1] * s.inv_z) + v->cy;
#ifdef APPEARANCE_LEN
    V y[4]; // at most opaque: no splat reaches farther
    live &= project_within(v, mx, my, sqrt((-ALPHA_MIN_LOG2 * (2.0f / LOG2E)) * s.s00),
                           sqrt((-ALPHA_MIN_LOG2 * (2.0f / LOG2E)) * s.s11));
    if (!ANY(live))
        return;
    for (uint plane = 11; plane < v->planes; plane++) // the network is long enough to wait for them
        PREFETCH(g + plane * LAYOUT_LANES);
    appearance_eval(look, g + (v->planes - APPEARANCE_LEN) * LAYOUT_LANES, y);
    V opacity = s.opacity + y[3];
    s.opacity = MIN_(opacity, 1.0f);
    ST(effective, 0, s.opacity);
    live &= s.opacity * s.rho >= (1.0f / 255.0f);
#endif
    V lo = log(s.opacity * s.rho) * LOG2E, reach = lo - ALPHA_MIN_LOG2;
    V sigmas2 = (reach > 0.0f ? reach : (V)(0.0f)) * (2.0f / LOG2E);
    V hx = sqrt(sigmas2 * s.s00), hy = sqrt(sigmas2 * s.s11), largest = MAX_(hx, hy);
    live &= project_within(v, mx, my, hx, hy);
    live &= (s.cam[2] >= 4.0f * v->near_m) | (largest <= v->half_max_px);
    if (!ANY(live))
        return;
    V i11 = 1.0f / s.s11, x_of_y = s.s01 * i11, y_of_x = s.s01 / s.s00;
    V p = sqrt((0.5f * LOG2E) * (s.s11 / s.det)), r = sqrt((0.5f * LOG2E) * i11);
    project_tiles(v, mx, my, p, x_of_y, r, y_of_x, reach, hx + MARGIN_PX, hy + MARGIN_PX, &c);
    live &= c.tiles > 0;
    if (!ANY(live))
        return;
    V w[16] = {mx,
               my,
               p,
               x_of_y,
               r,
               lo,
               mx,
               mx,
               mx,
               y_of_x,
               AS_V(c.cover),
               AS_V(c.bands[0]),
               AS_V(c.bands[1]),
               AS_V(c.bands[2]),
               AS_V(c.bands[3]),
               AS_V(c.bands[4])};
    project_color(v, g, w + 6);
#ifdef APPEARANCE_LEN
    for (uint ch = 0; ch < 3; ch++)
        w[6 + ch] = CLAMP_(w[6 + ch] + (2.0f * y[ch] - 1.0f), 0.0f, 1.0f);
#endif
    project_store(splats + index, w, live);
    *key = live ? AS_VU(s.cam[2]) : (VU)(0xFFFFFFFFu);
    *tiles = live ? AS_VU(c.tiles) : (VU)(0);
}

__kernel void project(__constant struct layout_view *view, __global const float *params,
                      __global const float *filter, __global const uint *list,
                      __global struct layout_splat *splats, __global uint *depth_key,
                      __global uint *tiles_of APPEARANCE_ARGS)
{
    size_t item = get_global_id(0);
#if VW == 16
    size_t end = min((item + 1) * LAYOUT_PROJECT_GROUPS, (size_t)view->groups);
    for (size_t group = item * LAYOUT_PROJECT_GROUPS; group < end; group++) {
        VU key, tiles;
        size_t next = min(group + 2, end - 1), from = view->listed ? list[group] : group;
        __global const float *ahead =
            params + (view->listed ? list[next] : next) * view->planes * LAYOUT_LANES;
        for (uint plane = 0; plane < 11; plane++) // all but the colour, which streams behind them
            PREFETCH(ahead + plane * LAYOUT_LANES);
        project_some(view, params + from * view->planes * LAYOUT_LANES,
                     filter + from * LAYOUT_LANES, (uint)group * LAYOUT_LANES, splats, &key,
                     &tiles LOOK(group * LAYOUT_LANES));
        LAYOUT_WIDE(__global, uint, depth_key + 16 * group) = key;
        LAYOUT_WIDE(__global, uint, tiles_of + 16 * group) = tiles;
    }
#else
    if (item < (size_t)view->groups * LAYOUT_LANES) {
        VU key, tiles;
        size_t group = item / LAYOUT_LANES, lane = item % LAYOUT_LANES;
        size_t from = view->listed ? list[group] : group;
        project_some(view, params + from * view->planes * LAYOUT_LANES + lane,
                     filter + from * LAYOUT_LANES + lane, (uint)item, splats, &key,
                     &tiles LOOK(item));
        depth_key[item] = key;
        tiles_of[item] = tiles;
    }
#endif
}
