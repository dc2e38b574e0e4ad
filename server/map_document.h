/* The documents by which maps find the tiles of a dataset seen from above: TileJSON of colours and
 * of heights, WMTS capabilities.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MAP_DOCUMENT_H
#define SERVER_MAP_DOCUMENT_H

#include "server/dataset.h"
#include "server/target.h"

enum map_document_of { MAP_DOCUMENT_COLOURS, MAP_DOCUMENT_TERRAIN };
/* edition: of the tiles (result_id.h), "": unknown yet. t: the appearance or encoding that the
 * tiles are asked for with. base: address of the service as clients see it, with or without '/' at
 * its end; NULL or "": addresses are relative to the document's own, which WMTS does not know
 * (ERR_ARG). ERR_MEM. */
enum err_code map_document_tilejson(const struct dataset *d, const char *edition,
                                    enum map_document_of of, const struct target *t,
                                    const char *base, struct body **out, struct err *e) ERR_USE;
enum err_code map_document_wmts(const struct dataset *d, const char *edition,
                                const struct target *t, const char *base, struct body **out,
                                struct err *e) ERR_USE;

#endif
