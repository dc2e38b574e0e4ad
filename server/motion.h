/* Streams of pictures that follow a camera, for clients that do not draw Gaussians themselves: one
 * request stays open and is answered with picture after picture; others, small, say where the
 * camera is.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MOTION_H
#define SERVER_MOTION_H

#include <sys/types.h>

#include "server/services.h"

struct motion;        /* all streams of a server; thread-safe */
struct motion_stream; /* one of them; counted references */

struct motion_wish { /* what a client wants to see */
    struct draw_view view;
    struct appearance_choice appearance;
    double timeout_s; /* of one picture */
    int64_t number;   /* the client's own, repeated with the picture */
    bool still;       /* draw it in full at once */
};
struct motion_counts {
    uint64_t streams, pictures, full; /* open now; sent since the start, those in full among them */
};

/* motion_close it, after the connections. ERR_MEM. */
enum err_code motion_open(struct services *s, struct motion **out, struct err *e) ERR_USE;
/* After job_close: no picture is under way any more. */
void motion_close(struct motion **m);
/* Draw in full where cameras rest, end streams that nobody steers; a few times a second. */
void motion_tick(struct motion *m, double now_s);
/* End all: what is being read is finished. New ones are refused. */
void motion_stop(struct motion *m);
void motion_count(struct motion *m, struct motion_counts *out);

/* A stream of a dataset's pictures by a name that the client chose. ready() is called, on any
 * thread and under no lock, once after each motion_await that returned true.
 *
 *   out  motion_leave it when its reader has gone
 *
 * Errors: ERR_ARG (the name is taken), ERR_LIMIT (too many streams of this client), ERR_BUSY (too
 * many in all, or the server stops), ERR_MEM. */
enum err_code motion_begin(struct motion *m, const char *ds, const char *name, uint64_t client,
                           void (*ready)(void *user), void *user, struct motion_stream **out,
                           struct err *e) ERR_USE;
/* The camera is here now; the newest wins. d: the dataset's revision to draw. ERR_NOENT: there is
 * no such stream. */
enum err_code motion_steer(struct motion *m, struct dataset *d, const char *name,
                           const struct motion_wish *wish, struct err *e) ERR_USE;
/* The next bytes of the stream, at most room; 0: none yet; -1: it has ended. */
ssize_t motion_read(struct motion_stream *st, char *out, size_t room);
/* There was nothing to read: call ready() when there is. False: there is already. */
bool motion_await(struct motion_stream *st);
/* It ends, at the next read; any thread. */
void motion_end(struct motion_stream *st);
/* The reader has gone: out of the table, the picture under way is given up. Leaves NULL. */
void motion_leave(struct motion_stream **st);
struct motion_stream *motion_ref(struct motion_stream *st);
void motion_drop(struct motion_stream **st);

#endif
