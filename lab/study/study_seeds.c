/* Combines the seeds of a row into one record: means, medians of times, the spread of PSNR, and the
 * gain over the study's first row if it is more than twice the spread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "lab/study/chart.h"
#include "lab/study/runs.h"
#include "lab/study/study.h"

struct seeds_sum { /* of a number over the seeds of a row */
    double n, mean, spread;
};

/* A new array of the records that belong to the row of `line`. NULL: out of memory. */
static json_t *seeds_own(const json_t *lines, const json_t *line)
{
    json_t *own = json_array(), *other;
    size_t i;
    json_array_foreach(lines, i, other)
    {
        if (own && study_same_row(line, other) && json_array_append(own, other)) {
            json_decref(own);
            own = NULL;
        }
    }
    return own;
}

/* Mean and standard deviation (of a sample) of `key` over the records of a row. */
static struct seeds_sum seeds_of(const json_t *own, const char *key)
{
    struct seeds_sum s = {0};
    size_t i;
    json_t *other;
    double squares = 0.0;
    json_array_foreach(own, i, other)
    {
        double v = runs_number(other, key);
        if (!isfinite(v))
            continue;
        double d = v - s.mean;
        s.n += 1.0;
        s.mean += d / s.n;
        squares += d * (v - s.mean);
    }
    s.spread = s.n > 1.0 ? sqrt(squares / (s.n - 1.0)) : (double)NAN;
    return s;
}

/* Times have neighbours in them, which are no property of the row: its median. */
static bool seeds_is_time(const char *key)
{
    return !strcmp(key, "train_s") || !strcmp(key, "run_s") || !strcmp(key, "ms_frame");
}

static int seeds_order(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

enum { SEEDS_MAX = 64 };

/* The values of `key` over the records of a row, in order; at most SEEDS_MAX of them. */
static size_t seeds_sorted(const json_t *own, const char *key, double out[SEEDS_MAX])
{
    size_t i, n = 0;
    json_t *other;
    json_array_foreach(own, i, other)
    {
        double v = runs_number(other, key);
        if (isfinite(v) && n < SEEDS_MAX)
            out[n++] = v;
    }
    qsort(out, n, sizeof *out, seeds_order);
    return n;
}

static double seeds_number(const json_t *own, const char *key)
{
    double v[SEEDS_MAX];
    if (!seeds_is_time(key))
        return seeds_of(own, key).mean;
    size_t n = seeds_sorted(own, key, v);
    return n ? 0.5 * (v[(n - 1) / 2] + v[n / 2]) : (double)NAN;
}

/* What the machine could do before each of the runs: the least, and as KEY_most the most. */
static int seeds_ceiling(const json_t *own, const char *key, json_t *merged)
{
    char most[64];
    double v[SEEDS_MAX];
    size_t n = seeds_sorted(own, key, v);
    snprintf(most, sizeof most, "%s_most", key);
    return n && (json_object_set_new(merged, key, json_real(v[0])) ||
                 json_object_set_new(merged, most, json_real(v[n - 1])));
}

/* Is `line` of a row with seeds, and not the first of it? */
static bool seeds_is_later(const json_t *lines, size_t at)
{
    for (size_t i = 0; i < at; i++)
        if (study_same_row(json_array_get(lines, i), json_array_get(lines, at)))
            return true;
    return false;
}

/* The first record of the study that is of the same thing: what the others are compared with. */
static const json_t *seeds_base(const json_t *lines, const json_t *line)
{
    size_t i;
    json_t *other;
    json_array_foreach(lines, i, other)
    {
        if (!strcmp(runs_text(other, "study"), runs_text(line, "study")) &&
            !strcmp(runs_text(other, "what"), runs_text(line, "what")))
            return other;
    }
    return line;
}

/* "+0.31", "none", or "" where there is nothing to compare: of the row `own`, first record `line`,
 * against its study's first row. False: out of memory. */
static bool seeds_gain(const json_t *lines, const json_t *line, const json_t *own, char *out,
                       size_t room)
{
    const json_t *base = seeds_base(lines, line);
    out[0] = '\0';
    if (base == line)
        return true;
    json_t *first = seeds_own(lines, base);
    if (!first)
        return false;
    struct seeds_sum a = seeds_of(first, "psnr_db"), b = seeds_of(own, "psnr_db");
    double gain = b.mean - a.mean, spread = hypot(a.spread, b.spread);
    if (isfinite(spread))
        snprintf(out, room, fabs(gain) < 2.0 * spread ? "none" : "%+.2f", gain);
    json_decref(first);
    return true;
}

static enum err_code seeds_merge(const json_t *lines, const json_t *line, json_t *out,
                                 struct err *e)
{
    const char *row = runs_text(line, "row"), *key;
    char gain[32] = "";
    json_t *numbers = json_object(), *merged = json_copy((json_t *)(uintptr_t)line), *v;
    json_t *own = seeds_own(lines, line);
    struct seeds_sum psnr = seeds_of(own, "psnr_db");
    int bad = !numbers || !merged || !own || !seeds_gain(lines, line, own, gain, sizeof gain);
    json_object_foreach(json_object_get(line, "numbers"), key, v)
    {
        if (!bad && strcmp(key, "seed"))
            bad = json_object_set_new(numbers, key, json_real(seeds_number(own, key)));
    }
    if (!bad && isfinite(psnr.spread))
        bad = json_object_set_new(numbers, "seeds", json_real(psnr.n)) ||
              json_object_set_new(numbers, "spread_db", json_real(psnr.spread));
    if (!bad)
        bad = seeds_ceiling(own, "fma_gflops", merged) || seeds_ceiling(own, "triad_gbps", merged);
    if (!bad && *gain)
        bad = json_object_set_new(merged, "gain", json_string(gain));
    if (!bad)
        bad = json_object_set(merged, "numbers", numbers) ||
              json_object_set_new(merged, "row", json_stringn(row, study_row_length(row))) ||
              json_array_append(out, merged);
    json_decref(own);
    json_decref(numbers);
    json_decref(merged);
    return bad ? err_set(e, ERR_MEM, "chart: out of memory") : ERR_OK;
}

enum err_code study_merge_seeds(const json_t *lines, json_t **out, struct err *e)
{
    enum err_code rc = ERR_OK;
    *out = json_array();
    if (!*out)
        return err_set(e, ERR_MEM, "chart: out of memory");
    for (size_t i = 0; !rc && i < json_array_size(lines); i++) {
        json_t *line = json_array_get(lines, i);
        const char *row = runs_text(line, "row");
        if (!row[study_row_length(row)]) /* of one seed: as it is */
            rc = json_array_append(*out, line) ? err_set(e, ERR_MEM, "chart: out of memory")
                                               : ERR_OK;
        else if (!seeds_is_later(lines, i))
            rc = seeds_merge(lines, line, *out, e);
    }
    if (rc) {
        json_decref(*out);
        *out = NULL;
    }
    return rc;
}
