/* The work of jobs: from a store to bytes, in a worker thread with its own store handle, or in the
 * process that draws. The result is in the cache before the job ends, so the next request finds the
 * job or the bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/work.h"

#include <stdio.h>

#include "core/trace.h"
#include "lod/store/remote.h"
#include "server/base/body_file.h"

/* Tracks of a trace; threads beyond the last share it. */
static const char *const work_tracks[] = {"tiles 1", "tiles 2", "tiles 3", "tiles 4",
                                          "tiles 5", "tiles 6", "tiles 7", "tiles 8"};

static const double REMOTE_PART = 0.8; /* of the time of an answer, for what it reads */

/* ---- for kinds ---- */

struct work *work_make(const struct work_kind *kind, struct dataset *d)
{
    struct work *w = mem_array(1, sizeof *w + kind->size);
    if (!w)
        return NULL;
    w->kind = kind;
    w->ds = d ? dataset_ref(d) : NULL;
    return w;
}

void *work_own(const struct work *w)
{
    return (void *)(uintptr_t)w->own;
}

enum err_code work_borrow(const struct work *w, struct store **s, struct err *e)
{
    return dataset_borrow(w->ds, s, e);
}

/* Codecs that do not compress add to the room of the result. */
enum err_code work_draw(struct services *s, const struct job *j, const struct work *w,
                        struct draw_request *q, struct buf *out, struct err *e)
{
    return picture_make(s->picture, job_drawer(j), j, w->ds, q, 2 * work_room(w), out, e);
}

size_t work_room(const struct work *w)
{
    return WORK_ROOM_HEAD + (w->kind->room ? w->kind->room(w) : 0);
}

double work_cost(const void *work, struct cost_kind *kind)
{
    const struct work *w = work;
    *kind = (struct cost_kind){w->kind, 0};
    return w->kind->cost ? w->kind->cost(w, &kind->variant) : 2;
}

/* ---- the run of a job ---- */

/* Where memory runs out, caches give way and it is tried once more. */
static enum err_code work_make_anyhow(struct services *s, const struct job *j, const struct work *w,
                                      struct buf *out, struct err *e)
{
    enum err_code rc = w->kind->make(s, j, w, out, e);
    if (!rc)
        rc = buf_check(out, e);
    if (rc != ERR_MEM)
        return rc;
    services_make_room(s, 2 * work_room(w));
    buf_free(out);
    rc = w->kind->make(s, j, w, out, e);
    return !rc ? buf_check(out, e) : rc;
}

static bool work_is_for_disk(const struct services *s, const struct work *w)
{
    return s->disk && w->keep && w->kind->traits & WORK_ON_DISK;
}

static const char *work_track(const struct work *w, size_t worker)
{
    enum { LAST = sizeof work_tracks / sizeof *work_tracks - 1 };
    if (w->kind->traits & WORK_DRAWN)
        return "pictures";
    return work_tracks[worker < LAST ? worker : LAST];
}

/* The bytes from the disk, or made. */
static enum err_code work_fetch(struct services *s, const struct job *j, const struct work *w,
                                const char *track, bool for_disk, bool *read, struct buf *out,
                                struct err *e)
{
    const double from_s = clock_s();
    *read = for_disk && disk_get(s->disk, w->id, out);
    if (for_disk)
        trace_span(track, "read disk", from_s, clock_s());
    if (*read)
        return ERR_OK;
    const double make_s = clock_s();
    enum err_code rc = work_make_anyhow(s, j, w, out, e);
    trace_span(track, w->kind->noun, make_s, clock_s());
    return rc;
}

enum err_code work_run(void *user, const struct job *j, void *work, size_t worker,
                       struct body **out, struct err *e)
{
    struct services *s = user;
    struct work *w = work;
    struct buf b = {0};
    char etag[BODY_ETAG_SIZE], what[64];
    bool read = false;
    /* of a store at an address: an answer in time, be it that there is none */
    remote_until(clock_s() + REMOTE_PART * s->cfg->deadline_s);
    if (w->kind->act)
        return w->kind->act(s, w, out, e);
    if (w->keep && ((*out = cache_get(s->cache, w->id, NULL)) ||
                    (*out = live_bodies_get(s->live_bodies, w->id))))
        return ERR_OK; /* made between the question for it and the question for a job */
    size_t room = work_room(w);
    enum err_code rc = live_bodies_reserve(s->live_bodies, room, cache_bytes(s->cache), e);
    if (rc)
        return rc;
    const bool for_disk = work_is_for_disk(s, w);
    rc = work_fetch(s, j, w, work_track(w, worker), for_disk, &read, &b, e);
    if (!rc)
        rc = buf_check(&b, e);
    if (!rc) {
        body_etag(w->id, etag);
        *out = body_take(&b, etag);
        if (!*out)
            rc = err_set(e, ERR_MEM, "out of memory for the encoded bytes");
    }
    if (!rc && w->kind->traits & WORK_COMPRESSED)
        body_compress(*out);
    if (!rc && w->keep)
        body_file_move(*out);
    if (!rc)
        live_bodies_add(s->live_bodies, w->id, *out);
    live_bodies_release(s->live_bodies, room);
    if (!rc && w->keep)
        cache_put(s->cache, w->id, *out);
    if (!rc && for_disk && !read)
        w->made = body_ref(*out);
    const bool none =
        (w->kind->traits & WORK_JUDGES && rc == ERR_DATA) || (w->may_lack && rc == ERR_NOENT);
    if (rc == ERR_MEM)
        services_note_short(s);
    if (rc && rc != ERR_CANCEL && !none) {
        if (rc == ERR_FORMAT || rc == ERR_IO)
            atomic_fetch_add(&w->ds->n_failed, 1);
        if (w->kind->traits & WORK_OF_STORE)
            atomic_fetch_add(&s->metrics.store_errors, 1);
        snprintf(what, sizeof what, "%s", w->kind->noun);
        if (w->kind->tell)
            w->kind->tell(w, what, sizeof what);
        log_error("serve", "job failed ds=%s %s: %s", w->ds->meta.name, what, e->msg);
    }
    buf_free(&b);
    return rc;
}

bool work_passing(const void *work)
{
    const struct work *w = work;
    return w->kind->traits & WORK_PICTURE || !w->keep;
}

void work_drop(void *services, void *work)
{
    struct services *s = services;
    struct work *w = work;
    const double from_s = clock_s();
    if (w->made) { /* its waiters have it: they did not wait for the disk */
        disk_put(s->disk, w->id, w->made->data, w->made->size, w->apart);
        trace_overlap("disk", "write", from_s, clock_s());
    }
    body_drop(&w->made);
    dataset_drop(&w->ds);
    if (w->kind->free)
        w->kind->free(w->own);
    mem_free(w);
}
