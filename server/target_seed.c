/* The query of a prefetch list: which tiles (an area, zooms, what a camera sees, or sees on its
 * way), in which form, and which page of the list.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/target.h"

#include <string.h>

#include "server/text.h"

static enum err_code target_take_bbox(struct text *one, struct target *out, struct err *e)
{
    int64_t v[4];
    for (int i = 0; i < 4; i++) {
        if ((i && !text_take(one, ",")) || !text_take_fixed(one, 7, &v[i]) || v[i] < -1800000000 ||
            v[i] > 1800000000)
            return err_set(e, ERR_FORMAT, "bbox is west,south,east,north in degrees");
        out->bbox_e7[i] = (int32_t)v[i];
    }
    out->has_bbox = true;
    return ERR_OK;
}

static enum err_code target_take_zooms(struct text *one, struct target *out, struct err *e)
{
    uint32_t a = 0, b = 0;
    bool ok = text_take_uint(one, &a);
    b = a;
    if (ok && text_take(one, "-"))
        ok = text_take_uint(one, &b);
    if (!ok || a > b || b > KEY_ZOOM_MAX)
        return err_set(e, ERR_FORMAT, "z is a zoom, or two as in 12-16");
    out->z_min = (uint8_t)a;
    out->z_max = (uint8_t)b;
    return ERR_OK;
}

/* A number of thousandths in [lo, hi]. */
static enum err_code target_take_measure(struct text *one, const char *name, uint32_t lo,
                                         uint32_t hi, uint32_t *out, struct err *e)
{
    int64_t v;
    if (!text_take_fixed(one, 3, &v))
        return err_set(e, ERR_FORMAT, "%s is a plain decimal number", name);
    if (v < lo || v > hi)
        return err_set(e, ERR_DATA, "%s is %g to %g", name, lo / 1e3, hi / 1e3);
    *out = (uint32_t)v;
    return ERR_OK;
}

static enum err_code target_take_sides(struct text *one, struct target_course *out, struct err *e)
{
    enum { SIDE_MAX = 16384 };
    uint32_t w, h;
    if (!text_take_uint(one, &w) || !text_take(one, "x") || !text_take_uint(one, &h))
        return err_set(e, ERR_FORMAT, "size is WxH, pixels");
    if (!w || !h || w > SIDE_MAX || h > SIDE_MAX)
        return err_set(e, ERR_DATA, "a side of size is 1 to %d pixels", SIDE_MAX);
    out->width_px = w;
    out->height_px = h;
    return ERR_OK;
}

static enum err_code target_take_page(struct text *one, const char *name, uint32_t lo, uint32_t hi,
                                      uint32_t *out, struct err *e)
{
    if (!text_take_uint(one, out) || *out < lo || *out > hi)
        return err_set(e, ERR_FORMAT, "%s is a number of lines, %u to %u", name, lo, hi);
    return ERR_OK;
}

enum {
    SEED_BBOX,
    SEED_Z,
    SEED_F,
    SEED_PATH,
    SEED_SIZE,
    SEED_FOV,
    SEED_ERROR,
    SEED_SPEED,
    SEED_HORIZON,
    SEED_AFTER,
    SEED_LIMIT,
    SEED_KEYS
};
static const char *const target_seed_keys[SEED_KEYS] = {
    "bbox=",  "z=",     "f=",       "path=",  "size=", "fov=",
    "error=", "speed=", "horizon=", "after=", "limit="};

/* What follows the `key`-th word. */
static enum err_code target_take_key(struct text *one, int key, struct target *out, struct err *e)
{
    struct target_course *c = &out->course;
    switch (key) {
    case SEED_BBOX:
        return target_take_bbox(one, out, e);
    case SEED_Z:
        return target_take_zooms(one, out, e);
    case SEED_F:
        return target_take_format(one, FORMAT_GLB, FORMAT_SOG, &out->form.format)
                   ? ERR_OK
                   : err_set(e, ERR_FORMAT,
                             "f is one of glb, spz, drc, ply, plain.glb, "
                             "compressed.ply, sog");
    case SEED_PATH:
        c->path = one->p;
        c->n_path = (size_t)(one->end - one->p);
        one->p = one->end; /* course.c reads it */
        return ERR_OK;
    case SEED_SIZE:
        return target_take_sides(one, c, e);
    case SEED_FOV:
        return target_take_measure(one, "fov", 1000, 150000, &c->fov_e3, e);
    case SEED_ERROR:
        return target_take_measure(one, "error", 500, 1000000, &c->error_e3, e);
    case SEED_SPEED:
        return target_take_measure(one, "speed", 100, 1000000, &c->speed_e3, e);
    case SEED_HORIZON:
        return target_take_measure(one, "horizon", 100, 3600000, &c->horizon_e3, e);
    case SEED_AFTER:
        return target_take_page(one, "after", 0, 999999999, &out->after, e);
    default:
        return target_take_page(one, "limit", 1, TARGET_LIMIT_MAX, &out->limit, e);
    }
}

static enum err_code target_take_seed(struct text *one, unsigned *seen, struct target *out,
                                      struct err *e)
{
    for (int k = 0; k < SEED_KEYS; k++) {
        if (*seen >> k & 1 || !text_take(one, target_seed_keys[k]))
            continue;
        *seen |= 1u << k;
        return target_take_key(one, k, out, e);
    }
    return err_set(e, ERR_FORMAT,
                   "the query may hold bbox, z, f, path, size, fov, error, speed, horizon, after, "
                   "limit, preset, sh, clip and appearance, each once");
}

/* In any order. Commas of a bbox may come as %2C. */
static bool target_plain_commas(struct text *one, char *out, size_t room)
{
    size_t n = 0;
    for (const char *p = one->p; p < one->end; p++) {
        bool comma = one->end - p >= 3 && p[0] == '%' && p[1] == '2' && (p[2] | 32) == 'c';
        if (n == room)
            return false;
        out[n++] = comma ? ',' : *p;
        p += comma ? 2 : 0;
    }
    *one = (struct text){out, out + n};
    return true;
}

enum err_code target_parse_seed(const char *query, size_t n, struct target *out, struct err *e)
{
    char plain[128];
    unsigned seen = 0;
    out->z_max = KEY_ZOOM_MAX;
    out->limit = TARGET_LIMIT;
    out->form.format = FORMAT_GLB;
    for (struct text t = {query, query + n}; !text_at_end(&t);) {
        const char *amp = memchr(t.p, '&', (size_t)(t.end - t.p));
        struct text one = {t.p, amp ? amp : t.end}, bbox = one;
        t.p = amp ? amp + 1 : t.end;
        bool known;
        if (text_take(&bbox, "bbox=") && !target_plain_commas(&one, plain, sizeof plain))
            return err_set(e, ERR_FORMAT, "bbox is west,south,east,north in degrees");
        enum err_code rc = target_take_form(&one, out, &known, e);
        if (!rc && !known)
            rc = target_take_seed(&one, &seen, out, e);
        if (!rc && !text_at_end(&one))
            rc = err_set(e, ERR_FORMAT, "the query has a malformed value");
        if (rc)
            return rc;
    }
    const unsigned camera =
        1u << SEED_SIZE | 1u << SEED_FOV | 1u << SEED_ERROR | 1u << SEED_SPEED | 1u << SEED_HORIZON;
    if (seen & camera && !(seen >> SEED_PATH & 1))
        return err_set(e, ERR_FORMAT,
                       "size, fov, error, speed and horizon are those of a camera: path says where "
                       "it is");
    return ERR_OK;
}

static void target_add_measure(struct buf *out, const char *name, uint32_t value_e3)
{
    if (value_e3)
        buf_printf(out, "&%s=%u.%03u", name, value_e3 / 1000, value_e3 % 1000);
}

void target_seed_query(const struct target *t, const char *path, uint32_t after, struct buf *out)
{
    const struct target_course *c = &t->course;
    char form[TARGET_QUERY_MAX];
    target_query(t, form);
    buf_printf(out, "%s%cf=%s&z=%u-%u", form, form[0] ? '&' : '?', target_ext(t->form.format),
               t->z_min, t->z_max);
    if (t->has_bbox) {
        static const char *const before[4] = {"&bbox=", ",", ",", ","};
        for (int i = 0; i < 4; i++) {
            int64_t v = t->bbox_e7[i], size = v < 0 ? -v : v;
            buf_printf(out, "%s%s%lld.%07lld", before[i], v < 0 ? "-" : "",
                       (long long)(size / 10000000), (long long)(size % 10000000));
        }
    }
    if (path)
        buf_printf(out, "&path=%s", path);
    if (c->width_px)
        buf_printf(out, "&size=%ux%u", c->width_px, c->height_px);
    target_add_measure(out, "fov", c->fov_e3);
    target_add_measure(out, "error", c->error_e3);
    target_add_measure(out, "speed", c->speed_e3);
    target_add_measure(out, "horizon", c->horizon_e3);
    buf_printf(out, "&limit=%u&after=%u", t->limit, after);
}
