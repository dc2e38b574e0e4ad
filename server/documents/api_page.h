/* The description of the service as an HTML page.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_API_PAGE_H
#define SERVER_API_PAGE_H

#include "server/base/body.h"

/* Makes the page from the OpenAPI document (openapi.h). ERR_INTERNAL: the document is invalid.
 * ERR_MEM. */
enum err_code api_page_describe(const struct body *openapi, struct body **out,
                                struct err *e) ERR_USE;

#endif
