/* Rows of several seeds as one: means, the spread of PSNR, and what the row gains on its study's
 * first row, where that is more than twice its spread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "bench/study.h"
#include "cli/chart.h"
#include "cli/runs.h"

struct seeds_sum { /* of a number over the seeds of a row */
    double n, mean, spread;
};

/* Mean and standard deviation (of a sample) of `key` over the records that belong to the row of
 * `line`. */
static struct seeds_sum seeds_of(const json_t *lines, const json_t *line, const char *key)
{
    struct seeds_sum s = {0};
    size_t i;
    json_t *other;
    double squares = 0.0;
    json_array_foreach(lines, i, other)
    {
        double v = runs_number(other, key);
        if (!isfinite(v) || !study_same_row(line, other))
            continue;
        double d = v - s.mean;
        s.n += 1.0;
        s.mean += d / s.n;
        squares += d * (v - s.mean);
    }
    s.spread = s.n > 1.0 ? sqrt(squares / (s.n - 1.0)) : (double)NAN;
    return s;
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

/* "+0.31", "none", or "" where there is nothing to compare. */
static void seeds_gain(const json_t *lines, const json_t *line, char *out, size_t room)
{
    const json_t *base = seeds_base(lines, line);
    struct seeds_sum a = seeds_of(lines, base, "psnr_db"), b = seeds_of(lines, line, "psnr_db");
    double gain = b.mean - a.mean, spread = hypot(a.spread, b.spread);
    out[0] = '\0';
    if (base == line || !isfinite(spread))
        return;
    snprintf(out, room, fabs(gain) < 2.0 * spread ? "none" : "%+.2f", gain);
}

static enum err_code seeds_merge(const json_t *lines, const json_t *line, json_t *out,
                                 struct err *e)
{
    const char *row = runs_text(line, "row"), *key;
    char gain[32];
    json_t *numbers = json_object(), *merged = json_copy((json_t *)(uintptr_t)line), *v;
    struct seeds_sum psnr = seeds_of(lines, line, "psnr_db");
    int bad = !numbers || !merged;
    json_object_foreach(json_object_get(line, "numbers"), key, v)
    {
        if (!bad && strcmp(key, "seed"))
            bad = json_object_set_new(numbers, key, json_real(seeds_of(lines, line, key).mean));
    }
    if (!bad && isfinite(psnr.spread))
        bad = json_object_set_new(numbers, "seeds", json_real(psnr.n)) ||
              json_object_set_new(numbers, "spread_db", json_real(psnr.spread));
    seeds_gain(lines, line, gain, sizeof gain);
    if (!bad && *gain)
        bad = json_object_set_new(merged, "gain", json_string(gain));
    if (!bad)
        bad = json_object_set(merged, "numbers", numbers) ||
              json_object_set_new(merged, "row", json_stringn(row, study_row_length(row))) ||
              json_array_append(out, merged);
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
