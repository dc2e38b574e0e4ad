/* Selects the work in a scene and its plan: the cells, and the training and test photographs of
 * each.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/train_scene.h"

#include <string.h>

#include "scene/cells/cell.h"
#include "scene/cells/cell_plan.h"
#include "train/base/config.h"

enum err_code train_scene_images(struct scene *s, enum scene_split split, bool test_split,
                                 uint32_t **out, size_t *n, struct err *e)
{
    *n = 0;
    *out = arena_get(&s->arena, s->n_images ? s->n_images : 1, sizeof **out);
    if (!*out)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu photographs", s->dir, s->n_images);
    for (size_t i = 0; i < s->n_images; i++)
        if (split == SCENE_TRAIN ? !test_split || s->images[i].split == SCENE_TRAIN
                                 : test_split && s->images[i].split == SCENE_TEST)
            (*out)[(*n)++] = (uint32_t)i;
    return ERR_OK;
}

enum err_code train_scene_open(const char *dir, const char *plan, const struct train_config *cfg,
                               struct train_scene *out, struct err *e)
{
    char path[FILE_PATH_MAX];
    *out = (struct train_scene){.cfg = cfg, .dir = dir};
    enum err_code rc = scene_read(dir, &out->scene, e);
    if (!rc)
        rc = file_join(path, dir, "plan.json", e);
    if (!rc && (plan || file_exists(path)))
        rc = cell_plan_read(plan ? plan : path, &out->scene, &out->plan, e);
    else if (!rc && cfg->cell)
        rc = err_set(e, ERR_NOENT, "%s: --cell needs a plan; `citysplat plan %s` makes it", path,
                     dir);
    if (rc)
        return rc;
    size_t n = out->plan.n_cells ? out->plan.n_cells : 1;
    out->cells = mem_array(n, sizeof *out->cells);
    if (!out->cells)
        return err_set(e, ERR_MEM, "train: out of memory for %zu cells", n);
    for (size_t i = 0; i < n; i++) {
        const struct partition_cell *c = out->plan.n_cells ? &out->plan.cells[i] : NULL;
        out->n_planned += c && c->parent < 0;
        if (!c || (c->parent < 0 && (!cfg->cell || !strcmp(cfg->cell, c->id))))
            out->cells[out->n_cells++] = i;
    }
    if (out->n_cells)
        return ERR_OK;
    return cfg->cell ? err_set(e, ERR_ARG, "--cell: %s/plan.json has no trained cell '%s'", dir,
                               cfg->cell)
                     : err_set(e, ERR_DATA,
                               "%s/plan.json: no cell has photographs enough to be trained", dir);
}

void train_scene_close(struct train_scene *s)
{
    mem_free(s->cells);
    partition_free(&s->plan);
    scene_free(&s->scene);
}

/* The photographs of a planned cell that train, those by location first; and the test photographs
 * taken from inside it. */
static enum err_code train_scene_planned(struct train_scene *s, size_t index, struct run_cell *job,
                                         struct err *e)
{
    const struct partition_cell *c = &s->plan.cells[index];
    size_t n_location = 0, n = 0, n_test = 0;
    uint32_t *images = arena_get(&s->scene.arena, c->n_images + 1, sizeof *images);
    if (!images)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu photographs", s->dir, c->n_images);
    for (size_t i = 0; i < c->n_images; i++) {
        if (s->cfg->test_split && s->scene.images[c->images[i]].split == SCENE_TEST)
            continue;
        images[n++] = c->images[i];
        n_location += i < c->n_location;
    }
    job->images = images;
    job->n_images = n;
    cell_planned(&s->scene, &s->plan, index, images, n_location ? n_location : n, &job->cell);
    for (size_t i = 0; i < job->n_test; i++) {
        double at[3];
        camera_center(&s->scene.images[job->test_images[i]].cam, at);
        if (cell_distance(&job->cell, at[0], at[1]) <= 0.0)
            job->test_images[n_test++] = job->test_images[i];
    }
    job->n_test = n_test;
    return ERR_OK;
}

/* ERR_DATA: nothing is left to train on. */
static enum err_code train_scene_any(const struct train_scene *s, const struct run_cell *job,
                                     struct err *e)
{
    size_t n_test = 0;
    for (size_t i = 0; s->cfg->test_split && i < s->scene.n_images; i++)
        n_test += s->scene.images[i].split == SCENE_TEST;
    if (job->n_images)
        return ERR_OK;
    return n_test ? err_set(e, ERR_DATA,
                            "%s: no photographs to train on: %zu of %zu are kept for scores; "
                            "--no-test-split trains with all",
                            s->dir, n_test, s->scene.n_images)
                  : err_set(e, ERR_DATA, "%s: no photographs to train on", s->dir);
}

enum err_code train_scene_whole(struct train_scene *s, struct run_cell *job, struct err *e)
{
    uint32_t *images;
    enum err_code rc = train_scene_images(&s->scene, SCENE_TEST, s->cfg->test_split,
                                          &job->test_images, &job->n_test, e);
    if (!rc)
        rc = train_scene_images(&s->scene, SCENE_TRAIN, s->cfg->test_split, &images, &job->n_images,
                                e);
    if (!rc)
        rc = train_scene_any(s, job, e);
    if (!rc)
        job->images = images;
    return rc;
}

enum err_code train_scene_cell(struct train_scene *s, size_t index, struct run_cell *job,
                               struct err *e)
{
    enum err_code rc;
    if (!s->plan.n_cells) {
        rc = train_scene_whole(s, job, e);
        if (!rc)
            cell_whole(&s->scene, job->images, job->n_images, &job->cell);
        return rc;
    }
    rc = train_scene_images(&s->scene, SCENE_TEST, s->cfg->test_split, &job->test_images,
                            &job->n_test, e);
    if (!rc)
        rc = train_scene_planned(s, index, job, e);
    if (!rc)
        rc = train_scene_any(s, job, e);
    return rc && s->plan.n_cells > 1 ? err_add(e, "cell %s", s->plan.cells[index].id) : rc;
}
