/* Parses a request target: finds its row of the route table and the values of its parameters.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ROUTER_H
#define SERVER_ROUTER_H

#include "server/route/param.h"
#include "server/route/route.h"

struct router; /* immutable; any thread */

/* Opens a router. rows [n] and what they point to are borrowed until router_close. ERR_INTERNAL: a
 * template is invalid, or names a parameter that params.def does not have. ERR_MEM. */
enum err_code router_open(const struct route *rows, size_t n, struct router **out,
                          struct err *e) ERR_USE;
void router_close(struct router **r);
/* router_rows: the rows in the order of the table. router_index: the position of a row; for NULL it
 * is the number of rows. */
const struct route *router_rows(const struct router *r, size_t *n);
size_t router_index(const struct router *r, const struct route *row);
/* The parameters of a row: those of its path, in order and in their form for this path, or those
 * that its query may have. Returns their number. The array lives as long as r. */
size_t router_params(const struct router *r, const struct route *row, bool of_query,
                     const struct param *const **out);
/* Replaces, in place, percent-encoded characters of the path that it may have plainly, such as
 * "%2C" and "%40" (RFC 3986, 6.2.2.2). Others stay: "%2F" is no slash. Returns the new length. */
size_t router_unescape(char *text);
/* Parses text [n], which may contain a NUL. ERR_FORMAT: it has bytes that no valid target has
 * (400). ERR_DATA: it is well formed, with impossible numbers (422). ERR_NOENT: there is no such
 * route, or a tile key is out of range (404). */
enum err_code router_read(const struct router *r, const char *text, size_t n, union target_any *out,
                          struct err *e) ERR_USE;

#endif
