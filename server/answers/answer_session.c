/* Sessions: a browser gives a token once and keeps a cookie (auth.h). Only pages of the service
 * itself may ask for one: else a page elsewhere could put its own session into a browser.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "server/answers/origin.h"
#include "server/base/text.h"

enum { ANSWER_SESSION_TOKEN = 512 };

/* Within a signed path, and where everything is public, nothing is opened by a signature: whatever
 * gets here is no address (dispatch.c). */
void answer_session_within(struct services *s, const struct request *r, struct dataset *d,
                           const struct target *t, struct response *out)
{
    (void)s, (void)r, (void)d, (void)t;
    response_problem(out, 404, "there is nothing at this path");
}

void answer_session_page(struct services *s, const struct request *r, struct dataset *d,
                         const struct target *t, struct response *out)
{
    static const char page[] =
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n"
        "<meta name=\"viewport\" content=\"width=device-width\">\n"
        "<title>citysplat: sign in</title>\n"
        "<style>body{font:1rem/1.5 system-ui,sans-serif;max-width:30rem;margin:4rem auto;"
        "padding:0 1rem}input,button{font:inherit;padding:.3rem .6rem}</style>\n"
        "<h1>Sign in</h1>\n<form method=\"post\"><p><label>Token<br>"
        "<input type=\"password\" name=\"token\" autocomplete=\"current-password\" required "
        "autofocus></label>\n<button>Sign in</button></form>\n</html>\n";
    (void)s, (void)d, (void)t;
    response_document(r, "text/html; charset=utf-8", body_text(page), out);
}

/* The token of {"token": "..."}, or of a form: token=... */
static bool answer_session_read(const struct request *r, char out[ANSWER_SESSION_TOKEN], bool *form)
{
    static const char field[] = "token=";
    const char *body = r->body;
    const size_t n = r->body_size, skip = sizeof field - 1;
    *form = n > skip && !memcmp(body, field, skip);
    if (*form) {
        struct text t = {body + skip, body + n};
        const char *amp = memchr(t.p, '&', n - skip);
        t.end = amp ? amp : t.end;
        return text_take_decoded(&t, out, ANSWER_SESSION_TOKEN);
    }
    json_t *o = n ? json_loadb(body, n, 0, NULL) : NULL;
    const char *token = json_string_value(json_object_get(o, "token"));
    const bool fits = token && *token && strlen(token) < ANSWER_SESSION_TOKEN;
    if (fits)
        memcpy(out, token, strlen(token) + 1);
    json_decref(o);
    return fits;
}

/* seal "": the browser forgets it. */
static void answer_session_set(const struct services *s, const struct request *r, const char *seal,
                               int64_t for_s, struct response *out)
{
    const char *base = s->cfg->base_path;
    struct buf b = {0};
    buf_printf(&b, "%s=%s; Path=%s; Max-Age=%lld; HttpOnly; SameSite=Lax%s", AUTH_COOKIE, seal,
               base && *base ? base : "/", (long long)for_s, origin_is_tls(s, r) ? "; Secure" : "");
    buf_u8(&b, 0);
    out->set_cookie = b.failed ? NULL : mem_text((const char *)b.data);
    buf_free(&b);
    if (!out->set_cookie)
        response_no_memory(out);
}

static bool answer_session_may(const struct services *s, const struct request *r,
                               struct response *out)
{
    if (!r->auth)
        response_problem(out, 404, "everything is public here: there are no sessions");
    else if (!origin_is_own_page(s, r))
        response_problem(out, 403, "sessions are for pages of this server");
    else
        return true;
    return false;
}

void answer_session_begin(struct services *s, const struct request *r, struct dataset *d,
                          const struct target *t, struct response *out)
{
    char token[ANSWER_SESSION_TOKEN], seal[AUTH_SEAL_MAX];
    int64_t for_s = 0;
    bool form;
    (void)d, (void)t;
    if (!answer_session_may(s, r, out))
        return;
    if (!answer_session_read(r, token, &form)) {
        response_problem(out, 400, "the body must be {\"token\": \"...\"}, or a form's token=...");
        return;
    }
    const double wait_s = services_sign_in(s, r->client, false);
    if (wait_s > 0) {
        response_problem(out, 429, "too many wrong tokens came from this client");
        out->retry_after_s = (int)ceil(wait_s);
        return;
    }
    const enum auth_answer answer = auth_session(r->auth, token, (int64_t)time(NULL), seal, &for_s);
    memset(token, 0, sizeof token);
    if (!answer)
        (void)services_sign_in(s, r->client, true);
    if (answer == AUTH_UNKNOWN) {
        response_problem(out, 404, "there are no sessions here: the file of --auth has no keys");
        return;
    }
    if (answer) {
        response_problem(out, 403, "no token is this one");
        return;
    }
    out->status = form ? 303 : 204;
    out->cache_control = RESPONSE_NO_STORE;
    out->location = form ? mem_text("./") : NULL;
    answer_session_set(s, r, seal, for_s, out);
}

void answer_session_end(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    (void)d, (void)t;
    if (!answer_session_may(s, r, out))
        return;
    out->status = 204;
    answer_session_set(s, r, "", 0, out);
}
