/* Memory of a cell in training: the sum of all buffers that grow with Gaussians or pixels.
 * Parameters and moments have room for their level's budget. A frame's buffers grow in steps, and
 * count with their largest excess. Temporary buffers (densification, scores, pruning, similarity)
 * never exist together, so only the largest counts.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/memory.h"

#include <math.h>

#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/layout.h"
#include "render/render.h"
#include "train/base/config.h"
#include "train/base/schedule.h"
#include "train/loss/embed_smoothness.h"
#include "train/photographs/photo_loader.h"

enum {
    MEMORY_WORD = 4,
    MEMORY_STATS = 4, /* words: grad, absg, count, radius; + opacity with appearance */
    MEMORY_KEYS = 7,  /* words a Gaussian: depth_key, tiles_of, slot_first, keys, ids */
    MEMORY_INTERSECTION = 5 * 4 + 2 /* lists, hits */ + LAYOUT_SLOT_FLOATS * 4 + 1 /* slot, mark */,
    MEMORY_EXTRA = LAYOUT_PLANES_SHAPE, /* words: gradients of the terms on sizes and rotations */
    MEMORY_CHOICE = 44, /* the plan's rows and their Morton order; its lists need less */
    MEMORY_MOVE = 52,   /* sources of rows, halves and their means, spare rows */
    MEMORY_SUMS = LAYOUT_IMPORTANCE_SUMS * 4, /* of a view */
    MEMORY_SCORES = 2 * 4 + 2,                /* mean gradient, score; classes */
    MEMORY_FRAME_PX = 7 * 4,                  /* colour, transmittance, gradient of the colour */
    MEMORY_LOSS_PX = 9 * 4,                   /* derivative maps of SSIM, less margins; GPUs */
    MEMORY_HOST_PX = 3 + 1 + 4,               /* photograph, mask, errors of the score */
    MEMORY_EVALUATE_PX = 12 + 12 * 8,         /* drawing, and planes of doubles of SSIM and GMSD */
    MEMORY_DECODERS = 2,                      /* photo_loader's thread and the training's */
    MEMORY_THIN = 4 + 2 + 1 + 4,              /* price, photographs, side, rows that stay */
    MEMORY_RANKS = 2 * 8 + 1,                 /* of prices, and what goes */
};
#define MEMORY_FRAME_ROOM 1.5    /* of a frame's */
#define MEMORY_INTERSECTIONS 3.0 /* a Gaussian of the cell, in the fullest view */
#define MEMORY_MARGIN_PX 128.0   /* of a row of the loss's maps */
#define MEMORY_OUTSIDE 1.5       /* budget inside, half of it outside */
enum { MEMORY_ARRAYS = 2 /* parameters, and both moments of each in a word */ };

static double memory_photos(const struct train_config *cfg, const struct scene *s,
                            const uint32_t *images, size_t n, double downsample, double *pixels,
                            double *photometric_pixels)
{
    double kept = 0.0, decoding = 0.0;
    for (size_t i = 0; i < n; i++) {
        const struct camera *full = &s->images[images[i]].cam;
        struct camera cam = photo_loader_camera(full, (uint32_t)cfg->max_edge_px, downsample);
        double px = (double)cam.width_px * cam.height_px;
        kept += 4.0 * px;
        *pixels = fmax(*pixels, px);
        *photometric_pixels =
            fmax(*photometric_pixels, (cam.width_px + MEMORY_MARGIN_PX) * cam.height_px);
        /* Whole, as the decoder's own copy, and shrunk in floats by rows at most. */
        decoding = fmax(decoding, 2.0 * 3.0 * full->width_px * full->height_px);
    }
    return fmin(kept, (double)cfg->cache_mib * 1048576.0) + MEMORY_DECODERS * decoding;
}

struct memory_need memory_estimate(const struct train_config *cfg, const struct scene *s,
                                   const uint32_t *images, size_t n_images,
                                   const struct schedule *levels, uint32_t n_levels, bool whole)
{
    bool light = cfg->appearance && cfg->embed_len > 0;
    double row = MEMORY_WORD * (double)layout_planes((uint32_t)cfg->sh_degree,
                                                     light ? (uint32_t)cfg->embed_len : 0);
    double n = 0.0, around = 0.0, pixels = 0.0, photometric_pixels = 0.0, downsample = HUGE_VAL;
    for (uint32_t i = 0; i < n_levels; i++) {
        n = fmax(n, (double)schedule_grows(&levels[i]));
        around = fmax(around, (double)levels[i].around);
        downsample = fmin(downsample, levels[i].downsample);
    }
    n = whole ? n : MEMORY_OUTSIDE * n + around;
    double groups = 0.0; /* of neighbours whose embeddings are compared: ids, places, gradients */
    if (light && cfg->embed_smoothness_weight > 0.0)
        groups = fmin(EMBED_SMOOTHNESS_SAMPLES, n) * EMBED_SMOOTHNESS_NEIGHBOURS * MEMORY_WORD *
                 (2.0 + (double)cfg->embed_len);
    double photos =
        memory_photos(cfg, s, images, n_images, downsample, &pixels, &photometric_pixels);
    bool extra = cfg->scale_weight > 0.0 || cfg->solid_flat > 0.0;
    double words = MEMORY_STATS + 2.0 * light + MEMORY_EXTRA * (double)extra;
    double trained = MEMORY_ARRAYS * row + MEMORY_WORD * words;
    double drawn = MEMORY_FRAME_ROOM * (sizeof(struct layout_splat) + MEMORY_WORD * MEMORY_KEYS +
                                        MEMORY_INTERSECTIONS * MEMORY_INTERSECTION);
    double passing = fmax(fmax(MEMORY_CHOICE, MEMORY_SCORES + MEMORY_SUMS), MEMORY_MOVE);
    passing = fmax(passing, MEMORY_THIN + fmax(MEMORY_SUMS + MEMORY_RANKS, MEMORY_MOVE));
    double per_pixel = MEMORY_FRAME_ROOM * MEMORY_FRAME_PX +
                       (pixels > 0.0 ? MEMORY_LOSS_PX * photometric_pixels / pixels : 0.0) +
                       MEMORY_HOST_PX + MEMORY_EVALUATE_PX +
                       MEMORY_FRAME_ROOM * 2.0 * MEMORY_INTERSECTION; /* large splats: 2 a pixel */
    double per_gaussian = trained + drawn + passing;
    double others = pixels * per_pixel + photos + groups;
    return (struct memory_need){.per_gaussian = (size_t)per_gaussian,
                                .trained = (size_t)trained,
                                .drawn = (size_t)drawn,
                                .passing = (size_t)passing,
                                .per_pixel = (size_t)per_pixel,
                                .photo_bytes = (size_t)photos,
                                .group_bytes = (size_t)groups,
                                .gaussians = (size_t)n,
                                .pixels = (size_t)pixels,
                                .total = (size_t)(n * per_gaussian + others)};
}
