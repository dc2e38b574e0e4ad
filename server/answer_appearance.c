/* Appearances: the list, one of them, a posted mix; and what a request says about one.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answer.h"

static void answer_appearance_problem(const struct dataset *d, enum err_code rc,
                                      const struct err *e, struct response *out)
{
    int status = rc == ERR_NOENT ? 404 : rc == ERR_MEM ? 503 : 400;
    response_problem(out, status,
                     d->appearance ? e->msg
                                   : "this dataset was trained without appearance: it has one "
                                     "appearance, leave `appearance` out");
}

bool answer_find_appearance(const struct dataset *d, const char *text,
                            struct appearance_choice *out, struct response *res)
{
    struct err e = {0};
    enum err_code rc = appearance_api_find(d, text, out, &e);
    if (rc)
        answer_appearance_problem(d, rc, &e, res);
    return !rc;
}

static void answer_appearance_one(const struct request *r, struct dataset *d, const char *text,
                                  const char *cache_control, struct response *out)
{
    struct err e = {0};
    struct body *b = NULL;
    enum err_code rc = appearance_api_describe(d, text, &b, &e);
    if (!rc)
        response_document(r, RESPONSE_JSON, cache_control, b, out);
    else
        answer_appearance_problem(d, rc, &e, out);
}

static void answer_appearance_mix(const struct request *r, struct dataset *d, struct response *out)
{
    struct err e = {0};
    char text[TARGET_APPEARANCE_MAX];
    enum err_code rc = appearance_api_read_mix(d, r->body, r->body_size, text, &e);
    if (!rc)
        answer_appearance_one(r, d, text, RESPONSE_NO_STORE, out);
    else
        response_problem(out,
                         rc == ERR_MEM     ? 503
                         : rc == ERR_NOENT ? 404
                         : rc == ERR_DATA  ? 422
                                           : 400,
                         e.msg);
}

bool answer_appearance(const struct request *r, struct dataset *d, const struct target *t,
                       struct response *out)
{
    if (t->route == ROUTE_APPEARANCES)
        response_document(r, RESPONSE_JSON, RESPONSE_MOVING, body_ref(d->appearances), out);
    else if (t->route == ROUTE_APPEARANCE)
        answer_appearance_one(r, d, t->appearance, RESPONSE_MOVING, out);
    else if (t->route == ROUTE_MIX)
        answer_appearance_mix(r, d, out);
    else
        return false;
    return true;
}
