/* What the viewer's page will ask for, said before its scripts are there.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_HINT_H
#define SERVER_HINT_H

#include "server/catalog.h"

enum { HINT_SIZE = 768 };
/* The value of a Link field (RFC 8288; rel=preload of the HTML standard) for the page with this
 * query, [n] bytes as they were sent, without its '?': the catalogue, then tileset, network and
 * coarsest tile of the scene that the page opens. "" where the query sends the page to another
 * server. */
void hint_write(const struct catalog *c, const char *query, size_t n, char out[HINT_SIZE]);

#endif
