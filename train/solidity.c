/* When the terms act, and with which weights. The distance between compared pixels changes at every
 * step, so that depth becomes smooth over one pixel and over several.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/solidity.h"

#include <math.h>

#include "cells/footprint.h"
#include "loss/solid.h"
#include "train/gallery.h"
#include "train/photo_loader.h"
#include "train/stage.h"

/* A level alone has its coarse part in its own first steps. */
#define SOLIDITY_SINGLE 0.5

bool solidity_acts(const struct train_config *c, const struct stage *at)
{
    const struct schedule *s = stage_schedule(at);
    double from = s->level == 1 ? c->solid_from * (double)s->steps : 0.0;
    if (s->n_levels == 1)
        from *= SOLIDITY_SINGLE;
    return (c->solid_spread > 0.0 || c->solid_bend > 0.0 || c->solid_light > 0.0) &&
           (double)at->step > from;
}

double solidity_unit_m(const struct site *site)
{
    const struct footprint *ground = site->ground;
    return ground && ground->height_m > 0.0 ? ground->height_m : site->cell.edge_m;
}

enum err_code solidity_step(struct solid **own, const struct gallery *g, const struct stage *at,
                            const struct photo *photo, const uint8_t *supported, struct err *e)
{
    static const uint32_t strides[] = {1, 2, 4};
    const struct train_config *c = g->cfg;
    double t = (double)at->step / (double)stage_schedule(at)->steps, fade = pow(c->solid_final, t);
    const struct solid_input in = {
        .width_px = photo->cam.width_px,
        .height_px = photo->cam.height_px,
        .focal_px = photo->cam.fx_px,
        .spread = c->solid_spread * fade,
        .bend = c->solid_bend * fade,
        .light = c->solid_light,
        .stride = strides[at->step % (sizeof strides / sizeof *strides)],
        .supported = supported,
    };
    enum err_code rc = *own ? ERR_OK : solid_open(g->engine.dev, own, e);
    return rc ? rc : solid_run(*own, g->engine.render, &in, e);
}
