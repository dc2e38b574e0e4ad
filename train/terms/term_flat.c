/* Flat Gaussians (train/loss/flat_loss.h): when and where.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/base.h"
#include "scene/cells/footprint.h"
#include "train/base/fixed.h"
#include "train/base/stage.h"
#include "train/loss/flat_loss.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/terms/term_size.h"
#include "train/terms/terms.h"

#define TERM_FLAT_PX 0.1 /* thickness below which a Gaussian is flat, in footprints of a pixel */

struct term_flat {
    struct flat_loss *loss;
    uint8_t *parts; /* of the ground; NULL without one */
};

static bool term_flat_wanted(const struct gallery *g)
{
    return g->cfg->solid_flat > 0.0;
}

static void term_flat_close(void *own)
{
    struct term_flat *t = own;
    flat_loss_close(&t->loss);
    mem_free(t->parts);
    mem_free(t);
}

/* Gaussians are flat well inside of the ground. At the rim few photographs see a place, and all
 * from one side: flat Gaussians would stand askew there (docs/decisions/015-solid-surfaces.md). */
static enum err_code term_flat_open(const struct gallery *g, const struct site *site, void **own,
                                    struct err *e)
{
    const struct footprint *f = site->ground;
    size_t n = f ? f->nx * f->ny : 0;
    struct term_flat *t = *own = mem_array(1, sizeof *t);
    if (!t || (n && !(t->parts = mem_array(n, sizeof *t->parts))))
        return err_set(e, ERR_MEM, "flat Gaussians: out of memory for %zu cells of ground", n);
    for (size_t i = 0; i < n; i++)
        t->parts[i] = footprint_is_deep(f, i) ? GROUND_PART_FLAT : 0;
    return flat_loss_open(g->engine.dev, &t->loss, e);
}

/* Where the ground is not known nothing is pressed. */
static enum err_code term_flat_run(void *own, const struct term_step *step, struct err *e)
{
    struct term_flat *t = own;
    const struct gallery *g = step->gallery;
    const struct schedule *s = stage_schedule(step->at);
    struct ground_parts ground;
    struct flat_loss_input in = {.flat_m = 1.0, .ground = &ground};
    bool known = term_size_ground(g, step->site, s, t->parts, &ground);
    if (known) {
        in.weight = g->cfg->solid_flat;
        in.flat_m = TERM_FLAT_PX * gallery_footprint_m(g, step->site, s);
    } else if (!step->fresh) {
        return ERR_OK;
    } else {
        in.ground = NULL;
    }
    return flat_loss_run(t->loss, &step->model->seen, &in, step->fresh, step->extra, e);
}

const struct term_pass term_flat_pass = {
    .place = TERM_GAUSSIANS,
    .wanted = term_flat_wanted,
    .open = term_flat_open,
    .close = term_flat_close,
    .acts = term_size_begun,
    .run = term_flat_run,
};
