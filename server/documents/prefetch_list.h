/* Prefetch lists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PREFETCH_LIST_H
#define SERVER_PREFETCH_LIST_H

#include "server/data/dataset.h"
#include "server/documents/appearance_api.h"
#include "server/route/target.h"

struct crop_node;
struct server_config;

/* Appends a page of the tiles that t selects, most important first, as JSON lines, then the address
 * of the next page if there is one. A tile is a line, or, for a client, a line for each form in
 * which that client asks for it. left: what the polygon of t leaves of the tiles
 * (lod/export/crop.h); NULL: all. form, a: for entity tags; addresses have them if t does.
 * ERR_MEM. */
enum err_code prefetch_list_write(const struct server_config *cfg, const struct dataset *d,
                                  const struct seed_target *t, const struct crop_node *left,
                                  struct form form, const struct appearance_choice *a,
                                  struct buf *out, struct err *e) ERR_USE;
/* Upper limit of the result's bytes. */
size_t prefetch_list_room(const struct dataset *d, const struct seed_target *t);

#endif
