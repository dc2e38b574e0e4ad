/* What determines the bytes of each kind of result.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/result_id.h"

#include <stdio.h>
#include <string.h>

#include "lod/store/store.h"
#include "server/route/target_query.h"

void result_id_mix(struct hash128 *id, const struct appearance_choice *a)
{
    const struct hash128 both[2] = {*id, a->hash};
    if (a->set)
        *id = hash_bytes(both, sizeof both);
}

struct hash128 result_id_tile(const struct dataset *d, const struct store_tile *t, struct form f,
                              const struct appearance_choice *a)
{
    struct { /* no padding */
        struct hash128 payload, salt;
        uint32_t z, x, y, form;
    } name = {t->hash,
              d->salt,
              t->key.z,
              t->key.x,
              t->key.y,
              (uint32_t)f.part << 25 | (uint32_t)f.trained << 24 | (uint32_t)f.format << 16 |
                  (uint32_t)f.preset << 8 | f.sh_degree};
    struct hash128 id = hash_bytes(&name, sizeof name);
    result_id_mix(&id, a);
    return id;
}

struct hash128 result_id_city(const struct dataset *d, struct form f,
                              const struct appearance_choice *a)
{
    struct { /* no padding */
        struct hash128 salt;
        char rev[16], kind[8];
        uint32_t format, unused;
    } name = {.salt = d->salt,
              .kind = "city",
              .format = (uint32_t)f.format << 16 | (uint32_t)f.preset << 8 | f.sh_degree};
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    struct hash128 id = hash_bytes(&name, sizeof name);
    result_id_mix(&id, a);
    return id;
}

void result_id_clip(struct hash128 *id, const struct target_clip *c)
{
    struct {
        struct hash128 id, clip;
    } both = {*id, hash_bytes(c->corner_e7, c->n * sizeof *c->corner_e7)};
    *id = hash_bytes(&both, sizeof both);
}

void result_id_edition(const void *name, size_t n, char out[9])
{
    snprintf(out, 9, "%08x", (unsigned)(hash_bytes(name, n).lo & 0xffffffff));
}

void result_id_tiles_edition(const struct dataset *d, unsigned preset, char out[9])
{
    const uint64_t name[3] = {d->salt.lo, d->salt.hi, preset};
    result_id_edition(name, sizeof name, out);
}

/* Add the query to the name of what is made from it. */
static void result_id_add_query(struct hash128 *id, const struct target_tiles *t)
{
    struct {
        struct hash128 id, query;
    } name = {.id = *id};
    char query[TARGET_QUERY_MAX];
    target_query_tiles(t, query);
    name.query = hash_bytes(query, strlen(query));
    *id = hash_bytes(&name, sizeof name);
}

struct hash128 result_id_seed(const struct dataset *d, const struct seed_target *t,
                              struct form form)
{
    struct { /* no padding */
        struct hash128 salt;
        char rev[16], edition[16];
        int32_t bbox_e7[4];
        uint32_t z_min, z_max, format, has_bbox, asked, preset, after, limit, moving, client;
    } name = {.salt = d->salt,
              .client = t->zooms.client,
              .after = t->page.after,
              .limit = t->page.limit,
              .moving = !t->all.names.rev[0],
              .z_min = t->zooms.z_min,
              .z_max = t->zooms.z_max,
              .format = (uint32_t)form.format,
              .asked = (uint32_t)t->tiles.form.preset << 8 | t->tiles.form.sh_degree,
              .preset = form.preset,
              .has_bbox = t->page.has_bbox};
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    memcpy(name.edition, d->edition, sizeof d->edition);
    memcpy(name.bbox_e7, t->page.bbox_e7, sizeof name.bbox_e7);
    struct hash128 id = hash_bytes(&name, sizeof name);
    result_id_add_query(&id, &t->tiles);
    return id;
}

struct hash128 result_id_appearances(const struct dataset *d, struct hash128 kept)
{
    struct {
        struct hash128 salt, kept;
        char rev[16], kind[16];
    } name = {.salt = d->salt, .kept = kept, .kind = "appearances"};
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    return hash_bytes(&name, sizeof name);
}

struct hash128 result_id_tileset(const struct dataset *d, const struct target_tiles *t, bool moving,
                                 const struct key *part)
{
    struct {
        struct hash128 salt;
        char rev[16], edition[16], kind[16];
        uint32_t z, x, y, unused;
    } name = {.salt = d->salt};
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    memcpy(name.edition, d->edition, sizeof d->edition);
    memcpy(name.kind, moving ? "tileset moving" : "tileset", moving ? 15 : 8);
    if (part) {
        memcpy(name.kind, "tileset part", 13);
        name.z = part->z;
        name.x = part->x;
        name.y = part->y;
    }
    struct hash128 id = hash_bytes(&name, sizeof name);
    result_id_add_query(&id, t);
    return id;
}

struct hash128 result_id_tilejson(const struct dataset *d, const char *public_url)
{
    struct {
        struct hash128 salt, base;
        char rev[16], edition[16], kind[16];
    } name = {.salt = d->salt, .kind = "tilejson"};
    if (public_url)
        name.base = hash_bytes(public_url, strlen(public_url));
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    memcpy(name.edition, d->edition, sizeof d->edition);
    return hash_bytes(&name, sizeof name);
}

struct hash128 result_id_thumbnail(const struct dataset *d, const char *name)
{
    struct {
        struct hash128 salt, photograph;
        char rev[16], kind[16];
    } id = {.salt = d->salt, .photograph = hash_bytes(name, strlen(name)), .kind = "thumbnail"};
    memcpy(id.rev, d->meta.revision, sizeof d->meta.revision);
    return hash_bytes(&id, sizeof id);
}
