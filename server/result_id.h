/* The names of results. A name is a hash of everything that decides the bytes, so equal names are
 * equal bytes: it is the key of the cache, the id of the job and, written in base64url, the strong
 * entity tag.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_RESULT_ID_H
#define SERVER_RESULT_ID_H

#include "core/camera.h"
#include "lod/query.h"
#include "server/appearance_api.h"
#include "server/config.h"
#include "server/course.h"
#include "server/dataset.h"
#include "server/map_tile.h"
#include "server/target.h"

/* form has nothing left unsaid (encode_form). */
struct hash128 result_id_tile(const struct dataset *d, const struct store_tile *t, struct form form,
                              const struct appearance_choice *a);
/* The same of what a polygon leaves of it. */
void result_id_clip(struct hash128 *id, const struct target_clip *c);
/* The edition of a dataset's tiles: what decides their bytes beside the revision and the rest of an
 * address. preset: of those that do not say one. */
void result_id_tiles_edition(const struct dataset *d, unsigned preset, char out[9]);
/* The same of its pictures and maps. */
void result_id_pictures_edition(const struct dataset *d, const char *device, int quality,
                                int supersample, double gaussians, char out[9]);
struct hash128 result_id_seed(const struct dataset *d, const struct target *t,
                              const struct course *c, struct form form); /* c: NULL: none */
/* kept: hash of the names that are kept. */
struct hash128 result_id_search(const struct dataset *d, const struct target *t,
                                struct hash128 kept);
/* part: the tile that the document begins at; NULL: the entry. */
struct hash128 result_id_tileset(const struct dataset *d, const struct target *t,
                                 const struct key *part);
/* A photograph's thumbnail in a revision. */
struct hash128 result_id_thumbnail(const struct dataset *d, const char *name);
/* device: its name and driver; other hardware rounds otherwise. gaussians: most that are drawn. */
struct hash128 result_id_view(const struct dataset *d, const char *device, const struct camera *cam,
                              const struct appearance_choice *a, enum format format, int quality,
                              const struct paint *paint, double gaussians);
/* geoid: name of the model, "": none. */
struct hash128 result_id_query(const struct dataset *d, const char *device, const char *geoid,
                               const struct query *q);
/* flat: nothing of the survey is in it, so all such tiles are the same. */
struct hash128 result_id_map(const struct dataset *d, const char *device, const struct map_tile *t,
                             bool flat, const struct appearance_choice *a);

#endif
