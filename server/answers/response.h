/* The answer to a request, and functions that put bytes and headers into it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_RESPONSE_H
#define SERVER_RESPONSE_H

#include "server/answers/services.h"
#include "server/answers/work.h"
#include "server/base/request.h"
#include "server/documents/link_header.h"
#include "server/route/route.h"

enum { RESPONSE_TAGS = 192 };
struct response { /* {0}, then dispatch_answer; free with response_free */
    int status;
    const struct route *route;                                  /* NULL: none */
    const char *type, *cache_control, *allow, *vary, *encoding; /* static strings; NULL = none */
    const char *cache_missing;   /* Cache-Control of a 404, also of a job's; NULL: RESPONSE_SHORT */
    char *location, *set_cookie; /* owned */
    char etag[BODY_ETAG_SIZE];   /* "" = none */
    char hints[LINK_HEADER_SIZE];  /* Link for the viewer's page; "" = none */
    char surrogate[RESPONSE_TAGS]; /* tags by which caches purge, sent as tag_header */
    const char *tag_header;        /* NULL: not sent */
    bool id_sent;                  /* the client or a proxy sent the id, so the answer repeats it */
    int64_t modified_s;            /* 0: not known */
    /* the requested tile, and the name of its dataset, or "" for other requests */
    struct key tile;
    char tile_of[64];  /* problem documents name them */
    const char *id;    /* id of the request; NULL: it is not sent */
    bool unauthorized; /* send WWW-Authenticate */
    /* [n_instance] path of a target that could be parsed, for problem documents */
    const char *instance;
    size_t n_instance;
    struct body *body;   /* a reference; NULL = no bytes */
    const uint8_t *data; /* bytes to send, inside body */
    size_t size;
    uint64_t range_first, range_total; /* for 206 and 416 */
    bool accept_ranges;
    bool secret;           /* the address gives access: pages of other sites do not learn it */
    bool same_origin;      /* pages of other sites may not read it: no CORS fields */
    bool unlogged;         /* one of many small answers: counted, not logged */
    bool unnamed;          /* the bytes have no name: they are not kept and have no entity tag */
    int retry_after_s;     /* 0 = none */
    double queue_s, run_s; /* of the job, for Server-Timing; < 0: there was none */
    const char *cache;     /* "hit", "miss" or "shared": for the log */
    struct work *work;     /* not NULL: submit it, then call dispatch_finish */
    enum job_class cls;
    const struct work_kind *kind; /* of the work; NULL: there was none */
    double timeout_s;
    char stream[64], stream_of[64]; /* not "": a stream of this dataset begins */
    bool video;                     /* moving pictures are frames of a video */
};

extern const char RESPONSE_IMMUTABLE[], RESPONSE_MOVING[], RESPONSE_NO_STORE[]; /* Cache-Control */
extern const char RESPONSE_SHORT[];                                             /* of a 404 */
extern const char RESPONSE_JSON[];                                              /* Content-Type */

/* Editions of a dataset (result_id.h): hashes of the inputs that determine the bytes and are not in
 * the rest of an address. While nothing can be drawn, the edition of pictures is "". */
enum edition { EDITION_TILES, EDITION_PICTURES };
void response_edition(struct services *s, const struct dataset *d, enum edition of, char out[9]);
/* The Cache-Control by the cache class of the route. An address with a revision is immutable if it
 * has this server's edition, so that it determines all bytes. Else caches ask again after a minute.
 */
const char *response_cache_control(struct services *s, const struct dataset *d,
                                   const struct target *t);
const char *response_status_text(int status);
/* Replaces the content of `out` by a problem document (RFC 9457). */
void response_problem(struct response *out, int status, const char *detail);
/* As response_problem: 503 with Retry-After. */
void response_no_memory(struct response *out);
/* As response_problem: 500 for a tile that cannot be made; it names the tile and says what to do.
 * out->tile and tile_of must be set. */
void response_tile_problem(struct response *out, bool damaged);
/* Answers 400, 404, 422 or 503, by the result of reading a posted document or a query. */
void response_refused(struct response *out, enum err_code rc, const char *detail);
/* Answers 200, 206, 304 or 416 with `b`, whose reference it takes over (NULL: out of memory). type
 * and cache_control must be set. */
void response_body(const struct request *r, struct body *b, struct response *out);
/* As response_body, with type. */
void response_document(const struct request *r, const char *type, struct body *b,
                       struct response *out);
/* Answers at once if possible: with 304 by the name `id`, or with a result in a cache. Returns true
 * if a job must make it; the caller then sets the work (response_work). With out->unnamed it always
 * returns true. */
bool response_made(struct services *s, const struct request *r, struct hash128 id,
                   struct response *out);
/* Makes work for a job, in out->work. Its result is kept unless out->unnamed. Returns the zeroed
 * parameters of the kind. NULL: out of memory; the problem is set. */
void *response_work(struct dataset *d, const struct work_kind *kind, struct hash128 id,
                    struct response *out);
void response_free(struct response *r);

#endif
