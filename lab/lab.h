/* The commands of citysplat-lab, the laboratory: benchmarks, studies and exact truths. It is no
 * part of the product: see README.md beside this file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_LAB_H
#define LAB_LAB_H

#include "core/base.h"

/* argv[0] is the command's own name. ERR_ARG becomes exit code 2, any other error 1. */
#define COMMAND(function, name, about)                                                             \
    enum err_code lab_##function(int argc, char **argv, struct err *e) ERR_USE;
#include "lab/commands.def"
#undef COMMAND

#endif
