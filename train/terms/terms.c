/* Runs the passes of terms.def in their order, and owns the buffer in which gradients of Gaussians
 * are summed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/terms/terms.h"

#include <assert.h>

#include "core/base.h"
#include "core/layout.h"
#include "scene/cells/footprint.h"
#include "train/base/fixed.h"
#include "train/model/model.h"

static const struct term_pass *const terms_all[] = {
#define PASS(name, place) &term_##name##_pass,
#include "train/terms/terms.def"
};
static const struct terms_list terms_def = {terms_all, sizeof terms_all / sizeof *terms_all};

struct terms {
    struct terms_list list;
    void *own[TERMS_MAX]; /* by pass */
    cl_mem extra;         /* see struct term_step */
    size_t extra_bytes;
};

void terms_free(struct terms **p)
{
    struct terms *t = *p;
    if (!t)
        return;
    for (size_t i = 0; i < t->list.n; i++)
        if (t->own[i])
            t->list.pass[i]->close(t->own[i]);
    dev_release(&t->extra);
    mem_free(t);
    *p = NULL;
}

enum err_code terms_open_list(struct terms **own, const struct terms_list *list,
                              const struct gallery *g, const struct site *site, struct err *e)
{
    if (*own)
        return ERR_OK;
    assert(list->n <= TERMS_MAX);
    struct terms *t = *own = mem_array(1, sizeof *t);
    if (!t)
        return err_set(e, ERR_MEM, "terms of the loss: out of memory");
    t->list = *list;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < list->n; i++)
        if (list->pass[i]->open && list->pass[i]->wanted(g))
            rc = list->pass[i]->open(g, site, &t->own[i], e);
    if (rc)
        terms_free(own);
    return rc;
}

enum err_code terms_open(struct terms **own, const struct gallery *g, const struct site *site,
                         struct err *e)
{
    return terms_open_list(own, &terms_def, g, site, e);
}

static bool terms_pass_acts(const struct term_pass *p, const struct gallery *g,
                            const struct stage *at)
{
    return p->wanted(g) && p->acts(g, at);
}

bool terms_act(const struct gallery *g, const struct stage *at, enum term_place place)
{
    for (size_t i = 0; i < terms_def.n; i++)
        if (terms_def.pass[i]->place == place && terms_pass_acts(terms_def.pass[i], g, at))
            return true;
    return false;
}

double terms_depth_unit_m(const struct site *site)
{
    const struct footprint *ground = site->ground;
    return ground && ground->height_m > 0.0 ? ground->height_m : site->cell.edge_m;
}

enum err_code terms_hand_over(struct terms *t, const struct term_step *s, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < t->list.n; i++) {
        const struct term_pass *p = t->list.pass[i];
        if (p->hand_over && terms_pass_acts(p, s->gallery, s->at))
            rc = p->hand_over(t->own[i], s, e);
    }
    return rc;
}

/* Those that act in places [from, to]. */
static enum err_code terms_run(struct terms *t, enum term_place from, enum term_place to,
                               struct term_step s, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < t->list.n; i++) {
        const struct term_pass *p = t->list.pass[i];
        if (p->place < from || p->place > to || !terms_pass_acts(p, s.gallery, s.at))
            continue;
        rc = p->run(t->own[i], &s, e);
        s.fresh = s.fresh && p->place != TERM_GAUSSIANS;
    }
    return rc;
}

/* The buffer of the Gaussians' gradients, if a pass writes to it. */
static enum err_code terms_reserve(struct terms *t, const struct term_step *s, struct err *e)
{
    struct model *m = s->model;
    bool any = false;
    for (size_t i = 0; i < t->list.n; i++)
        any |= t->list.pass[i]->place == TERM_GAUSSIANS &&
               terms_pass_acts(t->list.pass[i], s->gallery, s->at);
    m->adam.extra_grad = NULL;
    if (!any)
        return ERR_OK;
    size_t bytes = layout_floats(m->gauss.cap, LAYOUT_PLANES_SCALE) * sizeof(float);
    enum err_code rc = dev_reserve(m->dev, bytes, &t->extra, &t->extra_bytes, e);
    if (rc)
        return err_add(e, "terms of the loss of %u Gaussians", m->gauss.n);
    m->adam.extra_grad = t->extra;
    return ERR_OK;
}

enum err_code terms_before(struct terms *t, const struct term_step *s, struct err *e)
{
    struct term_step with = *s;
    enum err_code rc = terms_reserve(t, s, e);
    with.extra = s->model->adam.extra_grad;
    with.fresh = true;
    return rc ? rc : terms_run(t, TERM_EMBEDDINGS, TERM_GAUSSIANS, with, e);
}

enum err_code terms_after(struct terms *t, const struct term_step *s, struct err *e)
{
    return terms_run(t, TERM_PIXELS, TERM_RAYS, *s, e);
}

enum err_code terms_backward(struct terms *t, const struct term_step *s, struct err *e)
{
    return terms_run(t, TERM_BACKWARD, TERM_BACKWARD, *s, e);
}
