/* Internal to core/: what dev.c and dev_build.c share.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_DEV_INTERNAL_H
#define CORE_DEV_INTERNAL_H

#include <stdint.h>

#include "core/err.h"

/* Says that `what`, about `which`, failed with an OpenCL code (a cl_int). ERR_MEM for what more
 * memory would cure, ERR_DEVICE for the rest. */
enum err_code dev_fail(struct err *e, int32_t code, const char *what, const char *which) ERR_USE;

#endif
