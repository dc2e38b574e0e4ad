/* See appearance_list.h. Times are those of the cameras' clocks, without a time zone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/appearance_list.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "core/splat/appearance.h"
#include "core/splat/gauss.h"
#include "lod/store/bake.h"
#include "lod/store/photograph.h"
#include "server/base/document.h"
#include "server/base/text.h"
#include "server/data/appearance_rows.h"
#include "server/data/dataset.h"
#include "server/data/named_appearance.h"
#include "server/documents/appearance_api.h"
#include "server/documents/appearance_model.h"
#include "server/documents/link.h"

enum { LIST_SAMPLES = 8 /* Gaussians that a colour is averaged over */, LIST_ROW = 1500 };

/* ---- colours ---- */

/* Embeddings of a few Gaussians, evenly taken; none where they are another model's. */
static enum err_code list_sample(const struct appearance *a, const struct gauss *g,
                                 struct appearance_rows *s, struct err *e)
{
    const size_t n = g->n < LIST_SAMPLES ? g->n : LIST_SAMPLES, len = a->len_gauss;
    if (!n || g->embed_len != len)
        return ERR_OK;
    s->sample = mem_array(n * len, sizeof *s->sample);
    if (!s->sample)
        return err_set(e, ERR_MEM, "appearances: out of memory");
    s->n_sample = n;
    for (size_t i = 0; i < n; i++)
        memcpy(s->sample + i * len, g->embed + (i * g->n / n) * len, len * sizeof *s->sample);
    return ERR_OK;
}

/* What an appearance makes of mid grey. */
static void list_colour(const struct appearance *a, const struct appearance_rows *s,
                        const float *image, struct appearance_row *p)
{
    double sum[3] = {0};
    const size_t n = s->n_sample;
    if (!n)
        return;
    for (size_t i = 0; i < n; i++) {
        double y[APPEARANCE_OUT];
        appearance_eval(a, s->sample + i * a->len_gauss, image, y);
        for (int k = 0; k < 3; k++)
            sum[k] += fmin(fmax(2 * y[k] - 0.5, 0), 1);
    }
    for (int k = 0; k < 3; k++) {
        const double v = 255 * sum[k] / (double)n;
        p->rgb[k] = v >= 0 && v <= 255 ? (uint8_t)lround(v) : 0; /* NaN is black */
    }
    p->coloured = true;
}

/* ---- what is known ---- */

/* A date and time, or a date. */
static bool list_is_time(const char *text)
{
    struct tm t;
    const char *end = strptime(text, "%Y-%m-%dT%H:%M:%S", &t);
    if (!end)
        end = strptime(text, "%Y-%m-%d", &t);
    return end && !*end;
}

static enum err_code list_add(const struct dataset *d, const struct appearance_rows *s,
                              size_t number, struct appearance_row *out, struct err *e)
{
    const struct appearance *a = d->appearance;
    const char *name = appearance_model_photograph(d, number);
    struct photograph p;
    struct err why = {0};
    out->name = name;
    out->number = (uint32_t)number;
    list_colour(a, s, a->images + (size_t)appearance_find(a, name) * a->len_image, out);
    enum err_code rc = photograph_read(d->stores[0], name, &p, &why);
    if (rc)
        return rc == ERR_NOENT ? ERR_OK : err_set(e, rc, "%s", why.msg);
    out->posed = true;
    out->thumbnail = p.has_thumbnail;
    out->lon_deg = p.lon_deg;
    out->lat_deg = p.lat_deg;
    out->timed = list_is_time(p.time);
    snprintf(out->time, sizeof out->time, "%s", out->timed ? p.time : "");
    return ERR_OK;
}

enum err_code appearance_list_open(const struct dataset *d, struct appearance_rows **out,
                                   struct err *e)
{
    struct appearance_rows *s = mem_array(1, sizeof *s);
    struct gauss g = {0};
    struct err why = {0};
    size_t n = 0;
    *out = s;
    while (appearance_model_photograph(d, n))
        n++;
    if (!s || !(s->row = mem_array(n ? n : 1, sizeof *s->row))) {
        appearance_rows_close(out);
        return err_set(e, ERR_MEM, "out of memory for what is known of %zu photographs", n);
    }
    s->n = n;
    enum err_code rc = ERR_OK;
    if (store_read_gauss(d->stores[0], d->tiles[0].key, &g, &why))
        log_warn("serve", "appearances of %s have no colours: %s", d->meta.name, why.msg);
    else
        rc = list_sample(d->appearance, &g, s, e);
    for (size_t i = 0; !rc && i < n; i++)
        rc = list_add(d, s, i, &s->row[i], e);
    gauss_free(&g);
    if (rc)
        appearance_rows_close(out);
    return rc;
}

/* ---- the list ---- */

static json_t *list_link(const char *rel, void (*to)(const struct link *l, struct buf *out),
                         const char *name)
{
    static const char key[] = "?appearance=";
    const struct link l = {.from = LINK_DATASET};
    char href[3 * APPEARANCE_NAME_MAX + 64];
    size_t n = strlen(link_text(to, &l, href, 40));
    memcpy(href + n, key, sizeof key);
    text_escape(name, href + n + sizeof key - 1);
    return document_link(rel, "application/json", href, NULL);
}

/* is: its number, or true of one that is kept, or NULL. */
static json_t *list_row(const struct dataset *d, const struct appearance_row *p, json_t *is)
{
    char text[64];
    json_t *o = json_pack("{s:s}", "name", p->name);
    if (is)
        json_object_set_new(o, json_is_true(is) ? "kept" : "number", is);
    if (p->timed)
        json_object_set_new(o, "time", json_string(p->time));
    if (p->posed) {
        json_object_set_new(o, "lon", json_real(p->lon_deg));
        json_object_set_new(o, "lat", json_real(p->lat_deg));
    }
    snprintf(text, sizeof text, "%02x%02x%02x", p->rgb[0], p->rgb[1], p->rgb[2]);
    if (p->coloured)
        json_object_set_new(o, "colour", json_string(text));
    struct link l = link_to(LINK_DATASET, NULL, d, NULL);
    l.row = &p->number;
    if (p->thumbnail)
        json_object_set_new(o, "thumbnail",
                            json_string(link_text(link_thumbnail, &l, text, sizeof text)));
    json_object_set_new(o, "links",
                        json_pack("[o,o]", list_link("item", link_appearance, p->name),
                                  list_link("tileset", link_tileset_moving, p->name)));
    return o;
}

/* The default appearance: of no place, time and number. */
static void list_default(const struct dataset *d, json_t *list)
{
    const struct appearance *a = d->appearance;
    const ptrdiff_t at = appearance_find(a, BAKE_DEFAULT);
    struct appearance_row row = {.name = BAKE_DEFAULT};
    if (at < 0)
        return;
    list_colour(a, d->rows, a->images + (size_t)at * a->len_image, &row);
    json_array_append_new(list, list_row(d, &row, NULL));
}

static void list_named(const struct dataset *d, const struct named_appearance_row *named,
                       json_t *list)
{
    struct appearance_choice c;
    struct appearance_row row = {.name = named->name};
    if (appearance_api_find_kept(d, named, &c, NULL))
        return; /* of another revision */
    if (c.set)
        list_colour(d->appearance, d->rows, c.image, &row);
    json_array_append_new(list, list_row(d, &row, json_true()));
}

enum err_code appearance_list_write(const struct dataset *d,
                                    const struct named_appearance_table *kept, struct buf *out,
                                    struct err *e)
{
    const struct named_appearance_row *named = NULL;
    const size_t n_named = d->rows ? named_appearance_of(kept, d->meta.name, &named) : 0;
    const struct link here = {.from = LINK_DATASET};
    char self[64];
    json_t *list = json_array();
    for (size_t i = 0; d->rows && i < d->rows->n; i++) {
        const struct appearance_row *row = &d->rows->row[i];
        json_array_append_new(list, list_row(d, row, json_integer(row->number)));
    }
    if (d->rows)
        list_default(d, list);
    for (size_t i = 0; i < n_named; i++)
        list_named(d, &named[i], list);
    const int n = (int)json_array_size(list);
    json_t *links = json_pack(
        "[o]", document_link("self", "application/json",
                             link_text(link_appearances, &here, self, sizeof self), NULL));
    return document_write(
        json_pack("{s:s,s:i,s:i,s:i,s:o,s:o}", "default", d->appearance ? BAKE_DEFAULT : "",
                  "embeddingLength", d->appearance ? (int)d->appearance->len_image : 0,
                  "numberMatched", n, "numberReturned", n, "appearances", list, "links", links),
        out, e);
}

enum err_code appearance_list_all(const struct dataset *d, struct body **out, struct err *e)
{
    struct buf b = {0};
    const enum err_code rc = appearance_list_write(d, NULL, &b, e);
    return document_take(rc, &b, out, e);
}

size_t appearance_list_room(const struct dataset *d, const struct named_appearance_table *kept)
{
    const struct named_appearance_row *row = NULL;
    const size_t n = (d->appearance ? d->appearance->n_images : 0) +
                     named_appearance_of(kept, d->meta.name, &row);
    return n * LIST_ROW + 4096;
}
