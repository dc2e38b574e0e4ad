/* Rendered views: the cacheable GET of a pose, and the POST of any camera.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/answers/answer_view.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lod/choose/view.h"
#include "server/answers/answer.h"
#include "server/answers/answer_appearance.h"
#include "server/answers/posted_view.h"
#include "server/drawing/composite.h"
#include "server/drawing/picture_id.h"

/* Of --max-view-mpx are drawn for a picture: the largest one may be twice as fine. */
#define VIEW_DRAWN 4.0

bool answer_view_can_draw(struct services *s, struct response *out)
{
    char text[320], why[160] = "this server was started with --device none";
    if (!s->picture || picture_state(s->picture) == PICTURE_OFF) {
        if (s->picture)
            picture_about(s->picture, why, sizeof why);
        snprintf(text, sizeof text,
                 "pictures, maps and questions about the surface are off: %s; tiles are served",
                 why);
        response_problem(out, 503, text);
        out->retry_after_s = services_drawing_wait_s(s);
        return false;
    }
    struct worker_status st;
    picture_status(s->picture, &st);
    if (st.wait_s > 0) {
        snprintf(text, sizeof text,
                 "the process that draws has ended several times, and is started again in %.0f s; "
                 "tiles are served",
                 ceil(st.wait_s));
        response_problem(out, 503, text);
        out->retry_after_s = (int)ceil(st.wait_s);
    }
    if (!st.known)
        out->unnamed = true; /* names hold the device, which is not known yet */
    return !(st.wait_s > 0);
}

bool answer_view_check(struct services *s, uint32_t width_px, uint32_t height_px, enum format f,
                       struct composite *paint, struct response *out)
{
    char text[256];
    if (!answer_view_can_draw(s, out))
        return false;
    uint64_t side = (uint64_t)s->cfg->max_view_px;
    if (!width_px || !height_px || width_px > side || height_px > side ||
        (double)width_px * height_px > s->cfg->max_view_mpx * 1e6) {
        snprintf(text, sizeof text, "a picture has 1 to %u pixels a side and at most %g megapixels",
                 (unsigned)side, s->cfg->max_view_mpx);
        response_problem(out, 422, text);
        return false;
    }
    double px = (double)width_px * height_px, most_px = VIEW_DRAWN * s->cfg->max_view_mpx * 1e6;
    if (s->plan.drawn_px)
        most_px = fmin(most_px, (double)s->plan.drawn_px);
    uint32_t fine = paint->supersample;
    if (px * fine * fine > most_px) {
        snprintf(
            text, sizeof text,
            "at most %g megapixels are drawn for a picture: with supersample %u it may have %g",
            most_px * 1e-6, fine, most_px * 1e-6 / fine / fine);
        response_problem(out, 422, text);
        return false;
    }
    composite_settle(paint, f, (uint32_t)s->cfg->supersample, px, most_px);
    return true;
}

/* ---- the work ---- */

static enum err_code answer_view_make(struct services *s, const struct job *j, const struct work *w,
                                      struct buf *out, struct err *e)
{
    const struct answer_view_own *o = work_own(w);
    struct draw_request q;
    memset(&q, 0, sizeof q);
    q.kind = DRAW_VIEW;
    q.appearance = o->appearance;
    q.view = o->view;
    return work_draw(s, j, w, &q, out, e);
}

size_t answer_view_room(const struct draw_view *v)
{
    return (size_t)v->cam.width_px * v->cam.height_px * 4;
}

static size_t answer_view_work_room(const struct work *w)
{
    const struct answer_view_own *o = work_own(w);
    return answer_view_room(&o->view);
}

/* The formula of docs/scale.md for drawing a usual picture of 300,000 Gaussians. */
double answer_view_cost_ms(const struct draw_view *v)
{
    const double gaussian_ms = 25e-6, drawn = 3e5;
    return 5 + gaussian_ms * drawn +
           DRAW_PIXEL_MS * (double)v->cam.width_px * v->cam.height_px *
               fmax(1, v->composite.supersample * v->composite.supersample);
}

static double answer_view_cost(const struct work *w, unsigned *variant)
{
    const struct answer_view_own *o = work_own(w);
    (void)variant;
    return answer_view_cost_ms(&o->view);
}

const struct work_kind answer_view_work = {.noun = "picture",
                                           .traits = WORK_DRAWN | WORK_PICTURE | WORK_ON_DISK,
                                           .size = sizeof(struct answer_view_own),
                                           .make = answer_view_make,
                                           .room = answer_view_work_room,
                                           .cost = answer_view_cost};

static void answer_view_ask(struct dataset *d, struct hash128 id, const struct draw_view *v,
                            const struct appearance_choice *a, struct response *out)
{
    struct answer_view_own *own = response_work(d, &answer_view_work, id, out);
    if (own)
        *own = (struct answer_view_own){*v, *a};
}

/* ---- the answers ---- */

static struct hash128 answer_view_id(struct services *s, const struct dataset *d,
                                     const struct draw_view *v, const struct appearance_choice *a)
{
    char device[160];
    picture_about(s->picture, device, sizeof device);
    return picture_id_view(d, device, v, a, (double)s->cfg->view_gaussians);
}

void answer_view(struct services *s, const struct request *r, struct dataset *d,
                 const struct target *t, struct response *out)
{
    struct err e = {0};
    struct camera cam;
    const struct view_target *asked = target_of_view(t);
    const struct target_view *v = &asked->view;
    const struct view_pose pose = {
        .lon_deg = v->pose.lon_e7 / 1e7,
        .lat_deg = v->pose.lat_e7 / 1e7,
        .h_m = v->pose.h_mm / 1e3,
        .heading_deg = v->pose.heading_e3 / 1e3,
        .pitch_deg = v->pose.pitch_e3 / 1e3,
        .fov_y_deg = v->pose.fov_e3 / 1e3,
    };
    struct appearance_choice choice;
    struct composite paint = v->composite;
    if (!answer_view_check(s, v->width_px, v->height_px, v->format, &paint, out) ||
        !answer_appearance_find(s, d, asked->appearance.appearance, &choice, out))
        return;
    if (composite_check(&v->composite, v->format, &e) ||
        view_camera(&d->meta.origin, &pose, v->width_px, v->height_px, &cam, &e)) {
        response_problem(out, 422, e.msg);
        return;
    }
    composite_roll(&cam, v->pose.roll_e3 / 1e3);
    const struct draw_view view = {
        .cam = cam, .format = v->format, .quality = (int)s->cfg->quality, .composite = paint};
    struct hash128 id = answer_view_id(s, d, &view, &choice);
    out->type = format_type(v->format);
    snprintf(out->surrogate, sizeof out->surrogate, "ds-%s rev-%s view", d->meta.name,
             d->meta.revision);
    if (!response_made(s, r, id, out))
        return;
    answer_view_ask(d, id, &view, &choice, out);
}

void answer_view_render(struct services *s, const struct request *r, struct dataset *d,
                        const struct target *t, struct response *out)
{
    (void)t;
    struct err e = {0};
    struct posted_view p;
    struct appearance_choice choice;
    enum err_code rc = posted_view_read(s->cfg, &d->meta.origin, r->body, r->body_size, &p, &e);
    if (rc) {
        response_refused(out, rc, e.msg);
        return;
    }
    if (!answer_view_check(s, p.cam.width_px, p.cam.height_px, p.format, &p.composite, out) ||
        !answer_appearance_find(s, d, p.appearance, &choice, out))
        return;
    const struct draw_view view = {
        .cam = p.cam, .format = p.format, .quality = p.quality, .composite = p.composite};
    struct hash128 id = answer_view_id(s, d, &view, &choice);
    out->type = format_type(p.format);
    out->unnamed = true; /* a name of the bytes is of no use */
    if (!response_made(s, r, id, out))
        return;
    answer_view_ask(d, id, &view, &choice, out);
    out->timeout_s = p.timeout_s;
}
