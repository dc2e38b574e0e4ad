/* The loss on colours, L1 and SSIM (train/loss/photometric.h): the frame of the step against its
 * photograph.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/photographs/gallery.h"
#include "train/terms/terms.h"

static bool term_colour_wanted(const struct gallery *g)
{
    (void)g;
    return true;
}

static bool term_colour_acts(const struct gallery *g, const struct stage *at)
{
    (void)g;
    (void)at;
    return true;
}

static enum err_code term_colour_run(void *own, const struct term_step *step, struct err *e)
{
    (void)own;
    return gallery_loss(step->gallery, step->photo, e);
}

const struct term_pass term_colour_pass = {
    .place = TERM_PIXELS,
    .wanted = term_colour_wanted,
    .acts = term_colour_acts,
    .run = term_colour_run,
};
