/* A polygon in a query: clip=lon,lat,lon,lat,... in degrees, one ring, whose first corner may be
 * repeated at the end. The first corner and the direction do not matter. It is stored
 * counterclockwise from its westernmost corner (of several the southernmost), so that equal
 * polygons are equal for every cache.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/route/param_clip.h"

#include <stdio.h>
#include <string.h>

#include "core/geo/outline.h"
#include "lod/export/clip.h"
#include "server/base/text.h"

static const double PARAM_CLIP_UNIT = 1e-7; /* degrees */

static enum err_code param_clip_corners(struct text *one, struct target_clip *c, struct err *e)
{
    int32_t at[2];
    char what[32];
    do {
        snprintf(what, sizeof what, "clip: corner %u is", c->n + 1);
        enum err_code rc = text_take_degrees(one, 2, what, at, e);
        if (rc)
            return rc;
        if (c->n && !memcmp(at, c->corner_e7[c->n - 1], sizeof at))
            continue;
        if (c->n == TARGET_CLIP_CORNERS && memcmp(at, c->corner_e7[0], sizeof at) != 0)
            return err_set(e, ERR_DATA, "clip: a polygon has 3 to %d corners", TARGET_CLIP_CORNERS);
        if (c->n < TARGET_CLIP_CORNERS)
            memcpy(c->corner_e7[c->n++], at, sizeof at);
    } while (text_take(one, ","));
    if (c->n > 1 && !memcmp(c->corner_e7[c->n - 1], c->corner_e7[0], sizeof at))
        c->n--;
    return text_at_end(one) ? ERR_OK : ERR_NOENT;
}

static void param_clip_degrees(const struct target_clip *c, double (*at)[2])
{
    for (uint32_t i = 0; i < c->n; i++)
        for (int k = 0; k < 2; k++)
            at[i][k] = PARAM_CLIP_UNIT * (double)c->corner_e7[i][k];
}

static void param_clip_order(struct target_clip *c, bool back)
{
    const struct target_clip was = *c;
    uint32_t first = 0;
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

enum err_code param_clip_read(struct text *one, void *tiles, struct err *e)
{
    struct target_clip *out = &((struct target_tiles *)tiles)->clip;
    double at[TARGET_CLIP_CORNERS][2];
    enum err_code rc = param_clip_corners(one, out, e);
    param_clip_degrees(out, at);
    if (!rc && outline_check((const double(*)[2])at, out->n, e)) {
        err_add(e, "clip");
        rc = ERR_DATA;
    }
    if (!rc)
        param_clip_order(out, outline_is_clockwise((const double(*)[2])at, out->n));
    return rc;
}

enum err_code param_clip_open(const struct target_clip *c, struct clip *out, struct err *e)
{
    double at[TARGET_CLIP_CORNERS][2];
    param_clip_degrees(c, at);
    return clip_of_ring((const double(*)[2])at, c->n, out, e);
}

char *param_clip_text(const struct target_clip *c, char out[TARGET_CLIP_TEXT])
{
    char *p = out;
    for (uint32_t i = 0; i < 2 * c->n; i++) {
        p += snprintf(p, (size_t)(out + TARGET_CLIP_TEXT - p), "%s%.7f", i ? "," : "",
                      c->corner_e7[i / 2][i % 2] * PARAM_CLIP_UNIT);
        while (p[-1] == '0') /* zeros at the end, and their point */
            p--;
        p -= p[-1] == '.';
    }
    *p = '\0';
    return p;
}
