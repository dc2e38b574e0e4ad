/* citysplat align: photographs to poses, by an installed COLMAP.
 *
 * Stages, each of which is skipped when it is complete: look (small pictures, neighbours alone),
 * features, matches, model, again (more features for photographs that lack them), result. COLMAP's
 * database keeps what is done within a stage, models are written beside and renamed, and state.json
 * says which stages are complete: so a run that was killed goes on.
 *
 *   align_state.c     the folder, and which stages are complete
 *   align_colmap.c    calls of COLMAP; align_run.c runs it, align_db.c reads its database
 *   align_publish.c   its models, with the true names of photographs
 *   align_again.c     a second round for photographs that lack features
 *   align_tell.c      what is printed, and align.json
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "cli/base/cli.h"
#include "cli/scene/align_run.h"
#include "cli/scene/align_work.h"
#include "core/pool.h"

static const struct options_def align_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct align_options, __VA_ARGS__)
#include "cli/scene/align.def"
};

static const struct options_spec align_spec = {
    .command = "align",
    .usage = "citysplat align PHOTOS -o MODEL [options]",
    .about = "Finds the poses of photographs by COLMAP, which must be installed: one camera for "
             "each lens and focal length, pairs by GPS and order, features as large as --minutes "
             "allows. Photographs that find no place are named, with the reason.",
    .example = "citysplat align photos -o model",
    .defs = align_defs,
    .n_defs = sizeof align_defs / sizeof *align_defs,
    .min_args = 1,
    .max_args = 1,
};

const struct options_spec *align_options(void)
{
    return &align_spec;
}

enum { ALIGN_LOOK_NEAR = 4, ALIGN_LOOK_NEXT = 2, ALIGN_LOOK_FEATURES = 1024 };
static const double look_share = 0.25, look_least_px = 400;
static const double look_most = 0.25; /* of the minutes */
static const double look_start_s = 2; /* of COLMAP, before it computes */
static const double pace_most = 8;

/* Size of pictures and features: what was begun with, else what is asked for or affordable. */
static void align_afford(struct align *a, const struct align_pace *pace)
{
    const json_t *edge = json_object_get(a->state, "edge_px"),
                 *features = json_object_get(a->state, "features");
    bool known = json_is_integer(edge) && json_is_integer(features);
    a->forecast = align_plan_afford(
        &a->plan, (uint32_t)(known ? json_integer_value(edge) : a->o->max_edge_px),
        (uint32_t)(known ? json_integer_value(features) : a->o->features), pace,
        60 * a->o->minutes);
}

/* Is the look a part of the work, in its database? */
static bool align_look_shares(const struct align *a)
{
    return json_is_true(json_object_get(a->state, "look_shares"));
}

static char *align_look_db(struct align *a)
{
    return align_path(a, align_look_shares(a) ? "work/database.db" : "work/look.db");
}

/* Size of the look. Where small pictures would take much of the minutes, the look is the first part
 * of the work instead: the pictures and features that are affordable, in the same database. */
static enum err_code align_look_choose(struct align *a, struct align_forecast *out, struct err *e)
{
    const struct align_pace usual = {.cores = align_cores(a), .slow = 1, .load = 1};
    double longest = 1;
    for (size_t i = 0; i < a->plan.n; i++)
        longest = fmax(longest, fmax(a->plan.photos[i].width_px, a->plan.photos[i].height_px));
    *out = (struct align_forecast){.edge_px = (uint32_t)fmax(look_least_px, look_share * longest),
                                   .features = ALIGN_LOOK_FEATURES};
    enum err_code rc = align_plan_pairs(&a->plan, (size_t)a->o->neighbours, (size_t)a->o->next, e);
    double look_s = align_plan_look_s(&a->plan, 1) / (double)usual.cores;
    if (rc || a->o->dry_run || (look_s < look_most * 60 * a->o->minutes && !align_look_shares(a)))
        return rc;
    align_afford(a, &usual);
    *out = a->forecast;
    align_set_options(a);
    json_object_set_new(a->state, "look_shares", json_true());
    return align_save(a, e);
}

/* Each picture is compared with its neighbours alone: what will match, and how long this machine
 * takes. */
static enum err_code align_look_run(struct align *a, struct err *e)
{
    const struct align_spent start = align_spent_now();
    struct align_forecast size, f;
    enum err_code rc = align_look_choose(a, &size, e);
    char *db = align_look_db(a);
    if (!rc)
        rc = align_plan_pairs(&a->plan, ALIGN_LOOK_NEAR, ALIGN_LOOK_NEXT, e);
    if (!rc)
        rc = align_extract(a, db, size.edge_px, size.features, "look", "look: features", e);
    if (!rc)
        rc = align_match(a, db, "look", "look: pairs", e);
    if (rc)
        return rc;
    f = align_plan_forecast(&a->plan, size.edge_px, size.features, 1);
    struct align_spent now = align_spent_now();
    double cpu_s = now.cpu_s - start.cpu_s, clock_s = now.clock_s - start.clock_s;
    json_object_set_new(a->state, "slow",
                        json_real(cpu_s / (f.features_s + f.matches_s + look_start_s)));
    if (cpu_s > 0)
        json_object_set_new(a->state, "load", json_real(clock_s * (double)align_cores(a) / cpu_s));
    return align_set_done(a, ALIGN_LOOK, &start, e);
}

/* A factor of the look, within reason; 1 where it was not measured. */
static double align_factor(const struct align *a, const char *key, double least)
{
    double x = json_number_value(json_object_get(a->state, key));
    return x > 0 ? fmin(fmax(x, least), pace_most) : 1;
}

static enum err_code align_look(struct align *a, struct err *e)
{
    size_t largest;
    enum err_code rc = ERR_OK;
    if (a->o->look && !align_is_done(a, ALIGN_LOOK))
        rc = align_look_run(a, e);
    a->pace = (struct align_pace){.cores = align_cores(a),
                                  .slow = align_factor(a, "slow", 1 / pace_most),
                                  .load = align_factor(a, "load", 1)};
    if (rc || !align_is_done(a, ALIGN_LOOK))
        return rc;
    char *db = align_look_db(a);
    rc = db ? align_db_seen(db, &a->plan, ALIGN_INLIERS, a->seen, &largest, e) : align_no_memory(e);
    if (!rc)
        align_print_look(a, largest);
    memset(a->seen, 0, a->plan.n * sizeof *a->seen);
    return rc;
}

static enum err_code align_choose_size(struct align *a, struct err *e)
{
    enum err_code rc = align_plan_pairs(&a->plan, (size_t)a->o->neighbours, (size_t)a->o->next, e);
    if (rc)
        return rc;
    align_afford(a, &a->pace);
    align_print_forecast(a);
    if (a->o->dry_run)
        return ERR_OK;
    align_set_options(a);
    return align_save(a, e);
}

/* ---- the whole ---- */

static enum err_code align_stage_run(struct align *a, enum align_stage s, char *db, struct err *e)
{
    switch (s) {
    case ALIGN_FEATURES:
        return align_extract(a, db, a->forecast.edge_px, a->forecast.features, "features",
                             "features", e);
    case ALIGN_MATCHES:
        return align_match(a, db, "matches", "pairs", e);
    default:
        return align_map(a, db, "work/sparse", e);
    }
}

static enum err_code align_stages(struct align *a, struct err *e)
{
    char *db = align_path(a, "work/database.db");
    size_t largest;
    enum err_code rc = db ? ERR_OK : align_no_memory(e);
    for (enum align_stage s = ALIGN_FEATURES; !rc && s < ALIGN_AGAIN; s++) {
        const struct align_spent start = align_spent_now();
        if (align_is_done(a, s))
            continue;
        rc = align_stage_run(a, s, db, e);
        if (!rc)
            rc = align_set_done(a, s, &start, e);
        if (rc == ERR_DATA && s == ALIGN_MODEL && /* what speaks against each helps now */
            !align_db_seen(db, &a->plan, ALIGN_INLIERS, a->seen, &largest, NULL))
            align_print_unplaced(a);
    }
    return rc ? rc : align_db_seen(db, &a->plan, ALIGN_INLIERS, a->seen, &largest, e);
}

/* What each photograph matches, by the database of the last round. */
static enum err_code align_see(struct align *a, struct err *e)
{
    char *db = align_path(a, align_is_done(a, ALIGN_AGAIN) ? "work/again.db" : "work/database.db");
    size_t largest;
    if (!db)
        return align_no_memory(e);
    memset(a->seen, 0, a->plan.n * sizeof *a->seen);
    return align_db_seen(db, &a->plan, ALIGN_INLIERS, a->seen, &largest, e);
}

static enum err_code align_result(struct align *a, struct err *e)
{
    json_t *config = NULL;
    const json_t *again = json_object_get(a->state, "again");
    bool better = align_is_done(a, ALIGN_AGAIN) && json_is_true(json_object_get(again, "better"));
    enum err_code rc = align_publish(a, better ? "work/again" : "work/sparse", e);
    if (!rc)
        rc = align_again(a, e);
    if (!rc)
        rc = align_see(a, e);
    if (!rc)
        rc = options_to_json(&align_spec, a->o, &config, e);
    if (!rc)
        rc = align_write_result(a, config, e);
    if (!rc)
        align_print_result(a);
    return rc;
}

static enum err_code align_read(struct align *a, struct err *e)
{
    enum err_code rc = align_run_find(a->o->colmap, e);
    if (!rc)
        rc = align_plan_read(a->photos, &a->plan, e);
    for (size_t i = 0; !rc && i < a->plan.n; i++) {
        json_t *name = json_string(a->plan.photos[i].name);
        if (!name)
            rc = err_set(e, ERR_DATA, "%s: the name of photograph '%.200s' is not UTF-8; rename it",
                         a->photos, a->plan.photos[i].name);
        json_decref(name);
    }
    if (rc)
        return rc;
    a->seen = arena_get(&a->arena, a->plan.n, sizeof *a->seen);
    a->model_of = arena_get(&a->arena, a->plan.n, sizeof *a->model_of);
    a->pose = arena_get(&a->arena, a->plan.n, sizeof *a->pose);
    a->pose_most_px = arena_get(&a->arena, a->plan.n, sizeof *a->pose_most_px);
    if (!a->seen || !a->model_of || !a->pose || !a->pose_most_px)
        return align_no_memory(e);
    memset(a->model_of, 0xff, a->plan.n * sizeof *a->model_of);
    align_print_plan(a);
    return ERR_OK;
}

static enum err_code align_all(struct align *a, struct err *e)
{
    enum err_code rc = align_read(a, e);
    if (!rc)
        rc = align_open(a, e);
    if (!rc)
        rc = align_ask_version(a, e);
    if (!rc)
        rc = align_check_mapper(a, e);
    if (!rc)
        rc = align_link_photos(a, e);
    if (!rc)
        rc = align_look(a, e);
    if (!rc)
        rc = align_choose_size(a, e);
    if (!rc && !a->o->dry_run)
        rc = align_stages(a, e);
    return rc || a->o->dry_run ? rc : align_result(a, e);
}

enum err_code cli_align(int argc, char **argv, struct err *e)
{
    struct align_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct align a = {.o = &o};
    enum err_code rc = options_parse(&align_spec, argc, argv, &o, &args, &arena, e);
    bool run = !rc && !args.done;
    if (run && !o.output)
        rc = err_set(e, ERR_ARG, "-o is missing: the folder to make");
    if (run && !rc) {
        signals_catch();
        pool_limit((size_t)o.threads);
        setvbuf(stdout, NULL, _IOLBF, 0); /* what is told early is read early */
        a.photos = args.arg[0];
        a.dir = o.output;
        rc = align_all(&a, e);
    }
    json_decref(a.state);
    align_plan_free(&a.plan);
    arena_free(&a.arena);
    arena_free(&arena);
    return rc;
}
