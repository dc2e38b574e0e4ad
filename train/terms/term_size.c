/* The loss on sizes (train/loss/scale_loss.h): when it acts, and which sizes have no loss.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/terms/term_size.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "scene/cells/footprint.h"
#include "train/base/fixed.h"
#include "train/base/stage.h"
#include "train/loss/scale_loss.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/terms/terms.h"

#define TERM_SIZE_OF_CELL 0.1 /* largest size where none is configured, in cell edges */
#define TERM_SIZE_RATIO 10.0  /* longest to middle axis; REUrbanGS */
/* A limit below the size at which Gaussians are split would keep them from being split. */
#define TERM_SIZE_SPLIT_ROOM 1.5

struct term_size {
    struct scale_loss *loss;
    uint8_t *parts; /* of the ground; NULL without one */
};

/* Not while the first Gaussians still close the gaps between points; later levels go on with it. */
bool term_size_begun(const struct gallery *g, const struct stage *at)
{
    const struct schedule *s = stage_schedule(at);
    return (double)at->step > (s->turn == 1 ? (double)g->cfg->scale_from * s->kappa : 0.0);
}

bool term_size_ground(const struct gallery *g, const struct site *site, const struct schedule *s,
                      const uint8_t *parts, struct ground_parts *out)
{
    const struct footprint *f = site->ground;
    if (!(gallery_footprint_m(g, site, s) > 0.0))
        return false;
    *out = (struct ground_parts){.parts = parts, .nx = f->nx, .ny = f->ny, .cell_m = f->cell_m};
    memcpy(out->corner_m, f->corner_m, sizeof out->corner_m);
    return true;
}

static bool term_size_wanted(const struct gallery *g)
{
    return g->cfg->scale_weight > 0.0;
}

static void term_size_close(void *own)
{
    struct term_size *t = own;
    scale_loss_close(&t->loss);
    mem_free(t->parts);
    mem_free(t);
}

static enum err_code term_size_open(const struct gallery *g, const struct site *site, void **own,
                                    struct err *e)
{
    const struct footprint *f = site->ground;
    size_t n = f ? f->nx * f->ny : 0;
    struct term_size *t = *own = mem_array(1, sizeof *t);
    if (!t || (n && !(t->parts = mem_array(n, sizeof *t->parts))))
        return err_set(e, ERR_MEM, "sizes: out of memory for %zu cells of ground", n);
    for (size_t i = 0; i < n; i++)
        t->parts[i] = f->inside[i] ? GROUND_PART_LIMITED : 0;
    return scale_loss_open(g->engine.dev, &t->loss, e);
}

static enum err_code term_size_run(void *own, const struct term_step *step, struct err *e)
{
    struct term_size *t = own;
    const struct gallery *g = step->gallery;
    const struct schedule *s = stage_schedule(step->at);
    double limit_m = gallery_size_limit(g, step->site, s);
    double size_m = g->cfg->scale_max_m > 0.0 ? g->cfg->scale_max_m
                                              : TERM_SIZE_OF_CELL * step->site->cell.edge_m;
    struct ground_parts ground;
    struct scale_loss_input in = {
        .s_max_m = fmax(size_m, TERM_SIZE_SPLIT_ROOM * gallery_split_above(g, step->site, s)),
        .r_max = TERM_SIZE_RATIO,
        .weight = g->cfg->scale_weight,
        .s_near_m = limit_m > 0.0 ? limit_m : (double)INFINITY,
    };
    if (term_size_ground(g, step->site, s, t->parts, &ground))
        in.ground = &ground;
    return scale_loss_run(t->loss, &step->model->seen, &in, step->fresh, step->extra, e);
}

const struct term_pass term_size_pass = {
    .place = TERM_GAUSSIANS,
    .wanted = term_size_wanted,
    .open = term_size_open,
    .close = term_size_close,
    .acts = term_size_begun,
    .run = term_size_run,
};
