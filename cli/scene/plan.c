/* citysplat plan: cut a scene into cells before training, and show the cut.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "cli/base/cli.h"
#include "codec/scene/scene.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "scene/cells/share.h"

#define PLAN_RAD_PER_DEG 0.017453292519943295

struct plan_options {
#define OPT OPTIONS_MEMBER
#include "cli/scene/plan.def"
};

static const struct options_def plan_defs[] = {
#define OPT(...) OPTIONS_ROW(struct plan_options, __VA_ARGS__)
#include "cli/scene/plan.def"
};

static void plan_print(const struct scene *s, const struct partition *p)
{
    printf("%zu photographs, %zu points, %zu cells of %.4g m (%zu merged, %zu divided)\n",
           s->n_images, s->n_points, p->n_cells, p->edge_m, p->n_merged, p->n_divided);
    printf("%-12s %10s %10s %10s %12s  %s\n", "cell", "location", "visible", "points", "size m",
           "");
    for (size_t i = 0; i < p->n_cells; i++) {
        const struct partition_cell *c = &p->cells[i];
        printf("%-12s %10zu %10zu %10zu %5.0f x %-4.0f  %s%s\n", c->id, c->n_location,
               c->n_images - c->n_location, c->n_points, c->max_m[0] - c->min_m[0],
               c->max_m[1] - c->min_m[1], c->parent < 0 ? "" : "background of ",
               c->parent < 0 ? "" : p->cells[c->parent].id);
    }
}

/* The axes that the options ask for; {0}: those of ENU. */
static enum err_code plan_grid(const struct plan_options *o, struct cell_grid *out, struct err *e)
{
    double at[2] = {0.0, 0.0};
    *out = (struct cell_grid){0};
    if (o->origin_m && !number_list(o->origin_m, 2, at))
        return err_set(e, ERR_ARG,
                       "--origin-m '%s': two numbers with a comma are expected, as 10,-56",
                       o->origin_m);
    if (o->origin_m || o->yaw_deg != 0.0)
        *out = cell_grid_make(o->yaw_deg * PLAN_RAD_PER_DEG, at);
    return ERR_OK;
}

enum err_code cli_plan(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "plan",
        .usage = "citysplat plan SCENE [options]",
        .about =
            "Cuts a scene into cells that are trained independently. Writes SCENE/plan.json, "
            "which `citysplat train` uses, and SCENE/plan.svg, a picture of the cells, cameras "
            "and points.",
        .example = "citysplat plan scene --edge-m 50 --images-few 16 --images-least 8",
        .defs = plan_defs,
        .n_defs = sizeof plan_defs / sizeof plan_defs[0],
        .min_args = 1,
        .max_args = 1};
    struct plan_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct scene scene = {0};
    struct partition p = {0};
    char path[FILE_PATH_MAX];
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    if (rc || args.done)
        goto out;
    rc = scene_read(args.arg[0], &scene, e);
    if (rc)
        goto out;
    struct cell_grid grid;
    rc = plan_grid(&o, &grid, e);
    if (rc)
        goto out;
    struct partition_config cfg = partition_defaults();
    cfg.edge_m = o.edge_m;
    cfg.grid = grid;
    cfg.images_few = (size_t)o.images_few;
    cfg.images_least = (size_t)o.images_least;
    rc = partition_make(&scene, &cfg, &p, e);
    if (!rc)
        rc = share_photographs(&scene, o.share_min, &p, e);
    if (!rc)
        rc = file_join(path, args.arg[0], "plan.json", e);
    if (!rc)
        rc = cell_plan_write(path, &scene, &p, e);
    if (!rc)
        rc = file_join(path, args.arg[0], "plan.svg", e);
    if (!rc)
        rc = cell_plan_svg(path, &scene, &p, e);
    if (!rc)
        plan_print(&scene, &p);
out:
    partition_free(&p);
    scene_free(&scene);
    arena_free(&arena);
    return rc;
}
