/* Where a target looks: tiles, maps, cameras, places and boxes, as integers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/target.h"

#include <string.h>

#include "server/text.h"

/* ---- tiles ---- */

static bool target_take_place(struct text *t, uint32_t *z, uint32_t *x, uint32_t *y)
{
    return text_take_uint(t, z) && text_take(t, "/") && text_take_uint(t, x) && text_take(t, "/") &&
           text_take_uint(t, y);
}

static enum err_code target_set_key(uint32_t z, uint32_t x, uint32_t y, enum route route,
                                    struct target *out, struct err *e)
{
    out->route = route;
    out->key = (struct key){(uint8_t)(z > 255 ? 255 : z), x, y};
    if (!key_valid(out->key))
        return err_set(e, ERR_NOENT, "tile %u/%u/%u does not exist: z <= 24, x and y < 2^z", z, x,
                       y);
    return ERR_OK;
}

enum err_code target_parse_tile(struct text *t, enum route route, struct target *out, struct err *e)
{
    uint32_t z, x, y;
    if (!target_take_place(t, &z, &x, &y) || !text_take(t, ".") ||
        !target_take_format(t, FORMAT_GLB, FORMAT_SOG, &out->form.format))
        return err_set(e, ERR_NOENT,
                       "a tile is z/x/y.ext with ext one of glb, spz, drc, ply, plain.glb, "
                       "compressed.ply, sog");
    return target_set_key(z, x, y, route, out, e);
}

enum err_code target_parse_part(struct text *t, struct target *out, struct err *e)
{
    uint32_t z, x, y;
    if (!target_take_place(t, &z, &x, &y) || !text_take(t, ".json") || !text_at_end(t))
        return err_set(e, ERR_NOENT, "a part of a tileset is z/x/y.json");
    return target_set_key(z, x, y, ROUTE_TILESET_PART, out, e);
}

enum err_code target_parse_map(struct text *t, enum route route, struct target *out, struct err *e)
{
    uint32_t z, x, y;
    bool terrain = target_is_terrain(route);
    enum format first = terrain ? FORMAT_PNG : FORMAT_JPG,
                last = terrain ? FORMAT_PNG : FORMAT_WEBP;
    bool ok = target_take_place(t, &z, &x, &y);
    out->scale = ok && text_take(t, "@2x") ? 2 : 1;
    if (!ok || !text_take(t, ".") || !target_take_format(t, first, last, &out->form.format))
        return err_set(e, ERR_NOENT,
                       terrain ? "a terrain tile is z/x/y.png or z/x/y@2x.png"
                               : "a map tile is z/x/y.ext or z/x/y@2x.ext with ext one of jpg, "
                                 "png, webp");
    return target_set_key(z, x, y, route, out, e);
}

/* ---- cameras ---- */

/* {w}x{h}[@{s}x].{fmt} */
static bool target_take_size(struct text *t, struct target *out)
{
    enum { SIDE_MAX = 1 << 20, SCALE_MAX = 4 }; /* far beyond what is drawn */
    uint32_t w, h, scale = 1;
    if (!text_take_uint(t, &w) || !text_take(t, "x") || !text_take_uint(t, &h))
        return false;
    if (text_take(t, "@") &&
        (!text_take_uint(t, &scale) || !text_take(t, "x") || !scale || scale > SCALE_MAX))
        return false;
    out->width_px = (w < SIDE_MAX ? w : SIDE_MAX) * scale;
    out->height_px = (h < SIDE_MAX ? h : SIDE_MAX) * scale;
    return text_take(t, ".") && target_take_format(t, FORMAT_JPG, FORMAT_NPY, &out->form.format);
}

enum err_code target_parse_view(struct text *t, enum route route, struct target *out, struct err *e)
{
    int64_t lon, lat, h, heading, pitch, fov = 60000, roll = 0;
    bool ok = text_take_fixed(t, 7, &lon) && text_take(t, ",") && text_take_fixed(t, 7, &lat) &&
              text_take(t, ",") && text_take_fixed(t, 3, &h) && text_take(t, "@") &&
              text_take_fixed(t, 3, &heading) && text_take(t, ",") && text_take_fixed(t, 3, &pitch);
    if (ok && text_take(t, ",")) {
        ok = text_take_fixed(t, 3, &fov);
        if (ok && text_take(t, ","))
            ok = text_take_fixed(t, 3, &roll);
    }
    if (!ok || !text_take(t, "/") || !target_take_size(t, out))
        return err_set(e, ERR_FORMAT,
                       "a view is lon,lat,h@heading,pitch[,fov[,roll]]/WxH[@Sx].ext with plain "
                       "decimal numbers, S 1 to 4 and ext one of jpg, png, webp, npy");
    if (lon < -1800000000 || lon > 1800000000 || lat < -900000000 || lat > 900000000)
        return err_set(e, ERR_DATA, "longitude is -180..180 and latitude -90..90 degrees");
    if (h < -20000000 || h > 2000000000)
        return err_set(e, ERR_DATA, "height is -20000..2000000 m above the ellipsoid");
    if (heading < -360000 || heading > 360000 || pitch < -90000 || pitch > 90000)
        return err_set(e, ERR_DATA, "heading is -360..360 and pitch -90..90 degrees");
    if (roll < -360000 || roll > 360000)
        return err_set(e, ERR_DATA, "roll is -360..360 degrees");
    if (fov < 1000 || fov > 150000)
        return err_set(e, ERR_DATA, "the vertical field of view is 1..150 degrees");
    out->route = route;
    out->pose = (struct target_pose){(int32_t)lon,
                                     (int32_t)lat,
                                     (int32_t)h,
                                     (int32_t)((heading + 720000) % 360000),
                                     (int32_t)pitch,
                                     (int32_t)fov,
                                     (int32_t)((roll + 720000) % 360000)};
    return ERR_OK;
}

/* ---- places ---- */

enum err_code target_parse_place(const char *query, size_t n, struct target *out, struct err *e)
{
    int64_t at[2] = {0};
    unsigned seen = 0;
    for (struct text t = {query, query + n}; !text_at_end(&t);) {
        const char *amp = memchr(t.p, '&', (size_t)(t.end - t.p));
        struct text one = {t.p, amp ? amp : t.end};
        t.p = amp ? amp + 1 : t.end;
        int k = text_take(&one, "lon=") ? 0 : text_take(&one, "lat=") ? 1 : 2;
        if (k == 2)
            continue;
        if (seen >> k & 1 || !text_take_fixed(&one, 7, &at[k]) || !text_at_end(&one))
            return err_set(e, ERR_FORMAT, "lon and lat are plain decimal degrees, each given once");
        seen |= 1u << k;
    }
    if (seen == 1 || seen == 2)
        return err_set(e, ERR_FORMAT, "lon and lat are given together");
    if (at[0] < -1800000000 || at[0] > 1800000000 || at[1] < -850000000 || at[1] > 850000000)
        return err_set(e, ERR_DATA, "longitude is -180..180 and latitude -85..85 degrees");
    out->has_place = seen == 3;
    out->pose.lon_e7 = (int32_t)at[0];
    out->pose.lat_e7 = (int32_t)at[1];
    return ERR_OK;
}

enum err_code target_parse_bbox(const char *query, size_t n, struct target *out, struct err *e)
{
    const char *end = query + n;
    for (const char *p = query; p < end;) {
        const char *amp = memchr(p, '&', (size_t)(end - p)), *stop = amp ? amp : end;
        struct text one = {p, stop}, plain;
        char text[128];
        int64_t v[6] = {0};
        int k = 0;
        p = amp ? amp + 1 : end;
        if (!text_take(&one, "bbox="))
            continue;
        bool ok = !out->has_bbox && text_take_decoded(&one, text, sizeof text);
        plain = (struct text){text, text + (ok ? strlen(text) : 0)};
        for (; ok && k < 6 && (!k || text_take(&plain, ",")); k++)
            ok = text_take_fixed(&plain, 7, &v[k]);
        int east = k == 6 ? 3 : 2;
        const int64_t flat[4] = {v[0], v[1], v[east], v[east + 1]};
        for (int i = 0; ok && k >= 4 && i < 4; i++)
            ok = flat[i] >= -(i % 2 ? 900000000 : 1800000000) &&
                 flat[i] <= (i % 2 ? 900000000 : 1800000000);
        if (!ok || !text_at_end(&plain) || (k != 4 && k != 6) || flat[1] > flat[3])
            return err_set(e, ERR_FORMAT,
                           "bbox is west,south,east,north in degrees, or "
                           "west,south,lowest,east,north,highest with metres, given once");
        for (int i = 0; i < 4; i++)
            out->bbox_e7[i] = (int32_t)flat[i];
        out->has_bbox = true;
        out->has_heights = k == 6;
        out->heights_mm[0] = k == 6 ? v[2] / 10000 : 0;
        out->heights_mm[1] = k == 6 ? v[5] / 10000 : 0;
    }
    return ERR_OK;
}
