/* Documents about datasets: collections after OGC API Common and the 3D GeoVolumes draft.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_COLLECTION_H
#define SERVER_COLLECTION_H

#include "server/dataset.h"

struct collection_options {
    const char *public_url; /* the service's address as clients see it; NULL, "": unknown */
    const char *base_path;  /* of the service on its host; NULL, "": it has none */
    const char *basemap;    /* map tiles of somebody else that the viewer may show below its own, as
                                a URL with {z}, {x} and {y}; NULL, "": none */
    const char *attribution; /* whose they are; NULL: nobody's */
};

/* With a public_url `self` and the link to the map's tilesets are absolute; without, the first is
 * relative to the document, and the second begins with '/' (ogc_tiles.h). ERR_MEM. */
enum err_code collection_describe(const struct dataset *d, const struct collection_options *opt,
                                  struct body **out, struct err *e) ERR_USE;
/* Of ds[n], without those that a newer revision replaced. ERR_MEM. */
enum err_code collection_list(struct dataset *const *ds, size_t n,
                              const struct collection_options *opt, struct body **out,
                              struct err *e) ERR_USE;

#endif
