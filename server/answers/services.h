/* The services that answers use.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SERVICES_H
#define SERVER_SERVICES_H

#include <pthread.h>

#include "core/geo/geo.h"
#include "server/access/auth.h"
#include "server/access/cache_policy.h"
#include "server/answers/metrics.h"
#include "server/base/config.h"
#include "server/base/memory.h"
#include "server/data/cache.h"
#include "server/data/disk.h"
#include "server/data/live_bodies.h"
#include "server/data/named_appearance.h"
#include "server/documents/catalog.h"
#include "server/drawing/picture.h"
#include "server/http/access_log.h"
#include "server/http/static.h"
#include "server/http/tls.h"
#include "server/jobs/job.h"
#include "server/jobs/rate.h"
#include "server/route/router.h"

struct view_streams;
struct services { /* all are shared and thread-safe */
    const struct server_config *cfg;
    const struct geoid *geoid; /* --geoid; borrowed; NULL: none */
    /* address of the service: --public-url, else where it listens; NULL: it listens on every
     * address */
    const char *url;
    pthread_mutex_t catalog_lock; /* for catalog, reload_error and auth */
    struct catalog *catalog;
    char reload_error[256]; /* why the last reload failed; "": it did not fail */
    struct static_table web;
    struct cache *cache;
    struct live_bodies *live_bodies;
    struct disk *disk;                          /* NULL: no --cache-dir */
    struct named_appearance *named_appearances; /* named appearances; NULL: no --state-dir */
    struct jobs *jobs;
    struct picture *picture; /* NULL: pictures are off */
    struct view_streams
        *view_streams;         /* streams; the code that opened it closes it, after services_free */
    struct access_log *access; /* NULL: no access log */
    struct auth *auth;         /* by catalog_lock; NULL: everything is public */
    struct tls *tls;           /* NULL: the first listener has no TLS */
    struct cache_policy policy;
    pthread_mutex_t sign_in_lock;
    struct rate *sign_in;    /* by sign_in_lock: wrong tokens of each client */
    struct router *routes;   /* what is served */
    struct memory_plan plan; /* {0}: memory has no limit but those of the options */
    /* clock_s() of the last answer that was refused for want of memory, in ms; 0: none yet */
    _Atomic uint64_t short_ms;
    struct metrics metrics;
    struct body *landing, *conformance, *api, *api_page; /* documents that never change */
    _Atomic bool draining, reload_asked; /* reload_asked: by a signal, or as a store was replaced */
    _Atomic uint64_t reloads_begun;      /* by requests: names the next one */
    double start_s;
    /* Waits for a reload that begins from now on, and describes in *out what changed. An error with
     * *out: some stores could not be opened. NULL: a command without stores. */
    enum err_code (*reload)(void *user, struct body **out, struct err *e);
    void *reload_user;
    void *own; /* of a command with routes of its own (server_start_own); else NULL */
};
/* Makes the documents and services. plan NULL: {0}. End with services_free. cfg and routes [n], the
 * route table (routes.h), are borrowed until then. ERR_ARG (--metrics), ERR_INTERNAL (the table),
 * ERR_MEM. */
enum err_code services_open(struct services *s, const struct server_config *cfg,
                            const struct memory_plan *plan, const struct route *routes, size_t n,
                            struct err *e) ERR_USE;
/* False: a thread does not end, and nothing was freed (job_close). */
bool services_free(struct services *s);
/* Memory that this process and those that draw hold. */
size_t services_held_bytes(const struct services *s);
/* Makes room for `bytes`: shrinks caches and returns freed memory to the system. Any thread; does
 * not allocate. */
void services_make_room(struct services *s, size_t bytes);
/* Notes that an answer was refused for want of memory. /readyz says so for a minute. */
void services_note_short(struct services *s);
/* Seconds since then; -1: it never happened. */
double services_short_s(const struct services *s);
/* Counts a try to sign in with a token, before the token is looked at; gives it back if the token
 * was right. A client has ten wrong ones a minute. Returns the seconds until it may try again; 0:
 * now. */
double services_sign_in(struct services *s, uint64_t client, bool give_back);
struct catalog *services_catalog(struct services *s); /* a reference */
/* A document of a dataset: catalog_document. NULL: out of memory. */
struct body *services_document(const struct services *s, struct dataset *d,
                               enum dataset_document which);
struct auth *services_auth(struct services *s); /* a reference; NULL: everything is public */
/* Takes over the rights *a, and returns the earlier rights in it. */
void services_set_auth(struct services *s, struct auth **a);
/* Seconds since the drawing process first ended unexpectedly, of several since all of them did. 0:
 * a process is well, or has been well again for a while. */
double services_failing_s(struct services *s);
/* Seconds until a process that draws is started or tried again, at least 1; 0: none is waited for.
 */
int services_drawing_wait_s(struct services *s);
/* Sets the catalog (its reference is taken over; NULL: keep the present one) and reload_error
 * (NULL: keep). */
void services_set_catalog(struct services *s, struct catalog *c, const char *reload_error);

#endif
