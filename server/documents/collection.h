/* Documents about datasets: collections as in OGC API Common and the 3D GeoVolumes draft.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_COLLECTION_H
#define SERVER_COLLECTION_H

#include "server/data/dataset.h"

struct collection_options {
    const char *public_url; /* address of the service as clients see it; NULL, "": not known */
    size_t city_gaussians;  /* most that the server writes into one file */
};

/* Describes a dataset. `self` is absolute with a public_url, else relative to the document.
 * ERR_MEM. */
enum err_code collection_describe(const struct dataset *d, const struct collection_options *opt,
                                  struct body **out, struct err *e) ERR_USE;
/* Describes ds [n], without replaced revisions. ERR_MEM. */
enum err_code collection_list(struct dataset *const *ds, size_t n,
                              const struct collection_options *opt, struct body **out,
                              struct err *e) ERR_USE;

#endif
