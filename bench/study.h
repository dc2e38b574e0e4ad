/* The commands of citysplat-study: what is measured becomes records, charts and tables of docs/.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_STUDY_H
#define BENCH_STUDY_H

#include "core/err.h"

/* argv[0] is the command's own name. ERR_ARG for what a user mistyped; ERR_NOENT, ERR_IO,
 * ERR_FORMAT, ERR_DATA of files; ERR_MEM. */
enum err_code study_record(int argc, char **argv, struct err *e) ERR_USE;
enum err_code study_chart(int argc, char **argv, struct err *e) ERR_USE;

#endif
