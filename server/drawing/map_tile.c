/* Tiles of a web map as bytes: see map_tile.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/drawing/map_tile.h"

#include <math.h>

#include "codec/image/image.h"

static uint8_t map_tile_byte(float v)
{
    return (uint8_t)(fminf(fmaxf(v, 0), 1) * 255 + 0.5f);
}

static enum err_code map_tile_color(struct nadir *n, const struct map_tile *t, struct image *img,
                                    struct err *e)
{
    const struct raster_tile at = {t->key, t->size_px, 0};
    size_t pixels = (size_t)t->size_px * t->size_px;
    float *rgb = mem_array(pixels, 3 * sizeof *rgb);
    uint8_t *in = mem_array(pixels, 1);
    bool alpha = t->format != FORMAT_JPG;
    enum err_code rc = rgb && in
                           ? image_alloc(t->size_px, t->size_px, alpha ? 4 : 3, img, e)
                           : err_set(e, ERR_MEM, "out of memory for a tile of %u px", t->size_px);
    if (!rc)
        rc = raster_draw(n, &at, rgb, NULL, in, e);
    for (size_t i = 0; !rc && i < pixels; i++) {
        bool held = isfinite(rgb[3 * i]);
        uint8_t *px = img->px + i * img->channels;
        for (size_t k = 0; k < 3; k++)
            px[k] = held ? map_tile_byte(rgb[3 * i + k]) : alpha ? 0 : 255;
        if (alpha)
            px[3] = held ? 255 : 0;
    }
    mem_free(rgb);
    mem_free(in);
    return rc;
}

/* Whole steps of the encoding above its lowest height. */
static uint32_t map_tile_steps(enum encoding encoding, float height_m)
{
    double h = (double)height_m,
           steps = encoding == ENCODING_TERRARIUM ? (h + 32768) * 256 : (h + 10000) * 10;
    return (uint32_t)fmin(fmax(floor(steps + 0.5), 0), 0xffffff);
}

/* Pixels about a tile that decide what heights are in it. */
static uint32_t map_tile_margin(const struct map_tile *t)
{
    return t->ground ? raster_ground_margin(raster_ground_radius(t->key, t->size_px))
                     : MAP_TILE_REACH_PX;
}

static enum err_code map_tile_terrain(struct nadir *n, const struct map_tile *t, struct image *img,
                                      struct err *e)
{
    const struct raster_tile at = {t->key, t->size_px, map_tile_margin(t)};
    uint32_t side = raster_side(&at);
    size_t pixels = (size_t)side * side;
    float *height = mem_array(pixels, sizeof *height), *filled = mem_array(pixels, sizeof *filled);
    uint8_t *in = mem_array(pixels, 1);
    enum err_code rc = height && filled && in
                           ? image_alloc(t->size_px, t->size_px, 3, img, e)
                           : err_set(e, ERR_MEM, "out of memory for a tile of %u px", t->size_px);
    if (!rc)
        rc = raster_draw(n, &at, NULL, height, in, e);
    if (!rc && t->ground)
        rc = raster_ground(height, side, raster_ground_radius(t->key, t->size_px),
                           raster_base_m(nadir_area(n)), filled, e);
    else if (!rc)
        raster_fill(height, side, MAP_TILE_REACH_PX, raster_base_m(nadir_area(n)), filled);
    for (size_t y = 0; !rc && y < t->size_px; y++)
        for (size_t x = 0; x < t->size_px; x++) {
            uint32_t v =
                map_tile_steps(t->encoding, filled[(y + at.margin_px) * side + x + at.margin_px]);
            uint8_t *px = img->px + 3 * (y * t->size_px + x);
            px[0] = (uint8_t)(v >> 16);
            px[1] = (uint8_t)(v >> 8 & 255);
            px[2] = (uint8_t)(v & 255);
        }
    mem_free(height);
    mem_free(filled);
    mem_free(in);
    return rc;
}

bool map_tile_is_flat(const struct area *a, const struct map_tile *t)
{
    return t->encoding != ENCODING_UNSAID &&
           !area_is_near(a, t->key, (double)map_tile_margin(t) / t->size_px);
}

enum err_code map_tile_make(struct nadir *n, const struct map_tile *t, struct buf *out,
                            struct err *e)
{
    struct image img = {0};
    enum err_code rc = t->encoding == ENCODING_UNSAID ? map_tile_color(n, t, &img, e)
                                                      : map_tile_terrain(n, t, &img, e);
    if (!rc)
        rc = image_encode(&img, format_ext(t->format), t->quality, out, e);
    image_free(&img);
    return rc;
}
