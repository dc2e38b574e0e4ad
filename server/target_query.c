/* See target_query.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/target_query.h"

#include <stdio.h>
#include <string.h>

#include "codec/quant.h"
#include "server/param_clip.h"
#include "server/param_time.h"
#include "server/text.h"

void target_query_tiles(const struct target *t, char out[TARGET_QUERY_MAX])
{
    const struct form *f = &t->form;
    size_t n = 0;
    out[0] = '\0';
    if (f->preset < QUANT_PRESETS)
        n += (size_t)snprintf(out, TARGET_QUERY_MAX, "?preset=%s",
                              quant_preset_name((enum quant_preset)f->preset));
    if (f->sh_degree <= GAUSS_SH_DEGREE_MAX)
        n +=
            (size_t)snprintf(out + n, TARGET_QUERY_MAX - n, "%csh=%u", n ? '&' : '?', f->sh_degree);
    if (t->clip.n) {
        n += (size_t)snprintf(out + n, TARGET_QUERY_MAX - n, "%cclip=", n ? '&' : '?');
        param_clip_text(&t->clip, out + n);
        n += strlen(out + n);
    }
    if (t->appearance[0]) {
        n += (size_t)snprintf(out + n, TARGET_QUERY_MAX - n, "%cappearance=", n ? '&' : '?');
        text_escape(t->appearance, out + n);
    }
}

static void target_query_degrees(struct buf *out, const char *name, const int32_t *v_e7, int n)
{
    for (int i = 0; i < n; i++) {
        const int64_t v = v_e7[i], size = v < 0 ? -v : v;
        buf_printf(out, "%s%s%lld.%07lld", i ? "," : name, v < 0 ? "-" : "",
                   (long long)(size / 10000000), (long long)(size % 10000000));
    }
}

static void target_query_measure(struct buf *out, const char *name, uint32_t value_e3)
{
    if (value_e3)
        buf_printf(out, "%s%u.%03u", name, value_e3 / 1000, value_e3 % 1000);
}

void target_query_seed(const struct target *t, const char *path, uint32_t after, struct buf *out)
{
    const struct target_course *c = &t->course;
    char form[TARGET_QUERY_MAX];
    target_query_tiles(t, form);
    buf_printf(out, "%s%cf=%s&z=%u-%u", form, form[0] ? '&' : '?', format_ext(t->form.format),
               t->z_min, t->z_max);
    if (t->has_bbox)
        target_query_degrees(out, "&bbox=", t->bbox_e7, 4);
    if (path)
        buf_printf(out, "&path=%s", path);
    if (c->width_px)
        buf_printf(out, "&size=%ux%u", c->width_px, c->height_px);
    target_query_measure(out, "&fov=", c->fov_e3);
    target_query_measure(out, "&error=", c->error_e3);
    target_query_measure(out, "&speed=", c->speed_e3);
    target_query_measure(out, "&horizon=", c->horizon_e3);
    buf_printf(out, "&limit=%u&after=%u", t->limit, after);
}

void target_query_search(const struct target *t, uint32_t after, struct buf *out)
{
    static const char *const sorts[] = {[SEARCH_BY_NUMBER] = "number",
                                        [SEARCH_BY_DISTANCE] = "distance",
                                        [SEARCH_BY_TIME] = "time",
                                        [SEARCH_BY_COLOUR] = "colour"};
    const struct target_search *q = &t->search;
    buf_printf(out, "?sort=%s", sorts[q->sort]);
    if (t->has_bbox)
        target_query_degrees(out, "&bbox=", t->bbox_e7, 4);
    if (q->has_near)
        target_query_degrees(out, "&near=", q->near_e7, 2);
    target_query_measure(out, ",", q->radius_e3);
    if (q->has_time) {
        buf_printf(out, "&datetime=");
        param_time_write(q->time_s[0], out);
        buf_printf(out, "/");
        param_time_write(q->time_s[1], out);
    }
    if (q->has_hours)
        buf_printf(out, "&hours=%u-%u", q->hours[0], q->hours[1]);
    if (q->has_colour)
        buf_printf(out, "&colour=%06x", (unsigned)q->rgb);
    if (q->kept)
        buf_printf(out, "&kept=true");
    buf_printf(out, "&limit=%u&after=%u", t->limit, after);
}
