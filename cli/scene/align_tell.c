/* What an alignment prints, and align.json: see align_work.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include "cli/scene/align_work.h"

static void align_print_names(const char *what, const struct align *a,
                              bool (*is)(const struct align *a, size_t i))
{
    size_t n = 0;
    for (size_t i = 0; i < a->plan.n; i++)
        if (is(a, i) && n++ < ALIGN_SHOWN)
            printf("%s %s%s%s\n", what, a->plan.photos[i].name, a->plan.photos[i].fault ? ": " : "",
                   a->plan.photos[i].fault ? a->plan.photos[i].fault : "");
    if (n > ALIGN_SHOWN)
        printf("%s ... and %zu more\n", what, n - ALIGN_SHOWN);
}

static bool align_is_broken(const struct align *a, size_t i)
{
    return a->plan.photos[i].fault != NULL;
}
static bool align_is_copy(const struct align *a, size_t i)
{
    return a->plan.photos[i].copy_of != SIZE_MAX;
}
static bool align_is_blurred(const struct align *a, size_t i)
{
    return a->plan.photos[i].blurred;
}
static bool align_is_alone(const struct align *a, size_t i)
{
    return align_plan_usable(&a->plan.photos[i]) && !a->seen[i].matches;
}

void align_print_plan(const struct align *a)
{
    const struct align_plan *p = &a->plan;
    printf("photos   %zu, of which %zu are used: %.1f Mpx, %zu with GPS, %zu lens%s\n", p->n,
           p->n_usable, p->megapixels, p->n_gps, p->n_groups, p->n_groups == 1 ? "" : "es");
    align_print_names("broken  ", a, align_is_broken);
    align_print_names("copy    ", a, align_is_copy);
    align_print_names("blurred ", a, align_is_blurred);
    if (isfinite(p->overlap))
        printf("overlap  %.0f %% of a photograph's shorter side, by GPS and height\n",
               100 * p->overlap);
    if (isfinite(p->overlap) && p->overlap < 0.6)
        log_warn("align",
                 "neighbours overlap by %.0f %%: 70 to 80 are needed; parts will not be placed",
                 100 * p->overlap);
    if (p->n_clusters > 1)
        log_warn("align",
                 "the photographs lie in %zu places, %.0f m apart: these become models of their "
                 "own, of which ingest takes the largest; align them apart",
                 p->n_clusters, p->apart_m);
    if (4 * p->n_blurred > p->n_usable)
        log_warn("align", "%zu of %zu photographs are blurred", p->n_blurred, p->n_usable);
}

void align_print_forecast(const struct align *a)
{
    const struct align_forecast *f = &a->forecast;
    const struct align_pace rest = {.cores = a->pace.cores, .slow = a->pace.slow, .load = 1};
    printf("forecast %u px, %u features: features %.1f, %zu pairs %.1f, model %.1f minutes of a "
           "processor\n",
           f->edge_px, f->features, f->features_s / 60, a->plan.n_pairs, f->matches_s / 60,
           f->model_s / 60);
    printf("         %.1f min on %zu core%s without other programs",
           align_plan_clock_s(f, &rest) / 60, a->pace.cores, a->pace.cores == 1 ? "" : "s");
    if (a->pace.load > 1.2)
        printf("; %.1f min while others are as busy as now", align_plan_clock_s(f, &a->pace) / 60);
    printf("\n");
}

/* Which photographs match a neighbour in small pictures: told before the long work. */
void align_print_look(const struct align *a, size_t largest)
{
    size_t alone = 0;
    for (size_t i = 0; i < a->plan.n; i++)
        alone += align_is_alone(a, i);
    printf(
        "look     %zu of %zu photographs match a neighbour in small pictures; %zu hang together\n",
        a->plan.n_usable - alone, a->plan.n_usable, largest);
    if (10 * largest >= 8 * a->plan.n_usable)
        return;
    align_print_names("alone   ", a, align_is_alone);
    log_warn("align",
             "only %zu of %zu photographs hang together in small pictures: expect several models, "
             "and photographs without a place (too little overlap, blur, water, or several "
             "surveys)",
             largest, a->plan.n_usable);
}

/* Why photograph i has no place in the largest model. */
static void align_reason(const struct align *a, size_t i, char out[256])
{
    const struct align_photo *p = &a->plan.photos[i];
    const struct align_seen *s = &a->seen[i];
    const char *blur = p->blurred ? "blurred; " : "";
    if (p->fault)
        snprintf(out, 256, "it cannot be read: %.200s", p->fault);
    else if (p->copy_of != SIZE_MAX)
        snprintf(out, 256, "a copy of %.200s", a->plan.photos[p->copy_of].name);
    else if (a->model_of[i] != UINT32_MAX)
        snprintf(out, 256, "it is in sparse/%u, which nothing joins to the largest model",
                 a->model_of[i]);
    else if (s->features < 100)
        snprintf(out, 256, "%sonly %u features: nothing to recognise", blur, s->features);
    else if (!s->matches)
        snprintf(out, 256,
                 "%sit matches no neighbour: too little overlap, another place, or another season",
                 blur);
    else
        snprintf(out, 256, "%sit matches %u photographs, too weakly or at too small an angle", blur,
                 s->matches);
}

static json_t *align_unplaced_to_json(const struct align *a)
{
    json_t *list = json_array();
    for (size_t i = 0; i < a->plan.n; i++) {
        char why[256];
        if (a->model_of[i] == 0)
            continue;
        align_reason(a, i, why);
        json_array_append_new(list,
                              json_pack("{s:s, s:s, s:i, s:i}", "name", a->plan.photos[i].name,
                                        "why", why, "features", (int)a->seen[i].features, "matches",
                                        (int)a->seen[i].matches));
    }
    return list;
}

enum err_code align_write_result(struct align *a, json_t *config, struct err *e)
{
    json_t *models = json_array();
    for (size_t k = 0; k < a->n_models; k++)
        json_array_append_new(models, json_integer((json_int_t)a->sizes[k]));
    json_t *root = json_pack(
        "{s:s, s:s, s:s, s:I, s:I, s:I, s:I, s:I, s:o, s:I, s:I, s:I, s:O, s:O?, s:O?, s:O?, s:o, "
        "s:o}",
        "citysplat", CITYSPLAT_VERSION, "colmap", a->version, "photographs_in", a->photos,
        "photographs", (json_int_t)a->plan.n, "used", (json_int_t)a->plan.n_usable, "placed",
        (json_int_t)a->placed, "kept_by_ingest", (json_int_t)a->n_good, "lenses",
        (json_int_t)a->plan.n_groups, "models", models, "pairs", (json_int_t)a->plan.n_pairs,
        "edge_px", (json_int_t)a->forecast.edge_px, "features", (json_int_t)a->forecast.features,
        "seconds", json_object_get(a->state, "seconds"), "processor_seconds",
        json_object_get(a->state, "processor_seconds"), "mapper",
        json_object_get(a->state, "mapper"), "again", json_object_get(a->state, "again"),
        "unplaced", align_unplaced_to_json(a), "config", config);
    char *path = align_path(a, "align.json");
    enum err_code rc = root && path ? jsonc_write(path, root, e)
                                    : err_set(e, ERR_DATA,
                                              "%s: cannot be written: a path is not "
                                              "UTF-8, or memory is short",
                                              "align.json");
    json_decref(root);
    return rc;
}

void align_print_unplaced(const struct align *a)
{
    size_t shown = 0, left = 0;
    for (size_t i = 0; i < a->plan.n; i++) {
        char why[256];
        if (a->model_of[i] == 0)
            continue;
        left++;
        if (shown++ >= ALIGN_SHOWN)
            continue;
        align_reason(a, i, why);
        printf("unplaced %s: %s\n", a->plan.photos[i].name, why);
    }
    if (left > ALIGN_SHOWN)
        printf("unplaced ... and %zu more\n", left - ALIGN_SHOWN);
}

double align_sum(const struct align *a, const char *key)
{
    double sum = 0;
    for (enum align_stage s = 0; s < ALIGN_STAGES; s++)
        sum +=
            json_number_value(json_object_get(json_object_get(a->state, key), align_stage_name(s)));
    return sum;
}

/* Placed, but by points that ingest does not trust. */
static void align_print_loose(const struct align *a)
{
    size_t n = 0;
    for (size_t i = 0; i < a->plan.n; i++)
        if (a->model_of[i] == 0 && !align_is_good(a, i) && n++ < ALIGN_SHOWN)
            printf("loose    %s: its %zu points do not fix its pose; ingest leaves it out\n",
                   a->plan.photos[i].name, a->pose[i].n_points);
    if (n > ALIGN_SHOWN)
        printf("loose    ... and %zu more\n", n - ALIGN_SHOWN);
}

void align_print_result(const struct align *a)
{
    printf("model    %s/sparse/0: %zu of %zu photographs, %.1f min, %.1f of a processor\n", a->dir,
           a->placed, a->plan.n_usable, align_sum(a, "seconds") / 60,
           align_sum(a, "processor_seconds") / 60);
    for (size_t k = 1; k < a->n_models; k++)
        printf("model    %s/sparse/%zu: %zu photographs that nothing joins to it\n", a->dir, k,
               a->sizes[k]);
    align_print_loose(a);
    align_print_unplaced(a);
    if (10 * a->placed < 9 * a->plan.n_usable)
        log_warn("align", "%zu of %zu photographs have no place in the model",
                 a->plan.n_usable - a->placed, a->plan.n_usable);
    printf("next     citysplat ingest %s %s/sparse -o scene\n", a->photos, a->dir);
}
