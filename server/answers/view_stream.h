/* Streams of pictures that follow a camera, for clients that do not draw Gaussians. One request
 * stays open and gets picture after picture. Other, small requests send the position of the camera.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_VIEW_STREAM_H
#define SERVER_VIEW_STREAM_H

#include <sys/types.h>

#include "server/answers/services.h"

struct view_streams; /* all streams of a server; thread-safe */
struct view_stream;  /* one stream; reference-counted */

struct view_stream_wish { /* the picture that a client wants */
    struct draw_view view;
    struct appearance_choice appearance;
    double timeout_s; /* for one picture */
    int64_t number;   /* the client's own number, repeated with the picture */
    bool still;       /* draw at full size at once */
    bool key;         /* of a video: the next frame refers to no other */
};
struct view_stream_counts {
    /* streams that are open now; pictures sent since the start, and those of them at full size */
    uint64_t streams, pictures, full;
    /* encoders of videos that are open now; memory that they may take */
    uint64_t encoders, encoder_bytes;
    uint64_t frames; /* of videos, encoded since the start */
    double encode_s; /* sum */
};
struct view_stream_reader { /* who reads a stream */
    const char *ds, *name;
    uint64_t client;
    bool video;                /* moving pictures are frames of a video, where that can be */
    void (*ready)(void *user); /* see view_stream_begin */
    void *user;
};

/* Close *out with view_stream_close, after the connections. ERR_MEM. */
enum err_code view_stream_open(struct services *s, struct view_streams **out,
                               struct err *e) ERR_USE;
/* Call it after job_close, when no picture is being made. */
void view_stream_close(struct view_streams **m);
/* Draws at full size where cameras rest, and ends streams without a recent camera. Call it a few
 * times a second. */
void view_stream_tick(struct view_streams *m, double now_s);
/* After a change of rights: ends the streams of datasets that are not public. Clients that may
 * still read them can begin them again. */
void view_stream_recheck(struct view_streams *m, const struct auth *a);
/* Ends all streams; pictures that are being read are finished. New streams are refused. */
void view_stream_stop(struct view_streams *m);
void view_stream_count(struct view_streams *m, struct view_stream_counts *out);
/* Most memory that the encoders of `streams` streams can use. */
size_t view_stream_video_bytes(size_t streams);

/* Begins a stream of a dataset's pictures, with a name that the client chose. ready() is called
 * once after each view_stream_await that returned true, in any thread and without a lock. Call
 * view_stream_leave when the reader of *out has gone. If the limit of streams is reached, the
 * stream that was not steered for the longest time ends, unless this time is less than a twelfth of
 * stream_idle_s. ERR_ARG (the name is in use), ERR_LIMIT (too many streams of this client),
 * ERR_BUSY (too many streams, or the server is stopping), ERR_MEM. */
enum err_code view_stream_begin(struct view_streams *m, const struct view_stream_reader *r,
                                struct view_stream **out, struct err *e) ERR_USE;
/* Sets the camera of a stream; only the newest one is drawn. d: the revision of the dataset to
 * draw. ERR_NOENT: there is no such stream. */
enum err_code view_stream_steer(struct view_streams *m, struct dataset *d, const char *name,
                                const struct view_stream_wish *wish, struct err *e) ERR_USE;
/* Copies the next bytes of the stream, at most `room`. 0: none yet. -1: it has ended. */
ssize_t view_stream_read(struct view_stream *st, char *out, size_t room);
/* Asks for a call of ready() when there are bytes. False: there are some already. */
bool view_stream_await(struct view_stream *st);
/* Ends a stream at its next read. Any thread. */
void view_stream_end(struct view_stream *st);
/* Removes a stream whose reader has gone, and gives up its picture. Sets *st to NULL. */
void view_stream_leave(struct view_stream **st);
struct view_stream *view_stream_ref(struct view_stream *st);
void view_stream_drop(struct view_stream **st);

#endif
