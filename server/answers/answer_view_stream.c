/* Streams of pictures that follow a camera (view_stream.c): begins one, and sets its camera.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "server/answers/answer.h"
#include "server/answers/answer_appearance.h"
#include "server/answers/answer_view.h"
#include "server/answers/posted_view.h"
#include "server/answers/view_stream.h"
#include "server/http/multipart.h"

/* The wish is taken; its picture comes in the other answer. */
void answer_view_stream_steer(struct services *s, const struct request *r, struct dataset *d,
                              const struct target *t, struct response *out)
{
    struct err e = {0};
    struct posted_view p;
    struct view_stream_wish wish = {0};
    enum err_code rc =
        posted_view_read_stream(s->cfg, &d->meta.origin, r->body, r->body_size, &p, &e);
    if (rc) {
        response_refused(out, rc, e.msg);
        return;
    }
    if (!answer_view_check(s, p.cam.width_px, p.cam.height_px, p.format, &p.composite, out) ||
        !answer_appearance_find(s, d, p.appearance, &wish.appearance, out))
        return;
    wish.view = (struct draw_view){
        .cam = p.cam, .format = p.format, .quality = p.quality, .composite = p.composite};
    wish.timeout_s = p.timeout_s;
    wish.number = p.number;
    wish.still = p.still;
    wish.key = p.key;
    if (view_stream_steer(s->view_streams, d, target_of_motion(t)->stream.name, &wish, &e)) {
        response_problem(out, 404, e.msg);
        return;
    }
    out->status = 204;
    out->unlogged = true; /* cameras come many times a second */
}

void answer_view_stream(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    if (!answer_view_can_draw(s, out))
        return;
    out->status = 200;
    out->type = MULTIPART_TYPE;
    if (r->method == METHOD_HEAD)
        return;
    const struct target_stream *stream = &target_of_motion(t)->stream;
    out->video = stream->video;
    snprintf(out->stream, sizeof out->stream, "%s", stream->name);
    snprintf(out->stream_of, sizeof out->stream_of, "%s", d->meta.name);
}
