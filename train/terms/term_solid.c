/* The terms that make surfaces solid (train/loss/solid.h): when they act, and with which weights.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/base.h"
#include "train/base/stage.h"
#include "train/loss/depth_map.h"
#include "train/loss/solid.h"
#include "train/photographs/depth_prior.h"
#include "train/photographs/gallery.h"
#include "train/photographs/photo_loader.h"
#include "train/terms/terms.h"

/* They begin with the second level, or in the middle of a finest level that begins alone: before,
 * narrow courts would be bridged before they are seen (docs/decisions/015-solid-surfaces.md). */
#define TERM_SOLID_FROM 1.0
#define TERM_SOLID_SINGLE 0.5
/* Part of the weight of balance and spread at the end of a level; below 1 so that photographs
 * count more there (docs/decisions/015-solid-surfaces.md). */
#define TERM_SOLID_FINAL 0.3
/* Spread in a photograph without known depths, of its weight about known ones. */
#define TERM_SOLID_UNKNOWN 0.5
/* Light where depth is known, of its weight elsewhere: the surface cannot sink there. */
#define TERM_SOLID_LIGHT_KNOWN 2.0

struct term_solid {
    struct solid *solid;
    struct depth_map *maps;  /* NULL: no depth is known */
    char dir[FILE_PATH_MAX]; /* of the maps */
    struct solid_input in;   /* of the step */
};

static bool term_solid_wanted(const struct gallery *g)
{
    return g->cfg->solid_spread > 0.0 || g->cfg->solid_light > 0.0;
}

static bool term_solid_acts(const struct gallery *g, const struct stage *at)
{
    const struct schedule *s = stage_schedule(at);
    double from = s->turn == 1 && !s->last ? TERM_SOLID_FROM * (double)s->steps : 0.0;
    (void)g;
    if (s->level == s->n_levels)
        from *= TERM_SOLID_SINGLE;
    return (double)at->step > from;
}

static void term_solid_close(void *own)
{
    struct term_solid *t = own;
    solid_close(&t->solid);
    depth_map_close(&t->maps);
    mem_free(t);
}

static enum err_code term_solid_open(const struct gallery *g, const struct site *site, void **own,
                                     struct err *e)
{
    struct term_solid *t = *own = mem_array(1, sizeof *t);
    (void)site;
    if (!t)
        return err_set(e, ERR_MEM, "solid surfaces: out of memory");
    enum err_code rc = solid_open(g->engine.dev, &t->solid, e);
    if (!rc)
        rc = depth_prior_dir(g->cfg, g->scene, t->dir, e);
    if (rc || !t->dir[0])
        return rc;
    const struct depth_map_config maps = {
        .scene = g->scene, .images = g->images, .n_images = g->n_images, .dir = t->dir};
    return depth_map_open(&maps, &t->maps, e);
}

static enum err_code term_solid_hand_over(void *own, const struct term_step *step, struct err *e)
{
    struct term_solid *t = own;
    const struct train_config *c = step->gallery->cfg;
    const struct photo *photo = step->photo;
    double fade = pow(TERM_SOLID_FINAL, schedule_done(stage_schedule(step->at), step->at->step));
    struct depth_target known = {0};
    enum err_code rc = ERR_OK;
    if (t->maps)
        rc = depth_map_target(t->maps, photo->image, &photo->cam, photo->mask, &known, e);
    if (rc)
        return rc;
    step->frame->known = known.t;
    step->frame->known_zeta = known.unit_m / terms_depth_unit_m(step->site);
    t->in = (struct solid_input){
        .width_px = photo->cam.width_px,
        .height_px = photo->cam.height_px,
        .focal_px = photo->cam.fx_px,
        .spread = c->solid_spread * fade * (known.t ? 1.0 : TERM_SOLID_UNKNOWN),
        .light = c->solid_light,
        .light_known = TERM_SOLID_LIGHT_KNOWN * c->solid_light,
        .supported = step->supported,
        .known = known.t,
    };
    return solid_hand_over(t->solid, &t->in, e);
}

static enum err_code term_solid_run(void *own, const struct term_step *step, struct err *e)
{
    struct term_solid *t = own;
    return solid_run(t->solid, step->gallery->engine.render, &t->in, e);
}

const struct term_pass term_solid_pass = {
    .place = TERM_RAYS,
    .wanted = term_solid_wanted,
    .open = term_solid_open,
    .close = term_solid_close,
    .acts = term_solid_acts,
    .hand_over = term_solid_hand_over,
    .run = term_solid_run,
};
