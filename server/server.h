/* The server: tile stores in, HTTP out. A program needs only this header: start, reload, stop. A
 * request passes these files in this order, which is also the reading order; each uses only those
 * above it:
 *
 *     config           options
 *     body, body_file  bytes that several answers share, with their entity tag; large ones in files
 *     condition        headers of conditional, partial and negotiated requests
 *     route, param     rows of the route table; typed parameters
 *     router           a target becomes a row and integers; no byte of it becomes a path of a file
 *     screen, guard    refuse invalid requests
 *     cache, job       results in memory, limited in bytes; work in limited queues
 *     document, static JSON documents; the viewer's files
 *     memory           what the machine has, and the shares of --memory
 *     kept             named appearances, in a file
 *     encode           a tile in a format
 *     dataset          one revision of one store: index, handles, documents
 *     appearance_api   the appearances of a dataset
 *     result_id        the name of a result: a hash of all that determines its bytes
 *     link             addresses in documents and answers
 *     seed, collection prefetch lists; documents about datasets
 *     catalog          the datasets at one moment, and the stores that are not served
 *     worker           a second process of the program: started, asked, killed, started again
 *     draw             its work: cameras to pictures, on the device that it alone has
 *     picture          sends requests to it
 *     access, metrics  logs and counters
 *     services         all of the above, for answers
 *     work             what a job does
 *     response         puts bytes and headers into an answer
 *     answer_*         the answers, one family a file
 *     dispatch         request + services -> response
 *     watch            slow, idle and gone clients
 *     listen, http     libmicrohttpd -> struct request; suspends and resumes
 *     stores           opens stores, tries those again that failed, makes catalogs
 *     server           starts and stops all
 *
 * No slow work is done in an HTTP thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SERVER_H
#define SERVER_SERVER_H

#include <stdio.h>

#include "core/base.h"
#include "server/base/config.h"

struct server;
struct services;
struct route;

/* Opens the stores at paths [n], which are files, folders of stores, or addresses, and listens.
 * Requests are answered when it returns.
 *
 *     cfg    copied, its texts borrowed until server_stop
 *     paths  borrowed until server_stop (server_reload reads them again)
 *     out    end with server_stop; NULL on failure
 *
 * It makes the process ignore SIGPIPE. A store that cannot be opened is left out, and tried again
 * (server_expire); /readyz says so. ERR_ARG (an address), ERR_BUSY (the port is in use), ERR_LIMIT
 * (viewer files), ERR_MEM; ERR_IO, ERR_FORMAT, ERR_DATA, ERR_NOENT (files alone were given, and
 * none can be opened). A device that cannot be opened is no error: pictures are off until it can
 * be. */
enum err_code server_start(const struct server_config *cfg, const char *const *paths, size_t n,
                           struct server **out, struct err *e) ERR_USE;

/* Checks the memory in use. Beyond --memory, it returns freed memory to the system and shrinks
 * caches. Call it a few times a second. */
void server_keep_memory(struct server *sv, double now_s);
/* A service of a command, for one person: no stores, a route table of its own, and the viewer's
 * files. */
struct server_own {
    const struct route *routes; /* [n], as in routes.h */
    size_t n;
    void *data; /* for their functions: services.own */
};
/* As server_start. own is borrowed until server_stop. */
enum err_code server_start_own(const struct server_config *cfg, const struct server_own *own,
                               struct server **out, struct err *e) ERR_USE;
size_t server_count(struct server *s); /* datasets that are served now */
/* "http://127.0.0.1:8080/", with the port in use. It lives until server_stop. */
const char *server_url(const struct server *s);

/* The services of its answers (server/answers/services.h), for tests and benchmarks. They live
 * until server_stop. */
struct services *server_services(struct server *s);

/* Opens the stores again, those of folders as they are now, and reads --auth and the certificate.
 * Replaced revisions stay for a day (--keep-s). It logs what changed, and tells the supervisor and
 * /readyz. Of a store that cannot be opened, what was served before stays; the error is that of the
 * first one. After another error the same stores are served; a new --auth file is in force all the
 * same. Any thread. ERR_ARG, ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_DATA, ERR_LIMIT, ERR_BUSY
 * (also: the server is stopping), ERR_MEM. */
enum err_code server_reload(struct server *s, struct err *e) ERR_USE;
/* Asks for a reload, and does not wait: opening a file may take long, on a slow disk or at another
 * server. A thread of the server does it. */
void server_ask_reload(struct server *s);
/* From now on that thread calls server_look and server_expire, and reloads where server_look asks
 * for it. */
void server_keep(struct server *s);
/* Looks whether a store at an address was replaced at its server, and if so, asks for a reload
 * (server_reload_asked). Every --remote-refresh-s the servers are asked, by this thread. For
 * server_keep, and for tests. */
void server_look(struct server *s, double now_s);
/* Drops revisions whose time is over, by clock_s(), and tries stores again that could not be
 * opened. For server_keep, and for tests. */
void server_expire(struct server *s, double now_s);

/* Stops listening, finishes requests within the configured times, and frees everything. *s may be
 * NULL and becomes NULL. False: a thread does not return from a call. What it uses is not freed,
 * and the program should end without waiting for it (_exit). */
bool server_stop(struct server **s);
/* Returns whether a reload was asked for since the last call. For server_keep, and for tests. */
bool server_reload_asked(struct server *s);
/* Returns whether the server answers a request of its own within wait_s. For a watchdog. */
bool server_answers(const struct server *s, double wait_s);
uint16_t server_admin_port(const struct server *s); /* 0: there is none */
/* Checks what server_start would do, except for ports and the device. It opens everything and
 * closes it again, and prints what it found to `out` (may be NULL). Errors of server_start. */
enum err_code server_check(const struct server_config *cfg, const char *const *paths, size_t n,
                           FILE *out, struct err *e) ERR_USE;
/* Seconds since the drawing process first ended unexpectedly. 0: the process is well, or has been
 * well again for a while. */
double server_failing_s(struct server *s);

#endif
