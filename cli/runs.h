/* Recorded runs: what a study measured, kept in the repository as JSON lines
 * (docs/runs/NAME.jsonl).
 *
 * A line is one scored thing:
 *   {"study": "budgets", "row": "50 k", "what": "level 3", "dataset": "...", "command": "...",
 *    "commit": "...", "device": "...", "fma_gflops": N, "triad_gbps": N,
 *    "numbers": {"psnr_db": N, ...}}
 * (study, row, what) is unique in a file; recording it again replaces it. docs/runs/README.md tells
 * what the numbers mean. `citysplat-study record` writes such files, `citysplat-study chart` draws
 * them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_RUNS_H
#define CLI_RUNS_H

#include "core/base.h"

/* All lines of a file as an array of objects, each checked to have the texts study, row and what
 * and the object numbers. A file that does not exist is ERR_NOENT. json_decref. */
enum err_code runs_read(const char *path, struct json_t **out, struct err *e) ERR_USE;
/* JSON lines without a check of their members: what benchmarks print. json_decref. */
enum err_code runs_read_lines(const char *path, struct json_t **out, struct err *e) ERR_USE;
/* Write `lines` as JSON lines; whole or not at all. */
enum err_code runs_write(const char *path, const struct json_t *lines, struct err *e) ERR_USE;

/* Borrowed text of a member, "" when it has none; a number of "numbers" (or of the line itself),
 * NaN when it has none. */
const char *runs_text(const struct json_t *line, const char *key);
double runs_number(const struct json_t *line, const char *key);

#endif
