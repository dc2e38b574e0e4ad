/* See eval_lab.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/eval_lab.h"

#include <jansson.h>
#include <string.h>

#include "cli/base/output.h"
#include "cli/train/eval_score.h"

static const struct options_def eval_lab_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct eval_lab_options, city, __VA_ARGS__)
#include "cli/train/eval_city.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct eval_lab_options, __VA_ARGS__)
#include "lab/eval/eval_lab.def"
};
enum { EVAL_LAB_DEFS = sizeof eval_lab_defs / sizeof *eval_lab_defs, EVAL_LAB_OWN_MAX = 16 };

/* The options of the command, then those of all scores: one table and one struct of both. */
static enum err_code eval_lab_parse(struct eval_lab *v, const struct options_spec *own, int argc,
                                    char **argv, void *options, size_t size, struct err *e)
{
    struct options_def defs[EVAL_LAB_DEFS + EVAL_LAB_OWN_MAX];
    struct options_spec spec = *own;
    assert(own->n_defs <= EVAL_LAB_OWN_MAX);
    memcpy(defs, own->defs, own->n_defs * sizeof *defs);
    memcpy(defs + own->n_defs, eval_lab_defs, sizeof eval_lab_defs);
    size_t at = (size + 15) / 16 * 16;
    for (size_t i = 0; i < EVAL_LAB_DEFS; i++)
        defs[own->n_defs + i].offset += at;
    spec.defs = defs;
    spec.n_defs += EVAL_LAB_DEFS;
    char *both = mem_array(at + sizeof v->o, 1);
    if (!both)
        return err_set(e, ERR_MEM, "%s: out of memory", own->command);
    enum err_code rc = options_parse(&spec, argc, argv, both, &v->args, &v->arena, e);
    memcpy(options, both, size);
    memcpy(&v->o, both + at, sizeof v->o);
    mem_free(both);
    return rc;
}

static enum err_code eval_lab_check(const struct eval_lab_options *o, struct err *e)
{
    bool by_distance = (enum pick_metric)o->metric == PICK_DISTANCE, error = o->city.error_px > 0.0;
    if ((by_distance || error) && !o->city.tiles)
        return err_set(e, ERR_ARG, "levels are picked from a tile store alone; give --tiles FILE");
    if (o->distance_m.n && !by_distance)
        return err_set(e, ERR_ARG,
                       "--distance-m: distances pick levels with --metric distance alone; add it");
    if (error && by_distance)
        return err_set(e, ERR_ARG, "--error-px: the error picks levels with --metric screen alone");
    const enum err_code rc = output_check(o->output, o->overwrite, e);
    return rc ? rc : output_apart(o->output, o->city.tiles, e);
}

enum err_code eval_lab_open(struct eval_lab *v, const struct options_spec *own, int argc,
                            char **argv, void *options, size_t options_size, struct err *e)
{
    enum err_code rc = eval_lab_parse(v, own, argc, argv, options, options_size, e);
    if (rc || v->args.done)
        return rc;
    signals_catch();
    const struct options_nums *d = &v->o.distance_m;
    eval_city_defaults(&v->city);
    v->city.o = v->o.city;
    v->city.supersample = (uint32_t)v->o.supersample;
    v->city.metric = (enum pick_metric)v->o.metric;
    v->city.distance_m[0] = d->n == 1 ? d->one : d->v[0];
    v->city.distance_m[1] = d->n == 1 ? 2.0 * d->one : d->v[1];
    v->city.cache_bytes = (size_t)v->o.cache_mib << 20;
    rc = eval_lab_check(&v->o, e);
    if (!rc && !(v->rows = json_array()))
        rc = err_set(e, ERR_MEM, "%s: out of memory", own->command);
    return rc ? rc : eval_city_open(&v->city, v->args.arg[0], SCENE_TEST, e);
}

enum err_code eval_lab_write(const struct eval_lab *v, struct err *e)
{
    return eval_score_write(&v->city, v->rows, v->o.output, e);
}

void eval_lab_close(struct eval_lab *v)
{
    json_decref(v->rows);
    eval_city_close(&v->city);
    arena_free(&v->arena);
}
