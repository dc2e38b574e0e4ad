/* A small city for tests of the server: three zooms at one place, one cloud of Gaussians a tile,
 * and default options.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_SERVED_H
#define TESTS_SERVED_H

#include "tests/lod/store_kit.h"

#include <stdio.h>
#include <string.h>

#include "lod/store/store.h"
#include "server/answers/dispatch.h"
#include "server/answers/routes.h"
#include "server/data/encode.h"
#include "server/server.h"

enum { SERVED_ZOOM_MIN = 15, SERVED_ZOOM_MAX = 17 };
static const struct geo_origin served_origin = {13.4, 52.5, 40};

/* n Gaussians about the middle of a tile, and its entry. Free *g with gauss_free. */
static inline struct store_entry served_gauss(struct key key, size_t n, struct gauss *g)
{
    struct err e = {0};
    double lon, lat;
    key_center(key, &lon, &lat);
    kit_gauss(key.z * 1000 + key.x % 100 * 10 + key.y % 10, n, 30, 1, 0, g);
    kit_ok(geo_to_enu(&served_origin, lon, lat, 40, g->origin_enu_m, &e), e);
    const uint8_t level = key.z < SERVED_ZOOM_MIN ? 0 : (uint8_t)(key.z - SERVED_ZOOM_MIN + 1);
    return (struct store_entry){.tile = {.key = key, .level = level}};
}

static inline void served_put(struct store *s, struct key key, size_t n)
{
    struct err e = {0};
    struct gauss g = {0};
    struct store_entry t = served_gauss(key, n, &g);
    t.shape.geometric_error_m = SERVED_ZOOM_MAX - key.z;
    kit_ok(store_put(s, &t, &g, &e), e);
    gauss_free(&g);
}

/* The tile at the origin. The city has this tile on three zooms, and a neighbour at the finest. */
static inline struct key served_key(uint8_t z)
{
    return key_at(served_origin.lon_deg, served_origin.lat_deg, z);
}

static inline void served_city(const char *path, const char *name, size_t n)
{
    struct err e = {0};
    struct store *s = NULL;
    struct store_meta meta = {.origin = served_origin,
                              .sh_degree = 1,
                              .zoom_min = SERVED_ZOOM_MIN,
                              .zoom_max = SERVED_ZOOM_MAX};
    snprintf(meta.name, sizeof meta.name, "%s", name);
    snprintf(meta.attribution, sizeof meta.attribution, "a test");
    kit_ok(store_create(path, &meta, &s, &e), e);
    for (uint8_t z = SERVED_ZOOM_MIN; z <= SERVED_ZOOM_MAX; z++)
        served_put(s, served_key(z), n);
    struct key sibling = served_key(SERVED_ZOOM_MAX);
    sibling.x ^= 1;
    served_put(s, sibling, n);
    kit_ok(store_commit(&s, &e), e);
}

static const struct catalog_options served_stores = {
    .readers = 1, .keep_s = 86400, .keep_revisions = 8};

/* A catalog of the stores at these paths and of `older`: what cannot be opened is in its list of
 * what is absent. */
static inline struct catalog *served_catalog(const char *const *paths, size_t n,
                                             const struct catalog_options *o,
                                             const struct catalog *older)
{
    struct err e = {0};
    struct arena arena = {0};
    struct catalog_place *place = NULL;
    struct catalog *c = NULL;
    size_t n_places = 0, folders;
    kit_ok(catalog_list(paths, n, older, &arena, &place, &n_places, &folders, &e), e);
    for (size_t i = 0; i < n_places; i++)
        catalog_look(&place[i], o, older);
    kit_ok(catalog_make(place, n_places, o, older, &c, &e), e);
    arena_free(&arena);
    return c;
}

/* Number of tiles, polygons and lists that ended in this way, quick and slow ones (JOB_SLOW)
 * together: which of the two a job is depends on the machine. */
static inline uint64_t served_tiles(const struct job_stats *st, enum job_end end)
{
    return st->ended[JOB_TILE][end] + st->ended[JOB_SLOW][end];
}

static inline void served_config(struct server_config *cfg, struct arena *arena)
{
    struct err e = {0};
    kit_ok(config_defaults(cfg, arena, &e), e);
    cfg->port = 0;
    cfg->device = "none";
    cfg->cache_mb = 64;
    cfg->access_log = false;
}

#endif
