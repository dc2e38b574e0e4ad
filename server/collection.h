/* Documents about datasets: collections after OGC API Common and the 3D GeoVolumes draft.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_COLLECTION_H
#define SERVER_COLLECTION_H

#include "server/dataset.h"

/* References are the caller's. ERR_MEM. */
enum err_code collection_describe(const struct dataset *d, struct body **out,
                                  struct err *e) ERR_USE;
/* Of ds[n], without those that a newer revision replaced. basemap: map tiles of somebody else that
 * the viewer may show below its own, as a URL with {z}, {x} and {y}, and whose they are; NULL, "":
 * none. ERR_MEM. */
enum err_code collection_list(struct dataset *const *ds, size_t n, const char *basemap,
                              const char *attribution, struct body **out, struct err *e) ERR_USE;

#endif
