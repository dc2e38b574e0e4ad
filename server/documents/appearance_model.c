/* The appearance model as documents. Numbers are float32 in base64url, as in an appearance's text,
 * so a client gets the same bits that the server bakes with. The default appearance is no
 * photograph, so the numbers of photographs leave out its row.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/appearance_model.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "core/splat/appearance.h"
#include "lod/store/bake.h"
#include "lod/store/photograph.h"
#include "server/base/document.h"
#include "server/base/format.h"
#include "server/documents/link.h"

static json_t *appearance_model_text(const float *v, size_t n)
{
    char *text = mem_array(base64_room(n * sizeof *v), 1);
    if (!text)
        return NULL;
    base64_write(v, n * sizeof *v, BASE64_URL, text);
    json_t *o = json_string(text);
    mem_free(text);
    return o;
}

static size_t appearance_model_default(const struct appearance *a)
{
    ptrdiff_t row = appearance_find(a, BAKE_DEFAULT);
    return row < 0 ? a->n_images : (size_t)row;
}

/* The row of photograph number `at`. */
static size_t appearance_model_row(const struct appearance *a, size_t at)
{
    return at + (at >= appearance_model_default(a));
}

const char *appearance_model_photograph(const struct dataset *d, size_t at)
{
    const struct appearance *a = d->appearance;
    size_t row = a ? appearance_model_row(a, at) : 0;
    return a && row < a->n_images ? a->names[row] : NULL;
}

enum err_code appearance_model_describe(const struct dataset *d, struct body **out, struct err *e)
{
    const struct appearance *a = d->appearance;
    const float *standard = a->images + appearance_model_default(a) * a->len_image;
    const struct link l = {.from = LINK_REVISION, .ext = format_ext(FORMAT_DRC)};
    char tile[80], photographs[40];
    link_text(link_tile, &l, tile, sizeof tile - sizeof "?appearance=none");
    strcat(tile, "?appearance=none");
    return document_make(
        json_pack("{s:s,s:i,s:i,s:i,s:o,s:o,s:s,s:s}", "format", "citysplat-appearance-1",
                  "gaussianLength", (int)a->len_gauss, "imageLength", (int)a->len_image, "hidden",
                  (int)a->hidden, "weights", appearance_model_text(a->w1, appearance_weights(a)),
                  BAKE_DEFAULT, appearance_model_text(standard, a->len_image), "tiles", tile,
                  "photographs", link_text(link_photographs, &l, photographs, sizeof photographs)),
        out, e);
}

/* What the store knows of one, with its name; NULL when out of memory. */
static json_t *appearance_model_about(const struct dataset *d, const char *name, size_t number,
                                      const struct photograph *p)
{
    char href[40];
    json_t *o = json_pack("{s:s}", "name", name);
    if (!o || !p)
        return o;
    if (p->time[0])
        json_object_set_new(o, "time", json_string(p->time));
    const struct {
        const char *key;
        double v;
    } pose[] = {{"lon", p->lon_deg},         {"lat", p->lat_deg},     {"h", p->h_m + d->lift_m},
                {"heading", p->heading_deg}, {"pitch", p->pitch_deg}, {"fov", p->fov_y_deg}};
    for (size_t i = 0; i < sizeof pose / sizeof *pose; i++)
        json_object_set_new(o, pose[i].key, json_real(pose[i].v));
    const uint32_t row = (uint32_t)number;
    const struct link l = {.from = LINK_REVISION, .row = &row};
    if (p->has_thumbnail)
        json_object_set_new(o, "thumbnail",
                            json_string(link_text(link_thumbnail, &l, href, sizeof href)));
    return o;
}

/* Days before and after others; times begin with a day, year first. */
static void appearance_model_span(const char *time, char taken[2][11])
{
    char day[11];
    snprintf(day, sizeof day, "%.10s", time);
    if (strlen(day) < sizeof day - 1)
        return;
    if (!taken[0][0] || strcmp(day, taken[0]) < 0)
        memcpy(taken[0], day, sizeof day);
    if (strcmp(day, taken[1]) > 0)
        memcpy(taken[1], day, sizeof day);
}

/* One photograph into the list, and its embedding. */
static enum err_code appearance_model_add(const struct dataset *d, size_t number, float *image,
                                          json_t *list, char taken[2][11], struct err *e)
{
    const struct appearance *a = d->appearance;
    size_t row = appearance_model_row(a, number);
    struct photograph p;
    struct err why = {0};
    memcpy(image, a->images + row * a->len_image, a->len_image * sizeof *image);
    enum err_code rc = photograph_read(d->stores[0], a->names[row], &p, &why);
    if (rc && rc != ERR_NOENT)
        return err_set(e, rc, "%s", why.msg);
    if (!rc)
        appearance_model_span(p.time, taken);
    /* One that is missing would pair all after it with embeddings of others. */
    return json_array_append_new(list,
                                 appearance_model_about(d, a->names[row], number, rc ? NULL : &p))
               ? err_set(e, ERR_MEM, "photographs: out of memory")
               : ERR_OK;
}

enum err_code appearance_model_photographs(const struct dataset *d, struct body **out,
                                           char taken[2][11], struct err *e)
{
    const struct appearance *a = d->appearance;
    size_t n = a->n_images - (appearance_model_default(a) < a->n_images), len = a->len_image;
    float *images = mem_array(n, len * sizeof *images);
    json_t *list = json_array();
    enum err_code rc = images ? ERR_OK : err_set(e, ERR_MEM, "photographs: out of memory");
    for (size_t i = 0; !rc && i < n; i++)
        rc = appearance_model_add(d, i, images + i * len, list, taken, e);
    if (!rc)
        rc = document_make(json_pack("{s:s,s:i,s:o,s:O}", "format", "citysplat-photographs-1",
                                     "imageLength", (int)len, "embeddings",
                                     appearance_model_text(images, n * len), "photographs", list),
                           out, e);
    json_decref(list);
    mem_free(images);
    return rc;
}
