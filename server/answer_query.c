/* Questions about the surface of a dataset: posted JSON, and the height at one place by address.
 * The thread that draws answers them, in the dataset's default appearance.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer.h"

#include <jansson.h>
#include <string.h>

#include "server/answer_map.h"
#include "server/answer_view.h"
#include "server/result_id.h"

/* ERR_FORMAT: no JSON (400). ERR_DATA: impossible numbers (422). */
static enum err_code answer_query_read(const struct request *r, const struct dataset *d,
                                       const struct target *t, enum query_kind kind,
                                       struct query *out, struct err *e)
{
    json_t *o = NULL;
    enum err_code rc = ERR_OK;
    if (r->method != METHOD_POST && !t->has_place)
        return err_set(e, ERR_FORMAT, "say where: ?lon=8.6821&lat=50.1109, or post places");
    if (r->method != METHOD_POST) {
        memset(out, 0, sizeof *out);
        out->kind = kind;
        out->n = 1;
        out->place[0][0] = t->pose.lon_e7 / 1e7;
        out->place[0][1] = t->pose.lat_e7 / 1e7;
        return ERR_OK;
    }
    if (!r->body_size)
        rc = err_set(e, ERR_FORMAT, "the body must be a JSON object");
    if (!rc)
        rc = jsonc_parse(r->body, r->body_size, "body", &o, e);
    if (!rc)
        rc = query_read(kind, o, &d->meta.origin, out, e);
    json_decref(o);
    return rc;
}

static void answer_query(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, enum query_kind kind, struct response *out)
{
    struct err e = {0};
    char device[160];
    if (!answer_map_is_surveyed(d, out))
        return;
    struct query *q = mem_array(1, sizeof *q);
    enum err_code rc =
        q ? answer_query_read(r, d, t, kind, q, &e) : err_set(&e, ERR_MEM, "out of memory");
    if (rc) {
        response_refused(out, rc, e.msg);
    } else if (answer_view_can_draw(s, out)) {
        picture_about(s->picture, device, sizeof device);
        struct hash128 id = result_id_query(d, device, s->geoid ? geoid_name(s->geoid) : "", q);
        out->unnamed |= r->method == METHOD_POST;
        out->type = RESPONSE_JSON;
        struct work *w = response_made(s, r, id, out)
                             ? response_work(d, WORK_QUERY, id, (struct form){0}, out)
                             : NULL;
        if (w) {
            w->query = q;
            q = NULL;
        }
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
