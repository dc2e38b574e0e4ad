/* The server: tile stores in, HTTP out. This is all that a program needs: start, reload, stop. One
 * request's way, which is also the reading order, each file knowing only those above it:
 *
 *   config.h         options
 *   body             bytes that several answers share, with their entity tag
 *   condition        conditional, partial and negotiated requests (headers to decisions)
 *   target           the target, once, into integers and enums: no byte of it ever becomes a path
 *   screen, guard    which requests are refused before anything looks at them
 *   cache, job       what was made, bounded in bytes; what is to be made, in bounded queues
 *   document, static JSON documents; the viewer's files
 *   kept             appearances under names, in a file of their own
 *   encode           a tile in a format
 *   dataset          one revision of one store: index, handles, documents
 *   appearance_api   the appearances of a dataset
 *   result_id        the name of a result: a hash of all that decides its bytes
 *   seed, collection prefetch lists; documents about datasets
 *   catalog          the datasets at one moment
 *   worker           a second process of the program: started, asked, killed, started again
 *   draw             what it does: cameras to pictures, on the device that it alone has
 *   picture          which of the datasets it has open; asking it
 *   access, metrics  what is logged and counted
 *   services         all of the above together: what answers draw on
 *   work             what a job does
 *   response         putting bytes and headers into an answer
 *   answer_*         the answers, a family a file
 *   route            request + services -> response, pure
 *   watch            slow, idle and gone clients
 *   listen, http     libmicrohttpd -> struct request; suspends and resumes
 *   server           starts it all and takes it down
 *
 * Nothing slow happens on an HTTP thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SERVER_H
#define SERVER_SERVER_H

#include <stdio.h>

#include "core/base.h"
#include "server/config.h"

struct server;
struct services;

/* Open the stores at paths[n] and listen; answers may be asked for when this returns.
 *
 *   cfg    copied, its texts borrowed until server_stop
 *   paths  borrowed until server_stop (server_reload reads them again)
 *   out    server_stop it; NULL on failure
 *
 * Ignores SIGPIPE for the process. Errors: ERR_ARG (address, two datasets of one name), ERR_BUSY
 * (the port is taken), ERR_IO, ERR_FORMAT, ERR_DATA, ERR_NOENT (a store cannot be opened),
 * ERR_LIMIT (viewer files), ERR_MEM. A device that does not open is no error: pictures are then
 * off.
 */
enum err_code server_start(const struct server_config *cfg, const char *const *paths, size_t n,
                           struct server **out, struct err *e) ERR_USE;

/* "http://127.0.0.1:8080/", with the port that was taken. Lives until server_stop. */
const char *server_url(const struct server *s);

/* What its answers draw on (server/services.h), for tests and benches. Lives until server_stop. */
struct services *server_services(struct server *s);

/* Open the stores again. Revisions that were replaced stay for a day (--keep-s, --keep-revisions).
 * On any error (those of server_start about stores) the old data stay, and /readyz says so. One
 * caller at a time, of the next function as well. */
enum err_code server_reload(struct server *s, struct err *e) ERR_USE;
/* Let go of revisions whose day is over, by clock_s(); to be called now and then. */
void server_expire(struct server *s, double now_s);

/* Stop listening, finish what is under way within the configured times, free everything. Accepts
 * NULL inside, leaves NULL. False: a thread does not return from a call; what it uses is not freed,
 * and the program had better end without waiting for it (_exit). */
bool server_stop(struct server **s);
/* Has an operator asked for a reload (POST /-/reload on the listener of --admin) since the last
 * call? */
bool server_reload_asked(struct server *s);
/* Does it answer a request of its own within wait_s? For a watchdog. */
bool server_answers(const struct server *s, double wait_s);
uint16_t server_admin_port(const struct server *s); /* 0: there is none */
/* Would server_start do, but for ports and the device? Opens what it would open, and closes it
 * again; says what there is on `out` (may be NULL). Its errors. */
enum err_code server_check(const struct server_config *cfg, const char *const *paths, size_t n,
                           FILE *out, struct err *e) ERR_USE;
/* Seconds since the process that draws ended unasked, until it has been well for a while; 0: it
 * is. */
double server_failing_s(struct server *s);

#endif
