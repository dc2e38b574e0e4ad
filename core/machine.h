/* The memory that this program may use.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_MACHINE_H
#define CORE_MACHINE_H

#include <stddef.h>

#include "core/err.h"

/* Memory of this machine, or of the tightest control group that this process is in. */
size_t machine_memory(void);
/* The same from a file like /proc/self/cgroup and a folder like /sys/fs/cgroup, of version 1 or 2
 * of control groups. */
size_t machine_memory_limit(size_t physical, const char *cgroup, const char *root);
/* Parses the value of --memory: "auto" (half of `machine`), or a number with k, M or G: 512M.
 * ERR_ARG. */
enum err_code machine_memory_parse(const char *text, size_t machine, size_t *out,
                                   struct err *e) ERR_USE;

#endif
