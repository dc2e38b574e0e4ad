/* Streams of pictures that follow a camera. While the camera moves, pictures are small and made
 * quickly. When it rests, one is drawn at full size. A stream has at most one picture in progress,
 * always that of the newest camera. The next one is drawn when the last byte of the one before is
 * in the socket. A slow line therefore gets fewer pictures, never old ones (mhd_callbacks.c limits
 * the bytes in the socket). A frame of a video is drawn only when the one before is in the socket
 * as a whole: each frame refers to the one before, so those that are too many must not be encoded.
 *
 * One connection reads a stream, any number of requests set its camera, and one job at a time draws
 * for it. One mutex guards all streams. No job is submitted and no callback is called with it held.
 * The table, the reader and the job in progress have one reference each. `flying` decides who may
 * use the waiter: the code that sets it submits the job, and the job's end, or a job_leave that
 * claimed the waiter, clears it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/view_stream.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image/video.h"
#include "core/pool.h"
#include "server/answers/answer_view.h"
#include "server/drawing/picture_id.h"
#include "server/drawing/video_stream.h"
#include "server/http/multipart.h"

enum { VIEW_STREAM_QUALITY = 60, VIEW_STREAM_THREADS = 2 /* of an encoder */ };
static const double REST_S = 0.18;   /* a camera that did not move for so long rests */
static const double DRAW_S = 0.04;   /* what a moving picture may take */
static const double RETRY_S = 0.25;  /* after a refusal */
static const double GIVES_WAY = 12;  /* after this part of stream_idle_s without a camera */
static const double RUN_LEARN = 0.3; /* share of a new picture in what pictures take */
static const double RUN_LEAST = 0.67, RUN_MOST = 1.5; /* of DRAW_S over that: about right */
static const double AREA_FIRST_PX = 60000; /* of moving pictures; follows the time that they take */
static const double AREA_LEAST_PX = 20000;
static const double AREA_MOST_PX = 1e6;

struct view_stream {
    struct view_streams *m;
    _Atomic int refs;
    char ds[64], name[64];
    uint64_t client;
    void (*ready)(void *user);
    void *user;
    struct view_stream *next; /* in the table; this and what follows by the lock */
    bool listed, ended, awaits, flying;
    struct view_stream_wish wish;
    struct dataset *d; /* a reference; NULL: nothing was wished for yet */
    uint64_t wished;   /* counts wishes */
    double wished_s;   /* when the newest came; before the first: when the stream began */
    uint64_t drawn;    /* wish of the newest picture */
    bool drawn_full;
    double again_s;           /* not before this, after a refusal */
    double area_px, run_s;    /* of moving pictures, and what they take of late; 0: not known */
    struct job_waiter waiter; /* of the picture under way, while flying */
    uint64_t flight;          /* wish of it */
    int64_t flight_number;
    bool flight_full;
    uint32_t flight_px[2];
    const char *flight_type;
    struct video_stream *video; /* NULL: no video */
    bool flight_frame;          /* the picture under way is a frame of it */
    double put_s;               /* when the newest picture could be read; 0: it is in the socket */
    bool put_frame;             /* it is a frame */
    struct multipart parts;     /* what is read */
};
struct view_streams {
    struct services *s;
    pthread_mutex_t lock;
    struct view_stream *first;
    size_t n;
    bool stopping;
    uint64_t pictures, full;
    struct video_stream_room videos;
};

static void view_stream_on_wake(struct job_waiter *w);

/* ---- lifetime ---- */

enum err_code view_stream_open(struct services *s, struct view_streams **out, struct err *e)
{
    *out = mem_array(1, sizeof **out);
    if (!*out)
        return err_set(e, ERR_MEM, "streams: out of memory");
    (*out)->s = s;
    (*out)->videos.limit_bytes = s->plan.budget ? s->plan.video : SIZE_MAX;
    (*out)->videos.threads = pool_cores() > 1 ? VIEW_STREAM_THREADS : 1;
    pthread_mutex_init(&(*out)->lock, NULL);
    return ERR_OK;
}

void view_stream_close(struct view_streams **out)
{
    struct view_streams *m = *out;
    *out = NULL;
    if (!m)
        return;
    pthread_mutex_destroy(&m->lock);
    mem_free(m);
}

struct view_stream *view_stream_ref(struct view_stream *st)
{
    atomic_fetch_add(&st->refs, 1);
    return st;
}

void view_stream_drop(struct view_stream **out)
{
    struct view_stream *st = *out;
    *out = NULL;
    if (!st || atomic_fetch_sub(&st->refs, 1) > 1)
        return;
    video_stream_drop(&st->video);
    body_drop(&st->parts.picture);
    if (st->d)
        dataset_drop(&st->d);
    mem_free(st);
}

/* Under the lock: off the table. True: the caller drops the table's reference. */
static bool view_stream_unlist(struct view_stream *st)
{
    if (!st->listed)
        return false;
    struct view_stream **p = &st->m->first;
    while (*p != st)
        p = &(*p)->next;
    *p = st->next;
    st->m->n--;
    st->listed = false;
    return true;
}

/* Under the lock. */
static struct view_stream *view_stream_find(struct view_streams *m, const char *ds,
                                            const char *name)
{
    struct view_stream *st = m->first;
    while (st && (strcmp(st->name, name) != 0 || strcmp(st->ds, ds) != 0))
        st = st->next;
    return st;
}

/* Under the lock: may this client have one more, by this name? *gives_way: if all are taken, the
 * one that was not steered for longest. */
static enum err_code view_stream_may_begin(struct view_streams *m, const char *ds, const char *name,
                                           uint64_t client, struct view_stream **gives_way,
                                           struct err *e)
{
    const struct server_config *cfg = m->s->cfg;
    const double before_s = clock_s() - cfg->stream_idle_s / GIVES_WAY;
    struct view_stream *idlest = NULL;
    size_t own = 0;
    for (struct view_stream *st = m->first; st; st = st->next) {
        own += st->client == client;
        if (st->wished_s < (idlest ? idlest->wished_s : before_s))
            idlest = st;
    }
    if (m->stopping)
        return err_set(e, ERR_BUSY, "the server is stopping");
    if (view_stream_find(m, ds, name))
        return err_set(e, ERR_ARG, "a stream has this name: a name is used once, and by chance");
    if (cfg->client_streams && own >= (size_t)cfg->client_streams)
        return err_set(e, ERR_LIMIT, "your address has %zu streams open, and may have %d", own,
                       (int)cfg->client_streams);
    if (m->n < (size_t)cfg->streams)
        return ERR_OK;
    if (!idlest)
        return err_set(e, ERR_BUSY, "%zu streams are open, which is as many as there may be", m->n);
    *gives_way = idlest;
    return ERR_OK;
}

static struct view_stream *view_stream_make(struct view_streams *m,
                                            const struct view_stream_reader *r, struct err *e)
{
    const bool video = r->video && video_can();
    struct view_stream *st = mem_array(1, sizeof *st);
    struct video_stream *made = video ? video_stream_begin(&m->videos) : NULL;
    if (!st || (video && !made)) {
        video_stream_drop(&made);
        mem_free(st);
        (void)err_set(e, ERR_MEM, "out of memory for a stream");
        return NULL;
    }
    st->m = m;
    st->client = r->client;
    st->waiter.wake =
        view_stream_on_wake; /* the rest of it is touched by jobs alone, under their lock */
    st->ready = r->ready;
    st->user = r->user;
    st->video = made;
    st->wished_s = clock_s();
    st->area_px = AREA_FIRST_PX;
    snprintf(st->ds, sizeof st->ds, "%s", r->ds);
    snprintf(st->name, sizeof st->name, "%s", r->name);
    multipart_begin(&st->parts);
    atomic_init(&st->refs, 2);
    return st;
}

enum err_code view_stream_begin(struct view_streams *m, const struct view_stream_reader *r,
                                struct view_stream **out, struct err *e)
{
    struct view_stream *st = *out = view_stream_make(m, r, e), *old = NULL;
    if (!st)
        return ERR_MEM;
    pthread_mutex_lock(&m->lock);
    enum err_code rc = view_stream_may_begin(m, r->ds, r->name, r->client, &old, e);
    if (old)
        (void)view_stream_unlist(old);
    if (!rc) {
        st->listed = true;
        st->next = m->first;
        m->first = st;
        m->n++;
    }
    pthread_mutex_unlock(&m->lock);
    if (old) { /* its reference was the table's */
        view_stream_end(old);
        view_stream_drop(&old);
    }
    if (rc) {
        *out = NULL;
        video_stream_drop(&st->video);
        mem_free(st);
    }
    return rc;
}

/* ---- drawing ---- */

/* Call ready() if the reader waits. Not under the lock. */
static void view_stream_notify(struct view_stream *st)
{
    pthread_mutex_lock(&st->m->lock);
    bool awaits = st->awaits;
    st->awaits = false;
    pthread_mutex_unlock(&st->m->lock);
    if (awaits)
        st->ready(st->user);
}

/* Under the lock: moving pictures are as large as is made in time. They keep their size while that
 * is about right, because a picture of another size cannot use the last one's lists. */
static void view_stream_adapt(struct view_stream *st, const struct job_result *r,
                              struct video_stream_told *told)
{
    if (st->flight_frame) {
        st->area_px = video_stream_shown(st->video, r->run_s, DRAW_S, told);
    } else if (!st->flight_full && !r->coalesced) {
        st->run_s = st->run_s > 0 ? st->run_s + RUN_LEARN * (r->run_s - st->run_s) : r->run_s;
        const double factor = DRAW_S / fmax(st->run_s, 1e-3), before_px = st->area_px;
        if (factor < RUN_LEAST || factor > RUN_MOST)
            st->area_px *= fmin(1.3, fmax(0.5, factor));
        st->area_px = fmin(AREA_MOST_PX, fmax(AREA_LEAST_PX, st->area_px));
        st->run_s *= st->area_px / before_px;
    }
}

/* Under the lock: the picture that has come becomes what is read. Takes the body. */
static void view_stream_show(struct view_stream *st, const struct job_result *r)
{
    struct video_stream_told told = {0};
    char frame[64] = "";
    view_stream_adapt(st, r, &told);
    if (st->flight_frame)
        snprintf(frame, sizeof frame, ", encode;dur=%.1f\r\nKey: %d\r\nQuantizer: %d",
                 told.encode_s * 1e3, told.key, told.quantizer);
    multipart_put(&st->parts, r->body,
                  "Content-Type: %s\r\nContent-Length: %zu\r\nPose: %lld\r\nSize: %ux%u\r\n"
                  "Rest: %d\r\nServer-Timing: queue;dur=%.1f, job;dur=%.1f%s\r\n\r\n",
                  st->flight_type, r->body->size, (long long)st->flight_number,
                  (unsigned)st->flight_px[0], (unsigned)st->flight_px[1], st->flight_full,
                  r->queue_s * 1e3, r->run_s * 1e3, frame);
    st->put_s = clock_s();
    st->put_frame = st->flight_frame;
    st->drawn = st->flight;
    st->drawn_full = st->flight_full;
    st->m->pictures++;
    st->m->full += st->flight_full;
}

/* A job has ended: on a worker's thread, or for want of room on the one that asked. */
static void view_stream_landed(struct view_stream *st, struct job_result *r)
{
    bool refused = r->end == JOB_SHED || r->end == JOB_TIMEOUT || r->end == JOB_LIMITED ||
                   r->end == JOB_CANCELLED || r->code == ERR_MEM || r->code == ERR_BUSY ||
                   r->code == ERR_DEVICE; /* the process that draws is started again */
    pthread_mutex_lock(&st->m->lock);
    st->flying = false;
    if (r->end == JOB_OK && !st->ended) {
        view_stream_show(st, r);
        r->body = NULL;
    } else if (refused) {
        st->again_s = clock_s() + RETRY_S;
    } else if (r->end != JOB_OK) {
        st->ended = true; /* the log says why */
    }
    pthread_mutex_unlock(&st->m->lock);
    body_drop(&r->body);
    view_stream_notify(st);
}

static void view_stream_on_wake(struct job_waiter *w)
{
    struct view_stream *st =
        (struct view_stream *)(void *)((char *)w - offsetof(struct view_stream, waiter));
    struct job_result r = w->result;
    w->result.body = NULL;
    view_stream_landed(st, &r);
    view_stream_drop(&st);
}

/* Under the lock: a small camera for a wish, of as many pixels as are drawn in time. */
static void view_stream_shrink(const struct view_stream *st, struct draw_view *v)
{
    double width = v->cam.width_px, height = v->cam.height_px;
    double factor = fmin(1, sqrt(st->area_px / (width * height)));
    uint32_t w = (uint32_t)fmax(1, round(width * factor)),
             h = (uint32_t)fmax(1, round(height * factor));
    if (factor < 1)
        v->cam = camera_resize(&v->cam, w, h);
    v->moves = true;
    v->composite.supersample = 1;
    v->quality = v->quality < VIEW_STREAM_QUALITY ? v->quality : VIEW_STREAM_QUALITY;
}

/* The work of a frame of a video. That of other pictures is answer_view_work. */
struct view_stream_frame_own {
    struct draw_view view;
    struct appearance_choice appearance;
    struct video_stream *video; /* a reference */
    struct video_stream_shot shot;
};

/* Drawn by the other process, encoded here, where the encoder is. */
static enum err_code view_stream_frame_make(struct services *s, const struct job *j,
                                            const struct work *w, struct buf *out, struct err *e)
{
    const struct view_stream_frame_own *o = work_own(w);
    struct buf planes = {0};
    struct draw_request q;
    memset(&q, 0, sizeof q);
    q.kind = DRAW_VIEW;
    q.appearance = o->appearance;
    q.view = o->view;
    enum err_code rc = work_draw(s, j, w, &q, &planes, e);
    if (!rc)
        rc = buf_check(&planes, e);
    if (!rc && job_cancelled(j))
        rc = err_set(e, ERR_CANCEL, "cancelled");
    if (!rc)
        rc = video_stream_encode(o->video, &o->shot, planes.data, planes.size, out, e);
    buf_free(&planes);
    return rc;
}

static size_t view_stream_frame_room(const struct work *w)
{
    const struct view_stream_frame_own *o = work_own(w);
    return answer_view_room(&o->view);
}

/* Encoding is a part of the time that is learned. */
static double view_stream_frame_cost(const struct work *w, unsigned *variant)
{
    const struct view_stream_frame_own *o = work_own(w);
    (void)variant;
    return answer_view_cost_ms(&o->view);
}

static void view_stream_frame_free(void *own)
{
    video_stream_drop(&((struct view_stream_frame_own *)own)->video);
}

static const struct work_kind view_stream_frame_work = {.noun = "frame",
                                                        .traits = WORK_DRAWN | WORK_PICTURE,
                                                        .size =
                                                            sizeof(struct view_stream_frame_own),
                                                        .make = view_stream_frame_make,
                                                        .room = view_stream_frame_room,
                                                        .cost = view_stream_frame_cost,
                                                        .free = view_stream_frame_free};

/* Under the lock: can a moving picture be a frame of the video? Then it is planned. */
static bool view_stream_is_frame(struct view_stream *st, struct draw_view *v,
                                 struct video_stream_shot *shot)
{
    const bool can = st->video && v->composite.depth == DEPTH_NONE && v->format != FORMAT_NPY &&
                     v->composite.background != BACKGROUND_TRANSPARENT;
    if (!can || !video_stream_next(st->video, v->cam.width_px, v->cam.height_px, st->area_px,
                                   v->quality, shot))
        return false;
    v->cam = camera_resize(&v->cam, shot->width_px, shot->height_px);
    v->composite.supersample = 1;
    v->planes = v->moves = true;
    return true;
}

/* Under the lock. NULL: out of memory. */
static struct work *view_stream_make_work(struct view_stream *st, const struct draw_view *v,
                                          const struct video_stream_shot *shot)
{
    struct work *w =
        work_make(st->flight_frame ? &view_stream_frame_work : &answer_view_work, st->d);
    void *own = w ? work_own(w) : NULL;
    if (w && st->flight_frame)
        *(struct view_stream_frame_own *)own = (struct view_stream_frame_own){
            *v, st->wish.appearance, video_stream_ref(st->video), *shot};
    else if (w)
        *(struct answer_view_own *)own = (struct answer_view_own){*v, st->wish.appearance};
    return w;
}

/* Under the lock: whether a picture is to be drawn now. *full: of a camera that rests. */
static bool view_stream_is_due(const struct view_stream *st, double now_s, bool *full)
{
    bool fresh = st->drawn != st->wished;
    bool busy =
        st->flying || st->ended || !multipart_is_read(&st->parts) || (st->video && st->put_s > 0);
    *full = st->wish.still || (!fresh && !st->drawn_full && now_s - st->wished_s >= REST_S);
    return !busy && st->d && now_s >= st->again_s && (fresh || (!st->drawn_full && *full));
}

/* Under the lock: what is to be drawn now, *v, and for the flight to begin. NULL: nothing. */
static struct work *view_stream_next(struct view_stream *st, double now_s, struct draw_view *v)
{
    struct video_stream_shot shot = {0};
    bool full;
    if (!view_stream_is_due(st, now_s, &full))
        return NULL;
    *v = st->wish.view;
    st->flight_frame = !full && view_stream_is_frame(st, v, &shot);
    if (!full && !st->flight_frame)
        view_stream_shrink(st, v);
    struct work *w = view_stream_make_work(st, v, &shot);
    if (!w) {
        if (st->flight_frame) /* it was planned, and may have been one */
            video_stream_need_key(st->video);
        st->again_s = now_s + RETRY_S;
        return NULL;
    }
    st->flying = true;
    st->flight = st->wished;
    st->flight_full = full;
    st->flight_number = st->wish.number;
    st->flight_type = st->flight_frame ? MULTIPART_FRAME_TYPE : format_type(v->format);
    st->flight_px[0] = v->cam.width_px;
    st->flight_px[1] = v->cam.height_px;
    return w;
}

/* Ask for the next picture, if it is time. Not under the lock. */
static void view_stream_step(struct view_stream *st, double now_s)
{
    struct services *s = st->m->s;
    struct draw_view view;
    char device[160];
    pthread_mutex_lock(&st->m->lock);
    struct work *w = view_stream_next(st, now_s, &view);
    const struct appearance_choice appearance = st->wish.appearance;
    const bool frame = st->flight_frame;
    double timeout_s = st->wish.timeout_s;
    pthread_mutex_unlock(&st->m->lock);
    if (!w)
        return;
    picture_about(s->picture, device, sizeof device);
    w->id =
        frame ? video_stream_id(st->video)
              : picture_id_view(w->ds, device, &view, &appearance, (double)s->cfg->view_gaussians);
    struct view_stream *held = view_stream_ref(st); /* the flight's */
    if (job_submit(s->jobs, JOB_MOTION, w->id, w, st->client, timeout_s, &st->waiter)) {
        struct job_result r = st->waiter.result;
        view_stream_landed(st, &r);
        view_stream_drop(&held);
    }
}

/* ---- steering ---- */

enum err_code view_stream_steer(struct view_streams *m, struct dataset *d, const char *name,
                                const struct view_stream_wish *wish, struct err *e)
{
    double now_s = clock_s();
    pthread_mutex_lock(&m->lock);
    struct view_stream *st = view_stream_find(m, d->meta.name, name);
    struct dataset *was = NULL;
    bool late = false;
    if (st) {
        view_stream_ref(st);
        /* Requests on several connections overtake each other: an older pose does not replace a
         * newer. */
        late = st->d && wish->number < st->wish.number;
    }
    if (st && !late) {
        was = st->d;
        st->d = dataset_ref(d);
        st->wish = *wish;
        if (wish->key && st->video)
            video_stream_need_key(st->video);
        st->wished++;
        st->wished_s = now_s;
    }
    /* A full picture of a camera that has moved on is not worth its time. */
    bool stale = st && !late && st->flying && st->flight_full;
    pthread_mutex_unlock(&m->lock);
    if (was)
        dataset_drop(&was);
    if (!st)
        return err_set(e, ERR_NOENT, "no stream is open by this name");
    if (stale && job_leave(m->s->jobs, &st->waiter)) {
        struct view_stream *flown = st;
        pthread_mutex_lock(&m->lock);
        st->flying = false;
        pthread_mutex_unlock(&m->lock);
        view_stream_drop(&flown); /* the flight's reference, not the last */
    }
    view_stream_step(st, now_s);
    view_stream_drop(&st);
    return ERR_OK;
}

/* ---- reading ---- */

ssize_t view_stream_read(struct view_stream *st, char *out, size_t room)
{
    pthread_mutex_lock(&st->m->lock);
    struct body *read;
    if (multipart_is_read(&st->parts) && st->put_s > 0) { /* so the socket has all of it */
        if (st->put_frame)
            video_stream_sent(st->video, clock_s() - st->put_s);
        st->put_s = 0;
    }
    size_t n = multipart_read(&st->parts, out, room, &read);
    bool ended = st->ended && !n;
    bool more = !multipart_is_read(&st->parts);
    pthread_mutex_unlock(&st->m->lock);
    body_drop(&read);
    if (!more && !ended)
        view_stream_step(st, clock_s()); /* while these bytes are under way */
    return ended ? -1 : (ssize_t)n;
}

bool view_stream_await(struct view_stream *st)
{
    pthread_mutex_lock(&st->m->lock);
    st->awaits = !st->ended && multipart_is_read(&st->parts);
    bool awaits = st->awaits;
    pthread_mutex_unlock(&st->m->lock);
    return awaits;
}

void view_stream_end(struct view_stream *st)
{
    pthread_mutex_lock(&st->m->lock);
    st->ended = true;
    pthread_mutex_unlock(&st->m->lock);
    view_stream_notify(st);
}

void view_stream_leave(struct view_stream **out)
{
    struct view_stream *st = *out, *listed = st, *held = st;
    *out = NULL;
    if (!st)
        return;
    struct view_streams *m = st->m;
    pthread_mutex_lock(&m->lock);
    st->ended = true;
    st->awaits = false;
    bool was_listed = view_stream_unlist(st), flying = st->flying;
    pthread_mutex_unlock(&m->lock);
    if (flying && job_leave(m->s->jobs, &st->waiter))
        view_stream_drop(&held);
    if (was_listed)
        view_stream_drop(&listed);
    view_stream_drop(&st);
}

/* ---- all of them ---- */

/* Do something with each stream, not under the lock. */
static void view_stream_each(struct view_streams *m,
                             void (*fn)(struct view_stream *st, const void *user), const void *user)
{
    struct view_stream *all[64], *st;
    size_t skip = 0, n;
    do { /* those that begin meanwhile stand in front, and may be met twice: no harm */
        n = 0;
        pthread_mutex_lock(&m->lock);
        size_t i = 0;
        for (st = m->first; st && n < sizeof all / sizeof *all; st = st->next)
            if (i++ >= skip)
                all[n++] = view_stream_ref(st);
        pthread_mutex_unlock(&m->lock);
        for (size_t k = 0; k < n; k++) {
            fn(all[k], user);
            view_stream_drop(&all[k]);
        }
        skip += n;
    } while (n == sizeof all / sizeof *all);
}

static void view_stream_tick_one(struct view_stream *st, const void *user)
{
    const double now_s = *(const double *)user;
    pthread_mutex_lock(&st->m->lock);
    bool idle = st->m->stopping || now_s - st->wished_s > st->m->s->cfg->stream_idle_s;
    pthread_mutex_unlock(&st->m->lock);
    if (idle)
        view_stream_end(st);
    else
        view_stream_step(st, now_s);
}

void view_stream_tick(struct view_streams *m, double now_s)
{
    view_stream_each(m, view_stream_tick_one, &now_s);
}

static void view_stream_recheck_one(struct view_stream *st, const void *user)
{
    if (!auth_is_public(user, st->ds))
        view_stream_end(st);
}

void view_stream_recheck(struct view_streams *m, const struct auth *a)
{
    if (m)
        view_stream_each(m, view_stream_recheck_one, a);
}

static void view_stream_end_one(struct view_stream *st, const void *user)
{
    (void)user;
    view_stream_end(st);
}

void view_stream_stop(struct view_streams *m)
{
    if (!m)
        return;
    pthread_mutex_lock(&m->lock);
    m->stopping = true;
    pthread_mutex_unlock(&m->lock);
    view_stream_each(m, view_stream_end_one, NULL);
}

void view_stream_count(struct view_streams *m, struct view_stream_counts *out)
{
    *out = (struct view_stream_counts){0};
    if (!m)
        return;
    pthread_mutex_lock(&m->lock);
    *out = (struct view_stream_counts){m->n,
                                       m->pictures,
                                       m->full,
                                       atomic_load(&m->videos.encoders),
                                       atomic_load(&m->videos.held_bytes),
                                       atomic_load(&m->videos.frames),
                                       (double)atomic_load(&m->videos.encode_us) * 1e-6};
    pthread_mutex_unlock(&m->lock);
}

size_t view_stream_video_bytes(size_t streams)
{
    return video_can()
               ? streams * video_room((uint32_t)sqrt(AREA_MOST_PX), (uint32_t)sqrt(AREA_MOST_PX))
               : 0;
}
