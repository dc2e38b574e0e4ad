/* The loss on appearance embeddings of neighbours (train/loss/embed_smoothness.h): when it acts.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/base.h"
#include "train/base/fixed.h"
#include "train/base/stage.h"
#include "train/base/timing.h"
#include "train/loss/embed_smoothness.h"
#include "train/model/appearance_train.h"
#include "train/model/model.h"
#include "train/photographs/gallery.h"
#include "train/terms/terms.h"

/* Steps between two comparisons; they take 2 to 4 % of training. REUrbanGS. */
enum { TERM_SMOOTHNESS_EVERY = 50 };

static bool term_smoothness_wanted(const struct gallery *g)
{
    return g->cfg->embed_smoothness_weight > 0.0 && appearance_train_is_on(g->appearance);
}

/* From the first frame with appearance on; before, embeddings do not step. */
static bool term_smoothness_acts(const struct gallery *g, const struct stage *at)
{
    return at->step > appearance_train_warmup(g->appearance, g->cfg, stage_schedule(at)) &&
           at->step % TERM_SMOOTHNESS_EVERY == 0;
}

static void term_smoothness_close(void *own)
{
    struct embed_smoothness_step *t = own;
    embed_smoothness_step_close(&t);
}

static enum err_code term_smoothness_open(const struct gallery *g, const struct site *site,
                                          void **own, struct err *e)
{
    struct embed_smoothness_step *t = NULL;
    (void)site;
    enum err_code rc = embed_smoothness_step_open(g->engine.dev, &t, e);
    *own = t;
    return rc;
}

/* Steps the embeddings at once. The device finishes first: this part shall not pay for the step
 * before it. */
static enum err_code term_smoothness_run(void *own, const struct term_step *step, struct err *e)
{
    const struct train_config *c = step->gallery->cfg;
    struct model *m = step->model;
    double edge_m = step->site->cell.edge_m, loss;
    struct embed_smoothness_input pairs = {
        .samples = EMBED_SMOOTHNESS_SAMPLES,
        .neighbours = EMBED_SMOOTHNESS_NEIGHBOURS,
        .falloff = c->embed_smoothness_falloff / (edge_m * edge_m),
        .weight = c->embed_smoothness_weight,
        .seed = (uint64_t)c->seed,
        .stream = train_stream(TRAIN_STREAM_SIMILARITY, step->at->at + 1, step->at->step),
    };
    enum err_code rc = dev_finish(m->dev, e);
    enum timing_on was = timing_turn(step->timing, TIMING_EMBED_SMOOTHNESS);
    if (!rc)
        rc = embed_smoothness_step_run(own, &m->gauss, &m->adam, &pairs, &loss, e);
    (void)timing_turn(step->timing, was);
    return rc;
}

const struct term_pass term_smoothness_pass = {
    .place = TERM_EMBEDDINGS,
    .wanted = term_smoothness_wanted,
    .open = term_smoothness_open,
    .close = term_smoothness_close,
    .acts = term_smoothness_acts,
    .run = term_smoothness_run,
};
