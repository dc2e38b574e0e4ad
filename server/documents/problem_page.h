/* A problem as a page, for a person whose browser opened an address that has no answer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PROBLEM_PAGE_H
#define SERVER_PROBLEM_PAGE_H

#include "server/base/body.h"

/* Makes the page of a problem document (RFC 9457) of `size` bytes: title, detail, id of the
 * request, and links to the viewer and to all addresses. home: the address of the viewer, without
 * '/' at the end. All texts are escaped. ERR_DATA: `problem` is no problem document. ERR_MEM. */
enum err_code problem_page_make(const uint8_t *problem, size_t size, const char *home,
                                struct body **out, struct err *e) ERR_USE;

#endif
