/* Colours of the city: procedural textures on all surfaces, one sun with shadows, a sky.
 *
 * Texture decides how well Gaussians can be judged, so no surface is plain: asphalt with markings
 * and stains, tiled pavements, facades with windows, roofs of tiles, gravel or panels, leaves,
 * fields with furrows. Noise is value noise in octaves. An octave finer than the sample is left
 * out, so distance blurs and does not flicker. Surfaces are matt unless the city has gloss. With
 * gloss, glass and standing water reflect, and asphalt, tiles, sheet metal and car paint have a
 * highlight around the sun's mirror image (Blinn-Phong with Schlick's Fresnel term), with one
 * bounce only.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "scene/synth/synth.h"

/* ---- noise ---- */

static uint32_t shade_hash3(int32_t x, int32_t y, uint32_t seed)
{
    uint32_t h = (uint32_t)x * 0x8da6b343u ^ (uint32_t)y * 0xd8163841u ^ seed * 0xcb1ab31fu;
    h ^= h >> 15;
    h *= 0x2c1b3c6du;
    h ^= h >> 12;
    h *= 0x297a2d39u;
    return h ^ h >> 15;
}

static float shade_hash_unit(int32_t x, int32_t y, uint32_t seed)
{
    return (float)(shade_hash3(x, y, seed) >> 8) * 0x1p-24f;
}

/* Value noise in [-1, 1], wavelength 1. */
static float shade_noise(float x, float y, uint32_t seed)
{
    float fx = floorf(x), fy = floorf(y), u = x - fx, v = y - fy;
    int32_t i = (int32_t)fx, j = (int32_t)fy;
    u = u * u * (3 - 2 * u);
    v = v * v * (3 - 2 * v);
    float a = shade_hash_unit(i, j, seed), b = shade_hash_unit(i + 1, j, seed);
    float c = shade_hash_unit(i, j + 1, seed), d = shade_hash_unit(i + 1, j + 1, seed);
    return 2 * (a + u * (b - a) + v * (c - a + u * (a - b - c + d))) - 1;
}

struct shine {    /* of one hit; 0: matt */
    float normal; /* share of light that is mirrored at right angles */
    float sharp;  /* Blinn and Phong's exponent */
};
static const float shade_mirror_sharp = 500; /* from here on a surface shows what it mirrors */
static const struct shine shade_glass = {.08f, 1000}; /* two panes */
static const struct shine shade_water = {.03f, 1000};
static const struct shine shade_panel = {.04f, 1000};
static const struct shine shade_paintwork = {.05f, 300};
static const struct shine shade_sheet = {.25f, 15};
static const struct shine shade_asphalt = {.04f, 8};
static const struct shine shade_clay = {.03f, 6};

struct sample {          /* of one hit: what textures need */
    float foot;          /* metres a sample covers */
    struct shine *shine; /* what the texture says of it */
};

/* 1 where a detail of this size shows, 0 where the sample swallows it. */
static float shade_visible(const struct sample *s, float size)
{
    float v = size / (s->foot + 1e-6f) - 0.6f;
    return v < 0 ? 0 : v > 1 ? 1 : v;
}

/* Octaves of noise from wavelength `wave` down, each with 0.62 of the strength of the one before.
 */
static float shade_fbm(const struct sample *s, float x, float y, uint32_t seed, float wave,
                       int octaves)
{
    float sum = 0, amp = 0.55f;
    for (int o = 0; o < octaves; o++, wave *= 0.5f, amp *= 0.62f) {
        float w = shade_visible(s, 0.5f * wave);
        if (w <= 0)
            break;
        sum += w * amp * shade_noise(x / wave, y / wave, seed + (uint32_t)o * 7919u);
    }
    return sum;
}

static void shade_mix(float a[3], const float b[3], float t)
{
    for (int i = 0; i < 3; i++)
        a[i] += t * (b[i] - a[i]);
}

static void shade_paint(float a[3], float r, float g, float b)
{
    a[0] = r;
    a[1] = g;
    a[2] = b;
}

static void shade_tone(float a[3], float gain)
{
    for (int i = 0; i < 3; i++)
        a[i] *= gain;
}

static float shade_cell_phase(float v, float size)
{
    float q = v / size;
    return q - floorf(q);
}

/* 1 on a line of `width` at the borders of cells of `size`, fading when too fine. */
static float shade_grid_line(const struct sample *s, float v, float size, float width)
{
    float p = shade_cell_phase(v, size) * size;
    return p < width || p > size - width ? shade_visible(s, width * 2.5f) : 0;
}

/* ---- ground ---- */

struct street {         /* nearest along one axis */
    float across, half; /* signed distance from the centre line, half width */
};

static struct street shade_street_near(const struct synth_city *c, int axis, double v)
{
    size_t lo = 0, n = c->n_streets[axis];
    while (lo + 1 < n && 0.5 * (c->street_m[axis][lo] + c->street_m[axis][lo + 1]) < v)
        lo++;
    return (struct street){(float)(v - c->street_m[axis][lo]), (float)c->street_half_m[axis][lo]};
}

/* Marks of a street: s is the street, along the coordinate along it, cross the crossing one. */
static float shade_street_mark(const struct street *s, float along, const struct street *cross)
{
    float d = fabsf(s->across), to_crossing = fabsf(cross->across) - cross->half;
    if (to_crossing > 1.2f && to_crossing < 3.8f) /* zebra crossing */
        return d < s->half - 0.6f && shade_cell_phase(s->across, 1.1f) < 0.5f ? 1 : 0;
    if (to_crossing > 4.4f && to_crossing < 4.9f) /* stop line, on the lane that comes in */
        return d > 0.2f && d < s->half - 2.1f && (s->across > 0) == (cross->across > 0) ? 1 : 0;
    if (to_crossing <= 1.2f)
        return 0;
    if (d < 0.14f)
        return shade_cell_phase(along, 6) < 0.5f ? 1 : 0;
    if (fabsf(d - (s->half - 2.05f)) < 0.07f) /* parking bays */
        return 0.8f;
    if (d > s->half - 2.05f && d < s->half - 0.2f && shade_cell_phase(along, 6.2f) < 0.025f)
        return 0.8f;
    return 0;
}

static float shade_road_mark(float x, float y, const struct street *sx, const struct street *sy)
{
    bool along_y = fabsf(sx->across) < sx->half, along_x = fabsf(sy->across) < sy->half;
    return along_x && along_y ? 0
           : along_y          ? shade_street_mark(sx, y, sy)
                              : shade_street_mark(sy, x, sx);
}

static void shade_road_albedo(const struct sample *s, float x, float y, const struct street *sx,
                              const struct street *sy, uint32_t seed, float rgb[3])
{
    *s->shine = shade_asphalt;
    bool along_y = fabsf(sx->across) < sx->half;
    float grey = 0.115f * (1 + 0.55f * shade_fbm(s, x, y, seed, 9, 6));
    float patch = shade_noise(x / 13, y / 5, seed + 1);
    if (patch > 0.45f) /* resurfaced */
        grey *= shade_noise(x / 40, y / 40, seed + 3) > 0 ? 1.5f : 0.62f;
    float crack = fabsf(shade_noise(x / 3.1f, y / 3.1f, seed + 2));
    if (crack < 0.03f)
        grey *= 1 - 0.45f * shade_visible(s, 0.3f);
    shade_paint(rgb, grey, grey, grey * 1.05f);
    float d = along_y ? sx->across : sy->across;
    float oil = 1 - fabsf(fabsf(d) - 1.7f) / 0.9f; /* wheel tracks and drips */
    if (oil > 0)
        shade_tone(rgb, 1 - 0.28f * oil * (1 + 0.6f * shade_noise(x / 2, y / 2, seed + 5)));
    float mark = shade_road_mark(x, y, sx, sy);
    if (mark > 0) {
        float worn = 0.75f + 0.35f * shade_fbm(s, x, y, seed + 4, 1.2f, 3);
        shade_mix(rgb, (const float[3]){.72f, .71f, .66f}, mark * (worn > 1 ? 1 : worn));
    }
    int32_t mx = (int32_t)floorf(x / 17), my = (int32_t)floorf(y / 17); /* manhole covers */
    float cx = 17 * ((float)mx + 0.2f + 0.6f * shade_hash_unit(mx, my, seed + 6)) - x;
    float cy = 17 * ((float)my + 0.2f + 0.6f * shade_hash_unit(mx, my, seed + 7)) - y;
    if (cx * cx + cy * cy < 0.2f)
        shade_paint(rgb, .055f, .05f, .05f);
}

static void shade_pavement_albedo(const struct sample *s, float x, float y, uint32_t seed,
                                  float rgb[3])
{
    int32_t i = (int32_t)floorf(x / 0.9f), j = (int32_t)floorf(y / 0.9f);
    float tile = (shade_hash_unit(i, j, seed) - 0.5f) * 0.22f * shade_visible(s, 0.9f);
    float grey = 0.37f * (1 + tile + 0.4f * shade_fbm(s, x, y, seed + 1, 5, 5));
    shade_paint(rgb, grey * 1.03f, grey, grey * 0.93f);
    float line = fmaxf(shade_grid_line(s, x, 0.9f, 0.05f), shade_grid_line(s, y, 0.9f, 0.05f));
    shade_tone(rgb, 1 - 0.35f * line);
}

static void shade_grass_albedo(const struct sample *s, float x, float y, uint32_t seed,
                               float rgb[3])
{
    float n = shade_fbm(s, x, y, seed, 7, 7), dry = shade_noise(x / 11, y / 11, seed + 9);
    shade_paint(rgb, .115f, .175f, .045f);
    shade_mix(rgb, (const float[3]){.26f, .23f, .10f}, dry > 0 ? 0.8f * dry : 0);
    shade_tone(rgb, 1 + 0.75f * n);
}

/* Above 0.22 pavers, above 0.02 gravel, else grass. */
static float shade_yard_ground(float x, float y, uint32_t seed)
{
    return shade_noise(x / 12, y / 12, seed) + 0.35f * shade_noise(x / 3, y / 3, seed + 1);
}

static void shade_yard_albedo(const struct sample *s, float x, float y, uint32_t seed, float rgb[3])
{
    float what = shade_yard_ground(x, y, seed);
    if (what > 0.22f) { /* brick pavers, each its own shade */
        float row = floorf(y / 0.35f), shift = fmodf(row, 2) * 0.35f;
        int32_t i = (int32_t)floorf((x + shift) / 0.7f), j = (int32_t)row;
        float shade = 1 + shade_visible(s, 0.5f) * 0.5f * (shade_hash_unit(i, j, seed + 2) - 0.5f);
        shade_paint(rgb, .30f, .20f, .15f);
        shade_tone(rgb, shade * (1 + 0.45f * shade_fbm(s, x, y, seed + 3, 4, 5)));
    } else if (what > 0.02f) { /* gravel */
        shade_paint(rgb, .36f, .33f, .28f);
        shade_tone(rgb, 1 + 0.6f * shade_fbm(s, x, y, seed + 4, 3, 7));
    } else
        shade_grass_albedo(s, x, y, seed + 5, rgb);
}

static void shade_field_albedo(const struct sample *s, float x, float y, uint32_t seed,
                               float rgb[3])
{
    static const float crops[][3] = {{.13f, .20f, .05f}, {.32f, .26f, .11f}, {.20f, .14f, .09f},
                                     {.17f, .22f, .08f}, {.42f, .36f, .12f}, {.10f, .16f, .05f}};
    float u = x + 3 * shade_noise(x / 60, y / 60, seed),
          v = y + 3 * shade_noise(x / 60, y / 60, seed + 1);
    int32_t i = (int32_t)floorf(u / 42), j = (int32_t)floorf(v / 27);
    uint32_t h = shade_hash3(i, j, seed + 2);
    const float *crop = crops[h % 6];
    shade_paint(rgb, crop[0], crop[1], crop[2]);
    float along = h & 64 ? u : v, furrow = shade_cell_phase(along, h & 128 ? 1.6f : 2.4f);
    shade_tone(rgb, 1 + shade_visible(s, 0.8f) * 0.35f * (furrow < 0.5f ? 1 : -1) *
                            (0.7f + 0.5f * shade_noise(u / 2, v / 2, seed)));
    shade_tone(rgb, 1 + 0.6f * shade_fbm(s, x, y, seed + 3, 11, 7));
    float du = shade_cell_phase(u, 42) * 42,
          dv = shade_cell_phase(v, 27) * 27; /* farm tracks between fields */
    if (du < 2.2f || dv < 1.8f) {
        shade_paint(rgb, .33f, .28f, .21f);
        shade_tone(rgb, 1 + 0.5f * shade_fbm(s, x, y, seed + 4, 2, 5));
    }
}

struct ground {
    enum { GROUND_ROAD, GROUND_PAVEMENT, GROUND_YARD, GROUND_FIELD } kind;
    struct street sx, sy;
    float near; /* to the nearest street's edge */
};

static struct ground shade_ground_at(const struct synth_city *c, const double pos[3])
{
    struct ground g = {.sx = shade_street_near(c, 0, pos[0]),
                       .sy = shade_street_near(c, 1, pos[1])};
    float x = (float)pos[0], y = (float)pos[1], margin = 2.4f, reach = (float)c->half_m;
    float dx = fabsf(g.sx.across) - g.sx.half, dy = fabsf(g.sy.across) - g.sy.half;
    bool in_x = fabsf(x) < reach + 7,
         in_y = fabsf(y) < reach + 7; /* outer streets and their pavements */
    bool on_x = dx < 0 && in_y, on_y = dy < 0 && in_x;
    float outer = fmaxf(fabsf(x), fabsf(y)) - reach;
    g.near = fminf(in_y ? dx : 99, in_x ? dy : 99);
    g.kind = on_x || on_y                    ? GROUND_ROAD
             : g.near < margin && outer < 10 ? GROUND_PAVEMENT
             : outer < 0                     ? GROUND_YARD
                                             : GROUND_FIELD;
    return g;
}

enum { SHADE_ROAD = 11, SHADE_PAVEMENT = 21, SHADE_YARD = 31, SHADE_FIELD = 41 }; /* seeds */

static void shade_ground_albedo(const struct synth_city *c, const struct sample *s,
                                const double pos[3], float rgb[3])
{
    float x = (float)pos[0], y = (float)pos[1];
    struct ground g = shade_ground_at(c, pos);
    switch (g.kind) {
    case GROUND_ROAD:
        shade_road_albedo(s, x, y, &g.sx, &g.sy, c->seed + SHADE_ROAD, rgb);
        break;
    case GROUND_PAVEMENT:
        shade_pavement_albedo(s, x, y, c->seed + SHADE_PAVEMENT, rgb);
        if (g.near < 0.22f)
            shade_mix(rgb, (const float[3]){.55f, .54f, .50f}, 0.8f);
        break;
    case GROUND_YARD:
        shade_yard_albedo(s, x, y, c->seed + SHADE_YARD, rgb);
        break;
    case GROUND_FIELD:
        shade_field_albedo(s, x, y, c->seed + SHADE_FIELD, rgb);
        break;
    }
}

/* ---- houses ---- */

static void shade_window_albedo(const struct sample *s, float u, float v, uint32_t pane,
                                float rgb[3])
{
    /* u, v in [0, 1] within the opening: frame, bars, glass with a curtain or a bit of sky. */
    if (u < 0.07f || u > 0.93f || v < 0.06f || v > 0.94f || fabsf(u - 0.5f) < 0.035f) {
        shade_mix(rgb, (const float[3]){.62f, .61f, .58f}, 0.85f);
        return;
    }
    *s->shine = shade_glass;
    float lit = (float)(pane & 255) / 255;
    shade_paint(rgb, 0.035f + 0.05f * lit, 0.045f + 0.06f * lit, 0.06f + 0.09f * lit);
    shade_tone(rgb, 0.7f + 0.8f * v);
    if ((pane >> 8 & 7) == 0) /* blinds half down */
        if (v > 0.35f)
            shade_paint(rgb, .42f, .38f, .30f);
    if ((pane >> 8 & 7) == 1 && fabsf(u - 0.5f) > 0.3f) /* curtains */
        shade_paint(rgb, .36f, .33f, .33f);
}

static void shade_wall_albedo(const struct sample *s, const struct synth_hit *hit, float rgb[3])
{
    const struct synth_solid *h = hit->solid;
    int side = fabs(hit->local_normal[0]) > fabs(hit->local_normal[1])
                   ? 1
                   : 0; /* coordinate along the wall */
    uint32_t face = h->seed + (uint32_t)(2 * side + (hit->local_normal[1 - side] > 0)) * 131u;
    float u = (float)(hit->local[side] + h->half_m[side]), width = (float)(2 * h->half_m[side]);
    float z = (float)hit->local[2], eaves = (float)(h->z1_m - h->z0_m);
    shade_paint(rgb, h->color[0], h->color[1], h->color[2]);
    float stain = 0.42f * shade_fbm(s, u, z, face, 6, 6) +
                  0.22f * shade_noise(u / 0.4f, z / 5, face + 5) * shade_visible(s, 0.4f);
    shade_tone(rgb, (1 + stain) * (0.78f + 0.22f * fminf(1, z / 4)));
    if (h->seed & 1) { /* courses of brick */
        int32_t j = (int32_t)floorf(z / 0.3f),
                i = (int32_t)floorf(u / 0.6f + 0.5f * (float)(j & 1));
        shade_tone(rgb,
                   1 + shade_visible(s, 0.35f) * 0.35f * (shade_hash_unit(i, j, face + 6) - 0.5f));
    }
    float storey = 3.1f, level = floorf(z / storey), v = z - level * storey;
    if (v < 0.16f && level > 0)
        shade_mix(rgb, (const float[3]){.55f, .53f, .49f}, 0.6f);
    if (z < 0.7f)
        shade_mix(rgb, (const float[3]){.20f, .19f, .18f}, 0.7f);
    if ((level + 0.9f) * storey > eaves || h->z1_m - h->z0_m < 2.5)
        return;
    float want = 2.1f + 0.12f * (float)(h->seed >> 4 & 15);
    float bays = floorf(width / want + 0.5f), bay = width / (bays < 1 ? 1 : bays);
    float p = shade_cell_phase(u, bay),
          open = 0.20f + 0.012f * (float)(h->seed >> 8 & 7); /* wall beside the opening */
    int32_t column = (int32_t)floorf(u / bay);
    uint32_t pane = shade_hash3(column, (int32_t)level, face + 9);
    bool shop = level < 1 && h->z0_m == 0 && (h->seed >> 12 & 3) != 0;
    float sill = shop ? 0.45f : 0.95f, top = shop ? 2.65f : 2.45f;
    if (shop)
        open *= 0.4f;
    if (shop && v >= top && v < top + 0.42f) { /* awnings and signs */
        uint32_t sign = shade_hash3(column / 2, 3, face + 10);
        float stripe = shade_cell_phase(u, 0.5f) < 0.5f ? 1 : 0.75f;
        shade_paint(rgb, (0.15f + 0.5f * (float)(sign & 255) / 255) * stripe,
                    (0.12f + 0.35f * (float)(sign >> 8 & 255) / 255) * stripe,
                    (0.12f + 0.4f * (float)(sign >> 16 & 255) / 255) * stripe);
    } else if ((pane >> 20 & 15) != 0 && p > open && p < 1 - open && v > sill && v < top)
        shade_window_albedo(s, (p - open) / (1 - 2 * open), (v - sill) / (top - sill), pane, rgb);
    else if (p > open - 0.06f && p < 1.06f - open && v > sill - 0.14f && v <= sill)
        shade_mix(rgb, (const float[3]){.60f, .58f, .54f}, 0.8f); /* sill */
}

static void shade_tiled_roof_albedo(const struct sample *s, const struct synth_hit *hit,
                                    float rgb[3])
{
    static const float tiles[][3] = {
        {.33f, .12f, .07f}, {.26f, .09f, .06f}, {.14f, .13f, .14f}, {.36f, .20f, .11f}};
    const struct synth_solid *h = hit->solid;
    const float *base = tiles[h->seed >> 3 & 3];
    *s->shine = shade_clay;
    float u = (float)hit->local[0], len = (float)hypot(h->ridge_m - h->z1_m, h->half_m[1]);
    float v = (float)(fabs(hit->local[1]) / h->half_m[1]) * len;
    int32_t j = (int32_t)floorf(v / 0.4f), i = (int32_t)floorf(u / 0.35f);
    shade_paint(rgb, base[0], base[1], base[2]);
    shade_tone(rgb, 1 + shade_visible(s, 0.35f) * 0.5f * (shade_hash_unit(i, j, h->seed) - 0.5f) +
                        0.5f * shade_fbm(s, u, v, h->seed + 1, 4, 5));
    shade_tone(rgb, 1 - 0.3f * shade_grid_line(s, v, 0.4f, 0.06f));
    float moss = shade_noise(u / 2.2f, v / 2.2f + (hit->local[1] > 0 ? 40.f : 0.f), h->seed + 2);
    if (moss > 0.4f)
        shade_mix(rgb, (const float[3]){.13f, .15f, .06f}, moss - 0.2f);
    if (v < 0.25f) /* ridge tiles */
        shade_tone(rgb, 1.35f);
    float w = fabsf(shade_cell_phase(u + 50, 3.4f) * 3.4f - 1.7f),
          mid = fabsf(v - 0.55f * len); /* roof windows */
    if ((h->seed >> 6 & 1) && w < 0.42f && mid < 0.6f) {
        shade_paint(rgb, w > 0.34f || mid > 0.5f ? .4f : .06f, w > 0.34f || mid > 0.5f ? .4f : .08f,
                    w > 0.34f ? .4f : .12f);
        if (w <= 0.34f && mid <= 0.5f)
            *s->shine = shade_glass;
    }
}

static void shade_flat_roof_albedo(const struct sample *s, const struct synth_hit *hit,
                                   float rgb[3])
{
    static const float roofs[][3] = {{.30f, .29f, .27f}, {.13f, .13f, .14f}, {.50f, .49f, .46f},
                                     {.24f, .19f, .15f}, {.17f, .20f, .15f}, {.38f, .35f, .30f}};
    const struct synth_solid *h = hit->solid;
    const float *base = roofs[(h->seed >> 3) % 6];
    float u = (float)hit->local[0], v = (float)hit->local[1];
    float edge =
        (float)fmin(h->half_m[0] - fabs(hit->local[0]), h->half_m[1] - fabs(hit->local[1]));
    shade_paint(rgb, base[0], base[1], base[2]);
    shade_tone(rgb, 1 + 0.62f * shade_fbm(s, u, v, h->seed, 6, 7));
    shade_tone(rgb, 1 - 0.25f * shade_grid_line(s, u + 77, 1.9f, 0.05f)); /* seams of the felt */
    float pool = shade_noise(u / 3.5f, v / 3.5f, h->seed + 3);
    if ((h->seed >> 3) % 6 == 2)
        *s->shine = shade_sheet;
    if (pool > 0.35f) { /* where water stands */
        shade_tone(rgb, 1 - 0.7f * (pool - 0.2f));
        *s->shine = shade_water;
    }
    if (edge < 0.35f)
        shade_paint(rgb, .47f + 0.1f * shade_noise(u, v, h->seed + 4), .46f, .44f);
    else if (edge < 0.55f)
        shade_tone(rgb, 0.6f);
    float pu = u / (float)h->half_m[0], pv = v / (float)h->half_m[1];
    if ((h->seed >> 9 & 3) == 0 && pu > -0.75f && pu < 0.1f && pv > -0.7f && pv < 0.7f &&
        shade_cell_phase(v + 90, 2.5f) > 0.25f) { /* rows of solar panels */
        bool frame =
            shade_grid_line(s, u + 90, 1.05f, 0.05f) > 0 || shade_cell_phase(v + 90, 2.5f) < 0.29f;
        shade_paint(rgb, frame ? .35f : .03f, frame ? .36f : .045f, frame ? .38f : .12f);
        *s->shine = frame ? shade_sheet : shade_panel;
        shade_tone(rgb, 1 + 0.3f * shade_noise(u / 1.05f, v / 2.5f, h->seed + 5));
    }
}

/* ---- the rest ---- */

static void shade_shed_albedo(const struct sample *s, const struct synth_hit *hit, float rgb[3])
{
    const struct synth_solid *h = hit->solid;
    float u = (float)hit->local[0], v = (float)hit->local[1], z = (float)hit->local[2];
    bool top = hit->local_normal[2] > 0.5;
    *s->shine = shade_sheet;
    shade_paint(rgb, h->color[0], h->color[1], h->color[2]);
    shade_tone(rgb, 1 + 0.4f * shade_fbm(s, top ? u : u + v, top ? v : z, h->seed, 1.5f, 4));
    if (!top && shade_cell_phase(z, 0.25f) < 0.4f)
        shade_tone(rgb, 1 - 0.45f * shade_visible(s, 0.2f)); /* louvres */
    float r2 = u * u + v * v, fan = (float)(0.36 * fmin(h->half_m[0], h->half_m[1]));
    if (top && r2 < 4 * fan * fan)
        shade_tone(rgb, r2 > 3.2f * fan * fan || r2 < 0.2f * fan * fan ? 0.8f : 0.35f); /* fan */
}

static void shade_tree_albedo(const struct sample *s, const struct synth_hit *hit, float rgb[3])
{
    const struct synth_solid *h = hit->solid;
    float x = (float)hit->local[0], y = (float)hit->local[1], z = (float)hit->local[2];
    float n = shade_fbm(s, x + 0.71f * z, y - 0.69f * z, h->seed, 1.4f, 4) +
              0.6f * shade_fbm(s, y + 0.6f * z, z - 0.5f * x, h->seed + 1, 0.8f, 3);
    shade_paint(rgb, h->color[0], h->color[1], h->color[2]);
    float gain = 0.9f + 1.1f * n;
    shade_tone(rgb, gain < 0.25f ? 0.25f : gain);
}

static void shade_car_albedo(const struct sample *s, const struct synth_hit *hit, float rgb[3])
{
    const struct synth_solid *h = hit->solid;
    float u = (float)(hit->local[0] / h->half_m[0]), z = (float)hit->local[2];
    shade_paint(rgb, h->color[0], h->color[1], h->color[2]);
    *s->shine = shade_paintwork;
    if (h->material == SYNTH_CABIN) {
        if (hit->local_normal[2] < 0.5 && z > 0.08f && z < 0.48f) {
            shade_paint(rgb, .03f, .035f, .045f);
            *s->shine = shade_glass;
        }
        return;
    }
    if (hit->local_normal[2] > 0.5) {
        if (fabsf(u) > 0.55f && fabsf(u) < 0.6f)
            shade_tone(rgb, 0.5f);
        return;
    }
    if (fabs(hit->local_normal[0]) > 0.5)
        shade_paint(rgb, u > 0 ? .7f : .45f, u > 0 ? .68f : .03f, u > 0 ? .6f : .03f); /* lamps */
    else if (fabsf(fabsf(u) - 0.6f) < 0.16f && z < 0.35f)
        shade_paint(rgb, .02f, .02f, .02f); /* wheels */
}

/* ---- paint that says little of shape ---- */

static const double shade_roof_up = 0.2; /* least z of a normal that is no wall's */

static enum synth_paint shade_ground_paint(const struct synth_city *c, const double pos[3])
{
    float x = (float)pos[0], y = (float)pos[1];
    struct ground g = shade_ground_at(c, pos);
    if (g.kind == GROUND_ROAD)
        return shade_road_mark(x, y, &g.sx, &g.sy) > 0 ? SYNTH_MARK : SYNTH_ASPHALT;
    return g.kind == GROUND_YARD && shade_yard_ground(x, y, c->seed + SHADE_YARD) <= 0.02f
               ? SYNTH_LAWN
               : SYNTH_RICH;
}

enum synth_paint synth_shade_paint(const struct synth_city *c, const struct synth_hit *hit)
{
    if (!c->tricky || !isfinite(hit->t_m))
        return SYNTH_RICH;
    if (!hit->solid)
        return shade_ground_paint(c, hit->pos);
    if (hit->solid->material != SYNTH_HOUSE)
        return SYNTH_RICH;
    if (hit->local_normal[2] > shade_roof_up)
        return hit->solid->seed >> 16 & 1 ? SYNTH_BLACK : SYNTH_RICH;
    return (hit->solid->seed >> 17) % 3 == 0 ? SYNTH_GLASS : SYNTH_RICH;
}

static void shade_tricky_albedo(enum synth_paint paint, const struct sample *s, float rgb[3])
{
    static const float albedo[][3] = {[SYNTH_ASPHALT] = {.016f, .016f, .017f},
                                      [SYNTH_MARK] = {.80f, .80f, .78f},
                                      [SYNTH_LAWN] = {.075f, .155f, .035f},
                                      [SYNTH_BLACK] = {.010f, .010f, .011f},
                                      [SYNTH_GLASS] = {.022f, .026f, .034f}};
    *s->shine = paint == SYNTH_GLASS ? shade_glass : (struct shine){0};
    shade_paint(rgb, albedo[paint][0], albedo[paint][1], albedo[paint][2]);
}

static void shade_hit_albedo(const struct synth_city *c, const struct sample *s,
                             const struct synth_hit *hit, float rgb[3])
{
    enum synth_paint paint = synth_shade_paint(c, hit);
    if (paint != SYNTH_RICH) {
        shade_tricky_albedo(paint, s, rgb);
        return;
    }
    if (!hit->solid) {
        shade_ground_albedo(c, s, hit->pos, rgb);
        return;
    }
    bool roof = hit->local_normal[2] > shade_roof_up;
    switch (hit->solid->material) {
    case SYNTH_HOUSE:
        if (!roof)
            shade_wall_albedo(s, hit, rgb);
        else if (hit->solid->kind == SYNTH_GABLE)
            shade_tiled_roof_albedo(s, hit, rgb);
        else
            shade_flat_roof_albedo(s, hit, rgb);
        break;
    case SYNTH_SHED:
        shade_shed_albedo(s, hit, rgb);
        break;
    case SYNTH_TREE:
        shade_tree_albedo(s, hit, rgb);
        break;
    case SYNTH_CAR:
    case SYNTH_CABIN:
        shade_car_albedo(s, hit, rgb);
        break;
    case SYNTH_TRUNK:
        shade_paint(rgb, hit->solid->color[0], hit->solid->color[1], hit->solid->color[2]);
        break;
    }
}

/* ---- light ---- */

struct synth_light synth_shade_light(void)
{
    return (struct synth_light){{1.75f, 1.62f, 1.38f}, {.46f, .53f, .66f}, {1, 1, 1}};
}

static void shade_sky(const struct synth_light *light, const double dir[3], float rgb[3])
{
    float up = (float)fmax(dir[2], 0);
    shade_paint(rgb, 0.75f - 0.4f * up, 0.85f - 0.3f * up, 1.0f - 0.1f * up);
    for (int i = 0; i < 3; i++)
        rgb[i] = rgb[i] * light->sky[i] * 1.6f;
}

struct lit { /* a place, before the camera's gain */
    float rgb[3];
    struct shine shine;
    float sun; /* cosine to the sun, 0 in shadow */
};

/* What a place sends everywhere alike. */
static void shade_matt(const struct synth_city *c, const struct synth_grid *moving,
                       const struct synth_light *light, const struct synth_hit *hit,
                       double footprint_m, struct lit *out)
{
    out->shine = (struct shine){0};
    struct sample s = {(float)footprint_m, &out->shine};
    shade_hit_albedo(c, &s, hit, out->rgb);
    double normal[3] = {hit->normal[0], hit->normal[1], hit->normal[2]};
    if (hit->solid && hit->solid->material == SYNTH_TREE) { /* leaves face everywhere */
        float x = (float)hit->local[0], y = (float)hit->local[1], z = (float)hit->local[2];
        double len = 0;
        normal[0] += 0.7 * (double)shade_noise(x / 0.5f, (y + z) / 0.5f, hit->solid->seed + 20);
        normal[1] += 0.7 * (double)shade_noise((x - z) / 0.5f, y / 0.5f, hit->solid->seed + 21);
        for (int i = 0; i < 3; i++)
            len += normal[i] * normal[i];
        for (int i = 0; i < 3; i++)
            normal[i] /= sqrt(len);
    }
    double facing = normal[0] * c->sun[0] + normal[1] * c->sun[1] + normal[2] * c->sun[2], from[3];
    for (int i = 0; i < 3; i++)
        from[i] = hit->pos[i] + 1e-4 * hit->normal[i];
    out->sun = facing > 0 && !synth_trace_shadow(c, moving, from) ? (float)facing : 0;
    float sky = 0.62f + 0.38f * (float)normal[2];
    for (int i = 0; i < 3; i++)
        out->rgb[i] *= out->sun * light->sun[i] + sky * light->sky[i];
}

/* What a shining place sends along -dir of the light that it mirrors, and the share of its own that
 * it keeps back for that. */
static void shade_gloss(const struct synth_city *c, const struct synth_grid *moving,
                        const struct synth_light *light, const double dir[3],
                        const struct synth_hit *hit, double gloss, double footprint_m,
                        struct lit *lit)
{
    const double *n = hit->normal;
    double across = -(dir[0] * n[0] + dir[1] * n[1] + dir[2] * n[2]), mirror[3], from[3], half[3],
           len = 0, aligned = 0;
    if (!(across > 0))
        return;
    for (int i = 0; i < 3; i++) {
        mirror[i] = dir[i] + 2 * across * n[i];
        from[i] = hit->pos[i] + 1e-4 * n[i];
        half[i] = c->sun[i] - dir[i];
        len += half[i] * half[i];
        aligned += half[i] * n[i];
    }
    float f0 = lit->shine.normal, sharp = lit->shine.sharp, seen[3];
    /* A rough surface is no mirror at a grazing angle either (Lagarde's form of Schlick's term). */
    float graze = fmaxf(f0, 1 - sqrtf(2 / (sharp + 2)));
    float share = (float)gloss * (f0 + (graze - f0) * powf(1 - (float)across, 5));
    struct synth_hit other = {.t_m = (double)INFINITY};
    if (sharp >= shade_mirror_sharp)
        synth_trace_ray(c, moving, from, mirror, &other);
    if (isfinite(other.t_m)) {
        struct lit there;
        shade_matt(c, moving, light, &other, footprint_m * (1 + other.t_m / hit->t_m), &there);
        shade_paint(seen, there.rgb[0], there.rgb[1], there.rgb[2]);
    } else
        shade_sky(light, mirror, seen);
    /* Radiance of the sun is its light on a surface over pi, which is what light->sun counts. */
    float lobe = lit->sun * (sharp + 2) / 8 * powf((float)fmax(aligned / sqrt(len), 0), sharp);
    for (int i = 0; i < 3; i++)
        lit->rgb[i] = (1 - share) * lit->rgb[i] + share * (seen[i] + lobe * light->sun[i]);
}

void synth_shade_hit(const struct synth_city *c, const struct synth_grid *moving,
                     const struct synth_light *light, const double dir[3],
                     const struct synth_hit *hit, double footprint_m, float rgb[3])
{
    struct lit lit = {0};
    if (!isfinite(hit->t_m))
        shade_sky(light, dir, lit.rgb);
    else {
        shade_matt(c, moving, light, hit, footprint_m, &lit);
        double gloss = synth_shade_paint(c, hit) == SYNTH_GLASS ? 1 : c->gloss;
        if (gloss > 0 && lit.shine.normal > 0)
            shade_gloss(c, moving, light, dir, hit, gloss, footprint_m, &lit);
    }
    for (int i = 0; i < 3; i++)
        rgb[i] = lit.rgb[i] * light->gain[i];
}

uint8_t synth_shade_encode(float linear)
{
    if (!(linear > 0))
        return 0;
    if (linear >= 1)
        return 255;
    float v = linear <= 0.0031308f ? 12.92f * linear : 1.055f * powf(linear, 1 / 2.4f) - 0.055f;
    return (uint8_t)(v * 255 + 0.5f);
}
