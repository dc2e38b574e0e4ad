/* What benchmarks of servers share: a store of one tile and the options of a server for it, a
 * client that keeps many connections busy with one request, and libmicrohttpd alone, to compare
 * with.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_LOAD_H
#define BENCH_LOAD_H

#include <sys/types.h>

#include "core/base.h"
#include "lod/key.h"
#include "server/config.h"

enum { LOAD_CLIENTS = 2, LOAD_CONNECTIONS = 16 /* a client */, LOAD_ZOOM = 17 };
enum { LOAD_CORE_SERVER = 0, LOAD_CORE_CLIENT = 1 };

/* A store with one tile of n Gaussians, at *key. ERR_IO, ERR_MEM. */
enum err_code load_store(const char *path, size_t n, struct key *key, struct err *e) ERR_USE;
/* The defaults, on a free port, without a device, a log, or limits of a client. ERR_MEM. */
enum err_code load_config(struct server_config *cfg, struct arena *a, struct err *e) ERR_USE;

struct load {
    uint16_t port;
    char request[512];
    size_t answer_bytes;        /* head and body: all answers have one size */
    size_t requests;            /* of each client */
    bool pinned;                /* clients stay on LOAD_CORE_CLIENT */
    double cpu_s[LOAD_CLIENTS]; /* of the clients so far */
};
int load_dial(uint16_t port); /* -1: nobody listens */
bool load_send(int fd, const char *text);
/* One request: learn the size of an answer, and keep its body and entity tag (may be NULL). ERR_IO,
 * ERR_MEM. */
enum err_code load_ask(struct load *l, struct buf *body, char etag[64], struct err *e) ERR_USE;
/* All clients until they have their answers; user is a struct load. ERR_IO, ERR_MEM. */
enum err_code load_run(void *user, struct err *e) ERR_USE;
double load_cpu_of(pid_t pid); /* seconds, in steps of the kernel's clock; 0: not known */
/* This thread, and those that it starts from now on, on one core; and back to where it was. */
void load_pin(int core);
void load_unpin(void);

/* libmicrohttpd answering everything with the same bytes from a buffer. */
struct load_bare {
    struct MHD_Daemon *daemon;
    struct MHD_Response *response;
    unsigned status;
};
/* body: borrowed until load_bare_stop. ERR_IO. */
enum err_code load_bare_start(struct load_bare *s, const struct buf *body, unsigned status,
                              unsigned threads, uint16_t *port, struct err *e) ERR_USE;
void load_bare_stop(struct load_bare *s);

#endif
