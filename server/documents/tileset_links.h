/* The templates of tiles and parts in a served tileset.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TILESET_LINKS_H
#define SERVER_TILESET_LINKS_H

#include "lod/export/tileset.h"
#include "server/data/dataset.h"

/* The document that has the templates: the entry of a revision, a part of it, or the entry of the
 * current revision. */
enum tileset_links_of { TILESET_LINKS_ENTRY, TILESET_LINKS_PART, TILESET_LINKS_MOVING };
/* Makes the templates. query: for each tile, "" or "?...". text holds what *out points to; free it
 * with buf_free. ERR_MEM. */
enum err_code tileset_links_make(const struct dataset *d, enum tileset_links_of of,
                                 const char *query, struct buf *text, struct tileset_links *out,
                                 struct err *e) ERR_USE;

#endif
