/* Questions about the surface of a dataset: posted JSON, and the height at one place by address.
 * The thread that draws answers them, in the dataset's default appearance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer.h"

#include <jansson.h>
#include <string.h>

#include "server/answers/answer_map.h"
#include "server/answers/answer_view.h"
#include "server/drawing/picture_id.h"

/* A key of a posted question would have no effect in the address. ERR_FORMAT. */
static enum err_code answer_query_check_address(const struct request *r, const struct target *t,
                                                enum query_kind kind, struct err *e)
{
    const char *p = r->target + t->path_size, *end = r->target + r->target_size;
    while (p < end) {
        const char *key = ++p;
        while (p < end && *p != '=' && *p != '&')
            p++;
        const size_t n = (size_t)(p - key);
        const bool place =
            kind == QUERY_HEIGHT && n == 3 && (!memcmp(key, "lon", n) || !memcmp(key, "lat", n));
        if (place || query_takes(kind, key, n))
            return err_set(e, ERR_FORMAT,
                           "%.*s stands in the address: a posted question has it in the body%s",
                           (int)n, key, place ? ", as {\"places\": [[lon, lat]]}" : "");
        while (p < end && *p != '&')
            p++;
    }
    return ERR_OK;
}

/* ERR_FORMAT: no JSON (400). ERR_DATA: impossible numbers (422). */
static enum err_code answer_query_read(const struct request *r, const struct target *t,
                                       const struct dataset *d, enum query_kind kind,
                                       struct query *out, struct err *e)
{
    json_t *o = NULL;
    enum err_code rc = answer_query_check_address(r, t, kind, e);
    if (!rc && !r->body_size)
        rc = err_set(e, ERR_FORMAT, "the body must be a JSON object");
    if (!rc)
        rc = jsonc_parse(r->body, r->body_size, "body", &o, e);
    if (!rc)
        rc = query_read(kind, o, &d->meta.origin, out, e);
    json_decref(o);
    return rc;
}

/* The height at the one place of an address. */
static enum err_code answer_query_read_place(const struct target_place *place,
                                             const struct dataset *d, struct query *out,
                                             struct err *e)
{
    if (!place->given)
        return err_set(e, ERR_FORMAT, "say where: ?lon=%.6f&lat=%.6f, or post places",
                       d->meta.origin.lon_deg, d->meta.origin.lat_deg);
    out->kind = QUERY_HEIGHT;
    out->n = 1;
    out->place[0][0] = place->lon_e7 / 1e7;
    out->place[0][1] = place->lat_e7 / 1e7;
    out->gsd_m = place->gsd_mm / 1e3;
    return ERR_OK;
}

/* ---- the work: its parameters are a struct query ---- */

static enum err_code answer_query_make(struct services *s, const struct job *j,
                                       const struct work *w, struct buf *out, struct err *e)
{
    const struct query *asked = work_own(w);
    struct draw_request q;
    memset(&q, 0, sizeof q);
    q.kind = DRAW_QUERY;
    q.query = *asked;
    return work_draw(s, j, w, &q, out, e);
}

static size_t answer_query_room(const struct work *w)
{
    (void)w;
    return (size_t)MEASURE_SAMPLES_MAX * 160;
}

static double answer_query_cost(const struct work *w, unsigned *variant)
{
    *variant = ((const struct query *)work_own(w))->kind;
    return 10;
}

static const struct work_kind answer_query_work = {.noun = "answer",
                                                   .traits = WORK_DRAWN | WORK_JUDGES,
                                                   .size = sizeof(struct query),
                                                   .make = answer_query_make,
                                                   .room = answer_query_room,
                                                   .cost = answer_query_cost};

/* ---- the answers ---- */

static void answer_query(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, enum query_kind kind, struct response *out)
{
    struct err e = {0};
    char device[160];
    if (!answer_map_is_surveyed(d, out))
        return;
    struct query *q = mem_array(1, sizeof *q);
    enum err_code rc = !q ? err_set(&e, ERR_MEM, "out of memory")
                       : r->method == METHOD_POST
                           ? answer_query_read(r, t, d, kind, q, &e)
                           : answer_query_read_place(&target_of_height(t)->place, d, q, &e);
    if (rc) {
        response_refused(out, rc, e.msg);
    } else if (answer_view_can_draw(s, out)) {
        picture_about(s->picture, device, sizeof device);
        struct hash128 id = picture_id_query(d, device, s->geoid ? geoid_name(s->geoid) : "", q);
        out->unnamed |= r->method == METHOD_POST;
        out->type = RESPONSE_JSON;
        struct query *own =
            response_made(s, r, id, out) ? response_work(d, &answer_query_work, id, out) : NULL;
        if (own)
            *own = *q;
    }
    mem_free(q);
}

#define ANSWER_QUERY(name, kind)                                                                   \
    void answer_query_##name(struct services *s, const struct request *r, struct dataset *d,       \
                             const struct target *t, struct response *out)                         \
    {                                                                                              \
        answer_query(s, r, d, t, kind, out);                                                       \
    }
ANSWER_QUERY(height, QUERY_HEIGHT)
ANSWER_QUERY(pick, QUERY_PICK)
ANSWER_QUERY(profile, QUERY_PROFILE)
ANSWER_QUERY(measure, QUERY_MEASURE)
ANSWER_QUERY(visible, QUERY_VISIBLE)
