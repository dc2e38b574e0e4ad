/* The request target, parsed once into integers and enums. Everything after this file works with a
 * route, a dataset name that was matched against the catalog, and numbers; no byte of the target
 * ever becomes a path. A path needs no percent sign, no empty or dotted segment and no byte outside
 * [A-Za-z0-9/_.,@:-], so anything else is refused here and traversal, NUL and encoding tricks end
 * with it. Numbers are plain decimals without leading zeros, so that a resource has one name.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/target.h"

#include <stdio.h>
#include <string.h>

#include "codec/quant.h"
#include "server/text.h"

static const struct {
    const char *ext, *type;
} target_formats[] = {
#define FORMAT_ROW(id, ext, type) {ext, type},
    FORMAT_LIST(FORMAT_ROW)
#undef FORMAT_ROW
};

const char *target_ext(enum format f)
{
    return target_formats[f].ext;
}

const char *target_type(enum format f)
{
    return target_formats[f].type;
}

static const struct {
    unsigned allow;
    const char *path;
} target_routes[] = {
#define ROUTE_ROW(id, allow, path, summary) {allow, path},
    ROUTE_LIST(ROUTE_ROW)
#undef ROUTE_ROW
};

const char *target_path(enum route r)
{
    return target_routes[r].path;
}

unsigned target_allow(enum route r)
{
    return target_routes[r].allow;
}

/* One word of [a-z0-9][a-z0-9_-]* up to '/' or the end. */
static bool target_take_name(struct text *t, char *out, size_t room)
{
    size_t n = 0;
    for (; t->p < t->end && *t->p != '/'; t->p++) {
        char c = *t->p;
        bool plain = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9');
        if (n + 1 >= room || !(plain || (n && (c == '_' || c == '-'))))
            return false;
        out[n++] = c;
    }
    out[n] = 0;
    return n > 0;
}

static bool target_take_hex(struct text *t, int n, char *out)
{
    for (int i = 0; i < n; i++) {
        if (t->p == t->end || !(text_is_digit(t) || (*t->p >= 'a' && *t->p <= 'f')))
            return false;
        out[i] = *t->p++;
    }
    out[n] = 0;
    return true;
}

/* REV or REV-EDITION */
static bool target_take_rev(struct text *t, struct target *out)
{
    return target_take_hex(t, 12, out->rev) &&
           (!text_take(t, "-") || target_take_hex(t, 8, out->edition));
}

bool target_take_format(struct text *t, enum format first, enum format last, enum format *out)
{
    for (int f = (int)first; f <= (int)last; f++) {
        struct text at = *t;
        if (text_take(&at, target_formats[f].ext) && text_at_end(&at)) {
            *t = at;
            *out = (enum format)f;
            return true;
        }
    }
    return false;
}

static enum err_code target_nothing(struct err *e)
{
    return err_set(e, ERR_NOENT, "there is nothing at this path");
}

static bool target_is_terrain(enum route r)
{
    return r == ROUTE_TERRAIN || r == ROUTE_TERRAIN_MOVING || r == ROUTE_TERRAINJSON;
}

static bool target_is_view(enum route r)
{
    return r == ROUTE_VIEW || r == ROUTE_VIEW_MOVING;
}

enum err_code target_take_form(struct text *one, struct target *target, bool *known, struct err *e)
{
    struct form *out = &target->form;
    *known = true;
    if (text_take(one, "exp=") || text_take(one, "key=") || text_take(one, "scope=") ||
        text_take(one, "sig=")) {
        one->p = one->end; /* of a signed address (auth.c) */
    } else if (text_take(one, "appearance=")) {
        if (target->appearance[0] ||
            !text_take_decoded(one, target->appearance, sizeof target->appearance))
            return err_set(e, ERR_FORMAT,
                           "appearance is UTF-8 of at most %d bytes, percent-encoded, given once",
                           TARGET_APPEARANCE_MAX - 1);
    } else if (text_take(one, "preset=")) {
        int found = QUANT_PRESETS;
        for (int p = 0; p < QUANT_PRESETS; p++) {
            struct text at = *one;
            if (text_take(&at, quant_preset_name((enum quant_preset)p)) && text_at_end(&at))
                found = p;
        }
        if (found == QUANT_PRESETS || out->preset != QUANT_PRESETS)
            return err_set(e, ERR_FORMAT, "preset is one of " QUANT_PRESET_NAMES ", given once");
        out->preset = (uint8_t)found;
        one->p = one->end;
    } else if (text_take(one, "sh=")) {
        uint32_t degree;
        if (!text_take_uint(one, &degree) || degree > GAUSS_SH_DEGREE_MAX ||
            out->sh_degree != FORM_UNSAID)
            return err_set(e, ERR_FORMAT, "sh is 0 to %d, given once", GAUSS_SH_DEGREE_MAX);
        out->sh_degree = (uint8_t)degree;
    } else if (target_is_view(target->route) && text_take(one, "background=")) {
        if (target->paint.said_background ||
            !target_read_background(one->p, (size_t)(one->end - one->p), &target->paint))
            return err_set(e, ERR_FORMAT, "background is RRGGBB, sky or transparent, given once");
        one->p = one->end;
    } else if (target_is_view(target->route) && text_take(one, "depth=")) {
        if (target->paint.depth != DEPTH_NONE ||
            !target_read_depth(one->p, (size_t)(one->end - one->p), &target->paint))
            return err_set(e, ERR_FORMAT, "depth is mm, cm, dm or m, the unit, given once");
        one->p = one->end;
    } else if (target_is_terrain(target->route) && text_take(one, "encoding=")) {
        bool terrarium = text_take(one, "terrarium");
        if (target->encoding != ENCODING_UNSAID || (!terrarium && !text_take(one, "mapbox")))
            return err_set(e, ERR_FORMAT, "encoding is mapbox or terrarium, given once");
        target->encoding = terrarium ? ENCODING_TERRARIUM : ENCODING_MAPBOX;
    } else {
        *known = false;
    }
    return ERR_OK;
}

/* Of a query; what else it holds is for caches and not ours (Cesium adds v=REVISION). */
static enum err_code target_parse_form(const char *query, size_t n, struct target *out,
                                       struct err *e)
{
    for (struct text t = {query, query + n}; !text_at_end(&t);) {
        const char *amp = memchr(t.p, '&', (size_t)(t.end - t.p));
        struct text one = {t.p, amp ? amp : t.end};
        bool known;
        t.p = amp ? amp + 1 : t.end;
        enum err_code rc = target_take_form(&one, out, &known, e);
        if (!rc && known && !text_at_end(&one))
            rc = err_set(e, ERR_FORMAT, "the query has a malformed value");
        if (rc)
            return rc;
    }
    return ERR_OK;
}

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

/* {z}/{x}/{y}.{ext} */
static enum err_code target_parse_tile(struct text *t, enum route route, struct target *out,
                                       struct err *e)
{
    uint32_t z, x, y;
    if (!target_take_place(t, &z, &x, &y) || !text_take(t, ".") ||
        !target_take_format(t, FORMAT_GLB, FORMAT_SOG, &out->form.format))
        return err_set(e, ERR_NOENT,
                       "a tile is z/x/y.ext with ext one of glb, spz, drc, ply, plain.glb, "
                       "compressed.ply, sog");
    return target_set_key(z, x, y, route, out, e);
}

/* {z}/{x}/{y}.json: a part of a tileset */
static enum err_code target_parse_part(struct text *t, struct target *out, struct err *e)
{
    uint32_t z, x, y;
    if (!target_take_place(t, &z, &x, &y) || !text_take(t, ".json") || !text_at_end(t))
        return err_set(e, ERR_NOENT, "a part of a tileset is z/x/y.json");
    return target_set_key(z, x, y, ROUTE_TILESET_PART, out, e);
}

/* {z}/{x}/{y}[@2x].{fmt}: a map; terrain is PNG, since its pixels are numbers. */
static enum err_code target_parse_map(struct text *t, enum route route, struct target *out,
                                      struct err *e)
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

/* {lon},{lat},{h}@{heading},{pitch}[,{fov}[,{roll}]]/{w}x{h}[@{s}x].{fmt} */
static enum err_code target_parse_view(struct text *t, enum route route, struct target *out,
                                       struct err *e)
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

/* ?lon=X&lat=Y, both or (for POST) neither; other keys are ignored. */
static enum err_code target_parse_place(const char *query, size_t n, struct target *out,
                                        struct err *e)
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

/* Documents of a revision: false for what is none of them. */
static bool target_parse_document(struct text *t, struct target *out)
{
    static const struct {
        const char *path;
        enum route route;
    } words[] = {{"tileset.json", ROUTE_TILESET},
                 {"seed.ndjson", ROUTE_SEED},
                 {"appearance.json", ROUTE_MODEL},
                 {"appearances.json", ROUTE_PHOTOGRAPHS}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        struct text at = *t;
        if (text_take(&at, words[i].path) && text_at_end(&at)) {
            out->route = words[i].route;
            return true;
        }
    }
    struct text at = *t;
    if (!text_take(&at, "appearances/") || !text_take_uint(&at, &out->row) ||
        !text_take(&at, ".jpg") || !text_at_end(&at))
        return false;
    out->route = ROUTE_THUMBNAIL;
    return true;
}

/* Of /collections?bbox=w,s,e,n or w,s,lowest,e,n,highest; commas may come as %2C. Other keys are
 * ignored.
 */
static enum err_code target_parse_bbox(const char *query, size_t n, struct target *out,
                                       struct err *e)
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

static enum err_code target_parse_motion(struct text *t, struct target *out, struct err *e)
{
    if (!target_take_name(t, out->stream, sizeof out->stream) || !text_at_end(t) ||
        strlen(out->stream) < TARGET_STREAM_MIN)
        return err_set(
            e, ERR_NOENT,
            "a stream's name is %d to %zu of a-z, 0-9, _ and -, made by chance by whoever "
            "opens it",
            TARGET_STREAM_MIN, sizeof out->stream - 1);
    out->route = ROUTE_MOTION;
    return ERR_OK;
}

/* What follows /d/ */
static enum err_code target_parse_data(struct text *t, const char *query, size_t n_query,
                                       struct target *out, struct err *e)
{
    if (!target_take_name(t, out->ds, sizeof out->ds) || !text_take(t, "/"))
        return target_nothing(e);
    static const struct {
        const char *path;
        enum route route;
    } words[] = {{"tileset.json", ROUTE_TILESET_MOVING},
                 {"render", ROUTE_RENDER},
                 {"seed.ndjson", ROUTE_SEED_MOVING},
                 {"appearances", ROUTE_APPEARANCES},
                 {"appearance", ROUTE_APPEARANCE},
                 {"appearances:mix", ROUTE_MIX},
                 {"map.json", ROUTE_MAPJSON},
                 {"terrain.json", ROUTE_TERRAINJSON},
                 {"wmts.xml", ROUTE_WMTS},
                 {"height", ROUTE_HEIGHT},
                 {"pick", ROUTE_PICK},
                 {"profile", ROUTE_PROFILE},
                 {"measure", ROUTE_MEASURE},
                 {"visible", ROUTE_VISIBLE}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        struct text at = *t;
        if (!text_take(&at, words[i].path) || !text_at_end(&at))
            continue;
        out->route = words[i].route;
        return out->route == ROUTE_SEED_MOVING ? target_parse_seed(query, n_query, out, e)
               : out->route == ROUTE_HEIGHT    ? target_parse_place(query, n_query, out, e)
                                               : target_parse_form(query, n_query, out, e);
    }
    if (text_take(t, "motion/"))
        return target_parse_motion(t, out, e);
    bool revisioned = text_take(t, "r/");
    if (revisioned && (!target_take_rev(t, out) || !text_take(t, "/")))
        return err_set(e, ERR_NOENT,
                       "a revision is 12 hexadecimal digits, and - and the 8 of an edition "
                       "may follow");
    enum err_code rc = ERR_OK;
    if (revisioned && target_parse_document(t, out))
        ; /* it is taken */
    else if (revisioned && text_take(t, "tileset/"))
        rc = target_parse_part(t, out, e);
    else if (text_take(t, "t/"))
        rc = target_parse_tile(t, revisioned ? ROUTE_TILE : ROUTE_TILE_MOVING, out, e);
    else if (text_take(t, "static/"))
        rc = target_parse_view(t, revisioned ? ROUTE_VIEW : ROUTE_VIEW_MOVING, out, e);
    else if (text_take(t, "map/"))
        rc = target_parse_map(t, revisioned ? ROUTE_MAP : ROUTE_MAP_MOVING, out, e);
    else if (text_take(t, "terrain/"))
        rc = target_parse_map(t, revisioned ? ROUTE_TERRAIN : ROUTE_TERRAIN_MOVING, out, e);
    else
        rc = target_nothing(e);
    if (!rc && out->route == ROUTE_SEED)
        return target_parse_seed(query, n_query, out, e);
    return !rc ? target_parse_form(query, n_query, out, e) : rc;
}

static enum err_code target_parse_collection(struct text *t, struct target *out, struct err *e)
{
    if (!target_take_name(t, out->ds, sizeof out->ds))
        return target_nothing(e);
    if (text_at_end(t))
        return out->route = ROUTE_COLLECTION, ERR_OK;
    if (text_take(t, "/tiles.json") && text_at_end(t))
        return out->route = ROUTE_TILEJSON, ERR_OK;
    return target_nothing(e);
}

/* Bytes no legal path needs. */
static enum err_code target_check_path(const char *p, size_t n, struct err *e)
{
    if (!n || p[0] != '/')
        return err_set(e, ERR_FORMAT, "the request target must be a path");
    for (size_t i = 0; i < n; i++) {
        char c = p[i];
        bool ok = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                  memchr("/_.,@:-", c, 7);
        if (!ok)
            return err_set(e, ERR_FORMAT, "the path holds a byte that no path of this server has");
        if (c == '/' && i + 1 < n && (p[i + 1] == '/' || p[i + 1] == '.'))
            return err_set(e, ERR_FORMAT,
                           "the path holds an empty segment or one that begins with a dot");
    }
    return ERR_OK;
}

enum err_code target_parse(const char *text, size_t n, struct target *out, struct err *e)
{
    static const struct {
        const char *path;
        enum route route;
    } fixed[] = {
        {"/", ROUTE_LANDING},        {"/conformance", ROUTE_CONFORMANCE},
        {"/api", ROUTE_API},         {"/healthz", ROUTE_HEALTH},
        {"/readyz", ROUTE_READY},    {"/version", ROUTE_VERSION},
        {"/metrics", ROUTE_METRICS}, {"/collections", ROUTE_COLLECTIONS},
        {"/-/reload", ROUTE_RELOAD},
    };
    memset(out, 0, sizeof *out);
    out->route = ROUTE_NONE;
    out->form.preset = QUANT_PRESETS;
    out->form.sh_degree = FORM_UNSAID;
    const char *mark = n ? memchr(text, '?', n) : NULL;
    size_t n_path = mark ? (size_t)(mark - text) : n;
    out->path_size = n_path;
    enum err_code rc = target_check_path(text, n_path, e);
    for (size_t i = n_path; !rc && i < n; i++) /* it is logged and repeated in Location */
        if (text[i] <= 0x20 || text[i] >= 0x7f)
            rc = err_set(e, ERR_FORMAT, "the query holds a byte that must be percent-encoded");
    if (rc)
        return rc;
    struct text t = {text, text + n_path};
    for (size_t i = 0; i < sizeof fixed / sizeof *fixed; i++)
        if (strlen(fixed[i].path) == n_path && !memcmp(fixed[i].path, text, n_path)) {
            out->route = fixed[i].route;
            return mark && out->route == ROUTE_COLLECTIONS
                       ? target_parse_bbox(mark + 1, n - n_path - 1, out, e)
                       : ERR_OK;
        }
    if (text_take(&t, "/d/"))
        return target_parse_data(&t, mark ? mark + 1 : "", mark ? n - n_path - 1 : 0, out, e);
    if (text_take(&t, "/collections/"))
        return target_parse_collection(&t, out, e);
    out->route = ROUTE_STATIC; /* if the table of files has it */
    return ERR_OK;
}
