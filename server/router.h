/* From a request target to a row of the route table and the values of its parameters.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ROUTER_H
#define SERVER_ROUTER_H

#include "server/param.h"
#include "server/route.h"

struct router; /* immutable: any thread */

/* rows[n] and what they point to are borrowed until router_close. ERR_INTERNAL: a template names a
 * parameter that params.def does not have, or is no template. ERR_MEM. */
enum err_code router_open(const struct route *rows, size_t n, struct router **out,
                          struct err *e) ERR_USE;
void router_close(struct router **r);
/* The rows, in the order of the table, and the place of one in it; that of NULL is their number. */
const struct route *router_rows(const struct router *r, size_t *n);
size_t router_index(const struct router *r, const struct route *row);
/* The parameters of a row: those of its path in their order (of a name its form in this path), and
 * those that its query may have. Returns how many; the array is valid as long as r is. */
size_t router_path_params(const struct router *r, const struct route *row,
                          const struct param *const **out);
size_t router_query_params(const struct router *r, const struct route *row,
                           const struct param *const **out);
/* Read text[n], which may hold a NUL. ERR_FORMAT: bytes that no legal target has (400). ERR_DATA:
 * well formed, impossible numbers (422). ERR_NOENT: no such route, or a key out of range (404). */
enum err_code router_read(const struct router *r, const char *text, size_t n, struct target *out,
                          struct err *e) ERR_USE;

#endif
