/* See param.h. A form that many parameters share is a type. A parameter with a form of its own has
 * a function here, or in param_clip.c. Numbers are plain decimals without leading
 * zeros, so that a resource has only one name.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route/param.h"

#include <string.h>

#include "codec/splat/quant.h"
#include "server/route/param_clip.h"
#include "server/route/route.h"

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

const char *param_choice(const struct param *p, uint32_t i, size_t *n)
{
    const char *word = p->type == PARAM_WORD ? p->words : NULL;
    if (p->type == PARAM_FORMAT && p->least + i <= p->most)
        word = format_ext((enum format)(p->least + i));
    for (; word && p->type == PARAM_WORD && i; i--) {
        word = strchr(word, '|');
        word += word != NULL;
    }
    *n = word ? strcspn(word, "|") : 0;
    return word;
}

/* Where the value goes. */
static void *param_member(const struct param *p, struct target *out)
{
    return (char *)out + out->route->at[p->group] + p->at;
}

static void param_keep(const struct param *p, uint32_t v, struct target *out)
{
    uint8_t *to = param_member(p, out);
    if (p->size == 1)
        *to = (uint8_t)(v < 255 ? v : 255);
    else
        memcpy(to, &v, sizeof v);
}

/* All of t is one of the choices. */
static bool param_read_choice(const struct param *p, struct text *t, struct target *out)
{
    size_t n;
    const char *word;
    for (uint32_t i = 0; (word = param_choice(p, i, &n)) != NULL; i++)
        if ((size_t)(t->end - t->p) == n && !memcmp(t->p, word, n)) {
            param_keep(p, (uint32_t)p->least + i, out);
            t->p = t->end;
            return true;
        }
    return false;
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

/* The rest of a query's part, or of a path up to the next slash. */
static bool param_read_span(const struct param *p, struct text *t, struct target *out)
{
    const char *slash = p->in & PARAM_PATH ? memchr(t->p, '/', (size_t)(t->end - t->p)) : NULL;
    const struct text span = {t->p, slash ? slash : t->end};
    memcpy(param_member(p, out), &span, sizeof span);
    t->p = span.end;
    return span.end - span.p >= (ptrdiff_t)p->least;
}

enum err_code param_read(const struct param *p, struct text *t, struct target *out, struct err *e)
{
    uint32_t v = 0;
    bool ok = true;
    switch (p->type) {
    case PARAM_NAME:
        ok = param_take_name(t, (size_t)p->least, (size_t)p->most, param_member(p, out));
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
    case PARAM_WORD:
        ok = param_read_choice(p, t, out);
        break;
    case PARAM_TEXT:
        ok = text_take_decoded(t, param_member(p, out), p->size);
        break;
    case PARAM_SPAN:
        ok = param_read_span(p, t, out);
        break;
    case PARAM_REST:
        t->p = t->end;
        break;
    case PARAM_OWN:
        return p->read(t, (char *)out + out->route->at[p->group], e);
    }
    return ok ? ERR_OK : ERR_NOENT;
}

/* ---- of paths ---- */

static bool param_take_hex(struct text *t, int n, char *out)
{
    for (int i = 0; i < n; i++) {
        const char c = t->p < t->end ? *t->p : 0;
        if (!((c >= '0' && c <= '9') || (c >= 'a' && c <= 'f')))
            return false;
        out[i] = c;
        t->p++;
    }
    out[n] = 0;
    return true;
}

/* REV or REV-EDITION */
static enum err_code param_own_rev(struct text *t, void *group, struct err *e)
{
    struct target_names *out = group;
    (void)e;
    return param_take_hex(t, 12, out->rev) &&
                   (!text_take(t, "-") || param_take_hex(t, 8, out->edition)) &&
                   (text_at_end(t) || *t->p == '/')
               ? ERR_OK
               : ERR_NOENT;
}

/* Of a file, in the place of a revision. */
static enum err_code param_own_digest(struct text *t, void *group, struct err *e)
{
    struct target_names *out = group;
    (void)e;
    return param_take_hex(t, 12, out->rev) ? ERR_OK : ERR_NOENT;
}

static enum err_code param_own_row_2x(struct text *t, void *group, struct err *e)
{
    struct target_cell *out = group;
    (void)e;
    if (!text_take_uint(t, &out->key.y))
        return ERR_NOENT;
    out->scale = text_take(t, "@2x") ? 2 : 1;
    return ERR_OK;
}

static bool param_take_kept(struct text *t, char out[TARGET_KEPT_MAX])
{
    return param_take_name(t, 1, TARGET_KEPT_MAX - 1, out) && strcmp(out, "default") != 0 &&
           strcmp(out, "none") != 0;
}

bool param_is_kept_name(const char *name)
{
    struct text t = {name, name + strlen(name)};
    char again[TARGET_KEPT_MAX];
    return param_take_kept(&t, again) && text_at_end(&t);
}

static enum err_code param_own_kept(struct text *t, void *group, struct err *e)
{
    struct target_names *out = group;
    (void)e;
    return param_take_kept(t, out->kept) ? ERR_OK : ERR_NOENT;
}

bool param_read_background(const char *text, size_t n, struct composite *out)
{
    uint32_t rgb = 0;
    out->said_background = true;
    if (n == strlen("sky") && !memcmp(text, "sky", n))
        return out->background = BACKGROUND_SKY, true;
    if (n == strlen("transparent") && !memcmp(text, "transparent", n))
        return out->background = BACKGROUND_TRANSPARENT, true;
    for (size_t i = 0; i < n; i++) {
        char c = text[i];
        int v = c >= '0' && c <= '9'   ? c - '0'
                : c >= 'a' && c <= 'f' ? c - 'a' + 10
                : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                       : -1;
        if (v < 0 || n != 6)
            return false;
        rgb = rgb * 16 + (uint32_t)v;
    }
    out->rgb = rgb;
    return n == 6;
}

/* ---- places ---- */

static enum err_code param_own_bbox(struct text *one, void *group, struct err *e)
{
    struct target_page *out = group;
    enum err_code rc = text_take_degrees(one, 4, "bbox:", out->bbox_e7, e);
    out->has_bbox = true;
    return !rc && out->bbox_e7[1] > out->bbox_e7[3]
               ? err_set(e, ERR_DATA, "bbox is west,south,east,north: south is above north")
               : rc;
}

static bool param_take_box(struct text t, bool solid, struct target_box *out)
{
    for (int k = 0; k < 2; k++)
        if ((k && !text_take(&t, ",")) ||
            text_take_degrees(&t, 2, "bbox:", &out->bbox_e7[2 * k], NULL) ||
            (solid && !(text_take(&t, ",") && text_take_fixed(&t, 3, &out->heights_mm[k]))))
            return false;
    return text_at_end(&t);
}

/* Of collections: four numbers, or six with heights. */
static enum err_code param_own_box(struct text *one, void *group, struct err *e)
{
    struct target_box *out = group;
    (void)e;
    out->has_heights = !param_take_box(*one, false, out);
    out->has_bbox = !out->has_heights || param_take_box(*one, true, out);
    one->p = one->end;
    return out->has_bbox && out->bbox_e7[1] <= out->bbox_e7[3] ? ERR_OK : ERR_NOENT;
}

/* ---- lists ---- */

static enum err_code param_own_zooms(struct text *one, void *group, struct err *e)
{
    struct target_zooms *out = group;
    uint32_t a, b;
    (void)e;
    if (!text_take_uint(one, &a))
        return ERR_NOENT;
    b = a;
    if ((text_take(one, "-") && !text_take_uint(one, &b)) || a > b || b > KEY_ZOOM_MAX)
        return ERR_NOENT;
    out->z_min = (uint8_t)a;
    out->z_max = (uint8_t)b;
    return ERR_OK;
}

/* ---- pictures ---- */

static enum err_code param_own_background(struct text *one, void *group, struct err *e)
{
    struct target_view *out = group;
    (void)e;
    if (!param_read_background(one->p, (size_t)(one->end - one->p), &out->composite))
        return ERR_NOENT;
    one->p = one->end;
    return ERR_OK;
}

/* ---- the table ---- */

#define PATH PARAM_PATH
#define QUERY(group) 1u << TARGET_##group
#define PARAM_OWN(function) PARAM_OWN, .read = function
const struct param PARAMS[] = {
#define PARAM(id, in, form, from, to, list, left_out, group, member, message, text)                \
    {PARAM_##form,                                                                                 \
     .name = #id,                                                                                  \
     in,                                                                                           \
     from,                                                                                         \
     to,                                                                                           \
     list,                                                                                         \
     left_out,                                                                                     \
     TARGET_##group,                                                                               \
     offsetof(struct target_##group, member),                                                      \
     sizeof((struct target_##group *)0)->member,                                                   \
     message,                                                                                      \
     text},
#include "server/route/params.def"
#undef PARAM
};
const size_t PARAMS_COUNT = sizeof PARAMS / sizeof *PARAMS;
