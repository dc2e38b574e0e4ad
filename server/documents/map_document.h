/* Documents that lead map programs to the tiles of a dataset: TileJSON of colours and of heights, a
 * style for MapLibre, and WMTS capabilities.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MAP_DOCUMENT_H
#define SERVER_MAP_DOCUMENT_H

#include "server/data/dataset.h"
#include "server/route/target.h"

struct map_document_ask {
    const char *appearance; /* "": the default; NULL: tiles of heights */
    enum encoding encoding; /* of heights */
    bool ground;            /* heights of bare ground */
};
/* edition: of the tiles (result_id.h); "": not known yet. base: address of the service as clients
 * see it, with or without '/' at its end. NULL or "": addresses are relative to the document; WMTS
 * has no such addresses (ERR_ARG). ERR_MEM. */
enum err_code map_document_tilejson(const struct dataset *d, const char *edition,
                                    const struct map_document_ask *ask, const char *base,
                                    struct body **out, struct err *e) ERR_USE;
/* A style (version 8): the city from straight above on its terrain, with hillshade, and a view that
 * frames it in a window of 640 x 480 or larger. */
enum err_code map_document_style(const struct dataset *d, const char *edition,
                                 const char *appearance, const char *base, struct body **out,
                                 struct err *e) ERR_USE;
enum err_code map_document_wmts(const struct dataset *d, const char *edition,
                                const char *appearance, const char *base, struct body **out,
                                struct err *e) ERR_USE;

#endif
