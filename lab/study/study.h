/* Records of studies, which become charts and tables of lab/studies/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_STUDY_H
#define LAB_STUDY_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct json_t;

/* ---- valid records (lab/study/study_check.c) ---- */

enum study_history { STUDY_HISTORY_NONE, STUDY_HISTORY_SHALLOW, STUDY_HISTORY_WHOLE };

/* Returns how much history git has in the folder `dir`: none (no repository, or no git), a part, or
 * all. */
enum study_history study_history(const char *dir);

/* Checks records (runs.h). ERR_DATA names the first record that is shorter or has fewer seeds than
 * its study states in lab/study/studies.def. With history_dir, it also names one whose commit is
 * not an ancestor of HEAD in that repository. */
enum err_code study_check(const struct json_t *lines, const char *history_dir,
                          struct err *e) ERR_USE;

/* The seed of a record: from its command, else from its numbers, else 1. */
double study_seed(const struct json_t *line);
/* Length of a row's name without " (seed N)". */
size_t study_row_length(const char *row);
/* Returns whether two records differ in their seed alone: they have the same study, what and row.
 */
bool study_same_row(const struct json_t *a, const struct json_t *b);

/* ---- seeds (lab/study/study_seeds.c) ---- */

/* Returns a new array in which all seeds of a row are one record. Numbers become means, times
 * medians. It adds "seeds", "spread_db" (the standard deviation of PSNR), and the text "gain". The
 * gain is PSNR minus that of the study's first row, or "none" if this difference is below twice its
 * spread. "fma_gflops" and "triad_gbps" become the least of the runs; the same keys with "_most"
 * are the largest. Records with one seed stay unchanged. Release *out with json_decref. ERR_MEM. */
enum err_code study_merge_seeds(const struct json_t *lines, struct json_t **out,
                                struct err *e) ERR_USE;

#endif
