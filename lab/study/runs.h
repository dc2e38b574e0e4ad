/* Recorded runs: results of studies, in the repository as JSON lines (lab/runs/NAME.jsonl).
 *
 * Each line holds the scores of one thing:
 *
 *     {"study": "budgets", "row": "50 k", "what": "level 3", "dataset": "...", "command": "...",
 *      "commit": "...", "device": "...", "fma_gflops": N, "triad_gbps": N,
 *      "numbers": {"psnr_db": N, ...}}
 *
 * (study, row, what) is unique in a file; recording it again replaces the line. lab/runs/README.md
 * explains the numbers. `citysplat-lab study-record` writes such files, and `citysplat-lab
 * study-chart` draws them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_RUNS_H
#define LAB_RUNS_H

#include "core/base.h"

/* Reads all lines of a file as an array of objects. Each must have the texts study, row and what
 * and the object numbers. Release *out with json_decref. ERR_NOENT: there is no such file.
 * ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code runs_read(const char *path, struct json_t **out, struct err *e) ERR_USE;
/* Reads JSON lines without a check of their members, as benchmarks print them. Release *out with
 * json_decref. ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_MEM. */
enum err_code runs_read_lines(const char *path, struct json_t **out, struct err *e) ERR_USE;
/* Writes `lines` as JSON lines, by file_write. ERR_IO, ERR_MEM. */
enum err_code runs_write(const char *path, const struct json_t *lines, struct err *e) ERR_USE;

/* runs_text: a member's text, borrowed; "" if there is none. runs_number: a number of "numbers", or
 * of the line itself; NaN if there is none. */
const char *runs_text(const struct json_t *line, const char *key);
double runs_number(const struct json_t *line, const char *key);

#endif
