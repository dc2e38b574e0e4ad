/* The names of drawn results (result_id.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PICTURE_ID_H
#define SERVER_PICTURE_ID_H

#include "lod/surface/query.h"
#include "server/data/dataset.h"
#include "server/drawing/draw.h"

/* The edition of a dataset's pictures and maps. */
void picture_id_edition(const struct dataset *d, const char *device, int quality, int supersample,
                        double gaussians, char out[9]);
/* Name of a picture. That of a moving camera says what was asked for: its bytes also depend on the
 * pictures before. device: name and driver, because other hardware rounds differently. gaussians:
 * the limit of Gaussians. */
struct hash128 picture_id_view(const struct dataset *d, const char *device,
                               const struct draw_view *v, const struct appearance_choice *a,
                               double gaussians);
/* geoid: name of the model; "": none. */
struct hash128 picture_id_query(const struct dataset *d, const char *device, const char *geoid,
                                const struct query *q);
/* flat: the tile shows nothing of the survey, so all such tiles are the same. */
struct hash128 picture_id_map(const struct dataset *d, const char *device, const struct map_tile *t,
                              bool flat, const struct appearance_choice *a);

#endif
