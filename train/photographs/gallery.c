/* Draws training photographs from the model, and compares them with their drawings.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/photographs/gallery.h"

#include <math.h>

#include "codec/scene/scene.h"
#include "scene/cells/footprint.h"
#include "train/base/stage.h"
#include "train/loss/photometric.h"
#include "train/model/appearance_train.h"
#include "train/model/model.h"
#include "train/photographs/photo_loader.h"

#define GALLERY_SPACING_PX 2.0
#define GALLERY_SIZE_LIMIT 5.0     /* lab/studies/side.md */
#define GALLERY_SPLIT_PX 1.0       /* docs/decisions/011-density-control.md */
#define GALLERY_PERCENT_DENSE 0.01 /* 3DGS */

enum err_code gallery_open(struct gallery *g, const struct schedule *s, struct err *e)
{
    struct photo_loader_config f = {
        .scene = g->scene,
        .images = g->images,
        .n_images = g->n_images,
        .windows = g->windows,
        .max_edge_px = (uint32_t)g->cfg->max_edge_px,
        .downsample = s->downsample,
        .cache_bytes = (size_t)g->cfg->cache_mib << 20,
        .exposure = g->cfg->exposure ? PHOTO_LOADER_TO_MEAN : PHOTO_LOADER_AS_TAKEN,
        .no_masks = !g->cfg->masks,
        .seed = (uint64_t)g->cfg->seed,
        .level = s->level,
    };
    photo_loader_close(&g->photos);
    return photo_loader_open(&f, &g->photos, e);
}

void gallery_close(struct gallery *g)
{
    dev_release(&g->target);
    dev_release(&g->mask);
    photo_loader_close(&g->photos);
}

/* ---- cameras ---- */

struct camera *gallery_cameras_full(const struct gallery *g)
{
    struct camera *cams = mem_array(g->n_images, sizeof *cams);
    for (size_t i = 0; cams && i < g->n_images; i++)
        cams[i] = g->scene->images[g->images[i]].cam;
    return cams;
}

struct camera gallery_camera(const struct gallery *g, size_t nth, const struct schedule *s)
{
    const struct camera *full = &g->scene->images[g->images[nth]].cam;
    struct camera c = photo_loader_camera(full, (uint32_t)g->cfg->max_edge_px, s->downsample);
    return g->windows ? camera_crop(&c, &g->windows[nth]) : c;
}

double gallery_footprint_m(const struct gallery *g, const struct site *site,
                           const struct schedule *s)
{
    const struct footprint *ground = site->ground;
    if (!ground || !ground->nx)
        return 0.0;
    const struct camera *full = &g->scene->images[g->images[0]].cam;
    struct camera cam = photo_loader_camera(full, (uint32_t)g->cfg->max_edge_px, s->downsample);
    return full->fx_px / (ground->px_per_m * cam.fx_px);
}

double gallery_size_limit(const struct gallery *g, const struct site *site,
                          const struct schedule *s)
{
    double footprint_m = gallery_footprint_m(g, site, s);
    if (!(footprint_m > 0.0))
        return 0.0;
    return GALLERY_SIZE_LIMIT *
           fmax(site->cell.edge_m / sqrt((double)s->budget), GALLERY_SPACING_PX * footprint_m);
}

double gallery_split_above(const struct gallery *g, const struct site *site,
                           const struct schedule *s)
{
    double footprint_m = gallery_footprint_m(g, site, s);
    return footprint_m > 0.0 ? GALLERY_SPLIT_PX * footprint_m
                             : GALLERY_PERCENT_DENSE * site->cell.extent_m;
}

/* ---- how frames are drawn ---- */

struct render_options gallery_options(const struct gallery *g, const struct stage *at)
{
    const struct train_config *c = g->cfg;
    float grey = (float)c->background;
    return (struct render_options){
        .aa = (enum render_aa)c->aa,
        .background = {grey, grey, grey},
        .near_m = g->near_m,
        .sh_degree = (int)schedule_sh_degree(stage_schedule(at), at->step),
    };
}

struct render_options gallery_photo_options(const struct gallery *g, const struct stage *at,
                                            uint32_t image)
{
    struct appearance_train *a = g->appearance;
    struct render_options ro = gallery_options(g, at);
    if (appearance_train_is_on(a) &&
        at->step > appearance_train_warmup(a, g->cfg, stage_schedule(at)))
        ro.appearance_frame = appearance_train_frame(a, image);
    ro.appearance_hidden = a->model.hidden;
    return ro;
}

/* ---- comparing a frame with its photograph ---- */

static enum err_code gallery_upload(struct gallery *g, cl_mem *to, size_t *room, const void *from,
                                    size_t bytes, struct err *e)
{
    enum err_code rc = dev_reserve(g->engine.dev, bytes, to, room, e);
    return rc ? rc : dev_write_soon(g->engine.dev, *to, 0, bytes, from, e);
}

enum err_code gallery_hand_over(struct gallery *g, const struct photo *p, struct err *e)
{
    size_t pixels = (size_t)p->cam.width_px * p->cam.height_px;
    enum err_code rc = gallery_upload(g, &g->target, &g->target_bytes, p->px, 3 * pixels, e);
    if (!rc && p->mask)
        rc = gallery_upload(g, &g->mask, &g->mask_bytes, p->mask, pixels, e);
    if (rc)
        dev_abandon(g->engine.dev, NULL);
    return rc;
}

static enum err_code gallery_run(struct gallery *g, const struct photo *p, bool value_only,
                                 bool with_ssim, struct err *e)
{
    const struct photometric_input in = {
        .value_only = value_only,
        .color = render_color_buffer(g->engine.render),
        .target = g->target,
        .mask = p->mask ? g->mask : NULL,
        .width_px = p->cam.width_px,
        .height_px = p->cam.height_px,
        .l1_weight = (float)(1.0 - g->cfg->ssim_weight),
        .ssim_weight = with_ssim ? (float)g->cfg->ssim_weight : 0.0f,
    };
    return photometric_run(g->engine.loss, &in,
                           value_only ? NULL : render_color_grad_buffer(g->engine.render), e);
}

enum err_code gallery_loss(struct gallery *g, const struct photo *p, struct err *e)
{
    return gallery_run(g, p, false, true, e);
}

enum err_code gallery_score(struct gallery *g, const struct photo *p, const struct render_model *m,
                            const struct render_options *ro, bool with_ssim,
                            struct photometric_value *out, struct err *e)
{
    enum err_code rc = gallery_hand_over(g, p, e);
    if (!rc)
        rc = render_forward(g->engine.render, m, &p->cam, ro, NULL, NULL, e);
    if (!rc)
        rc = gallery_run(g, p, true, with_ssim, e);
    return rc ? rc : photometric_read(g->engine.loss, out, e);
}
