/* When the terms act, and with which weights. The distance between compared pixels changes at every
 * step, so that depth becomes smooth over one pixel and over several.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/solidity.h"

#include <math.h>
#include <string.h>

#include "cells/footprint.h"
#include "codec/scene.h"
#include "core/base.h"
#include "loss/depth_map.h"
#include "loss/solid.h"
#include "train/depth_prior.h"
#include "train/gallery.h"
#include "train/photo_loader.h"
#include "train/stage.h"

/* A finest level that begins alone has its coarse part in its own first steps. */
#define SOLIDITY_SINGLE 0.5

struct solidity {
    struct solid *solid;
    struct depth_map *maps;  /* NULL: no depth is known */
    char dir[FILE_PATH_MAX]; /* of the maps */
    struct solid_input in;   /* of the step */
};

void solidity_free(struct solidity **p)
{
    struct solidity *s = *p;
    if (!s)
        return;
    solid_close(&s->solid);
    depth_map_close(&s->maps);
    mem_free(s);
    *p = NULL;
}

/* Whether the terms that need no prior act. */
static bool solidity_has_begun(const struct train_config *c, const struct stage *at)
{
    const struct schedule *s = stage_schedule(at);
    double from = s->turn == 1 && !s->last ? c->solid_from * (double)s->steps : 0.0;
    if (s->level == s->n_levels)
        from *= SOLIDITY_SINGLE;
    return (double)at->step > from;
}

bool solidity_acts(const struct train_config *c, const struct stage *at)
{
    bool own = c->solid_spread > 0.0 || c->solid_bend > 0.0 || c->solid_light > 0.0;
    bool known = c->solid_prior > 0.0 && c->depth_prior && strcmp(c->depth_prior, "none");
    return (own || known) && solidity_has_begun(c, at);
}

double solidity_unit_m(const struct site *site)
{
    const struct footprint *ground = site->ground;
    return ground && ground->height_m > 0.0 ? ground->height_m : site->cell.edge_m;
}

static enum err_code solidity_open(struct solidity **own, const struct gallery *g, struct err *e)
{
    const struct train_config *c = g->cfg;
    if (*own)
        return ERR_OK;
    *own = mem_array(1, sizeof **own);
    if (!*own)
        return err_set(e, ERR_MEM, "solid surfaces: out of memory");
    enum err_code rc = solid_open(g->engine.dev, &(*own)->solid, e);
    if (!rc && c->solid_prior > 0.0)
        rc = depth_prior_dir(c, g->scene, (*own)->dir, e);
    if (rc || !(*own)->dir[0])
        return rc;
    const struct depth_map_config maps = {
        .scene = g->scene,
        .images = g->images,
        .n_images = g->n_images,
        .dir = (*own)->dir,
        .metric = true,
    };
    return rc ? rc : depth_map_open(&maps, &(*own)->maps, e);
}

enum err_code solidity_hand_over(struct solidity **own, const struct site *site,
                                 const struct gallery *g, const struct stage *at,
                                 const struct photo *photo, const uint8_t *supported, struct err *e)
{
    static const uint32_t strides[] = {1, 2, 4};
    const struct train_config *c = g->cfg;
    double fade = pow(c->solid_final, schedule_done(stage_schedule(at), at->step));
    double begun = solidity_has_begun(c, at) ? 1.0 : 0.0;
    struct depth_target known = {0};
    enum err_code rc = solidity_open(own, g, e);
    if (!rc && (*own)->maps)
        rc = depth_map_target((*own)->maps, photo->image, &photo->cam, photo->mask, &known, e);
    if (rc)
        return rc;
    (*own)->in = (struct solid_input){
        .width_px = photo->cam.width_px,
        .height_px = photo->cam.height_px,
        .focal_px = photo->cam.fx_px,
        .spread = c->solid_spread * fade * begun,
        .prior = c->solid_prior * fade * begun,
        .bend = c->solid_bend * fade * begun,
        .light = c->solid_light * begun,
        .light_known = c->solid_light_known * begun,
        .unknown = c->solid_unknown,
        .stride = strides[at->step % (sizeof strides / sizeof *strides)],
        .supported = supported,
        .known = known.t,
        .known_zeta = known.unit_m / solidity_unit_m(site),
    };
    return solid_hand_over((*own)->solid, &(*own)->in, e);
}

enum err_code solidity_step(struct solidity *s, const struct gallery *g, struct err *e)
{
    return solid_run(s->solid, g->engine.render, &s->in, e);
}
