/* What the page of `citysplat mark` asks for: its route table and answers. Everything but the
 * page's own files needs the token of the address.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <string.h>

#include "cli/scene/mark_work.h"
#include "server/answers/answer.h"
#include "server/answers/origin.h"
#include "server/base/document.h"
#include "server/route/target.h"

/* Else the problem is set. */
static struct mark_work *mark_enter(struct services *s, const struct request *r,
                                    struct response *out)
{
    static const char bearer[] = "Bearer ";
    struct mark_work *w = s->own;
    const size_t n = strlen(bearer);
    const char *given = r->authorization;
    unsigned differs = 0;
    out->same_origin = true;
    bool fits = given && !strncmp(given, bearer, n) && strlen(given) == n + MARK_TOKEN - 1;
    for (size_t i = 0; fits && i < MARK_TOKEN - 1; i++)
        differs |= (unsigned)(given[n + i] ^ w->token[i]);
    if (fits && !differs && origin_is_own_page(s, r))
        return w;
    response_problem(out, 401,
                     "open the whole address that `citysplat mark` has printed, with what stands "
                     "behind its #");
    out->same_origin = true;
    return NULL;
}

static json_t *mark_pair(const double v[2])
{
    return json_pack("[f,f]", v[0], v[1]);
}

static json_t *mark_points(const struct marking *m)
{
    static const char *const sources[] = {"nowhere", "frame", "one", "marks"};
    const struct gcp_list *l = marking_list(m);
    json_t *a = json_array();
    for (size_t i = 0; i < l->n; i++) {
        const struct gcp *g = &l->gcps[i];
        const struct marking_point p = marking_point(m, i);
        json_array_append_new(
            a, json_pack("{s:s,s:[f,f,f],s:I,s:I,s:s,s:o,s:o,s:o}", "name", g->name, "at",
                         g->file[0], g->file[1], g->file[2], "marks", (json_int_t)p.marks,
                         "suspects", (json_int_t)p.suspects, "source", sources[p.source], "worst",
                         jsonc_real(p.worst_px), "offPlan", jsonc_real(p.off_m[0]), "offHeight",
                         jsonc_real(p.off_m[1])));
    }
    return a;
}

static json_t *mark_spots(const struct marking *m, size_t point)
{
    struct marking_spot *spots = mem_array(marking_survey(m)->n, sizeof *spots);
    const size_t n = spots ? marking_spots(m, point, spots) : 0;
    json_t *a = json_array();
    for (size_t i = 0; i < n; i++) {
        const struct marking_spot *s = &spots[i];
        json_array_append_new(
            a, json_pack("{s:I,s:o,s:o,s:o,s:o,s:b,s:b}", "photo", (json_int_t)s->photo, "expected",
                         s->expected ? mark_pair(s->expected_px) : json_null(), "mark",
                         s->marked ? mark_pair(s->marked_px) : json_null(), "residual",
                         jsonc_real(s->residual_px), "out", jsonc_real(s->out_px), "suspect",
                         s->suspect, "lost", s->marked && s->lost));
    }
    mem_free(spots);
    return spots ? a : NULL;
}

/* {revision, points, point, spots}; `point` beyond the last: without the last two. */
static void mark_state(const struct marking *m, size_t point, const struct request *r,
                       struct response *out)
{
    struct body *b = NULL;
    json_t *o = json_pack("{s:I,s:o}", "revision", (json_int_t)marking_revision(m), "points",
                          mark_points(m));
    if (o && point < marking_list(m)->n) {
        json_object_set_new(o, "point", json_integer((json_int_t)point));
        json_object_set_new(o, "spots", mark_spots(m, point));
    }
    if (document_make(o, &b, NULL))
        body_drop(&b);
    response_document(r, RESPONSE_JSON, b, out);
}

/* The target of every row. */
struct mark_target {
    struct target all;
    struct target_row row;
};

static const struct target_row *mark_row(const struct target *t)
{
    return &((const struct mark_target *)t)->row;
}

static void mark_answer_home(struct services *s, const struct request *r, struct dataset *d,
                             const struct target *t, struct response *out)
{
    (void)s, (void)r, (void)d, (void)t;
    out->status = 307; /* browsers keep what stands behind # */
    out->location = mem_text("./mark.html");
}

static void mark_answer_survey(struct services *s, const struct request *r, struct dataset *d,
                               const struct target *t, struct response *out)
{
    struct mark_work *w = mark_enter(s, r, out);
    struct body *b = NULL;
    (void)d, (void)t;
    if (!w)
        return;
    pthread_mutex_lock(&w->lock);
    const struct ingest_survey *survey = marking_survey(w->marking);
    json_t *photos = json_array();
    for (size_t i = 0; i < survey->n; i++)
        json_array_append_new(photos, json_pack("{s:s,s:i,s:i}", "name", survey->photos[i].file,
                                                "width", (int)survey->photos[i].width_px, "height",
                                                (int)survey->photos[i].height_px));
    json_t *o =
        json_pack("{s:s,s:I,s:i,s:b,s:I,s:i,s:o,s:o}", "output", w->output, "revision",
                  (json_int_t)marking_revision(w->marking), "epsg", marking_list(w->marking)->epsg,
                  "placed", survey->placed, "strays", (json_int_t)marking_strays(w->marking),
                  "part", MARK_PART_PX, "photographs", photos, "points", mark_points(w->marking));
    pthread_mutex_unlock(&w->lock);
    if (document_make(o, &b, NULL))
        body_drop(&b);
    response_document(r, RESPONSE_JSON, b, out);
}

static void mark_answer_point(struct services *s, const struct request *r, struct dataset *d,
                              const struct target *t, struct response *out)
{
    struct mark_work *w = mark_enter(s, r, out);
    (void)d;
    if (!w)
        return;
    pthread_mutex_lock(&w->lock);
    const uint32_t row = mark_row(t)->row;
    if (row < marking_list(w->marking)->n)
        mark_state(w->marking, row, r, out);
    else
        response_problem(out, 404, "there is no such point");
    pthread_mutex_unlock(&w->lock);
}

/* Any photograph, or a part of it; errors are those of mark_photo_whole. */
static void mark_picture(struct mark_work *w, const struct target_row *at, bool part,
                         const struct request *r, struct response *out)
{
    char path[FILE_PATH_MAX];
    struct buf b = {0};
    struct err e = {0};
    const struct ingest_survey *survey = marking_survey(w->marking); /* it does not change */
    if (at->row >= survey->n) {
        response_problem(out, 404, "there is no such photograph");
        return;
    }
    const struct ingest_survey_photo *p = &survey->photos[at->row];
    const uint32_t longest = p->width_px > p->height_px ? p->width_px : p->height_px;
    enum err_code rc = file_join(path, w->images_dir, p->file, &e);
    if (!rc)
        rc = part ? mark_photo_part(&w->album, path, at->row, at->column, at->line, &b, &e)
                  : mark_photo_whole(&w->album, path, at->row, longest, &b, &e);
    if (!rc) {
        response_document(r, "image/jpeg", body_take(&b, NULL), out);
        return;
    }
    log_error("mark", "%s", e.msg);
    buf_free(&b);
    response_problem(out, rc == ERR_NOENT ? 404 : 500, e.msg);
    out->same_origin = true;
}

static void mark_answer_photo(struct services *s, const struct request *r, struct dataset *d,
                              const struct target *t, struct response *out)
{
    struct mark_work *w = mark_enter(s, r, out);
    (void)d;
    if (w)
        mark_picture(w, mark_row(t), false, r, out);
}

static void mark_answer_part(struct services *s, const struct request *r, struct dataset *d,
                             const struct target *t, struct response *out)
{
    struct mark_work *w = mark_enter(s, r, out);
    (void)d;
    if (w)
        mark_picture(w, mark_row(t), true, r, out);
}

/* {"revision": 3, "point": 0, "photo": 12, "at": [1024.5, 330.1]}; at null: the mark goes. */
static enum err_code mark_read_change(const struct request *r, json_int_t *revision, size_t at[2],
                                      double px[2], bool *gone, struct err *e)
{
    json_int_t point = -1, photo = -1;
    json_error_t why;
    json_t *where = NULL, *o = json_loadb(r->body ? r->body : "", r->body_size, 0, &why);
    enum err_code rc = ERR_OK;
    if (!o ||
        json_unpack(o, "{s:I,s:I,s:I,s:o}", "revision", revision, "point", &point, "photo", &photo,
                    "at", &where) ||
        point < 0 || photo < 0 || json_is_false(where) ||
        (!json_is_null(where) && json_unpack(where, "[F,F!]", &px[0], &px[1])))
        rc = err_set(e, ERR_FORMAT,
                     "expected is {\"revision\": N, \"point\": N, \"photo\": N, \"at\": [COLUMN, "
                     "ROW] or null}");
    *gone = json_is_null(where);
    at[0] = (size_t)point;
    at[1] = (size_t)photo;
    json_decref(o);
    return rc;
}

static void mark_change(struct mark_work *w, const struct request *r, struct response *out)
{
    json_int_t revision;
    size_t at[2];
    double px[2] = {0};
    bool gone;
    struct err e = {0};
    if (mark_read_change(r, &revision, at, px, &gone, &e)) {
        response_problem(out, 400, e.msg);
        return;
    }
    if (at[0] >= marking_list(w->marking)->n || at[1] >= marking_survey(w->marking)->n) {
        response_problem(out, 404, "there is no such point or photograph");
        return;
    }
    if ((uint64_t)revision != marking_revision(w->marking)) {
        response_problem(out, 409, "another page has changed marks meanwhile");
        return;
    }
    enum err_code rc = marking_set(w->marking, at[0], at[1], gone ? NULL : px, &e);
    if (!rc) {
        mark_state(w->marking, at[0], r, out);
        return;
    }
    log_error("mark", "%s", e.msg);
    response_problem(out, rc == ERR_ARG ? 422 : rc == ERR_BUSY ? 409 : 500, e.msg);
}

static void mark_answer_change(struct services *s, const struct request *r, struct dataset *d,
                               const struct target *t, struct response *out)
{
    struct mark_work *w = mark_enter(s, r, out);
    (void)d, (void)t;
    if (!w)
        return;
    pthread_mutex_lock(&w->lock);
    mark_change(w, r, out);
    pthread_mutex_unlock(&w->lock);
    out->same_origin = true;
}

#define MARK_ROUTE(name, path, scope, method, function, takes, gives, about)                       \
    {                                                                                              \
        name, path, SCOPE_PUBLIC | (scope), CACHE_NONE, RATE_MEMORY, 1u << TARGET_row,             \
            sizeof(struct mark_target), {[TARGET_row] = offsetof(struct mark_target, row)},        \
        {                                                                                          \
            {METHOD_##method, function, takes, gives, about, false},                               \
        }                                                                                          \
    }
const struct route MARK_ROUTES[] = {
    MARK_ROUTE("home", "/", 0, GET, mark_answer_home, NULL, "307,", "To the page"),
    MARK_ROUTE("file", "/{file}", SCOPE_FILE, GET, answer_service_file, NULL, "200 */* Bytes,",
               "A file of the viewer"),
    MARK_ROUTE("survey", "/mark/survey", 0, GET, mark_answer_survey, NULL,
               "200 application/json Document,", "Points and photographs"),
    MARK_ROUTE("point", "/mark/points/{row}", 0, GET, mark_answer_point, NULL,
               "200 application/json Document,", "A point in its photographs"),
    MARK_ROUTE("photograph", "/mark/photographs/{row}", 0, GET, mark_answer_photo, NULL,
               "200 image/jpeg Bytes,", "A photograph, smaller where it is large"),
    MARK_ROUTE("part", "/mark/photographs/{row}/{column}/{line}", 0, GET, mark_answer_part, NULL,
               "200 image/jpeg Bytes,", "A part of a photograph at full size"),
    MARK_ROUTE("change", "/mark/marks", 0, PUT, mark_answer_change, "Document",
               "200 application/json Document,", "Sets or removes a mark"),
};
const size_t MARK_ROUTES_COUNT = sizeof MARK_ROUTES / sizeof *MARK_ROUTES;
