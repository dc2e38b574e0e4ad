// Stage: project. Gaussians -> splat records, depth keys, tile counts.
//   in   params [groups][planes][16]
//        list [groups], with view->listed: which groups of params these are
//        edge [LAYOUT_EDGE][LAYOUT_EDGE], with view->edge_cells: what is left of opacities
//   out  splats [groups * 16] (anything where culled), depth_key (bits of depth, ~0 where culled),
//        tiles_of
// Culling has several steps, cheapest first: depth, a bound of the extent, the ellipse, its extent.
// A group ends as soon as all its lanes are culled. Spherical harmonics, three quarters of the
// bytes, are read last.
//
// Tiles: alpha >= 1/255 inside the ellipse u^2 + v^2 <= opacity_log2 + log2(255) = L. In a band of
// tile rows, the ellipse touches the columns between its leftmost and rightmost point in the band.
// They take two square roots (AccuTile, Hanson et al. 2025, in rows of tiles). A margin of 0.01 px
// covers rounding, so that no pixel is lost that blending would draw.
//
// With view->room_px, tiles and picture are as if they were larger by so much on every side: their
// lists hold what comes into them when the camera moves a little. A frame of such lists (again)
// hides the splats that are not in it any more, and leaves tiles_of alone.
//
// With APPEARANCE_LEN (appearance.cl) the network runs before extents and culling, for Gaussians
// that would reach into the picture if they were opaque:
//   in   frame, its constants;   out  effective [groups * 16], opacity with its offset
//
// Reference: ref_project in render_ref.c.

#define MARGIN_PX 0.01f
#define HIDDEN_LOG2 (-1e4f) // an opacity that is drawn nowhere
#ifdef APPEARANCE_LEN
#define APPEARANCE_ARGS , __constant float *frame, __global float *effective
#define APPEARANCE(at) , frame, effective + (at)
#else
#define APPEARANCE_ARGS
#define APPEARANCE(at)
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

// A splat on the screen, in the terms of struct layout_splat.
struct outline {
    V mx, my; // mean, px
    V p, x_of_y, r, opacity_log2, y_of_x;
    V reach;  // L
    V hx, hy; // half-sizes of its box, px
};

struct coverage {
    VU cover, bands[LAYOUT_BANDS / 2];
    VI tiles;
};

// The tiles of an ellipse. Lanes that are not visible hold anything.
INLINE void project_tiles(__constant struct layout_view *v, const struct outline *o,
                          struct coverage *c)
{
    const float room = v->room_px, margin = MARGIN_PX + room;
    V mx = o->mx, my = o->my, hx = o->hx + margin, hy = o->hy + margin;
    VI row0 = tile_first(my - hy, v->tiles_y), row1 = tile_last(my + hy, v->tiles_y);
    VI col0 = tile_first(mx - hx, v->tiles_x), col1 = tile_last(mx + hx, v->tiles_x);
    VI rows = row1 - row0 + 1, cols = col1 - col0 + 1;
    VI shift = cols > 512 ? (VI)(2) : (cols > 256 ? (VI)(1) : (VI)(0));
    VI step = TO_VI(floor(TO_V(rows + (LAYOUT_BANDS - 1)) * (1.0f / LAYOUT_BANDS) + 1e-3f));
    V inv_p = 1.0f / o->p;
    V y_right = o->y_of_x * (o->hx + MARGIN_PX); // where it is widest, and its mirror image
    c->cover = AS_VU(row0) | (AS_VU(col0) << 10) | (AS_VU(rows - 1) << 20) | (AS_VU(shift) << 30);
    c->tiles = (VI)(0);
    for (int b = 0; b < LAYOUT_BANDS / 2; b++)
        c->bands[b] = (VU)(0);
#if VW == 16
#pragma unroll // or the words of the bands lie in memory
#endif
    for (int b = 0; b < LAYOUT_BANDS; b++) {
        VI top = row0 + b * step, bottom = MIN_(top + step - 1, row1);
        if (!ANY(top <= row1))
            break;
        V y0 = TO_V(top) * LAYOUT_TILE + (0.5f - room) - my,
          y1 = TO_V(bottom) * LAYOUT_TILE + (LAYOUT_TILE - 0.5f + room) - my;
        V yr = CLAMP_(y_right, y0, y1), yl = CLAMP_(-y_right, y0, y1);
        V wr = o->reach - (o->r * yr) * (o->r * yr), wl = o->reach - (o->r * yl) * (o->r * yl);
        wr = sqrt(MAX_(wr, 0.0f)) * inv_p;
        wl = sqrt(MAX_(wl, 0.0f)) * inv_p;
        VI first = tile_first(mx + (o->x_of_y * yl - wl) - margin, v->tiles_x);
        VI last = tile_last(mx + (o->x_of_y * yr + wr) + margin, v->tiles_x);
        if (!v->tile_cull) {
            first = col0;
            last = col1;
        }
        first = MAX_(first, col0) - col0; // rounding may put them just outside the box
        last = MIN_(last, col1) - col0;
        last = top <= row1 ? last : (VI)(-1);
        VI f = first >> shift, l = last >> shift,
           end = MIN_((l + 1) << shift, (VI)((int)v->tiles_x) - col0);
        VI count = (end - (f << shift)) * (bottom - top + 1), columns = f + (l << 8);
        c->tiles += first <= last ? count : (VI)(0);
        columns = first <= last ? columns : (VI)(255); // first 255, last 0: none
        c->bands[b >> 1] |= AS_VU(columns) << (16u * (b & 1));
    }
}

// The halves of a group. lane: of g, VW 1.
INLINE __global const half *project_halves(__global const float *g, uint lane)
{
    return (__global const half *)(g + LAYOUT_PLANE_SH * LAYOUT_LANES) - lane;
}

INLINE void project_color(__constant struct layout_view *v, __global const float *g, uint lane,
                          V rgb[3])
{
    V dir[3], basis[LAYOUT_SH_MAX];
    uint count = (v->sh_degree + 1) * (v->sh_degree + 1);
    seen_direction(v, g, dir);
    sh_basis(dir, v->sh_degree, basis);
    V red = (V)(0.5f), green = red, blue = red; // in registers, where an array lies in memory
    if (v->sh_halves) {
        __global const half *sh = project_halves(g, lane);
        for (uint k = 0; k < count; k++) {
            red = basis[k] * LD_HALF(sh, 3 * k) + red;
            green = basis[k] * LD_HALF(sh, 3 * k + 1) + green;
            blue = basis[k] * LD_HALF(sh, 3 * k + 2) + blue;
        }
    } else {
        for (uint k = 0; k < count; k++) {
            __global const float *sh = g + (LAYOUT_PLANE_SH + 3 * k) * LAYOUT_LANES;
            red = basis[k] * LD(sh, 0) + red;
            green = basis[k] * LD(sh, 1) + green;
            blue = basis[k] * LD(sh, 2) + blue;
        }
    }
    rgb[0] = red;
    rgb[1] = green;
    rgb[2] = blue;
#ifndef APPEARANCE_LEN
    for (uint ch = 0; ch < 3; ch++)
        rgb[ch] = CLAMP_(rgb[ch], 0.0f, 1e30f); // finite: blending multiplies it by zeros
#endif
}

#if VW == 16
// Culled lanes beside visible ones, too: nothing reads them, and choosing costs more.
INLINE void project_store(__global struct layout_splat *out, V w[LAYOUT_SPLAT_WORDS], VI visible)
{
    (void)visible;
    transpose_16(w);
#pragma unroll
    for (int i = 0; i < LAYOUT_LANES; i++)
        LAYOUT_WIDE(__global, float, out + i) = w[i];
}
#else
INLINE void project_store(__global struct layout_splat *out, V w[LAYOUT_SPLAT_WORDS], VI visible)
{
    __global float *f = (__global float *)out;
    if (visible)
        for (int i = 0; i < LAYOUT_SPLAT_WORDS; i++)
            f[i] = w[i];
}
#endif

// The mask of lanes within `hx`, `hy` of the picture.
INLINE VI project_within(__constant struct layout_view *v, V mx, V my, V hx, V hy)
{
    const float room = v->room_px;
    return (mx + hx > -room) & (mx - hx < (float)v->width + room) & (my + hy > -room) &
           (my - hy < (float)v->height + room);
}

#ifdef APPEARANCE_LEN
// The network, where an opaque splat would reach into the picture: y, and opacity with its offset.
// The mask of lanes that are left.
INLINE VI project_appearance(__constant struct layout_view *v, __global const float *g,
                             const struct outline *o, VI live, struct seen *s,
                             V y[LAYOUT_APPEARANCE_OUT] APPEARANCE_ARGS)
{
    const float sigmas2 = -LAYOUT_ALPHA_MIN_LOG2 * (2.0f / LOG2E);
    live &= project_within(v, o->mx, o->my, sqrt(sigmas2 * s->s00), sqrt(sigmas2 * s->s11));
    if (!ANY(live))
        return live;
    // The network is long enough to wait for the planes of the colour.
    for (uint plane = LAYOUT_PLANE_SH; plane < v->planes; plane++)
        PREFETCH(g + plane * LAYOUT_LANES);
    appearance_eval(frame, g + (v->planes - APPEARANCE_LEN) * LAYOUT_LANES, y);
    V opacity = s->opacity + y[LAYOUT_APPEARANCE_OPACITY];
    s->opacity = MIN_(opacity, 1.0f);
    ST(effective, 0, s->opacity);
    return live & (s->opacity * s->rho >= LAYOUT_ALPHA_MIN);
}
#endif

// What is left of Gaussians near the city's edge: render_edge between the middles of four cells.
INLINE V project_edge(__constant struct layout_view *v, __global const float *edge,
                      __global const float *g)
{
    V x = (LD(g, LAYOUT_PLANE_MEAN) - v->edge_x) * v->edge_cells - 0.5f;
    V y = (LD(g, LAYOUT_PLANE_MEAN + 1) - v->edge_y) * v->edge_cells - 0.5f;
    x = CLAMP_(x, 0.0f, LAYOUT_EDGE - 1.001f); // of NaN: 0
    y = CLAMP_(y, 0.0f, LAYOUT_EDGE - 1.001f);
    V column = floor(x), row = floor(y);
    VI cell = TO_VI(row) * LAYOUT_EDGE + TO_VI(column);
#if VW == 16
    int at[16];
    float corner[4][16];
    vstore16(cell, 0, at);
    for (int i = 0; i < 16; i++) {
        corner[0][i] = edge[at[i]];
        corner[1][i] = edge[at[i] + 1];
        corner[2][i] = edge[at[i] + LAYOUT_EDGE];
        corner[3][i] = edge[at[i] + LAYOUT_EDGE + 1];
    }
    V sw = vload16(0, corner[0]), se = vload16(0, corner[1]);
    V nw = vload16(0, corner[2]), ne = vload16(0, corner[3]);
#else
    V sw = edge[cell], se = edge[cell + 1];
    V nw = edge[cell + LAYOUT_EDGE], ne = edge[cell + LAYOUT_EDGE + 1];
#endif
    V south = sw + (x - column) * (se - sw), north = nw + (x - column) * (ne - nw);
    return south + (y - row) * (north - south);
}

// How far it reaches, then the rest of the outline. The mask of lanes that are left: those that
// reach into the picture, and not from just before the lens over all of it.
INLINE VI project_outline(__constant struct layout_view *v, const struct seen *s, VI live,
                          struct outline *o)
{
    o->opacity_log2 = log(s->opacity * s->rho) * LOG2E;
    o->reach = o->opacity_log2 - LAYOUT_ALPHA_MIN_LOG2;
    V sigmas2 = (o->reach > 0.0f ? o->reach : (V)(0.0f)) * (2.0f / LOG2E);
    o->hx = sqrt(sigmas2 * s->s00);
    o->hy = sqrt(sigmas2 * s->s11);
    V largest = MAX_(o->hx, o->hy);
    live &= project_within(v, o->mx, o->my, o->hx, o->hy);
    live &= (s->cam[2] >= 4.0f * v->near_m) | (largest <= v->half_max_px);
    if (!ANY(live))
        return live;
    V i11 = 1.0f / s->s11;
    o->x_of_y = s->s01 * i11;
    o->y_of_x = s->s01 / s->s00;
    o->p = sqrt((0.5f * LOG2E) * (s->s11 / s->det));
    o->r = sqrt((0.5f * LOG2E) * i11);
    return live;
}

// Words of the record but those of the colour.
INLINE void project_record(const struct outline *o, const struct coverage *c,
                           V w[LAYOUT_SPLAT_WORDS])
{
    w[LAYOUT_SPLAT_MEAN_X] = o->mx;
    w[LAYOUT_SPLAT_MEAN_Y] = o->my;
    w[LAYOUT_SPLAT_P] = o->p;
    w[LAYOUT_SPLAT_X_OF_Y] = o->x_of_y;
    w[LAYOUT_SPLAT_R] = o->r;
    w[LAYOUT_SPLAT_OPACITY_LOG2] = o->opacity_log2;
    w[LAYOUT_SPLAT_Y_OF_X] = o->y_of_x;
    w[LAYOUT_SPLAT_COVER] = AS_V(c->cover);
    for (uint b = 0; b < LAYOUT_BANDS / 2; b++)
        w[LAYOUT_SPLAT_BANDS + b] = AS_V(c->bands[b]);
}

// Asks for a third of the harmonics. They come while the ellipse and its tiles are made; a core has
// no room for all of these lines at once, and waits when it is asked to. project_appearance has
// asked before.
INLINE void project_ask(__constant struct layout_view *v, __global const float *g, uint third)
{
#if VW == 16 && !defined APPEARANCE_LEN
    uint planes = (v->sh_degree + 1) * (v->sh_degree + 1);
    planes = v->sh_halves ? (planes + 1) / 2 : planes;
    uint from = LAYOUT_PLANE_SH + third * planes;
    for (uint plane = from; plane < from + planes; plane++)
        PREFETCH(g + plane * LAYOUT_LANES);
#endif
}

// Could a lane reach into the picture? Where no mean lies in it, by the bound
//     S00 <= |J0|^2 sigma^2 + kernel,   |J0|^2 = (fx / z)^2 (1 + (t'x / z)^2)
// with the largest sigma and opacity 1, and the same of S11. A group without one ends before its
// ellipse is made.
INLINE int project_near(__constant struct layout_view *v, __global const float *g, VI live,
                        const struct seen *s)
{
    V iz = v->orthographic ? (V)(1.0f) : 1.0f / s->cam[2];
    V x = s->cam[0] * iz, y = s->cam[1] * iz;
    const float half_w = 0.5f * (float)v->width, half_h = 0.5f * (float)v->height;
    V out_x = fabs(v->fx * x + (v->cx - half_w)) - (half_w + v->room_px);
    V out_y = fabs(v->fy * y + (v->cy - half_h)) - (half_h + v->room_px);
    if (ANY(live & (out_x <= 0.0f) & (out_y <= 0.0f)))
        return 1;
    V most = LD(g, LAYOUT_PLANE_SCALE), second = LD(g, LAYOUT_PLANE_SCALE + 1),
      third = LD(g, LAYOUT_PLANE_SCALE + 2);
    most = MAX_(most, second);
    most = MAX_(most, third);
    V sigma2 = exp(2.0f * most);
    V lim_x = CLAMP_(x, -v->lim_neg_x, v->lim_pos_x);
    V lim_y = CLAMP_(y, -v->lim_neg_y, v->lim_pos_y);
    V fx = v->fx * iz, fy = v->fy * iz;
    // a little more than LAYOUT_EXTENT_MAX^2, for rounding
    const float reach2 = 1.01f * LAYOUT_EXTENT_MAX * LAYOUT_EXTENT_MAX;
    V x2 = reach2 * (fx * fx * (1.0f + lim_x * lim_x) * sigma2 + v->kernel_px2);
    V y2 = reach2 * (fy * fy * (1.0f + lim_y * lim_y) * sigma2 + v->kernel_px2);
    return ANY(live & ((out_x <= 1.0f) | (out_x * out_x <= x2)) &
               ((out_y <= 1.0f) | (out_y * out_y <= y2)));
}

// The group (VW 16) or lane (VW 1) whose parameters start at g and whose first index is `index`.
INLINE void project_some(__constant struct layout_view *v, __global const float *g, uint index,
                         __global struct layout_splat *splats, VU *key, VU *tiles,
                         __global const float *edge APPEARANCE_ARGS)
{
    struct seen s;
    struct outline o;
    struct coverage c;
    V w[LAYOUT_SPLAT_WORDS];
    VI live = seen_mean(v, g, &s) & ((VI)((int)index) + LANE < (int)v->n);
    *key = (VU)(0xFFFFFFFFu);
    *tiles = (VU)(0);
    if (!ANY(live) || !project_near(v, g, live, &s))
        return;
    live &= seen_ellipse(v, g, &s);
    if (!ANY(live))
        return;
    project_ask(v, g, 0);
    o.mx = v->fx * (s.cam[0] * s.inv_z) + v->cx;
    o.my = v->fy * (s.cam[1] * s.inv_z) + v->cy;
#ifdef APPEARANCE_LEN
    V y[LAYOUT_APPEARANCE_OUT];
    live = project_appearance(v, g, &o, live, &s, y APPEARANCE(0));
    if (!ANY(live))
        return;
#endif
    if (v->edge_cells > 0.0f) {
        s.opacity *= project_edge(v, edge, g);
        live &= s.opacity * s.rho >= LAYOUT_ALPHA_MIN;
        if (!ANY(live))
            return;
    }
    live = project_outline(v, &s, live, &o);
    if (!ANY(live))
        return;
    project_ask(v, g, 1);
    project_tiles(v, &o, &c);
    project_ask(v, g, 2);
    live &= c.tiles > 0;
    if (!ANY(live))
        return;
    project_record(&o, &c, w);
    project_color(v, g, index % LAYOUT_LANES, w + LAYOUT_SPLAT_RGB);
#ifdef APPEARANCE_LEN
    for (uint ch = 0; ch < 3; ch++) {
        V color = w[LAYOUT_SPLAT_RGB + ch] + (2.0f * y[ch] - 1.0f);
        w[LAYOUT_SPLAT_RGB + ch] = CLAMP_(color, 0.0f, 1.0f);
    }
#endif
    if (v->again)
        w[LAYOUT_SPLAT_OPACITY_LOG2] = live ? o.opacity_log2 : (V)(HIDDEN_LOG2);
    project_store(splats + index, w, live);
    *key = live ? AS_VU(s.cam[2]) : (VU)(0xFFFFFFFFu);
    *tiles = live ? AS_VU(c.tiles) : (VU)(0);
}

// Lists of an earlier frame name splats of this group (VW 16) or lane (VW 1). None is in the
// picture any more.
INLINE void project_hide(__global struct layout_splat *splats, VU tiles, VU listed)
{
    if (!ANY(tiles != 0) && ANY(listed != 0))
        for (int i = 0; i < VW; i++)
            splats[i].opacity_log2 = HIDDEN_LOG2;
}

__kernel void project(__constant struct layout_view *view, __global const float *params,
                      __global const uint *list, __global struct layout_splat *splats,
                      __global uint *depth_key, __global uint *tiles_of,
                      __global const float *edge APPEARANCE_ARGS)
{
    size_t item = get_global_id(0);
#if VW == 16
    size_t end = min((item + 1) * LAYOUT_PROJECT_GROUPS, (size_t)view->groups);
    for (size_t group = item * LAYOUT_PROJECT_GROUPS; group < end; group++) {
        VU key, tiles;
        size_t next = min(group + 2, end - 1), from = view->listed ? list[group] : group;
        __global const float *ahead =
            params + (view->listed ? list[next] : next) * view->planes * LAYOUT_LANES;
        // All but the colour, which streams behind them.
        for (uint plane = 0; plane < LAYOUT_PLANES_GEOMETRY; plane++)
            PREFETCH(ahead + plane * LAYOUT_LANES);
        project_some(view, params + from * view->planes * LAYOUT_LANES, (uint)group * LAYOUT_LANES,
                     splats, &key, &tiles, edge APPEARANCE(group * LAYOUT_LANES));
        LAYOUT_WIDE(__global, uint, depth_key + LAYOUT_LANES * group) = key;
        if (view->again)
            project_hide(splats + LAYOUT_LANES * group, tiles,
                         LAYOUT_WIDE(__global, uint, tiles_of + LAYOUT_LANES * group));
        else
            LAYOUT_WIDE(__global, uint, tiles_of + LAYOUT_LANES * group) = tiles;
    }
#else
    if (item < (size_t)view->groups * LAYOUT_LANES) {
        VU key, tiles;
        size_t group = item / LAYOUT_LANES, lane = item % LAYOUT_LANES;
        size_t from = view->listed ? list[group] : group;
        project_some(view, params + from * view->planes * LAYOUT_LANES + lane, (uint)item, splats,
                     &key, &tiles, edge APPEARANCE(item));
        depth_key[item] = key;
        if (view->again)
            project_hide(splats + item, tiles, tiles_of[item]);
        else
            tiles_of[item] = tiles;
    }
#endif
}
