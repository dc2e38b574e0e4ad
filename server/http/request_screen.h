/* Checks the bytes of requests before libmicrohttpd's parser gets them
 * (docs/decisions/031-request-screen.md).
 *
 * The parser gets only whole lines that were checked. It never sees a line with a control byte, a
 * field without a valid name, a length that is not digits, a second length or coding, or a bad
 * chunk. Instead of the first such line it gets the shortest text that ends the request, and after
 * that nothing. The code that answers calls request_screen_refused, answers with that status and
 * closes the connection.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_REQUEST_SCREEN_H
#define SERVER_REQUEST_SCREEN_H

#include <sys/types.h>

#include "core/base.h"

enum request_screen_state {
    REQUEST_SCREEN_REQUEST, /* a request line is expected, after any empty lines */
    REQUEST_SCREEN_FIELD,
    REQUEST_SCREEN_BODY,
    REQUEST_SCREEN_CHUNK_SIZE,
    REQUEST_SCREEN_CHUNK_DATA,
    REQUEST_SCREEN_CHUNK_END,
    REQUEST_SCREEN_TRAILER,
    REQUEST_SCREEN_CLOSED, /* refused; the parser has got the end of the request */
};
struct tls;
/* state of a connection: {0}, request_screen_attach, request_screen_detach; only one thread uses it
 */
struct request_screen {
    /* set before request_screen_attach: libmicrohttpd checks by itself, and nothing is read here */
    bool passes;
    struct tls *tls; /* the connection uses TLS: tls.c decrypts its bytes; NULL: plain */
    enum request_screen_state state;
    char *in; /* received bytes; [0, n_ok) were checked */
    size_t n_in, n_ok, cap, line_max;
    const char *feed; /* bytes that the parser gets next, before it gets nothing more */
    uint64_t left;    /* bytes left of a body or chunk */
    uint64_t length;  /* this and the next two: for the head in progress */
    unsigned n_length, n_coding;
    uint64_t requests;   /* number of request lines so far */
    uint64_t refused_at; /* number of the refused request: 1, 2, ...; 0: none */
    int status;          /* status of the refusal */
};

/* From now until request_screen_detach, recv() on this descriptor (with tls: gnutls_record_recv())
 * returns only bytes that s has checked. Lines may have line_max bytes. ERR_MEM. */
enum err_code request_screen_attach(struct request_screen *s, int fd, struct tls *tls,
                                    size_t line_max, struct err *e) ERR_USE;
void request_screen_detach(struct request_screen *s, int fd);
struct request_screen *request_screen_at(int fd); /* NULL: none is attached */
/* A short read from a socket means that the socket is empty. After a TLS record there may be
 * others. */
enum request_screen_source { REQUEST_SCREEN_SOCKET, REQUEST_SCREEN_RECORDS };
/* Reads from a source until `room` is full or nothing comes, and returns checked bytes in `out`.
 * more() returns a number of bytes, 0 at the end, and less than 0 for "not now" and for errors. If
 * more() returned 0 or less, *last gets that value. */
size_t request_screen_read(struct request_screen *s,
                           ssize_t (*more)(void *from, char *out, size_t room), void *from,
                           enum request_screen_source source, char *out, size_t room,
                           ssize_t *last);
/* The status with which to refuse request n of the connection, counted from 1. 0: it is not
 * refused. */
int request_screen_refused(const struct request_screen *s, uint64_t n);
const char *request_screen_reason(int status); /* for people */

/* For tests: request_screen_put checks bytes as if they came from a socket; request_screen_take
 * returns checked bytes, at most `room`, as recv() would. */
void request_screen_put(struct request_screen *s, const char *bytes, size_t n);
size_t request_screen_take(struct request_screen *s, char *out, size_t room);

#endif
