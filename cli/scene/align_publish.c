/* COLMAP's models under DIR/sparse: see align_work.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cli/scene/align_work.h"
#include "codec/scene/colmap.h"

/* True names instead of links, and which photographs it has. */
static enum err_code align_name_model(struct align *a, struct colmap_model *m, uint32_t number,
                                      struct err *e)
{
    for (size_t i = 0; i < m->n_images; i++) {
        size_t p = align_plan_find(&a->plan, m->images[i].name);
        if (p == SIZE_MAX)
            return err_set(e, ERR_DATA, "COLMAP's model has '%.60s', which it was not given",
                           m->images[i].name);
        if (!(m->images[i].name = arena_text(&m->arena, a->plan.photos[p].name)))
            return align_no_memory(e);
        if (a->model_of[p] == UINT32_MAX)
            a->model_of[p] = number;
    }
    return ERR_OK;
}

enum { MODELS_MOST = 50 };

struct align_sized {
    size_t n;
    unsigned from;
};

static int align_sized_compare(const void *a, const void *b)
{
    const struct align_sized *p = a, *q = b;
    return p->n != q->n ? (p->n > q->n ? -1 : 1) : (p->from > q->from) - (p->from < q->from);
}

/* COLMAP's models by size; *n of them, at most `most`. */
static enum err_code align_list_models(struct align *a, const char *below, struct align_sized *list,
                                       size_t most, size_t *n, struct err *e)
{
    *n = 0;
    for (unsigned k = 0; *n < most && k < 2 * most; k++) {
        struct colmap_model m = {0};
        char *from = arena_printf(&a->arena, "%s/%s/%u", a->dir, below, k);
        if (!from)
            return align_no_memory(e);
        if (!file_is_dir(from))
            continue;
        enum err_code rc = colmap_read(from, &m, e);
        if (rc)
            return rc;
        list[(*n)++] = (struct align_sized){m.n_images, k};
        colmap_free(&m);
    }
    qsort(list, *n, sizeof *list, align_sized_compare);
    return ERR_OK;
}

enum err_code align_weigh(struct align *a, const char *db, const char *below,
                          struct align_weight *out, struct err *e)
{
    struct align_sized list[MODELS_MOST];
    struct colmap_model m = {0};
    size_t n = 0;
    enum err_code rc = align_list_models(a, below, list, MODELS_MOST, &n, e);
    *out = (struct align_weight){0};
    if (rc || !n)
        return rc;
    char *from = arena_printf(&a->arena, "%s/%s/%u", a->dir, below, list->from);
    rc = from ? colmap_read(from, &m, e) : align_no_memory(e);
    out->n_observations = m.n_tracks;
    for (size_t i = 0; i < m.n_cameras; i++) {
        const double begun = align_db_focal(db, m.cameras[i].id), px = m.cameras[i].lens.params[0];
        if (begun > 0 && (px > 2 * begun || 2 * px < begun))
            out->focal_off = px / begun;
    }
    colmap_free(&m);
    return rc;
}

/* How well the poses of the largest model are known. */
static enum err_code align_judge_model(struct align *a, const struct colmap_model *m, struct err *e)
{
    struct pose_error *known = arena_get(&a->arena, m->n_images, sizeof *known);
    enum err_code rc = known ? pose_error_find(m, known, e) : align_no_memory(e);
    a->n_good = 0;
    for (size_t i = 0; !rc && i < m->n_images; i++) {
        size_t p = align_plan_find(&a->plan, m->images[i].name);
        if (p == SIZE_MAX)
            continue; /* align_name_model refuses it */
        a->pose[p] = known[i];
        a->pose_most_px[p] = pose_error_most_px(&m->cameras[m->images[i].camera].lens);
        a->n_good += known[i].picture_px <= a->pose_most_px[p];
    }
    return rc;
}

bool align_is_good(const struct align *a, size_t i)
{
    return a->model_of[i] == 0 && a->pose[i].picture_px <= a->pose_most_px[i];
}

static enum err_code align_write_model(struct align *a, const char *below,
                                       const struct align_sized *from, size_t to, struct err *e)
{
    struct colmap_model m = {0};
    char *source = arena_printf(&a->arena, "%s/%s/%u", a->dir, below, from->from),
         *folder = arena_printf(&a->arena, "%s/work/named/%zu", a->dir, to);
    enum err_code rc = source && folder ? colmap_read(source, &m, e) : align_no_memory(e);
    if (!rc && to == 0)
        rc = align_judge_model(a, &m, e);
    if (!rc)
        rc = align_name_model(a, &m, (uint32_t)to, e);
    if (!rc)
        rc = file_mkdir(folder, e);
    if (!rc)
        rc = colmap_write_bin(folder, &m, e);
    a->sizes[to] = m.n_images;
    colmap_free(&m);
    return rc;
}

/* All models, the largest first, beside DIR/sparse; then renamed. */
enum err_code align_publish(struct align *a, const char *below, struct err *e)
{
    struct align_sized list[MODELS_MOST];
    char *named = align_path(a, "work/named"), *sparse = align_path(a, "sparse");
    a->sizes = arena_get(&a->arena, MODELS_MOST, sizeof *a->sizes);
    if (!named || !sparse || !a->sizes)
        return align_no_memory(e);
    align_remove(named);
    memset(a->model_of, 0xff, a->plan.n * sizeof *a->model_of);
    enum err_code rc = align_list_models(a, below, list, MODELS_MOST, &a->n_models, e);
    if (!rc && !a->n_models)
        rc = err_set(e, ERR_DATA,
                     "no two photographs gave a model: too little overlap, blur, or nothing to "
                     "recognise; see %s/logs/model.log",
                     a->dir);
    for (size_t k = 0; !rc && k < a->n_models; k++)
        rc = align_write_model(a, below, &list[k], k, e);
    if (rc)
        return rc;
    align_remove(sparse);
    if (rename(named, sparse))
        return err_errno(e, ERR_IO, "%s: cannot rename", named);
    a->placed = a->sizes[0];
    return ERR_OK;
}
