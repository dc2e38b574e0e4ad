/* A self-test: the server sends requests to itself before it reports that it is ready.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SELF_TEST_H
#define SERVER_SELF_TEST_H

#include "server/answers/services.h"

/* Opens a listener on loopback that answers as the public one does, but is neither logged nor
 * counted, and asks it for /healthz and all of malformed.def; with s->tls once more by TLS. It
 * needs s->jobs, and takes some 10 ms. ERR_INTERNAL: this libmicrohttpd reads or answers in a way
 * that this program was not written for; the errors of http_open. */
enum err_code self_test(struct services *s, struct err *e) ERR_USE;

#endif
