/* The loss on the offset of opacity that appearance makes (render/render.h): a weight that the
 * backward pass of a frame with appearance takes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/model/appearance_train.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/terms/terms.h"

static bool term_offset_wanted(const struct gallery *g)
{
    return appearance_train_is_on(g->appearance);
}

static bool term_offset_acts(const struct gallery *g, const struct stage *at)
{
    (void)g;
    (void)at;
    return true;
}

/* Before the warm-up is over, frames have no appearance. */
static enum err_code term_offset_run(void *own, const struct term_step *step, struct err *e)
{
    struct render_appearance_grad *grad = step->model->adam.appearance;
    (void)own;
    (void)e;
    if (grad)
        grad->offset_weight = (float)step->gallery->cfg->opacity_offset_weight;
    return ERR_OK;
}

const struct term_pass term_offset_pass = {
    .place = TERM_BACKWARD,
    .wanted = term_offset_wanted,
    .acts = term_offset_acts,
    .run = term_offset_run,
};
