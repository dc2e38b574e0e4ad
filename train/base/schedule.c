/* What happens at which step of a level: length, densification, degree of
 * harmonics, learning rate of positions. All are pure functions of the options, so a resumed run
 * needs no state for them.
 *
 * Lengths grow with the number of photographs, by max(n / 600, 1), rounded up to two decimals, but
 * not a total length that was asked for (--iterations). Intervals and rates follow kappa, the run's
 * part of the published length. How each interval shrinks was found by measurements; the reasons
 * stand beside its constant.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "scene/cells/cell.h"
#include "train/base/config.h"
#include "train/base/schedule.h"

#define SCHEDULE_PHOTOS 600.0       /* photographs at which lengths begin to stretch */
#define SCHEDULE_SIZE_FROM 3000.0   /* first step at which sizes are limited, 3DGS */
#define SCHEDULE_LR_FINAL 1.6e-6    /* rate of positions at a level's end, half cell edges; 3DGS */
#define SCHEDULE_LR_RESTART 0.5     /* of lr_mean, at the start of levels after the first */
#define SCHEDULE_SH_INTERVAL 1000.0 /* steps before the next degree of harmonics; 3DGS */
/* The finest level grows to so many budgets, then the cheapest Gaussians go. Measured:
 * docs/decisions/012-importance-and-pruning.md. */
#define SCHEDULE_GROWTH 1.5
enum { SCHEDULE_STEPS_MAX = 1 << 30 };

/* Steps of the levels as published, coarsest first. */
static const int64_t schedule_published[TRAIN_LEVELS_MAX] = {15000, 15000, 30000};
/* --iterations when nothing is asked for: docs/decisions/013-rates-and-length.md. */
static const int64_t schedule_default[TRAIN_LEVELS_MAX] = {1750, 1750, 3500};

/* Half up, as counts are rounded everywhere here. */
static uint32_t schedule_round(double x)
{
    double r = floor(x + 0.5);
    return r < 1.0 ? 1 : r > SCHEDULE_STEPS_MAX ? SCHEDULE_STEPS_MAX : (uint32_t)r;
}

static double schedule_kappa(size_t n_photos)
{
    double k = (double)n_photos / SCHEDULE_PHOTOS;
    return k > 1.0 ? ceil(100.0 * k - 1e-9) / 100.0 : 1.0;
}

static bool schedule_is_default(const struct options_ints *n)
{
    return n->n <= 1 && !memcmp(n->v, schedule_default, sizeof schedule_default);
}

/* Steps of a level in a run of full length. */
static int64_t schedule_base_length(const struct train_config *cfg, size_t level)
{
    const struct options_ints *n = &cfg->iterations;
    return schedule_is_default(n) ? schedule_published[level] : n->v[level];
}

int64_t schedule_asked(const struct train_config *cfg, size_t n_photos)
{
    const struct options_ints *n = &cfg->iterations;
    int64_t sum = 0;
    if (n->one > 0)
        return n->one;
    if (n->n || !schedule_is_default(n))
        return 0;
    for (size_t l = TRAIN_LEVELS_MAX - (size_t)cfg->level_count; l < TRAIN_LEVELS_MAX; l++)
        sum += schedule_default[l];
    return (int64_t)schedule_round((double)sum * schedule_kappa(n_photos));
}

/* What the lists of the configuration say of each level, the finest last. */
struct schedule_base {
    int64_t steps, budget, interval;
    double downsample, until, tau;
};

/* Of the finest level's steps. Measured: docs/decisions/014-order-of-levels.md. */
#define SCHEDULE_TUNE_SHARE 0.2

/* Steps of a coarser level that is made of the finer one. With --level-order both they are taken
 * from those that the level has: half of them at most. */
static int64_t schedule_base_tuned(const struct train_config *cfg, size_t level)
{
    const size_t last = TRAIN_LEVELS_MAX - 1;
    const double finest = (double)schedule_base_length(cfg, last);
    const int64_t part = (int64_t)schedule_round(finest * SCHEDULE_TUNE_SHARE);
    const int64_t half = schedule_base_length(cfg, level) / 2;
    if (cfg->level_order != SCHEDULE_BOTH || level == last)
        return 0;
    return part < half ? part : half;
}

/* One value of --budget and --downsample is the finest level's, and the coarser levels keep their
 * proportion to it; one value of the others holds at all levels. */
static struct schedule_base schedule_base_at(const struct train_config *cfg, size_t level)
{
    const size_t last = TRAIN_LEVELS_MAX - 1;
    const struct options_ints *b = &cfg->budget, *every = &cfg->densify_interval;
    const struct options_nums *d = &cfg->downsample;
    double part = (double)b->v[level] / (double)b->v[last];
    return (struct schedule_base){
        .steps = schedule_base_length(cfg, level),
        .budget = b->n == 1 ? (int64_t)ceil((double)b->one * part) : b->v[level],
        .interval = every->n == 1 ? every->one : every->v[level],
        .downsample = d->n == 1 ? d->one * d->v[level] / d->v[last] : d->v[level],
        .until = cfg->densify_until.n == 1 ? cfg->densify_until.one : cfg->densify_until.v[level],
        .tau = cfg->tau.n == 1 ? cfg->tau.one : cfg->tau.v[level],
    };
}

/* A list has one value, or one a level. */
static enum err_code schedule_check_lists(const struct train_config *cfg, struct err *e)
{
    const struct {
        const char *flag;
        size_t n;
    } lists[] = {
        {"iterations", cfg->iterations.n},
        {"budget", cfg->budget.n},
        {"densify-interval", cfg->densify_interval.n},
        {"densify-until", cfg->densify_until.n},
        {"downsample", cfg->downsample.n},
        {"tau", cfg->tau.n},
    };
    for (size_t i = 0; i < sizeof lists / sizeof *lists; i++)
        if (lists[i].n > 1 && lists[i].n != (size_t)cfg->level_count)
            return err_set(e, ERR_ARG,
                           "--%s has %zu values and --level-count is %lld: give one value, or one "
                           "for each level, coarsest first",
                           lists[i].flag, lists[i].n, (long long)cfg->level_count);
    return ERR_OK;
}

/* A cell that was merged from several has more ground to cover. */
static double schedule_budget_factor(const struct cell *cell)
{
    if (cell->whole)
        return 1.0;
    double area =
        (cell->max_enu_m[0] - cell->min_enu_m[0]) * (cell->max_enu_m[1] - cell->min_enu_m[1]);
    return fmin(fmax(sqrt(area) / cell->edge_m, 1.0), 2.0);
}

/* A run of a part kappa of the full length has fewer steps to get anywhere in and takes larger
 * ones: kappa^-0.4 times the published rates of positions, sizes and rotations, at most `most`
 * times. Measured at 1/20 (docs/decisions/013-rates-and-length.md). */
#define SCHEDULE_LR_EXPONENT 0.4
/* Parts of the steps that thinnings stand at the ends of. */
enum { SCHEDULE_THIN_PARTS = 6 };
static double schedule_lr_factor(double most, double kappa)
{
    return fmin(fmax(pow(kappa, -SCHEDULE_LR_EXPONENT), 1.0), most);
}

static void schedule_rates(const struct train_config *cfg, const struct cell *cell,
                           struct schedule *s)
{
    double unit_m = 0.5 * cell->edge_m;
    s->lr_factor = schedule_lr_factor(cfg->lr_short, s->kappa);
    s->lr_mean_first =
        cfg->lr_mean * s->lr_factor * unit_m * (s->turn > 1 ? SCHEDULE_LR_RESTART : 1.0);
    /* over kappa: a short run has more left to go at its end */
    double last = SCHEDULE_LR_FINAL * pow(s->lr_factor, 1.0 / SCHEDULE_LR_EXPONENT);
    s->lr_mean_last = fmin(last * unit_m, s->lr_mean_first);
}

/* Steps between the thinnings after growth; 0: the level is too short for them. */
static uint32_t schedule_thin_every(const struct schedule *s)
{
    const uint32_t from = s->densify_until;
    return s->steps > from ? (s->steps - from) / SCHEDULE_THIN_PARTS : 0;
}

double schedule_growth(const struct schedule *s)
{
    const bool thins = s->level == s->n_levels && s->densify_until && schedule_thin_every(s);
    return thins ? SCHEDULE_GROWTH : 1.0;
}

size_t schedule_grows(const struct schedule *s)
{
    return (size_t)floor(schedule_growth(s) * (double)s->budget);
}

static void schedule_fill(const struct train_config *cfg, const struct schedule_base *b,
                          double kappa, const struct cell *cell, struct schedule *s)
{
    double shrink = kappa < 1.0 ? kappa : 1.0;
    double interval = (double)b->interval * kappa;
    double floor_steps = fmin((double)b->interval, (double)cfg->densify_interval_min);
    s->kappa = kappa;
    s->downsample = b->downsample;
    s->interval = schedule_round(fmax(interval, floor_steps));
    s->densify_from = (uint32_t)floor((double)cfg->densify_from * kappa + 0.5);
    s->densify_until = (uint32_t)floor((double)s->steps * b->until + 0.5);
    s->budget = (size_t)floor((double)b->budget * schedule_budget_factor(cell));
    /* The first Gaussians may be as large as the gaps between points; later levels begin without
     * such. */
    s->size_from = s->turn == 1 ? schedule_round(SCHEDULE_SIZE_FROM * kappa) : 0;
    s->sh_degree = (uint32_t)cfg->sh_degree;
    s->sh_interval = s->turn == 1 ? schedule_round(SCHEDULE_SH_INTERVAL * shrink) : 0;
    s->tau = b->tau;
    schedule_rates(cfg, cell, s);
}

/* Part of the finest level in which rates fall. */
static double schedule_fade_share(const struct train_config *cfg)
{
    return cfg->lr_end < 1.0 ? SCHEDULE_FADE_SHARE : 0.0;
}

/* How a level ends from which no other goes on: its rates fall. */
static void schedule_fill_end(const struct train_config *cfg, struct schedule *s)
{
    s->fade_from = s->steps;
    s->fade_to = cfg->lr_end;
    if (s->level == s->n_levels)
        s->fade_from = (uint32_t)floor((double)s->steps * (1.0 - schedule_fade_share(cfg)) + 0.5);
}

struct schedule schedule_again(const struct schedule *s, const struct schedule *finer,
                               const struct train_config *cfg)
{
    struct schedule again = *s;
    again.steps = s->tuned > 0 ? s->tuned : 1;
    again.turn = 2 * s->n_levels - s->level;
    again.derived = true;
    again.thin_share = fmin((double)s->budget / (double)finer->budget, 1.0);
    again.lr_mean_first = s->turn > 1 ? s->lr_mean_first : s->lr_mean_first * SCHEDULE_LR_RESTART;
    again.lr_mean_last = fmin(s->lr_mean_last, again.lr_mean_first);
    again.fade_from = (uint32_t)floor((double)again.steps * (1.0 - schedule_fade_share(cfg)) + 0.5);
    again.densify_until = 0; /* it has all its Gaussians */
    again.size_from = 0;
    again.sh_interval = 0; /* what fades during a level is at its end */
    return again;
}

double schedule_full(const struct train_config *cfg)
{
    double total = 0.0;
    for (size_t l = TRAIN_LEVELS_MAX - (size_t)cfg->level_count; l < TRAIN_LEVELS_MAX; l++)
        total += (double)schedule_base_length(cfg, l);
    return total;
}

enum err_code schedule_make(const struct train_config *cfg, size_t n_photos,
                            const struct cell *cell, struct schedule out[TRAIN_LEVELS_MAX],
                            struct err *e)
{
    struct schedule_base base[TRAIN_LEVELS_MAX];
    enum err_code rc = schedule_check_lists(cfg, e);
    if (rc)
        return rc;
    const int64_t asked = schedule_asked(cfg, n_photos);
    for (size_t l = 0; l < TRAIN_LEVELS_MAX; l++)
        base[l] = schedule_base_at(cfg, l);
    uint32_t n = (uint32_t)cfg->level_count, first = TRAIN_LEVELS_MAX - n;
    double total = schedule_full(cfg), kappa = schedule_kappa(n_photos);
    double share = cell->steps_share > 0.0 ? cell->steps_share : 1.0;
    int64_t left = (int64_t)fmax(floor((double)asked * share + 0.5), 1.0);
    kappa = asked > 0 ? (double)left / total : kappa * share;
    for (uint32_t l = 0; l < n; l++) {
        const struct schedule_base *b = &base[first + l];
        struct schedule *s = &out[l];
        *s = (struct schedule){.level = l + 1, .n_levels = n, .turn = l + 1};
        double steps = floor((double)b->steps * kappa + 0.5);
        if (asked > 0 && l + 1 == n)
            steps = (double)left; /* the last level takes what rounding left */
        left -= (int64_t)steps;
        if (!(steps >= 1.0) || steps > SCHEDULE_STEPS_MAX)
            return err_set(e, ERR_ARG,
                           "level %u of %u would have %.0f steps: change --iterations or %s", l + 1,
                           n, steps, "--level-count");
        const double tuned = floor((double)schedule_base_tuned(cfg, first + l) * kappa + 0.5);
        s->tuned = (uint32_t)fmin(tuned, floor(0.5 * steps));
        s->steps = (uint32_t)steps - s->tuned;
        schedule_fill(cfg, b, kappa, cell, s);
        schedule_fill_end(cfg, s);
        s->absgrad = (int64_t)(first + l + 1) >= cfg->absgrad_from;
        if (l > 0 && s->budget < out[l - 1].budget)
            return err_set(e, ERR_ARG,
                           "level %u: budget %zu is below level %u's %zu: budgets must not fall",
                           l + 1, s->budget, l, out[l - 1].budget);
    }
    return ERR_OK;
}

size_t schedule_cap(size_t start, size_t most, uint32_t x, uint32_t n)
{
    if (start >= most)
        return start;
    if (n <= 1 || x >= n - 1)
        return most;
    double u = (double)x / (double)(n - 1);
    return start + (size_t)floor((double)(most - start) * (2.0 * u - u * u));
}

size_t schedule_cap_outside(const struct schedule *s)
{
    return s->budget / 2 + s->around;
}

/* Last step at which densification is allowed: before both `until` and the end. */
static uint32_t schedule_densify_last(const struct schedule *s)
{
    uint32_t end = s->densify_until < s->steps ? s->densify_until : s->steps;
    return end > 0 ? end - 1 : 0;
}

size_t schedule_most(const struct schedule *s, const struct cell *cell)
{
    return schedule_grows(s) + (cell->whole ? 0 : schedule_cap_outside(s));
}

uint32_t schedule_densify_count(const struct schedule *s)
{
    uint32_t first = s->densify_from / s->interval, last = schedule_densify_last(s) / s->interval;
    return last > first ? last - first + 1 : 1;
}

uint32_t schedule_densify_index(const struct schedule *s, uint32_t step)
{
    if (step <= s->densify_from || step > schedule_densify_last(s) || step % s->interval)
        return 0;
    return step / s->interval - s->densify_from / s->interval;
}

uint32_t schedule_thinnings_derived(const struct schedule *s)
{
    return s->steps < SCHEDULE_THINNINGS ? s->steps : SCHEDULE_THINNINGS;
}

/* The thinning at `step` of those that begin at `from` and are `every` steps apart. */
static uint32_t schedule_thinning_from(uint32_t step, uint32_t from, uint32_t every, uint32_t n)
{
    if (step < from || !every || (step - from) % every)
        return 0;
    uint32_t nth = (step - from) / every + 1;
    return nth <= n ? nth : 0;
}

uint32_t schedule_thinning(const struct schedule *s, uint32_t step)
{
    const uint32_t every = schedule_thin_every(s);
    if (s->last || s->still)
        return 0;
    if (s->derived)
        return schedule_thinning_from(step, 1, every ? every : 1, schedule_thinnings_derived(s));
    return s->level == s->n_levels && s->densify_until
               ? schedule_thinning_from(step, s->densify_until, every, SCHEDULE_THINNINGS)
               : 0;
}

bool schedule_limits_size(const struct schedule *s, uint32_t step)
{
    return step > s->size_from;
}

uint32_t schedule_sh_degree(const struct schedule *s, uint32_t step)
{
    if (!s->sh_interval)
        return s->sh_degree;
    uint32_t d = step / s->sh_interval;
    return d < s->sh_degree ? d : s->sh_degree;
}

double schedule_done(const struct schedule *s, uint32_t step)
{
    return s->last || s->derived ? 1.0 : fmin((double)step / (double)s->steps, 1.0);
}

double schedule_fade(const struct schedule *s, uint32_t step)
{
    if (step <= s->fade_from || s->fade_from >= s->steps)
        return 1.0;
    return pow(s->fade_to, (double)(step - s->fade_from) / (double)(s->steps - s->fade_from));
}

double schedule_sh_factor(const struct train_config *cfg, const struct schedule *s, size_t n_photos)
{
    const double looks = s->kappa * schedule_full(cfg) / fmax((double)n_photos, 1.0);
    return fmin(SCHEDULE_SH_LOOKS / fmax(looks, 1.0), 1.0);
}

double schedule_lr_mean(const struct schedule *s, uint32_t step)
{
    if (!(s->lr_mean_first > 0.0) || !(s->lr_mean_last > 0.0))
        return s->lr_mean_first;
    double t = s->last ? 1.0 : fmin((double)step / (double)s->steps, 1.0);
    return exp((1.0 - t) * log(s->lr_mean_first) + t * log(s->lr_mean_last));
}
