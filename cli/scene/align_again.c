/* A second round for photographs that lack features: see align_work.h.
 *
 * With few features a photograph may see so few points that its pose is hardly known, or find no
 * place at all. Those that match others get as many features as is left of --minutes, by the
 * forecast or by the clock, whichever leaves more (others may keep the machine busy),
 * and so do those that they are compared with: a match needs both. Their features leave a copy of
 * the database, COLMAP fills the gaps, and the model is computed anew. The better of the two models
 * stays.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "cli/scene/align_work.h"

static bool align_lacks_features(const struct align *a, size_t i)
{
    const uint32_t model = a->model_of[i];
    return align_plan_usable(&a->plan.photos[i]) && a->seen[i].matches > 0 &&
           (model == 0 || model == UINT32_MAX) && /* a smaller model is sound for itself */
           !align_is_good(a, i);
}

/* Photographs to seek anew, and the plan of the work on these alone. */
static size_t align_again_choose(const struct align *a, bool *of, struct align_plan *part)
{
    size_t lack = 0;
    for (size_t i = 0; i < a->plan.n; i++) {
        of[i] = align_lacks_features(a, i);
        lack += of[i];
    }
    for (size_t k = 0; k < a->plan.n_pairs; k++) {
        const struct align_pair *p = &a->plan.pairs[k];
        of[p->a] = of[p->a] || align_lacks_features(a, p->b);
        of[p->b] = of[p->b] || align_lacks_features(a, p->a);
    }
    *part = a->plan;
    part->n_usable = part->n_pairs = 0;
    for (size_t i = 0; i < a->plan.n; i++)
        part->n_usable += of[i];
    for (size_t k = 0; k < a->plan.n_pairs; k++)
        part->n_pairs += of[a->plan.pairs[k].a] || of[a->plan.pairs[k].b];
    return lack;
}

/* Size and features of the second round. False: the minutes that are left allow no more than the
 * first one had. */
static bool align_again_afford(struct align *a, const struct align_plan *part,
                               struct align_forecast *out)
{
    const json_t *was = json_object_get(a->state, "again");
    const struct align_pace pace = align_plan_pace(&a->pace);
    struct align_forecast first = align_plan_forecast(&a->plan, a->forecast.edge_px,
                                                      a->forecast.features, pace.slow),
                          rest = {.model_s = first.model_s * (1 - (double)part->n_usable /
                                                                      (double)a->plan.n_usable)};
    double spent_s = fmin(align_sum(a, "seconds"), align_plan_clock_s(&first, &pace));
    double left_s = 60 * a->o->minutes - spent_s - align_plan_clock_s(&rest, &pace);
    if (was) { /* of a run that was killed */
        *out = (struct align_forecast){
            .edge_px = (uint32_t)json_integer_value(json_object_get(was, "edge_px")),
            .features = (uint32_t)json_integer_value(json_object_get(was, "features"))};
        return true;
    }
    *out = align_plan_afford(part, (uint32_t)a->o->max_edge_px, 0, &a->pace, left_s);
    struct align_forecast f = align_plan_forecast(part, out->edge_px, out->features, pace.slow);
    return !a->o->features && out->features > a->forecast.features &&
           align_plan_clock_s(&f, &pace) <= left_s;
}

static enum err_code align_again_run(struct align *a, const bool *of, struct err *e)
{
    char *db = align_path(a, "work/again.db"), *first = align_path(a, "work/database.db");
    const struct align_spent start = align_spent_now();
    const json_t *how = json_object_get(a->state, "again");
    size_t good = a->n_good;
    enum err_code rc = db && first ? ERR_OK : align_no_memory(e);
    if (!rc && !file_exists(db))
        rc = align_db_without(first, db, &a->plan, of, e);
    if (!rc)
        rc = align_extract(a, db, (uint32_t)json_integer_value(json_object_get(how, "edge_px")),
                           json_integer_value(json_object_get(how, "features")), "again",
                           "more features", e);
    if (!rc)
        rc = align_match(a, db, "again", "their pairs", e);
    if (!rc)
        rc = align_map(a, db, "work/again", e);
    if (!rc)
        rc = align_publish(a, "work/again", e);
    if (rc == ERR_DATA) { /* the first model is there all the same */
        log_warn("align", "the second round gave no model, the first one stays: %s", e->msg);
        a->n_good = 0;
        rc = ERR_OK;
    }
    bool better = !rc && a->n_good > good;
    if (!rc)
        json_object_set_new(json_object_get(a->state, "again"), "better", json_boolean(better));
    if (!rc && !better)
        rc = align_publish(a, "work/sparse", e);
    return rc ? rc : align_set_done(a, ALIGN_AGAIN, &start, e);
}

enum err_code align_again(struct align *a, struct err *e)
{
    struct align_plan part;
    struct align_forecast f;
    bool *of = arena_get(&a->arena, a->plan.n, sizeof *of);
    if (!of)
        return align_no_memory(e);
    size_t lack = align_again_choose(a, of, &part);
    if (!lack || align_is_done(a, ALIGN_AGAIN))
        return ERR_OK;
    if (!align_again_afford(a, &part, &f)) {
        if (a->forecast.features < ALIGN_PLAN_FEATURES_MOST)
            log_warn("align",
                     "%zu photographs match others, but with %u features their poses are not "
                     "known: give %s, and the same command goes on",
                     lack, a->forecast.features,
                     a->o->features ? "more --features and --overwrite" : "more --minutes");
        return ERR_OK;
    }
    log_info("align",
             "%zu photographs match others, but with %u features their poses are not known: these "
             "and %zu beside them get up to %u, in pictures of %u px",
             lack, a->forecast.features, part.n_usable - lack, f.features, f.edge_px);
    json_object_set_new(a->state, "again",
                        json_pack("{s:I, s:I, s:I}", "photographs", (json_int_t)part.n_usable,
                                  "edge_px", (json_int_t)f.edge_px, "features",
                                  (json_int_t)f.features));
    enum err_code rc = align_save(a, e);
    return rc ? rc : align_again_run(a, of, e);
}
