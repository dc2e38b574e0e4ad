/* The background colour of a training step: see background.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/photographs/background.h"

#include <string.h>

#include "core/base.h"
#include "render/render.h"
#include "scene/cells/footprint.h"
#include "train/base/config.h"
#include "train/base/stage.h"
#include "train/photographs/photo_loader.h"

enum background_random {
    BACKGROUND_RANDOM_NONE,
    BACKGROUND_RANDOM_DARK,
    BACKGROUND_RANDOM_SUPPORTED,
    BACKGROUND_RANDOM_ALL
}; /* option background_random */

enum {
    BACKGROUND_DARK = 40,   /* of 255: all channels of a dark pixel are below */
    BACKGROUND_BLOCK_PX = 8 /* pixels are asked in squares of so many a side */
};

static bool background_is_supported(const struct footprint *f, const double from_m[3],
                                    const double ray[3])
{
    ptrdiff_t cell = footprint_meets(f, from_m, ray);
    return cell >= 0 && footprint_is_deep(f, (size_t)cell);
}

static void background_mark(const struct footprint *f, const struct camera *c, uint8_t *where)
{
    double from_m[3], ray[3];
    size_t w = c->width_px, h = c->height_px, block = BACKGROUND_BLOCK_PX;
    camera_center(c, from_m);
    for (size_t y = 0; y < h; y += block)
        for (size_t x = 0; x < w; x += block) {
            size_t right = x + block < w ? x + block : w, below = y + block < h ? y + block : h;
            footprint_ray(c, (double)(x + right - 1) / 2.0, (double)(y + below - 1) / 2.0, ray);
            bool supported = background_is_supported(f, from_m, ray);
            for (size_t row = y; row < below; row++)
                memset(where + row * w + x, supported, right - x);
        }
}

static void background_keep_dark(const uint8_t *px, size_t n, const uint8_t *supported,
                                 uint8_t *where)
{
    for (size_t i = 0; i < n; i++, px += 3)
        where[i] = supported[i] && px[0] < BACKGROUND_DARK && px[1] < BACKGROUND_DARK &&
                   px[2] < BACKGROUND_DARK;
}

enum err_code background_support(struct background *b, const struct footprint *ground,
                                 const struct photo *p, const uint8_t **out, struct err *e)
{
    size_t n = (size_t)p->cam.width_px * p->cam.height_px;
    *out = NULL;
    if (!ground || !ground->nx)
        return ERR_OK;
    if (n > b->cap) {
        background_free(b);
        b->where = mem_array(n, 1);
        b->supported = mem_array(n, 1);
        if (!b->where || !b->supported) {
            background_free(b);
            return err_set(e, ERR_MEM, "background: out of memory for %zu pixels", n);
        }
        b->cap = n;
    }
    background_mark(ground, &p->cam, b->supported);
    *out = b->supported;
    return ERR_OK;
}

void background_choose(struct background *b, const struct train_config *cfg,
                       const uint8_t *supported, const struct stage *at, const struct photo *p,
                       struct render_options *ro)
{
    size_t n = (size_t)p->cam.width_px * p->cam.height_px;
    uint64_t stream = train_stream(TRAIN_STREAM_BACKGROUND, at->at + 1, at->step);
    float *color = ro->background;
    if (cfg->background_random == BACKGROUND_RANDOM_NONE)
        return;
    if (cfg->background_random != BACKGROUND_RANDOM_ALL) {
        if (!supported)
            return;
        ro->background_where = supported;
        if (cfg->background_random == BACKGROUND_RANDOM_DARK) {
            background_keep_dark(p->px, n, supported, b->where);
            ro->background_where = b->where;
        }
        color = ro->background_there;
    }
    for (uint64_t c = 0; c < 3; c++)
        color[c] = (float)rng_unit((uint64_t)cfg->seed, stream, c);
}

void background_free(struct background *b)
{
    mem_free(b->where);
    mem_free(b->supported);
    *b = (struct background){0};
}
