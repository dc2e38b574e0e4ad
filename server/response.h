/* A request, its answer, and putting bytes and headers into the answer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_RESPONSE_H
#define SERVER_RESPONSE_H

#include "server/hint.h"
#include "server/route.h"
#include "server/services.h"
#include "server/work.h"

enum { REQUEST_FIELDS_MAX = 64 }; /* more are refused */
struct request {                  /* borrowed from the connection */
    enum method method;
    const char *target; /* raw, as sent */
    size_t target_size;
    /* NULL when absent: */
    const char *accept, *accept_encoding, *if_none_match, *if_match, *if_range, *range;
    const char *authorization;
    const char *forwarded[REQUEST_FIELDS_MAX]; /* [n_forwarded], X-Forwarded-For */
    size_t n_forwarded;
    const char *host, *forwarded_host, *forwarded_proto; /* NULL: absent */
    bool proxied;                                        /* a proxy says that it is there */
    bool trusted;                                        /* the connection is of a trusted proxy */
    const char *referer, *agent;                         /* for the log */
    const char *id;                                      /* of the request; NULL: none */
    bool id_sent; /* by the client or a proxy: it comes back */
    bool admin;   /* it came to the listener of operators */
    const char *if_modified_since;
    const void *body;
    size_t body_size;
    bool prefetch;  /* Sec-Purpose: prefetch, or a low Priority */
    bool from_page; /* Origin came with it: a page of some site asks */
    bool local;     /* the client is this machine, and nothing says that it asks for another */
};
enum { RESPONSE_TAGS = 192 };
struct response { /* {0}, then dispatch_answer; response_free it */
    int status;
    const struct route *route;                                  /* NULL: none */
    const char *type, *cache_control, *allow, *vary, *encoding; /* static strings, NULL = none */
    char *location;                                             /* owned */
    char etag[BODY_ETAG_SIZE];                                  /* "" = none */
    char hints[HINT_SIZE];         /* Link of the viewer's page; "" = none */
    char surrogate[RESPONSE_TAGS]; /* tags by which caches purge, sent as tag_header */
    const char *tag_header;        /* NULL: not sent */
    bool id_sent;                  /* the client or a proxy sent the id: it comes back */
    int64_t modified_s;            /* 0: not said */
    struct key tile;   /* that is asked for, and the name of its dataset, "" for anything else: */
    char tile_of[64];  /* what a problem with it names */
    const char *id;    /* of the request; NULL: it is not sent */
    bool unauthorized; /* WWW-Authenticate goes with it */
    const char *instance; /* the path of a target that could be read, [n_instance]: for problems */
    size_t n_instance;
    struct body *body;   /* a reference; NULL = no bytes */
    const uint8_t *data; /* what to send: inside body */
    size_t size;
    uint64_t range_first, range_total; /* of 206 and 416 */
    bool accept_ranges;
    bool same_origin;      /* pages of other sites may not read it: no CORS fields */
    bool unlogged;         /* one of many small ones: counted, not logged */
    bool unnamed;          /* the bytes have no name: nothing keeps them, and they have no tag */
    int retry_after_s;     /* 0 = none */
    double queue_s, run_s; /* of the job, for Server-Timing; < 0: there was none */
    const char *cache;     /* "hit", "miss", "shared": for the log */
    struct work *work;     /* not NULL: submit it, then dispatch_finish */
    enum job_class cls;
    enum work_kind kind; /* of the work */
    double timeout_s;
    char stream[64], stream_of[64]; /* not "": a stream begins, of this dataset */
};

extern const char RESPONSE_IMMUTABLE[], RESPONSE_MOVING[], RESPONSE_NO_STORE[]; /* Cache-Control */
extern const char RESPONSE_JSON[];                                              /* Content-Type */

/* Editions of a dataset: what decides the bytes and is in no other part of an address
 * (result_id.h). That of pictures is "" while nothing can be drawn. */
enum edition { EDITION_TILES, EDITION_PICTURES };
void response_edition(struct services *s, const struct dataset *d, enum edition of, char out[9]);
/* By the cache class of the route. Of an address with a revision: immutable where it names this
 * server's edition, so that it says all that decides the bytes; else caches ask again after a
 * minute. */
const char *response_cache_control(struct services *s, const struct dataset *d,
                                   const struct target *t);
const char *response_status_text(int status);
/* A problem document (RFC 9457) in place of whatever `out` held. */
void response_problem(struct response *out, int status, const char *detail);
/* The same, 503 with Retry-After. */
void response_no_memory(struct response *out);
/* 500 for a tile that cannot be made: which one, and what to do. out->tile and tile_of are set. */
void response_tile_problem(struct response *out, bool damaged);
/* 400, 404, 422 or 503, by what reading a posted document or a query returned. */
void response_refused(struct response *out, enum err_code rc, const char *detail);
/* 200, 206, 304 or 416 with `b`, whose reference is taken (NULL: out of memory). type and
 * cache_control are set already. */
void response_body(const struct request *r, struct body *b, struct response *out);
/* The same, with its type. */
void response_document(const struct request *r, const char *type, struct body *b,
                       struct response *out);
/* The result of work with a known name: 304 and hits are answered now; true when a job has to make
 * it, and the caller says which (response_work). Of out->unnamed always: nobody has it. */
bool response_made(struct services *s, const struct request *r, struct hash128 id,
                   struct response *out);
/* New work for a job, in out->work, whose result is kept unless out->unnamed; NULL, with the
 * problem set, when out of memory. */
struct work *response_work(struct dataset *d, enum work_kind kind, struct hash128 id,
                           struct form form, struct response *out);
void response_free(struct response *r);

#endif
