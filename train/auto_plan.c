/* Cells of ever smaller edges, until the forecast of training fits in memory. See auto_plan.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/auto_plan.h"

#include <math.h>

#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/machine.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "scene/cells/share.h"
#include "train/base/config.h"
#include "train/jobs.h"

/* Cells train on all photographs of which they take this share, as by `citysplat plan`. */
#define AUTO_PLAN_SHARE_MIN 0.02
enum { AUTO_PLAN_PARTS = 32 /* at most, of the scene's longer side */ };

struct auto_plan_need {
    size_t n_cells;
    double memory_bytes; /* of the cell that needs most */
    bool begun;          /* of a scene in one piece: training has begun, or is complete */
};

/* What training the cells of a plan takes; NULL: of the scene as it is. */
static enum err_code auto_plan_ask(const char *scene_dir, const char *plan,
                                   const struct train_config *cfg, struct auto_plan_need *out,
                                   struct err *e)
{
    struct jobs_list list;
    const enum log_level was = log_get_level();
    log_set_level(LOG_WARN); /* what each cell is told when it is trained */
    enum err_code rc = jobs_list(scene_dir, plan, cfg, true, &list, e);
    log_set_level(was);
    *out = (struct auto_plan_need){.n_cells = list.n_cells};
    for (size_t i = 0; i < list.n_cells; i++) {
        out->memory_bytes = fmax(out->memory_bytes, list.cells[i].memory_bytes);
        out->begun |= list.cells[i].state != JOBS_NEW;
    }
    jobs_list_free(&list);
    return rc;
}

/* The plan that `citysplat plan --edge-m` writes; edge_m 0: one cell, which is not written.
 * *edge_out is its edge, *n_cells how many are trained. */
static enum err_code auto_plan_write(const char *path, const struct scene *s, double edge_m,
                                     double *edge_out, size_t *n_cells, struct err *e)
{
    struct partition_config cfg = partition_defaults();
    struct partition p = {0};
    cfg.edge_m = edge_m;
    enum err_code rc = partition_make(s, &cfg, &p, e);
    if (!rc)
        rc = share_photographs(s, AUTO_PLAN_SHARE_MIN, &p, e);
    *edge_out = p.edge_m;
    *n_cells = 0;
    for (size_t i = 0; !rc && i < p.n_cells; i++)
        *n_cells += p.cells[i].parent < 0;
    if (!rc && *n_cells > 1 && edge_m > 0.0)
        rc = cell_plan_write(path, s, &p, e);
    partition_free(&p);
    return rc;
}

/* Writes plans under another name until one fits, which gets the name `path`. *fits has 0 cells if
 * none does; then there is no plan, nor if it is stopped. */
static enum err_code auto_plan_search(const char *scene_dir, const char *path,
                                      const struct train_config *cfg, double memory_bytes,
                                      struct auto_plan_need *fits, double *edge_m, struct err *e)
{
    struct scene scene = {0};
    char trial[FILE_PATH_MAX];
    size_t n = 0;
    double span_m = 0.0;
    *fits = (struct auto_plan_need){0};
    file_sweep(path);
    enum err_code rc = file_begin(path, trial, e);
    if (rc)
        return rc;
    rc = scene_read(scene_dir, &scene, e);
    if (!rc)
        rc = auto_plan_write(trial, &scene, 0.0, &span_m, &n, e);
    for (size_t parts = 2; !rc && parts <= AUTO_PLAN_PARTS; parts++) {
        struct auto_plan_need need;
        if (signals_stopping()) {
            rc = err_set(e, ERR_CANCEL, "stopped while cells were planned");
            break;
        }
        /* Whole metres, so that a person can write the same on a command line. */
        rc = auto_plan_write(trial, &scene, fmax(ceil(span_m / (double)parts), 1.0), edge_m, &n, e);
        if (rc || n < 2)
            continue;
        rc = auto_plan_ask(scene_dir, trial, cfg, &need, e);
        if (!rc && need.memory_bytes <= memory_bytes) {
            *fits = need;
            break;
        }
    }
    if (!rc && fits->n_cells)
        rc = file_commit(trial, path, e);
    else
        file_abort(trial);
    scene_free(&scene);
    return rc;
}

enum err_code auto_plan(const char *scene_dir, const struct train_config *cfg, struct err *e)
{
    struct auto_plan_need whole, cells;
    char path[FILE_PATH_MAX];
    size_t memory = 0;
    double edge_m = 0.0;
    enum err_code rc = file_join(path, scene_dir, "plan.json", e);
    if (rc || cfg->cell || cfg->coarse_only || file_exists(path))
        return rc;
    rc = machine_memory_parse(cfg->memory, machine_memory(), &memory, e);
    if (!rc)
        rc = auto_plan_ask(scene_dir, NULL, cfg, &whole, e);
    if (rc || whole.memory_bytes <= (double)memory)
        return rc;
    if (whole.begun) {
        log_warn(
            "train",
            "the forecast for this scene in one piece, %.2f GB, exceeds --memory, %.2f GB; its "
            "training has begun so and goes on so",
            1e-9 * whole.memory_bytes, 1e-9 * (double)memory);
        return ERR_OK;
    }
    rc = auto_plan_search(scene_dir, path, cfg, (double)memory, &cells, &edge_m, e);
    if (rc)
        return rc;
    if (!cells.n_cells)
        log_warn("train",
                 "the forecast for this scene is %.2f GB, --memory is %.2f GB, and no cut into "
                 "cells fits: it is trained in one piece; a smaller --budget or --max-edge-px "
                 "needs less",
                 1e-9 * whole.memory_bytes, 1e-9 * (double)memory);
    else
        log_warn("train",
                 "the forecast for this scene in one piece is %.2f GB, --memory is %.2f GB: it is "
                 "cut into %zu cells of %.0f m, %.2f GB at most, as by `citysplat plan %s --edge-m "
                 "%.0f`. Without %s and with more memory or a smaller --budget it is one piece",
                 1e-9 * whole.memory_bytes, 1e-9 * (double)memory, cells.n_cells, edge_m,
                 1e-9 * cells.memory_bytes, scene_dir, edge_m, path);
    return ERR_OK;
}
