/* Cross-fade between levels: see fade.h.
 *
 * A new tile fades in if an ancestor or a descendant of it was drawn before. An old tile fades out
 * if an ancestor or descendant replaces it. Other tiles came into view or left it, and change at
 * once.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/fade.h"

#include <math.h>
#include <string.h>

#include "core/base.h"
#include "lod/store/tree.h"

double fade_share(double t)
{
    return fmax(0.0, fmin(1.0, t));
}

enum err_code fade_open(const struct tree *t, size_t frames, struct fade *out, struct err *e)
{
    *out = (struct fade){.tree = t, .frames = frames};
    out->above = mem_array(3 * t->n_nodes + 1, sizeof *out->above);
    if (!out->above)
        return err_set(e, ERR_MEM, "fade: out of memory for %zu tiles", t->n_nodes);
    out->from = out->above + t->n_nodes;
    out->to = out->from + t->n_nodes;
    return ERR_OK;
}

void fade_close(struct fade *f)
{
    mem_free(f->above);
    *f = (struct fade){0};
}

/* Notes in f->above what lies above the tiles of a set. */
static void fade_look_up(struct fade *f, const bool *set)
{
    const struct tree_place *node = f->tree->places;
    memset(f->above, 0, f->tree->n_nodes);
    for (size_t i = 0; i < f->tree->n_nodes; i++)
        if (set[i])
            for (uint32_t p = node[i].parent; p != TREE_NONE; p = node[p].parent)
                f->above[p] = true;
}

/* After fade_look_up of that set: whether something of it stands where tile i does. */
static bool fade_meets(const struct fade *f, const bool *set, size_t i)
{
    bool met = set[i] || f->above[i];
    const struct tree_place *node = f->tree->places;
    for (uint32_t p = node[i].parent; !met && p != TREE_NONE; p = node[p].parent)
        met = set[p];
    return met;
}

static void fade_begin(struct fade *f, const uint32_t *wanted, size_t n)
{
    bool *was = f->from, changes = false;
    f->from = f->to;
    f->to = was;
    memset(f->to, 0, f->tree->n_nodes);
    for (size_t i = 0; i < n; i++)
        f->to[wanted[i]] = true;
    fade_look_up(f, f->to);
    for (size_t i = 0; i < f->tree->n_nodes; i++)
        if (f->from[i] && !f->to[i]) {
            f->from[i] = fade_meets(f, f->to, i);
            changes |= f->from[i];
        }
    fade_look_up(f, f->from);
    for (size_t i = 0; i < n; i++) /* nothing stands there: at once */
        if (!f->from[wanted[i]])
            f->from[wanted[i]] = !fade_meets(f, f->from, wanted[i]);
    f->frame = changes && f->frames > 1 ? 1 : 0;
}

/* A fade is under way: of what is wanted now, that which nothing stands for. */
static void fade_join(struct fade *f, const uint32_t *wanted, size_t n)
{
    fade_look_up(f, f->to);
    for (size_t i = 0; i < n; i++)
        if (!fade_meets(f, f->to, wanted[i]))
            f->to[wanted[i]] = f->from[wanted[i]] = true;
}

size_t fade_next(struct fade *f, const uint32_t *wanted, size_t n, uint32_t *tile, float *weight)
{
    size_t n_out = 0;
    if (f->frame > 0 && ++f->frame == f->frames)
        f->frame = 0;
    if (f->frame > 0)
        fade_join(f, wanted, n);
    else
        fade_begin(f, wanted, n);
    double share = fade_share(f->frame > 0 ? (double)f->frame / (double)f->frames : 1.0);
    for (size_t i = 0; i < f->tree->n_nodes; i++) {
        double w = (f->to[i] ? share : 0.0) + (f->from[i] ? 1.0 - share : 0.0);
        if (w > 0.0) {
            tile[n_out] = (uint32_t)i;
            weight[n_out++] = (float)w;
        }
    }
    return n_out;
}
