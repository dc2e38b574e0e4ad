/* One request and its answer: the callbacks of libmicrohttpd, from the request line to the last
 * byte. cls of all callbacks is the front of the connection.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MHD_CALLBACKS_H
#define SERVER_MHD_CALLBACKS_H

#include "server/answers/services.h"
#include "server/client_watch.h"
#include "server/http/ipv6_groups.h"
#include "server/reply.h"

/* Shared by the connections of a listener. http.c fills and frees it. */
struct front {
    struct services *s;
    bool admin;                  /* the listener for operators */
    bool self;                   /* of self_test.c: neither counted nor logged */
    bool screened;               /* request_screen.c reads before libmicrohttpd */
    struct tls *tls;             /* NULL: none */
    size_t n_base;               /* length of --base-path */
    struct address_nets proxies; /* trusted proxies */
    struct hash128 secret;       /* for the numbers of clients */
    struct ipv6_groups *ipv6_groups;
    struct client_watch *watch;
    struct replies *replies;
    /* it was logged that requests come through a proxy that is not trusted */
    atomic_flag proxy_told;
    _Atomic uint64_t open, asked; /* connections now; number of requests so far, for their ids */
};

/* MHD_OPTION_NOTIFY_CONNECTION: makes and frees the state of a connection. */
void mhd_callbacks_on_connection(void *cls, struct MHD_Connection *c, void **context,
                                 enum MHD_ConnectionNotificationCode what);
/* MHD_OPTION_URI_LOG_CALLBACK: a request begins. */
void *mhd_callbacks_on_target(void *cls, const char *target, struct MHD_Connection *c);
/* The access handler. It is called for the head, the body and the end of a request, and once more
 * after a job. */
enum MHD_Result mhd_callbacks_on_request(void *cls, struct MHD_Connection *c, const char *url,
                                         const char *method, const char *version,
                                         const char *upload, size_t *n_upload, void **con_cls);
/* MHD_OPTION_NOTIFY_COMPLETED: counts, logs, frees. */
void mhd_callbacks_on_completed(void *cls, struct MHD_Connection *c, void **con_cls,
                                enum MHD_RequestTerminationCode how);
/* For client_watch_open: the client of a waiting request has hung up. */
void mhd_callbacks_on_gone(struct job_waiter *w);

#endif
