/* The description of the service: OpenAPI 3.0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_OPENAPI_H
#define SERVER_OPENAPI_H

#include "server/base/body.h"
#include "server/route/router.h"

/* Describes all routes. ERR_MEM. */
enum err_code openapi_describe(const struct router *routes, struct body **out,
                               struct err *e) ERR_USE;

#endif
