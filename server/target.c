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
#include "render/supersample.h"
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

bool target_is_terrain(enum route r)
{
    return r == ROUTE_TERRAIN || r == ROUTE_TERRAIN_MOVING || r == ROUTE_TERRAINJSON;
}

bool target_is_of_tiles(enum route r)
{
    return r == ROUTE_TILE || r == ROUTE_TILE_MOVING || r == ROUTE_TILESET ||
           r == ROUTE_TILESET_MOVING || r == ROUTE_TILESET_PART || r == ROUTE_SEED ||
           r == ROUTE_SEED_MOVING;
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
    } else if (text_take(one, "clip=")) {
        return target_take_clip(one, target, e);
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
    } else if (target_is_view(target->route) && text_take(one, "supersample=")) {
        uint32_t *to = &target->paint.supersample;
        if (*to || !text_take_uint(one, to) || !*to || *to > SUPERSAMPLE_MOST)
            return err_set(e, ERR_FORMAT, "supersample is 1 to %d, given once", SUPERSAMPLE_MOST);
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

bool target_is_kept_name(const char *name)
{
    struct text t = {name, name + strlen(name)};
    char again[TARGET_KEPT_MAX];
    return target_take_name(&t, again, sizeof again) && text_at_end(&t) &&
           strcmp(name, "default") != 0 && strcmp(name, "none") != 0;
}

static enum err_code target_parse_kept(struct text *t, struct target *out, struct err *e)
{
    if (!target_take_name(t, out->kept, sizeof out->kept) || !text_at_end(t) ||
        !target_is_kept_name(out->kept))
        return err_set(e, ERR_NOENT,
                       "an appearance is kept under a name of at most %d of a-z, 0-9, _ and -, "
                       "which begins with a letter or digit and is neither default nor none",
                       TARGET_KEPT_MAX - 1);
    out->route = ROUTE_KEPT;
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
    bool revisioned = text_take(t, "r/"); /* first: nearly all requests are for tiles of one */
    for (size_t i = 0; !revisioned && i < sizeof words / sizeof *words; i++) {
        struct text at = *t;
        if (!text_take(&at, words[i].path) || !text_at_end(&at))
            continue;
        out->route = words[i].route;
        return out->route == ROUTE_SEED_MOVING   ? target_parse_seed(query, n_query, out, e)
               : out->route == ROUTE_APPEARANCES ? target_parse_search(query, n_query, out, e)
               : out->route == ROUTE_HEIGHT      ? target_parse_place(query, n_query, out, e)
                                                 : target_parse_form(query, n_query, out, e);
    }
    if (!revisioned && text_take(t, "motion/"))
        return target_parse_motion(t, out, e);
    if (!revisioned && text_take(t, "appearances/"))
        return target_parse_kept(t, out, e);
    if (revisioned && (!target_take_rev(t, out) || !text_take(t, "/")))
        return err_set(e, ERR_NOENT,
                       "a revision is 12 hexadecimal digits, and - and the 8 of an edition "
                       "may follow");
    enum err_code rc = ERR_OK;
    if (text_take(t, "t/"))
        rc = target_parse_tile(t, revisioned ? ROUTE_TILE : ROUTE_TILE_MOVING, out, e);
    else if (revisioned && target_parse_document(t, out))
        ; /* it is taken */
    else if (revisioned && text_take(t, "tileset/"))
        rc = target_parse_part(t, out, e);
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
    if (text_take(t, "/map/tiles")) {
        out->route = text_at_end(t) ? ROUTE_MAP_TILESETS : ROUTE_MAP_TILESET;
        if (text_at_end(t) || (text_take(t, "/WebMercatorQuad") && text_at_end(t)))
            return ERR_OK;
        out->route = ROUTE_NONE;
    }
    return target_nothing(e);
}

/* A letter, a digit, or one of /_.,@:- which stand beside them in ASCII. */
static bool target_is_of_path(char c)
{
    return (c >= ',' && c <= ':') || (c >= '@' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '_';
}

/* Bytes no legal path needs. */
static enum err_code target_check_path(const char *p, size_t n, struct err *e)
{
    if (!n || p[0] != '/')
        return err_set(e, ERR_FORMAT, "the request target must be a path");
    for (size_t i = 0; i < n; i++) {
        char c = p[i];
        if (!target_is_of_path(c))
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
        {"/", ROUTE_LANDING},
        {"/conformance", ROUTE_CONFORMANCE},
        {"/api", ROUTE_API},
        {"/api.html", ROUTE_API_PAGE},
        {"/healthz", ROUTE_HEALTH},
        {"/readyz", ROUTE_READY},
        {"/version", ROUTE_VERSION},
        {"/metrics", ROUTE_METRICS},
        {"/collections", ROUTE_COLLECTIONS},
        {"/tileMatrixSets/WebMercatorQuad", ROUTE_MATRICES},
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
    if (text_take(&t, "/d/"))
        return target_parse_data(&t, mark ? mark + 1 : "", mark ? n - n_path - 1 : 0, out, e);
    for (size_t i = 0; i < sizeof fixed / sizeof *fixed; i++)
        if (strlen(fixed[i].path) == n_path && !memcmp(fixed[i].path, text, n_path)) {
            out->route = fixed[i].route;
            return mark && out->route == ROUTE_COLLECTIONS
                       ? target_parse_bbox(mark + 1, n - n_path - 1, out, e)
                       : ERR_OK;
        }
    if (text_take(&t, "/collections/"))
        return target_parse_collection(&t, out, e);
    out->route = ROUTE_STATIC; /* if the table of files has it */
    return ERR_OK;
}
