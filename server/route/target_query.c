/* See target_query.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route/target_query.h"

#include "codec/splat/quant.h"
#include "server/base/text.h"
#include "server/route/param_clip.h"
#include "server/route/param_time.h"

void target_query_tiles(const struct target_tiles *t, char out[TARGET_QUERY_MAX])
{
    const struct form *f = &t->form;
    char *p = out;
    if (f->preset < QUANT_PRESETS)
        p = text_put(text_put(p, "&preset="), quant_preset_name((enum quant_preset)f->preset));
    if (f->sh_degree <= GAUSS_SH_DEGREE_MAX)
        p = text_put_uint(text_put(p, "&sh="), f->sh_degree);
    if (f->part)
        p = text_put_uint(text_put(p, "&part="), f->part);
    if (t->clip.n)
        p = param_clip_text(&t->clip, text_put(p, "&clip="));
    *p = '\0';
    if (t->appearance[0])
        text_escape(t->appearance, text_put(p, "&appearance="));
    out[0] = out[0] ? '?' : '\0';
}

static void target_query_degrees(struct buf *out, const char *name, const int32_t *v_e7, int n)
{
    for (int i = 0; i < n; i++)
        buf_printf(out, "%s%.7f", i ? "," : name, v_e7[i] / 1e7);
}

static void target_query_measure(struct buf *out, const char *name, uint32_t value_e3)
{
    if (value_e3)
        buf_printf(out, "%s%.3f", name, value_e3 / 1e3);
}

void target_query_seed(const struct seed_target *t, uint32_t after, struct buf *out)
{
    static const char *const clients[] = {[CLIENT_CESIUM] = "cesium",
                                          [CLIENT_THREE] = "three",
                                          [CLIENT_VIEWER] = "viewer",
                                          [CLIENT_ALL] = "all"};
    char form[TARGET_QUERY_MAX];
    target_query_tiles(&t->tiles, form);
    buf_printf(out, "%s%cf=%s&z=%u-%u", form, form[0] ? '&' : '?', format_ext(t->tiles.form.format),
               t->zooms.z_min, t->zooms.z_max);
    if (t->zooms.client)
        buf_printf(out, "&for=%s", clients[t->zooms.client]);
    if (t->page.has_bbox)
        target_query_degrees(out, "&bbox=", t->page.bbox_e7, 4);
    buf_printf(out, "&limit=%u&after=%u", t->page.limit, after);
}

void target_query_search(const struct appearances_target *t, uint32_t after, struct buf *out)
{
    static const char *const sorts[] = {[SEARCH_BY_NUMBER] = "number",
                                        [SEARCH_BY_DISTANCE] = "distance",
                                        [SEARCH_BY_TIME] = "time",
                                        [SEARCH_BY_COLOUR] = "colour"};
    const struct target_search *q = &t->search;
    buf_printf(out, "?sort=%s", sorts[q->sort]);
    if (t->page.has_bbox)
        target_query_degrees(out, "&bbox=", t->page.bbox_e7, 4);
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
    buf_printf(out, "&limit=%u&after=%u", t->page.limit, after);
}
