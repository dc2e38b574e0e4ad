/* Shared by benchmarks of servers: a store with one tile, options of a server for it, a client that
 * sends one request on many connections, and libmicrohttpd alone to compare with.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_LOAD_H
#define LAB_LOAD_H

#include <sys/types.h>

#include "core/base.h"
#include "lod/store/key.h"
#include "server/base/config.h"

enum { LOAD_CLIENTS = 2, LOAD_CONNECTIONS = 16 /* each client */, LOAD_ZOOM = 17 };
enum { LOAD_CORE_SERVER = 0, LOAD_CORE_CLIENT = 1 };

/* Writes a store with one tile of n Gaussians and returns its key. ERR_IO, ERR_MEM. */
enum err_code load_store(const char *path, size_t n, struct key *key, struct err *e) ERR_USE;
/* Writes a store with the procedural city of n Gaussians in levels of detail. ERR_IO, ERR_MEM. */
enum err_code load_city(const char *path, size_t n, struct err *e) ERR_USE;
/* Default options, but with a free port and without device, log and limits for clients. ERR_MEM. */
enum err_code load_config(struct server_config *cfg, struct arena *a, struct err *e) ERR_USE;

struct load {
    uint16_t port;
    char request[512];
    size_t answer_bytes;        /* head and body; all answers have the same size */
    size_t requests;            /* number of requests of each client */
    bool pinned;                /* clients stay on LOAD_CORE_CLIENT */
    double cpu_s[LOAD_CLIENTS]; /* CPU time of the clients so far */
};
int load_dial(uint16_t port); /* -1: no server listens */
/* As load_dial, from the address 127.0.0.`host`, which the server counts as a client of its own. */
int load_dial_from(unsigned host, uint16_t port);
bool load_send(int fd, const char *text);
/* Sends one request and keeps the size of the answer, its body and its entity tag (either may be
 * NULL). ERR_IO, ERR_MEM. */
enum err_code load_ask(struct load *l, struct buf *body, char etag[64], struct err *e) ERR_USE;
/* Runs all clients until they have all answers. `user` is a struct load. ERR_IO, ERR_MEM. */
enum err_code load_run(void *user, struct err *e) ERR_USE;
double load_cpu_of(pid_t pid); /* CPU seconds; 0: not known */
/* load_pin binds this thread, and threads that it starts later, to one core. load_unpin undoes
 * that. */
void load_pin(int core);
void load_unpin(void);

/* A server of libmicrohttpd alone, which answers all requests with the same bytes of a buffer. */
struct load_bare {
    struct MHD_Daemon *daemon;
    struct MHD_Response *response;
    unsigned status;
};
/* body is borrowed until load_bare_stop. ERR_IO. */
enum err_code load_bare_start(struct load_bare *s, const struct buf *body, unsigned status,
                              unsigned threads, uint16_t *port, struct err *e) ERR_USE;
void load_bare_stop(struct load_bare *s);

#endif
