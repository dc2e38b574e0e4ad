/* The names of results. A name is a hash of all that determines the bytes, so equal names mean
 * equal bytes. It is the key of the cache, the id of the job and, in base64url, the strong entity
 * tag.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_RESULT_ID_H
#define SERVER_RESULT_ID_H

#include "server/base/config.h"
#include "server/data/dataset.h"
#include "server/documents/appearance_api.h"
#include "server/route/target.h"

/* Makes *id the name of the same result in an appearance. */
void result_id_mix(struct hash128 *id, const struct appearance_choice *a);
/* Writes an edition: a short hash of a name [n]. */
void result_id_edition(const void *name, size_t n, char out[9]);
/* Name of a tile. form must be complete (encode_form). */
struct hash128 result_id_tile(const struct dataset *d, const struct store_tile *t, struct form form,
                              const struct appearance_choice *a);
/* Changes a name to that of the part inside a polygon. */
void result_id_clip(struct hash128 *id, const struct target_clip *c);
/* The edition of a dataset's tiles: a hash of the inputs that determine their bytes and are in
 * neither the revision nor the rest of an address. preset: that of addresses without one. */
void result_id_tiles_edition(const struct dataset *d, unsigned preset, char out[9]);
/* Of the whole city in one file. */
struct hash128 result_id_city(const struct dataset *d, struct form f,
                              const struct appearance_choice *a);
struct hash128 result_id_seed(const struct dataset *d, const struct seed_target *t,
                              struct form form);
/* kept: hash of the named appearances */
struct hash128 result_id_appearances(const struct dataset *d, struct hash128 kept);
/* moving: its addresses lead to the current revision. part: the tile that the document begins at;
 * NULL: the entry. */
struct hash128 result_id_tileset(const struct dataset *d, const struct target_tiles *t, bool moving,
                                 const struct key *part);
/* public_url: base of its addresses; NULL: they are relative */
struct hash128 result_id_tilejson(const struct dataset *d, const char *public_url);
/* Name of a photograph's thumbnail in a revision. */
struct hash128 result_id_thumbnail(const struct dataset *d, const char *name);

#endif
