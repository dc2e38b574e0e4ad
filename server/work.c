/* The work of jobs: from a store to bytes, in a worker thread with its own store handle, or in the
 * process that draws. The result is in the cache before the job ends, so the next request finds the
 * job or the bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/work.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/trace.h"
#include "lod/clip.h"
#include "lod/crop.h"
#include "lod/photograph.h"
#include "lod/remote.h"
#include "lod/store.h"
#include "lod/tileset.h"
#include "lod/tree.h"
#include "server/appearance_model.h"
#include "server/cost.h"
#include "server/encode.h"
#include "server/link.h"
#include "server/param_clip.h"
#include "server/search.h"
#include "server/seed.h"
#include "server/target_query.h"
#include "server/tileset_links.h"

/* Tracks of a trace; threads beyond the last share it. */
static const char *const work_tracks[] = {"tiles 1", "tiles 2", "tiles 3", "tiles 4",
                                          "tiles 5", "tiles 6", "tiles 7", "tiles 8"};

static const double REMOTE_PART = 0.8; /* of the time of an answer, for what it reads */

static enum err_code work_borrow(const struct work *w, struct store **s, struct err *e)
{
    *s = dataset_borrow(w->ds);
    return *s ? ERR_OK
              : err_set(e, ERR_INTERNAL, "dataset %s: fewer store handles than workers",
                        w->ds->meta.name);
}

static enum err_code work_make_tile(const struct work *w, struct buf *out, struct err *e)
{
    struct store *s = NULL;
    struct clip clip = {0};
    const bool clipped = w->target.clip.n;
    enum err_code rc = clipped ? param_clip_open(&w->target.clip, &clip, e) : ERR_OK;
    if (!rc)
        rc = work_borrow(w, &s, e);
    if (!rc)
        rc = encode_tile(s, w->key, w->form, appearance_api_image(&w->appearance),
                         clipped ? &clip : NULL, out, e);
    if (s)
        dataset_return(w->ds, s);
    clip_free(&clip);
    return rc;
}

/* What the target's polygon leaves of the tiles of one document, or of all (part, and first, of a
 * prefetch list: the root); mem_free it. NULL where there is no polygon. */
static enum err_code work_crop(const struct work *w, struct crop_node **out, struct err *e)
{
    struct store *s = NULL;
    struct clip clip = {0};
    const struct tree *tree = store_tree(w->ds->index);
    *out = NULL;
    if (!w->target.clip.n)
        return ERR_OK;
    enum err_code rc = param_clip_open(&w->target.clip, &clip, e);
    if (!rc)
        rc = work_borrow(w, &s, e);
    uint32_t start = tree->root;
    if (w->part)
        start = (uint32_t)(store_find(w->ds->index, w->key) - w->ds->tiles);
    if (!rc)
        rc = crop_tiles(&clip, s, start, w->kind == WORK_TILESET, out, e);
    if (!rc && !w->part && !(*out)[start].any)
        rc = err_set(e, ERR_NOENT, "nothing of this dataset lies within clip");
    if (s)
        dataset_return(w->ds, s);
    clip_free(&clip);
    return rc;
}

/* A tileset whose tiles are all asked for with the same query, or a part of one. */
static enum err_code work_make_tileset(const struct work *w, struct buf *out, struct err *e)
{
    char query[TARGET_QUERY_MAX];
    struct buf text = {0};
    struct tileset_links links;
    struct crop_node *left = NULL;
    target_query_tiles(&w->target, query);
    const enum tileset_links_of of = w->part            ? TILESET_LINKS_PART
                                     : w->target.rev[0] ? TILESET_LINKS_ENTRY
                                                        : TILESET_LINKS_MOVING;
    enum err_code rc = tileset_links_make(w->ds, of, query, &text, &links, e);
    if (!rc)
        rc = work_crop(w, &left, e);
    if (!rc)
        rc = tileset_write(w->ds->index, &links, w->part ? &w->key : NULL, left, out, e);
    mem_free(left);
    buf_free(&text);
    return rc;
}

/* A row a tile: 200 bytes and 2 us each, so it is made when it is asked for. */
static enum err_code work_make_tilejson(const struct work *w, struct buf *out, struct err *e)
{
    struct buf tile = {0};
    struct link l =
        link_to(LINK_ROOT, w->public_url ? w->public_url : "../..", w->ds, w->ds->edition);
    l.ext = format_ext(FORMAT_GLB);
    link_tile(&l, &tile);
    buf_u8(&tile, 0);
    enum err_code rc = buf_check(&tile, e);
    if (!rc)
        rc = tileset_tilejson(w->ds->index, (const char *)tile.data, out, e);
    buf_free(&tile);
    return rc;
}

/* What the process that draws makes. `room` is that of the result from above; codecs that do not
 * compress add to it. */
static enum err_code work_make_drawn(struct services *s, const struct job *j, const struct work *w,
                                     enum draw_kind kind, struct buf *out, struct err *e)
{
    struct draw_request q;
    memset(&q, 0, sizeof q);
    q.kind = kind;
    q.appearance = w->appearance;
    if (kind == DRAW_VIEW)
        q.view = w->view;
    else if (kind == DRAW_MAP)
        q.map = w->map;
    else
        q.query = *w->query;
    return picture_make(s->picture, job_drawer(j), j, w->ds, &q, 2 * work_room(w), out, e);
}

static enum err_code work_make_thumbnail(const struct work *w, struct buf *out, struct err *e)
{
    struct store *s;
    enum err_code rc = work_borrow(w, &s, e);
    if (rc)
        return rc;
    rc = photograph_thumbnail(s, appearance_model_photograph(w->ds, w->target.row), out, e);
    dataset_return(w->ds, s);
    return rc == ERR_NOENT ? err_set(e, ERR_NOENT, "this photograph has no thumbnail") : rc;
}

static enum err_code work_make_seed(const struct work *w, struct buf *out, struct err *e)
{
    struct crop_node *left;
    enum err_code rc = work_crop(w, &left, e);
    if (!rc)
        rc = seed_write(w->ds, &w->target, left, w->form, &w->appearance, out, e);
    mem_free(left);
    return rc;
}

/* A frame of a video: drawn by the other process, encoded here, where the encoder is. */
static enum err_code work_make_frame(struct services *s, const struct job *j, const struct work *w,
                                     struct buf *out, struct err *e)
{
    struct buf planes = {0};
    enum err_code rc = work_make_drawn(s, j, w, DRAW_VIEW, &planes, e);
    if (!rc)
        rc = buf_check(&planes, e);
    if (!rc && job_cancelled(j))
        rc = err_set(e, ERR_CANCEL, "cancelled");
    if (!rc)
        rc = film_encode(w->film, &w->shot, planes.data, planes.size, out, e);
    buf_free(&planes);
    return rc;
}

static enum err_code work_make_bytes(struct services *s, const struct job *j, const struct work *w,
                                     struct buf *out, struct err *e)
{
    switch (w->kind) {
    case WORK_VIEW:
        return w->film ? work_make_frame(s, j, w, out, e)
                       : work_make_drawn(s, j, w, DRAW_VIEW, out, e);
    case WORK_MAP:
        return work_make_drawn(s, j, w, DRAW_MAP, out, e);
    case WORK_QUERY:
        return work_make_drawn(s, j, w, DRAW_QUERY, out, e);
    case WORK_SEED:
        return work_make_seed(w, out, e);
    case WORK_TILESET:
        return work_make_tileset(w, out, e);
    case WORK_TILEJSON:
        return work_make_tilejson(w, out, e);
    case WORK_THUMBNAIL:
        return work_make_thumbnail(w, out, e);
    case WORK_SEARCH:
        return w->target.search.asked
                   ? search_write(w->ds, w->ds->search, &w->target, w->kept, out, e)
                   : appearance_api_write_list(w->ds, w->kept, out, e);
    default:
        return work_make_tile(w, out, e);
    }
}

/* Where memory runs out, caches give way and it is tried once more. */
static enum err_code work_make_anyhow(struct services *s, const struct job *j, const struct work *w,
                                      struct buf *out, struct err *e)
{
    enum err_code rc = work_make_bytes(s, j, w, out, e);
    if (!rc)
        rc = buf_check(out, e);
    if (rc != ERR_MEM)
        return rc;
    services_make_room(s, 2 * work_room(w));
    buf_free(out);
    rc = work_make_bytes(s, j, w, out, e);
    return !rc ? buf_check(out, e) : rc;
}

/* Tiles, pictures and maps take long enough that reading them is quicker; lists are as quick. */
static bool work_is_for_disk(const struct services *s, const struct work *w)
{
    return s->disk && w->keep &&
           (w->kind == WORK_TILE || w->kind == WORK_VIEW || w->kind == WORK_MAP);
}

/* Rows of lists repeat the query, which may be longer than all the rest of them. */
static size_t work_query_bytes(const struct work *w)
{
    char query[TARGET_QUERY_MAX];
    target_query_tiles(&w->target, query);
    return strlen(query);
}

size_t work_room(const struct work *w)
{
    enum { HEAD = WORK_ROOM_HEAD, TILESET_ROW = 768, TILEJSON_ROW = 384 };
    const struct store_tile *t = NULL;
    const char *footprint = store_footprint(w->ds->index);
    size_t sh = 3 * gauss_sh_count(w->ds->meta.sh_degree);
    switch (w->kind) {
    case WORK_VIEW:
        return HEAD + (size_t)w->view.cam.width_px * w->view.cam.height_px * 4;
    case WORK_MAP:
        return HEAD + (size_t)w->map.size_px * w->map.size_px * 4;
    case WORK_QUERY:
        return HEAD + (size_t)MEASURE_SAMPLES_MAX * 160;
    case WORK_SEED:
        return HEAD + seed_room(w->ds, &w->target);
    case WORK_TILESET:
        return HEAD + w->ds->n_tiles * (TILESET_ROW + 2 * work_query_bytes(w));
    case WORK_TILEJSON:
        return HEAD + (footprint ? strlen(footprint) : 0) + w->ds->n_tiles * TILEJSON_ROW;
    case WORK_THUMBNAIL:
        return HEAD + PHOTOGRAPH_BYTES_MAX;
    case WORK_SEARCH:
        return HEAD + search_room(w->ds, &w->target, w->kept);
    default:
        t = store_find(w->ds->index, w->key);
        if (w->form.format == FORMAT_PLY || w->form.format == FORMAT_GLB_PLAIN ||
            w->form.format == FORMAT_GLB_PACKED)
            return HEAD + (t ? t->count : 0) * (17 + sh) * sizeof(float);
        return HEAD + (t ? t->count : 0) * (20 + sh + w->ds->meta.embed_len);
    }
}

/* The formulas of docs/sizing.md for drawing a usual picture of 300,000 Gaussians, those of
 * docs/benchmarks.md for encoding. What they miss is learned: for each kind of question, each
 * format of tiles, and what polygons cut, apart from the rest. */
double work_cost(const void *work, unsigned *kind)
{
    enum {
        QUESTION = WORK_KEEP + 1,
        TILE = QUESTION + QUERY_VISIBLE + 1,
        CLIPPED_TILE = TILE + FORMAT_COUNT,
        CLIPPED_LIST,
        FRAME
    };
    static_assert((int)FRAME < (int)COST_KINDS, "each kind has a factor of its own");
    const double gaussian_ms = 25e-6, pixel_ms = 34e-6, encode_ms = 1.5e-3, row_ms = 2e-3,
                 drawn = 3e5;
    const struct work *w = work;
    const bool clipped = w->target.clip.n;
    const struct store_tile *t = NULL;
    *kind = (unsigned)w->kind;
    switch (w->kind) {
    case WORK_VIEW:
        *kind = w->film ? (unsigned)FRAME : *kind; /* encoding is a part of its time */
        return 5 + gaussian_ms * drawn +
               pixel_ms * (double)w->view.cam.width_px * w->view.cam.height_px *
                   fmax(1, w->view.paint.supersample * w->view.paint.supersample);
    case WORK_MAP:
        return 5 + 4 * pixel_ms * (double)w->map.size_px * w->map.size_px;
    case WORK_QUERY:
        *kind = QUESTION + w->query->kind;
        return 10;
    case WORK_SEED:
    case WORK_TILESET:
    case WORK_TILEJSON:
        *kind = clipped ? (unsigned)CLIPPED_LIST : *kind;
        return 1 + (double)w->ds->n_tiles * row_ms * (clipped ? 1000 : 1);
    case WORK_TILE:
        t = store_find(w->ds->index, w->key);
        *kind = clipped ? (unsigned)CLIPPED_TILE : TILE + (unsigned)w->form.format;
        return 1 + encode_ms * (t ? t->count : 0);
    default:
        return 2;
    }
}

const char *work_noun(enum work_kind kind)
{
    static const char *const nouns[] = {[WORK_TILE] = "tile",
                                        [WORK_SEED] = "list of tiles",
                                        [WORK_TILESET] = "tileset",
                                        [WORK_TILEJSON] = "TileJSON",
                                        [WORK_VIEW] = "picture",
                                        [WORK_MAP] = "map tile",
                                        [WORK_QUERY] = "answer",
                                        [WORK_THUMBNAIL] = "thumbnail",
                                        [WORK_SEARCH] = "list of appearances",
                                        [WORK_KEEP] = "change"};
    return nouns[kind];
}

/* For the log: which one. */
static void work_describe(const struct work *w, char out[64])
{
    const char *noun = work_noun(w->kind);
    if (w->kind == WORK_TILE || w->kind == WORK_MAP)
        snprintf(out, 64, "%s %u/%u/%u.%s", noun, w->key.z, w->key.x, w->key.y,
                 format_ext(w->form.format));
    else if (w->kind == WORK_THUMBNAIL)
        snprintf(out, 64, "%s %u", noun, (unsigned)w->target.row);
    else
        snprintf(out, 64, "%s", noun);
}

/* Keep a name or forget one. What is kept is described to whoever kept it; empty is the body of a
 * name that was there before, or is no more. */
static enum err_code work_change(struct services *s, const struct work *w, struct body **out,
                                 struct err *e)
{
    const struct work_change *c = w->change;
    const struct kept_condition when = {c->match, c->none_match};
    struct buf none = {0};
    char etag[BODY_ETAG_SIZE] = "";
    bool created = false;
    enum err_code rc = c->removes ? kept_remove(s->kept, c->row.ds, c->row.name, &when, e)
                                  : kept_put(s->kept, &c->row, &when, &created, e);
    if (rc == ERR_IO || rc == ERR_FORMAT || rc == ERR_MEM)
        log_error("serve", "%s of ds=%s is not %s: %s", c->row.name, c->row.ds,
                  c->removes ? "forgotten" : "kept", e->msg);
    if (rc)
        return rc;
    log_info("serve", "appearance %s of ds=%s is %s", c->row.name, c->row.ds,
             c->removes ? "forgotten" : "kept");
    if (!c->removes)
        kept_etag(&c->row, etag);
    if (created)
        rc = appearance_api_describe_kept(w->ds, &c->row, out, e);
    else
        *out = body_take(&none, etag);
    if (!rc && !*out)
        rc = err_set(e, ERR_MEM, "out of memory for the answer");
    return rc;
}

static const char *work_track(const struct work *w, size_t worker)
{
    enum { LAST = sizeof work_tracks / sizeof *work_tracks - 1 };
    if (w->kind == WORK_VIEW || w->kind == WORK_MAP || w->kind == WORK_QUERY)
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
    trace_span(track, work_noun(w->kind), make_s, clock_s());
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
    if (w->kind == WORK_KEEP)
        return work_change(s, w, out, e);
    if (w->keep &&
        ((*out = cache_get(s->cache, w->id, NULL)) || (*out = flight_get(s->flight, w->id))))
        return ERR_OK; /* made between the question for it and the question for a job */
    size_t room = work_room(w);
    enum err_code rc = flight_reserve(s->flight, room, cache_bytes(s->cache), e);
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
    if (!rc && (w->kind == WORK_TILESET || w->kind == WORK_TILEJSON || w->kind == WORK_SEARCH))
        body_compress(*out);
    if (!rc)
        flight_add(s->flight, w->id, *out);
    flight_release(s->flight, room);
    if (!rc && w->keep)
        cache_put(s->cache, w->id, *out);
    if (!rc && for_disk && !read)
        w->made = body_ref(*out);
    const bool may_lack = w->kind == WORK_THUMBNAIL || w->target.clip.n || w->form.part;
    bool none = (w->kind == WORK_QUERY && rc == ERR_DATA) || (may_lack && rc == ERR_NOENT);
    if (rc == ERR_MEM)
        services_note_short(s);
    if (rc && rc != ERR_CANCEL && !none) {
        if (rc == ERR_FORMAT || rc == ERR_IO)
            atomic_fetch_add(&w->ds->n_failed, 1);
        atomic_fetch_add(&s->metrics.store_errors, w->kind == WORK_TILE);
        work_describe(w, what);
        log_error("serve", "job failed ds=%s %s: %s", w->ds->meta.name, what, e->msg);
    }
    buf_free(&b);
    return rc;
}

bool work_passing(const void *work)
{
    const struct work *w = work;
    return w->kind == WORK_VIEW || !w->keep;
}

void work_drop(void *services, void *work)
{
    struct services *s = services;
    struct work *w = work;
    const double from_s = clock_s();
    if (w->made) { /* its waiters have it: they did not wait for the disk */
        disk_put(s->disk, w->id, w->made->data, w->made->size, w->target.clip.n);
        trace_overlap("disk", "write", from_s, clock_s());
    }
    body_drop(&w->made);
    dataset_drop(&w->ds);
    film_drop(&w->film);
    mem_free(w->query);
    mem_free(w->public_url);
    kept_drop(&w->kept);
    if (w->change) {
        mem_free(w->change->match);
        mem_free(w->change->none_match);
    }
    mem_free(w->change);
    mem_free(w);
}
