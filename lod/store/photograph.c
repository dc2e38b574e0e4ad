/* Photographs of a store: the content of their blobs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/photograph.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lod/store/store_db.h"

enum err_code photograph_blob(const char *kind, const char *name, char out[PHOTOGRAPH_NAME_MAX],
                              struct err *e)
{
    int n = snprintf(out, PHOTOGRAPH_NAME_MAX, "%s%s", kind, name);
    return n > 0 && n < PHOTOGRAPH_NAME_MAX
               ? ERR_OK
               : err_set(e, ERR_LIMIT, "photograph '%.100s': its name is too long", name);
}

bool photograph_is_blob(const char *name)
{
    return !strncmp(name, PHOTOGRAPH_BLOB, strlen(PHOTOGRAPH_BLOB)) ||
           !strncmp(name, PHOTOGRAPH_THUMBNAIL, strlen(PHOTOGRAPH_THUMBNAIL));
}

enum err_code photograph_write(const struct photograph *p, struct buf *out, struct err *e)
{
    const double v[] = {p->lon_deg, p->lat_deg, p->h_m, p->heading_deg, p->pitch_deg, p->fov_y_deg};
    for (size_t i = 0; i < sizeof v / sizeof *v; i++)
        if (!isfinite(v[i]))
            return err_set(e, ERR_DATA, "photograph: its pose is not finite");
    buf_printf(out, "{\"time\":\"%s\",\"lon\":%.8f,\"lat\":%.8f,\"h\":%.3f,", p->time, v[0], v[1],
               v[2]);
    buf_printf(out, "\"heading\":%.2f,\"pitch\":%.2f,\"fov\":%.2f,\"thumbnail\":%s}", v[3], v[4],
               v[5], p->has_thumbnail ? "true" : "false");
    return buf_check(out, e);
}

/* A number of a blob within bounds, which also excludes what is not finite. */
static enum err_code photograph_number(const json_t *o, const char *key, double lo, double hi,
                                       double *out, struct err *e)
{
    enum err_code rc = jsonc_num(o, key, out, e);
    if (!rc && !(*out >= lo && *out <= hi))
        rc = err_set(e, ERR_FORMAT, "%s: out of range", key);
    return rc;
}

static enum err_code photograph_parse(const struct buf *b, const char *name, struct photograph *out,
                                      struct err *e)
{
    json_t *o = NULL;
    const char *time;
    *out = (struct photograph){0};
    enum err_code rc = jsonc_parse((const char *)b->data, b->size, name, &o, e);
    const struct {
        const char *key;
        double lo, hi, *to;
    } rows[] = {{"lon", -180, 180, &out->lon_deg},   {"lat", -90, 90, &out->lat_deg},
                {"h", -20000, 2000000, &out->h_m},   {"heading", 0, 360, &out->heading_deg},
                {"pitch", -90, 90, &out->pitch_deg}, {"fov", 0, 180, &out->fov_y_deg}};
    for (size_t i = 0; !rc && i < sizeof rows / sizeof *rows; i++)
        rc = photograph_number(o, rows[i].key, rows[i].lo, rows[i].hi, rows[i].to, e);
    if (!rc)
        rc = jsonc_text(o, "time", &time, e);
    if (!rc && strlen(time) >= sizeof out->time)
        rc = err_set(e, ERR_FORMAT, "time: too long");
    if (!rc) {
        memcpy(out->time, time, strlen(time) + 1);
        out->has_thumbnail = json_is_true(json_object_get(o, "thumbnail"));
    }
    json_decref(o);
    return rc;
}

enum err_code photograph_read(struct store *s, const char *name, struct photograph *out,
                              struct err *e)
{
    char blob[PHOTOGRAPH_NAME_MAX];
    struct buf b = {0};
    enum err_code rc = photograph_blob(PHOTOGRAPH_BLOB, name, blob, e);
    if (!rc)
        rc = store_get_blob(s, blob, &b, e);
    if (!rc && photograph_parse(&b, name, out, e))
        rc = err_add(e, "%s", s->path);
    buf_free(&b);
    return rc;
}

enum err_code photograph_thumbnail(struct store *s, const char *name, struct buf *out,
                                   struct err *e)
{
    char blob[PHOTOGRAPH_NAME_MAX];
    enum err_code rc = photograph_blob(PHOTOGRAPH_THUMBNAIL, name, blob, e);
    if (!rc)
        rc = store_get_blob(s, blob, out, e);
    if (!rc && (out->size < 4 || out->data[0] != 0xff || out->data[1] != 0xd8))
        rc = err_set(e, ERR_FORMAT, "%s: the thumbnail of %.100s is no JPEG", s->path, name);
    return rc;
}
