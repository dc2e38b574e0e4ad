/* A route: one row of routes.def. The parser (router.c), the dispatch (dispatch.c), the links
 * (link.c), the OpenAPI document and the page of addresses all read this row. No other file has a
 * path.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ROUTE_H
#define SERVER_ROUTE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "server/base/request.h"

struct dataset;
struct response;
struct services;
struct target;

/* Who may ask, as bits. The first listener is the public one, the second is --admin. */
enum {
    SCOPE_PUBLIC = 1,    /* the public listener answers */
    SCOPE_OPERATORS = 2, /* the listener of operators answers */
    SCOPE_DATASET = 4,   /* the route belongs to one dataset: --auth decides who may read that */
    SCOPE_RENDER = 8,    /* --auth decides who may request drawings of this dataset */
    SCOPE_MOVES = 16,    /* with --admin the public listener does not answer it */
    SCOPE_FILE = 32,     /* a file of the viewer; without such a file there is no route */
    SCOPE_SIGNED = 64,   /* the seal that opens the rest of the path, which is a path of its own */
    SCOPE_STATE = 128,   /* PUT and DELETE need --state-dir */
};
/* What caches may do with an answer. */
enum route_cache {
    CACHE_NONE,     /* no-store */
    CACHE_MOVING,   /* 60 s */
    CACHE_TILES,    /* immutable if the address has the edition of tiles, else 60 s */
    CACHE_PICTURES, /* the same, with the edition of pictures */
    CACHE_STORE,    /* immutable: the bytes are in the store */
};
/* The queue of an answer, and the client's limit that it counts against, if it needs a job. */
enum route_rate {
    RATE_MEMORY, /* never a job */
    RATE_LISTS,
    RATE_TILES,
    RATE_VIEWS,
    RATE_MAPS,
    RATE_THUMBNAILS,
};
enum { ROUTE_GROUPS = 15 }; /* of parameters: enum target_group */

/* Fills the response. It does not block and cannot fail: a failure is an answer, too. d is NULL for
 * a route without SCOPE_DATASET. */
typedef void route_function(struct services *s, const struct request *r, struct dataset *d,
                            const struct target *t, struct response *out);

enum { ROUTE_METHODS = 4 };
struct route_method {
    enum method method;
    route_function *answer; /* NULL: no more methods */
    const char *takes;      /* schema of the body; NULL: there is no body */
    /* "STATUS MEDIA|MEDIA SCHEMA,STATUS,": its answers. Problems are not listed. */
    const char *gives;
    const char *about;
    bool whole; /* GET: never 206, 304 or 416 */
};
struct route {
    const char *name;
    const char *path; /* template with {parameter} and [optional part] */
    unsigned scope;
    enum route_cache cache;
    enum route_rate rate;
    unsigned takes;            /* groups of parameters, bits 1 << enum target_group */
    uint16_t size;             /* bytes of its target */
    uint16_t at[ROUTE_GROUPS]; /* where each of its groups is in its target; 0: it has not */
    struct route_method on[ROUTE_METHODS]; /* HEAD follows from GET, OPTIONS from all */
};
/* The row's entry for a method. NULL: there is none. */
const struct route_method *route_on(const struct route *r, enum method method);
/* The value of Allow, with HEAD and OPTIONS. changes: PUT and DELETE are possible; they always
 * occur together. */
const char *route_allow(const struct route *r, bool changes);
const char *route_path(const struct route *r); /* "unmatched" for NULL */
/* Returns whether a GET answers with a document or a redirect, which name other addresses, and not
 * with bytes alone. */
bool route_names_others(const struct route *r);
/* Returns whether a GET answers with a redirect to the current revision. */
bool route_redirects(const struct route *r);

#endif
