/* See target_query.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route/target_query.h"

#include "codec/splat/quant.h"
#include "server/base/text.h"
#include "server/route/param_clip.h"

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
    for (int i = 0; t->page.has_bbox && i < 4; i++)
        buf_printf(out, "%s%.7f", i ? "," : "&bbox=", t->page.bbox_e7[i] / 1e7);
    buf_printf(out, "&limit=%u&after=%u", t->page.limit, after);
}
