/* The OpenAPI description of the service.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_OPENAPI_H
#define SERVER_OPENAPI_H

#include "server/body.h"

/* Made from the route table, so that no route is missing. A reference is the caller's. ERR_MEM. */
enum err_code openapi_describe(struct body **out, struct err *e) ERR_USE;

#endif
