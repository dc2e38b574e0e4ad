/* What answers draw on.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SERVICES_H
#define SERVER_SERVICES_H

#include <pthread.h>

#include "core/geo.h"
#include "server/access.h"
#include "server/auth.h"
#include "server/cache.h"
#include "server/cache_policy.h"
#include "server/catalog.h"
#include "server/config.h"
#include "server/disk.h"
#include "server/flight.h"
#include "server/job.h"
#include "server/kept.h"
#include "server/metrics.h"
#include "server/picture.h"
#include "server/router.h"
#include "server/static.h"
#include "server/tls.h"

struct motion;
struct services { /* all shared, all thread-safe */
    const struct server_config *cfg;
    struct geoid *geoid;          /* --geoid; NULL: none */
    const char *url;              /* of the service: --public-url, else where it listens;
                                   * NULL: on every address */
    pthread_mutex_t catalog_lock; /* of catalog and reload_error */
    struct catalog *catalog;
    char reload_error[256]; /* why the last reload failed, "": it did not; by the same lock */
    struct static_table web;
    struct cache *cache;
    struct flight *flight;
    struct disk *disk; /* NULL: without --cache-dir */
    struct kept *kept; /* named appearances; NULL: without --state-dir */
    struct jobs *jobs;
    struct picture *picture; /* NULL: pictures are off */
    struct motion *motion;   /* streams; whoever opened it closes it, after services_free */
    struct access *access;   /* NULL: no access log */
    struct auth *auth;       /* NULL: everybody may read everything */
    struct tls *tls;         /* NULL: the first listener speaks HTTP as it is */
    struct cache_policy policy;
    struct router *routes; /* what is served */
    struct metrics metrics;
    struct body *landing, *conformance, *api, *api_page,
        *matrices;                       /* documents that never change */
    _Atomic bool draining, reload_asked; /* asked: on the listener of operators */
    double start_s;
};
/* {0} services -> ready documents; services_free takes back everything. cfg and routes[n], the
 * table of what is served (routes.h), are borrowed until then. ERR_ARG (--metrics), ERR_INTERNAL
 * (the table), ERR_MEM. */
enum err_code services_open(struct services *s, const struct server_config *cfg,
                            const struct route *routes, size_t n, struct err *e) ERR_USE;
/* False: a thread does not return, and nothing was freed (job_close). */
bool services_free(struct services *s);
struct catalog *services_catalog(struct services *s); /* a reference */
/* Seconds since the process that draws ended unasked, until it has been well for a while; 0: it
 * is. */
double services_failing_s(struct services *s);
/* From now on this one (taken; NULL: the one that is there). reload_error NULL leaves what is
 * known. */
void services_set_catalog(struct services *s, struct catalog *c, const char *reload_error);

#endif
