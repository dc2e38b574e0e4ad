/* A byte-level check of requests in front of libmicrohttpd's parser (docs/decisions/012-screen.md).
 *
 * The parser gets whole lines that were looked at before, and nothing else: a line with a control
 * byte, a field without a proper name, a length that is not digits, a second length or coding, a
 * bad chunk never reaches it. In place of the first such line it gets the shortest end of the
 * request, and from then on nothing; whoever answers asks screen_refused, answers with that status
 * and closes the connection.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SCREEN_H
#define SERVER_SCREEN_H

#include <sys/types.h>

#include "core/base.h"

enum screen_state {
    SCREEN_REQUEST, /* a request line is expected, after any empty ones */
    SCREEN_FIELD,
    SCREEN_BODY,
    SCREEN_CHUNK_SIZE,
    SCREEN_CHUNK_DATA,
    SCREEN_CHUNK_END,
    SCREEN_TRAILER,
    SCREEN_CLOSED, /* refused, and the parser has its end */
};
struct tls;
struct screen {      /* of one connection; {0}, screen_attach, screen_detach. One thread. */
    struct tls *tls; /* it speaks TLS: bytes come through tls.c, decrypted; NULL: as they are */
    enum screen_state state;
    char *in; /* what has come; [0, n_ok) was looked at */
    size_t n_in, n_ok, cap, line_max;
    const char *feed; /* goes to the parser next, and then nothing more */
    uint64_t left;    /* of a body or chunk */
    uint64_t length;  /* these three of the head under way */
    unsigned n_length, n_coding;
    uint64_t requests;   /* request lines so far */
    uint64_t refused_at; /* the request that is refused: 1, 2, ...; 0: none */
    int status;          /* to refuse it with */
};

/* From here to screen_detach, what recv(), or with tls gnutls_record_recv(), gives for this
 * descriptor comes through s, whose lines are at most line_max bytes. ERR_MEM. */
enum err_code screen_attach(struct screen *s, int fd, struct tls *tls, size_t line_max,
                            struct err *e) ERR_USE;
void screen_detach(struct screen *s, int fd);
struct screen *screen_at(int fd); /* NULL: none is attached */
/* Of a socket a short read means that it is empty; a record of TLS may be followed by others. */
enum screen_source { SCREEN_SOCKET, SCREEN_RECORDS };
/* Read from a source until the room is full or nothing comes: more() gives bytes, 0 at their end,
 * less for "not now" and errors; *last is its last answer of these two, if it came so far. */
size_t screen_read(struct screen *s, ssize_t (*more)(void *from, char *out, size_t room),
                   void *from, enum screen_source source, char *out, size_t room, ssize_t *last);
/* The status to refuse the n-th request of the connection with, counted from 1; 0 when nothing is
 * known against it. */
int screen_refused(const struct screen *s, uint64_t n);
const char *screen_reason(int status); /* for people */

/* Look at bytes as if they had come from a socket, and take what may go on, at most room bytes:
 * what recv() does, for tests. */
void screen_put(struct screen *s, const char *bytes, size_t n);
size_t screen_take(struct screen *s, char *out, size_t room);

#endif
