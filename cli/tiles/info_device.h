/* citysplat info --device.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_INFO_DEVICE_H
#define CLI_INFO_DEVICE_H

#include "core/base.h"

/* Opens a device, builds the programs that pictures and training need, and adds to the object `out`
 * what it is, which way of compiling its driver survives, and where each program came from. The
 * errors of dev_open and dev_build. */
enum err_code info_device(const char *want, struct json_t *out, struct err *e) ERR_USE;

#endif
