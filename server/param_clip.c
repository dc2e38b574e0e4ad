/* A polygon in a query: clip=lon,lat,lon,lat,... in degrees, one ring, whose first corner may be
 * repeated at the end. The first corner and the direction do not matter. It is stored
 * counterclockwise from its westernmost corner (of several the southernmost), so that equal
 * polygons are equal for every cache.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/param_clip.h"

#include <string.h>

#include "core/outline.h"
#include "lod/clip.h"
#include "server/text.h"

static const double PARAM_CLIP_UNIT = 1e-7; /* degrees */

static bool param_clip_same(const int32_t a[2], const int32_t b[2])
{
    return a[0] == b[0] && a[1] == b[1];
}

/* A comma, which may come as %2C. */
static bool param_clip_comma(struct text *t)
{
    return text_take(t, ",") || text_take(t, "%2C") || text_take(t, "%2c");
}

static enum err_code param_clip_corners(struct text *one, struct target_clip *c, struct err *e)
{
    static const int64_t most[2] = {1800000000, 900000000};
    int32_t at[2];
    do {
        for (int k = 0; k < 2; k++) {
            int64_t v;
            if ((k && !param_clip_comma(one)) || !text_take_fixed(one, 7, &v))
                return ERR_NOENT;
            if (v < -most[k] || v > most[k])
                return err_set(e, ERR_DATA, "clip: corner %u is no longitude and latitude",
                               c->n + 1);
            at[k] = (int32_t)v;
        }
        if (c->n && param_clip_same(at, c->corner_e7[c->n - 1]))
            continue;
        if (c->n == TARGET_CLIP_CORNERS && !param_clip_same(at, c->corner_e7[0]))
            return err_set(e, ERR_DATA, "clip: a polygon has 3 to %d corners", TARGET_CLIP_CORNERS);
        if (c->n < TARGET_CLIP_CORNERS)
            memcpy(c->corner_e7[c->n++], at, sizeof at);
    } while (param_clip_comma(one));
    if (!text_at_end(one))
        return ERR_NOENT;
    if (c->n > 1 && param_clip_same(c->corner_e7[c->n - 1], c->corner_e7[0]))
        c->n--;
    return ERR_OK;
}

static void param_clip_degrees(const struct target_clip *c, double (*at)[2])
{
    for (uint32_t i = 0; i < c->n; i++)
        for (int k = 0; k < 2; k++)
            at[i][k] = PARAM_CLIP_UNIT * (double)c->corner_e7[i][k];
}

/* Twice the signed area: positive counterclockwise, longitude to the right. */
static double param_clip_area(const struct target_clip *c)
{
    double sum = 0;
    const int32_t *o = c->corner_e7[0];
    for (uint32_t i = 1; i + 1 < c->n; i++) {
        const int32_t *p = c->corner_e7[i], *q = c->corner_e7[i + 1];
        sum += ((double)p[0] - o[0]) * ((double)q[1] - o[1]) -
               ((double)q[0] - o[0]) * ((double)p[1] - o[1]);
    }
    return sum;
}

static void param_clip_order(struct target_clip *c)
{
    struct target_clip was = *c;
    uint32_t first = 0;
    const bool back = param_clip_area(c) < 0;
    for (uint32_t i = 1; i < c->n; i++) {
        const int32_t *p = c->corner_e7[i], *q = c->corner_e7[first];
        if (p[0] < q[0] || (p[0] == q[0] && p[1] < q[1]))
            first = i;
    }
    memset(c->corner_e7, 0, sizeof c->corner_e7);
    for (uint32_t i = 0; i < c->n; i++)
        memcpy(c->corner_e7[i], was.corner_e7[(back ? first + c->n - i : first + i) % c->n],
               sizeof *c->corner_e7);
}

enum err_code param_clip_read(struct text *one, struct target_clip *out, struct err *e)
{
    double at[TARGET_CLIP_CORNERS][2];
    enum err_code rc = param_clip_corners(one, out, e);
    param_clip_degrees(out, at);
    if (!rc && outline_check((const double(*)[2])at, out->n, e)) {
        err_add(e, "clip");
        rc = ERR_DATA;
    }
    if (!rc)
        param_clip_order(out);
    return rc;
}

enum err_code param_clip_open(const struct target_clip *c, struct clip *out, struct err *e)
{
    double at[TARGET_CLIP_CORNERS][2];
    param_clip_degrees(c, at);
    return clip_of_ring((const double(*)[2])at, c->n, out, e);
}

/* The number without zeros at its end. */
static char *param_clip_put(char *p, int32_t v)
{
    const int64_t size = v < 0 ? -(int64_t)v : v;
    if (v < 0)
        *p++ = '-';
    p = text_put_uint(p, (uint32_t)(size / 10000000));
    uint32_t rest = (uint32_t)(size % 10000000);
    if (rest)
        *p++ = '.';
    for (uint32_t unit = 1000000; rest; rest %= unit, unit /= 10)
        *p++ = (char)('0' + rest / unit);
    return p;
}

void param_clip_text(const struct target_clip *c, char out[TARGET_CLIP_TEXT])
{
    char *p = out;
    for (uint32_t i = 0; i < 2 * c->n; i++) {
        if (i)
            *p++ = ',';
        p = param_clip_put(p, c->corner_e7[i / 2][i % 2]);
    }
    *p = '\0';
}
