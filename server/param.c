/* See param.h. A form that many parameters share is a type. A parameter with a form of its own has
 * a function here, or in param_clip.c and param_time.c. Numbers are plain decimals without leading
 * zeros, so that a resource has only one name.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/param.h"

#include <string.h>

#include "codec/quant.h"
#include "server/paint.h"
#include "server/param_clip.h"
#include "server/param_time.h"
#include "server/route.h"

/* ---- types ---- */

/* At least `least` and at most `most` letters, up to '/' or the end. */
static bool param_take_name(struct text *t, size_t least, size_t most, char *out)
{
    size_t n = 0;
    for (; t->p < t->end && *t->p != '/'; t->p++) {
        char c = *t->p;
        bool plain = (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9');
        if (n == most || !(plain || (n && (c == '_' || c == '-'))))
            return false;
        out[n++] = c;
    }
    out[n] = 0;
    return n >= least;
}

static bool param_take_format(struct text *t, int first, int last, enum format *out)
{
    for (int f = first; f <= last; f++) {
        struct text at = *t;
        if (text_take(&at, format_ext((enum format)f)) && text_at_end(&at)) {
            *t = at;
            *out = (enum format)f;
            return true;
        }
    }
    return false;
}

/* Which of the words "a|b|c" all of t is; false: none. */
static bool param_take_word(struct text *t, const char *words, uint32_t *out)
{
    const size_t n = (size_t)(t->end - t->p);
    for (uint32_t i = 0;; i++, words++) {
        const size_t m = strcspn(words, "|");
        if (n == m && !memcmp(t->p, words, n)) {
            t->p = t->end;
            *out = i;
            return true;
        }
        words += m;
        if (!*words)
            return false;
    }
}

static void param_keep(const struct param *p, uint32_t v, struct target *out)
{
    uint8_t *to = (uint8_t *)out + p->at;
    if (p->size == 1)
        *to = (uint8_t)(v < 255 ? v : 255);
    else
        memcpy(to, &v, sizeof v);
}

static enum err_code param_read_decimal(const struct param *p, struct text *t, struct target *out,
                                        struct err *e)
{
    const int digits = p->type == PARAM_E7 ? 7 : 3;
    const double unit = p->type == PARAM_E7 ? 1e7 : 1e3;
    int64_t v;
    if (!text_take_fixed(t, digits, &v))
        return ERR_NOENT;
    if ((double)v < p->least * unit || (double)v > p->most * unit)
        return err_set(e, ERR_DATA, "%s is %.9g to %.9g", p->name, p->least, p->most);
    if (p->type == PARAM_ANGLE)
        v = (v + 720000) % 360000;
    param_keep(p, (uint32_t)(int32_t)v, out);
    return ERR_OK;
}

enum err_code param_read(const struct param *p, struct text *t, struct target *out, struct err *e)
{
    uint32_t v = 0;
    enum format f;
    bool ok = true;
    switch (p->type) {
    case PARAM_NAME:
        ok = param_take_name(t, (size_t)p->least, (size_t)p->most, (char *)out + p->at);
        break;
    case PARAM_NATURAL:
    case PARAM_COUNT:
        ok = text_take_uint(t, &v) && (p->type == PARAM_NATURAL || (v >= p->least && v <= p->most));
        param_keep(p, v, out);
        break;
    case PARAM_E7:
    case PARAM_E3:
    case PARAM_ANGLE:
        return param_read_decimal(p, t, out, e);
    case PARAM_FORMAT:
        if ((ok = param_take_format(t, (int)p->least, (int)p->most, &f)))
            param_keep(p, (uint32_t)f, out);
        break;
    case PARAM_WORD:
        if ((ok = param_take_word(t, p->words, &v)))
            param_keep(p, v + (uint32_t)p->least, out);
        break;
    case PARAM_TEXT:
        ok = text_take_decoded(t, (char *)out + p->at, p->size);
        break;
    case PARAM_REST:
        t->p = t->end;
        break;
    case PARAM_OWN:
        return p->read(t, out, e);
    }
    return ok ? ERR_OK : ERR_NOENT;
}

/* ---- of paths ---- */

static bool param_take_hex(struct text *t, int n, char *out)
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
static enum err_code param_own_rev(struct text *t, struct target *out, struct err *e)
{
    (void)e;
    return param_take_hex(t, 12, out->rev) &&
                   (!text_take(t, "-") || param_take_hex(t, 8, out->edition)) &&
                   (text_at_end(t) || *t->p == '/')
               ? ERR_OK
               : ERR_NOENT;
}

/* Up to the next slash, or the end. */
static enum err_code param_own_seal(struct text *t, struct target *out, struct err *e)
{
    const char *slash = memchr(t->p, '/', (size_t)(t->end - t->p));
    (void)e;
    out->seal = t->p;
    t->p = slash ? slash : t->end;
    out->n_seal = (size_t)(t->p - out->seal);
    return out->n_seal ? ERR_OK : ERR_NOENT;
}

static enum err_code param_own_row_2x(struct text *t, struct target *out, struct err *e)
{
    (void)e;
    if (!text_take_uint(t, &out->key.y))
        return ERR_NOENT;
    out->scale = text_take(t, "@2x") ? 2 : 1;
    return ERR_OK;
}

bool param_is_kept_name(const char *name)
{
    struct text t = {name, name + strlen(name)};
    char again[TARGET_KEPT_MAX];
    return param_take_name(&t, 1, sizeof again - 1, again) && text_at_end(&t) &&
           strcmp(name, "default") != 0 && strcmp(name, "none") != 0;
}

static enum err_code param_own_kept(struct text *t, struct target *out, struct err *e)
{
    (void)e;
    return param_take_name(t, 1, sizeof out->kept - 1, out->kept) && param_is_kept_name(out->kept)
               ? ERR_OK
               : ERR_NOENT;
}

/* ---- places ---- */

/* A comma, which may come as %2C. */
static bool param_take_comma(struct text *t)
{
    return text_take(t, ",") || text_take(t, "%2C") || text_take(t, "%2c");
}

/* n numbers: longitude, latitude, longitude, ... in 1e-7 degrees. */
static enum err_code param_take_degrees(struct text *one, int n, const char *name, int32_t *out,
                                        struct err *e)
{
    for (int i = 0; i < n; i++) {
        int64_t v;
        const int64_t most = i % 2 ? 900000000 : 1800000000;
        if ((i && !param_take_comma(one)) || !text_take_fixed(one, 7, &v))
            return ERR_NOENT;
        if (v < -most || v > most)
            return err_set(e, ERR_DATA, "%s: no longitude and latitude", name);
        out[i] = (int32_t)v;
    }
    return ERR_OK;
}

static enum err_code param_own_bbox(struct text *one, struct target *out, struct err *e)
{
    enum err_code rc = param_take_degrees(one, 4, "bbox", out->bbox_e7, e);
    out->has_bbox = true;
    return !rc && out->bbox_e7[1] > out->bbox_e7[3]
               ? err_set(e, ERR_DATA, "bbox is west,south,east,north: south is above north")
               : rc;
}

/* Of collections: four numbers, or six with heights. */
static enum err_code param_own_box(struct text *one, struct target *out, struct err *e)
{
    char text[128];
    int64_t v[6] = {0};
    int n = 0;
    (void)e;
    bool ok = text_take_decoded(one, text, sizeof text);
    struct text plain = {text, text + (ok ? strlen(text) : 0)};
    for (; ok && n < 6 && (!n || text_take(&plain, ",")); n++)
        ok = text_take_fixed(&plain, 7, &v[n]);
    const int east = n == 6 ? 3 : 2;
    const int64_t flat[4] = {v[0], v[1], v[east], v[east + 1]};
    for (int i = 0; ok && n >= 4 && i < 4; i++)
        ok = flat[i] >= -(i % 2 ? 900000000 : 1800000000) &&
             flat[i] <= (i % 2 ? 900000000 : 1800000000);
    if (!ok || !text_at_end(&plain) || (n != 4 && n != 6) || flat[1] > flat[3])
        return ERR_NOENT;
    for (int i = 0; i < 4; i++)
        out->bbox_e7[i] = (int32_t)flat[i];
    out->has_bbox = true;
    out->has_heights = n == 6;
    out->heights_mm[0] = n == 6 ? v[2] / 10000 : 0;
    out->heights_mm[1] = n == 6 ? v[5] / 10000 : 0;
    return ERR_OK;
}

static enum err_code param_own_near(struct text *one, struct target *out, struct err *e)
{
    struct target_search *q = &out->search;
    int64_t radius;
    enum err_code rc = param_take_degrees(one, 2, "near", q->near_e7, e);
    q->has_near = true;
    if (rc || !param_take_comma(one))
        return rc;
    if (!text_take_fixed(one, 3, &radius))
        return ERR_NOENT;
    if (radius < 1 || radius > 4000000000)
        return err_set(e, ERR_DATA, "near: the radius is 0.001 to 4000000 m");
    q->radius_e3 = (uint32_t)radius;
    return ERR_OK;
}

/* ---- lists ---- */

static enum err_code param_own_datetime(struct text *one, struct target *out, struct err *e)
{
    out->search.has_time = true;
    return param_time_interval(one, out->search.time_s, e);
}

static enum err_code param_own_hours(struct text *one, struct target *out, struct err *e)
{
    uint32_t from, to;
    if (!text_take_uint(one, &from) || !text_take(one, "-") || !text_take_uint(one, &to))
        return ERR_NOENT;
    if (from > 23 || to > 24 || from == to)
        return err_set(e, ERR_DATA,
                       "hours: from 0 to 23, to another one, at most 24; 22-4 is over midnight");
    out->search.hours[0] = (uint8_t)from;
    out->search.hours[1] = (uint8_t)to;
    out->search.has_hours = true;
    return ERR_OK;
}

static enum err_code param_own_colour(struct text *one, struct target *out, struct err *e)
{
    struct paint p = {0};
    const size_t n = (size_t)(one->end - one->p);
    (void)e;
    if (n != 6 || !paint_read_background(one->p, n, &p) || p.background != BACKGROUND_COLOUR)
        return ERR_NOENT;
    out->search.rgb = p.rgb;
    out->search.has_colour = true;
    one->p = one->end;
    return ERR_OK;
}

static enum err_code param_own_zooms(struct text *one, struct target *out, struct err *e)
{
    uint32_t a = 0, b = 0;
    (void)e;
    bool ok = text_take_uint(one, &a);
    b = a;
    if (ok && text_take(one, "-"))
        ok = text_take_uint(one, &b);
    if (!ok || a > b || b > KEY_ZOOM_MAX)
        return ERR_NOENT;
    out->z_min = (uint8_t)a;
    out->z_max = (uint8_t)b;
    return ERR_OK;
}

/* course.c reads it. */
static enum err_code param_own_path(struct text *one, struct target *out, struct err *e)
{
    (void)e;
    out->course.path = one->p;
    out->course.n_path = (size_t)(one->end - one->p);
    one->p = one->end;
    return ERR_OK;
}

static enum err_code param_own_size(struct text *one, struct target *out, struct err *e)
{
    enum { SIDE_MAX = 16384 };
    uint32_t w, h;
    if (!text_take_uint(one, &w) || !text_take(one, "x") || !text_take_uint(one, &h))
        return ERR_NOENT;
    if (!w || !h || w > SIDE_MAX || h > SIDE_MAX)
        return err_set(e, ERR_DATA, "a side of size is 1 to %d pixels", SIDE_MAX);
    out->course.width_px = w;
    out->course.height_px = h;
    return ERR_OK;
}

/* ---- tiles and pictures ---- */

static enum err_code param_own_clip(struct text *one, struct target *out, struct err *e)
{
    if (!(out->route->query & QUERY_TILES))
        return err_set(e, ERR_FORMAT, "clip is of tiles, tilesets and prefetch lists");
    return param_clip_read(one, &out->clip, e);
}

static enum err_code param_own_background(struct text *one, struct target *out, struct err *e)
{
    (void)e;
    if (!paint_read_background(one->p, (size_t)(one->end - one->p), &out->paint))
        return ERR_NOENT;
    one->p = one->end;
    return ERR_OK;
}

/* ---- the table ---- */

#define PATH PARAM_PATH
#define NAME PARAM_NAME, NULL
#define NATURAL PARAM_NATURAL, NULL
#define COUNT PARAM_COUNT, NULL
#define E7 PARAM_E7, NULL
#define E3 PARAM_E3, NULL
#define ANGLE PARAM_ANGLE, NULL
#define FORMAT PARAM_FORMAT, NULL
#define WORD PARAM_WORD, NULL
#define TEXT PARAM_TEXT, NULL
#define REST PARAM_REST, NULL
#define OWN(name) PARAM_OWN, param_own_##name
const struct param PARAMS[] = {
#define PARAM(name, groups, type, least, most, words, standard, member, must, about)               \
    {#name,                                                                                        \
     groups,                                                                                       \
     type,                                                                                         \
     least,                                                                                        \
     most,                                                                                         \
     words,                                                                                        \
     standard,                                                                                     \
     offsetof(struct target, member),                                                              \
     sizeof((struct target *)0)->member,                                                           \
     must,                                                                                         \
     about},
#include "server/params.def"
#undef PARAM
};
const size_t PARAMS_COUNT = sizeof PARAMS / sizeof *PARAMS;
