/* The commands of citysplat-study: what is measured becomes records, charts and tables of docs/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef STUDIES_STUDY_H
#define STUDIES_STUDY_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct json_t;

/* argv[0] is the command's own name. ERR_ARG for what a user mistyped; ERR_NOENT, ERR_IO,
 * ERR_FORMAT, ERR_DATA of files; ERR_MEM. */
enum err_code study_record(int argc, char **argv, struct err *e) ERR_USE;
enum err_code study_chart(int argc, char **argv, struct err *e) ERR_USE;

/* ---- which records count (studies/study_check.c) ---- */

enum study_history { STUDY_HISTORY_NONE, STUDY_HISTORY_SHALLOW, STUDY_HISTORY_WHOLE };

/* What git knows of the past in folder `dir`: nothing (no repository, or no git), a part, or all.
 */
enum study_history study_history(const char *dir);

/* ERR_DATA for the first record (runs.h) that is shorter or has fewer seeds than its study states
 * in studies/studies.def, or, when `history_dir` is not NULL, whose commit is not an ancestor of
 * HEAD in the repository there. */
enum err_code study_check(const struct json_t *lines, const char *history_dir,
                          struct err *e) ERR_USE;

/* The seed of a record: of its command, or of its numbers, or 1. */
double study_seed(const struct json_t *line);
/* Length of a row's name without its " (seed N)". */
size_t study_row_length(const char *row);
/* The same study, thing and row but for the seed? */
bool study_same_row(const struct json_t *a, const struct json_t *b);

/* ---- seeds (studies/study_seeds.c) ---- */

/* A new array in which the seeds of a row are one record: numbers are means, times medians; "seeds"
 * and "spread_db", the standard deviation of PSNR, are added, and the text "gain": PSNR less that
 * of the study's first row, "none" below twice the spread of the difference. "fma_gflops" and
 * "triad_gbps" are the least of the runs, with "_most" behind it the most. Records of one seed stay
 * as they are. ERR_MEM. json_decref. */
enum err_code study_merge_seeds(const struct json_t *lines, struct json_t **out,
                                struct err *e) ERR_USE;

#endif
