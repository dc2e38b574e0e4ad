/* Search for appearances by place, time and colour: see search.h.
 *
 * Distances are between places on the ellipsoid, in a straight line; over a city that is a
 * millionth shorter than along it. Colours are compared in CIE Lab by the distance of 1976. Times
 * are those of the cameras' clocks, without a time zone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/search.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/splat/appearance.h"
#include "core/splat/gauss.h"
#include "lod/store/bake.h"
#include "lod/store/photograph.h"
#include "server/base/document.h"
#include "server/base/text.h"
#include "server/data/dataset.h"
#include "server/data/named_appearance.h"
#include "server/data/search_index.h"
#include "server/documents/appearance_api.h"
#include "server/documents/appearance_model.h"
#include "server/documents/link.h"
#include "server/route/param_time.h"
#include "server/route/target_query.h"

enum { SEARCH_SAMPLES = 8 /* Gaussians that a colour is averaged over */, SEARCH_ROW = 1500 };

/* ---- colours ---- */

/* Embeddings of a few Gaussians, evenly taken; none where they are another model's. */
static enum err_code search_sample(const struct appearance *a, const struct gauss *g,
                                   struct search_index *s, struct err *e)
{
    const size_t n = g->n < SEARCH_SAMPLES ? g->n : SEARCH_SAMPLES, len = a->len_gauss;
    if (!n || g->embed_len != len)
        return ERR_OK;
    s->sample = mem_array(n * len, sizeof *s->sample);
    if (!s->sample)
        return err_set(e, ERR_MEM, "search: out of memory");
    s->n_sample = n;
    for (size_t i = 0; i < n; i++)
        memcpy(s->sample + i * len, g->embed + (i * g->n / n) * len, len * sizeof *s->sample);
    return ERR_OK;
}

/* What an appearance makes of mid grey. */
static void search_colour(const struct appearance *a, const struct search_index *s,
                          const float *image, struct search_photo *p)
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
    search_index_lab(p->rgb, p->lab);
    p->coloured = true;
}

/* ---- the index ---- */

static enum err_code search_add(const struct dataset *d, const struct search_index *s,
                                size_t number, struct search_photo *out, struct err *e)
{
    const struct appearance *a = d->appearance;
    const char *name = appearance_model_photograph(d, number);
    struct photograph p;
    struct err why = {0};
    out->name = name;
    out->number = (uint32_t)number;
    search_colour(a, s, a->images + (size_t)appearance_find(a, name) * a->len_image, out);
    enum err_code rc = photograph_read(d->stores[0], name, &p, &why);
    if (rc)
        return rc == ERR_NOENT ? ERR_OK : err_set(e, rc, "%s", why.msg);
    out->posed = true;
    out->thumbnail = p.has_thumbnail;
    out->lon_deg = p.lon_deg;
    out->lat_deg = p.lat_deg;
    out->timed = param_time_read(p.time, strlen(p.time), &out->time_s, NULL);
    snprintf(out->time, sizeof out->time, "%s", out->timed ? p.time : "");
    return geo_to_enu(&d->meta.origin, p.lon_deg, p.lat_deg, 0, out->at_m, e);
}

enum err_code search_open(const struct dataset *d, struct search_index **out, struct err *e)
{
    struct search_index *s = mem_array(1, sizeof *s);
    struct gauss g = {0};
    struct err why = {0};
    size_t n = 0;
    *out = s;
    while (appearance_model_photograph(d, n))
        n++;
    if (!s || !(s->photo = mem_array(n ? n : 1, sizeof *s->photo))) {
        search_index_close(out);
        return err_set(e, ERR_MEM, "out of memory for what is known of %zu photographs", n);
    }
    s->n = n;
    enum err_code rc = ERR_OK;
    if (store_read_gauss(d->stores[0], d->tiles[0].key, &g, &why))
        log_warn("serve", "appearances of %s are not found by colour: %s", d->meta.name, why.msg);
    else
        rc = search_sample(d->appearance, &g, s, e);
    for (size_t i = 0; !rc && i < n; i++)
        rc = search_add(d, s, i, &s->photo[i], e);
    gauss_free(&g);
    if (rc)
        search_index_close(out);
    return rc;
}

/* ---- asking ---- */

struct search_hit {
    const struct search_photo *photo;
    /* a name, or the default: of no place and no time; numbers are after those of photographs */
    bool kept, standard;
    double distance_m, colour; /* as far as they are asked for */
    double by;                 /* what it is sorted by */
};

static bool search_in_area(const struct appearances_target *t, const struct search_photo *p)
{
    const double lon = p->lon_deg * 1e7, lat = p->lat_deg * 1e7;
    const int32_t *b = t->page.bbox_e7;
    const bool across = b[0] > b[2]; /* of the antimeridian */
    const bool east_west = across ? lon >= b[0] || lon <= b[2] : lon >= b[0] && lon <= b[2];
    return !t->page.has_bbox || (p->posed && east_west && lat >= b[1] && lat <= b[3]);
}

static bool search_in_time(const struct target_search *q, const struct search_photo *p)
{
    const int64_t second = ((p->time_s % 86400) + 86400) % 86400;
    const int32_t from = q->hours[0] * 3600, to = q->hours[1] * 3600;
    const bool in_hours = from < to ? second >= from && second < to
                                    : second >= from || second < to; /* over midnight */
    return (!q->has_time || (p->timed && p->time_s >= q->time_s[0] && p->time_s <= q->time_s[1])) &&
           (!q->has_hours || (p->timed && in_hours));
}

/* True: it is one of those that are asked for. */
static bool search_hits(const struct appearances_target *t, const double near_m[3],
                        const double lab[3], const struct search_photo *p, struct search_hit *hit)
{
    const struct target_search *q = &t->search;
    if (!search_in_area(t, p) || !search_in_time(q, p) || (q->has_near && !p->posed) ||
        (q->has_colour && !p->coloured))
        return false;
    double d[3], c[3];
    for (int k = 0; k < 3; k++) {
        d[k] = p->at_m[k] - near_m[k];
        c[k] = p->lab[k] - lab[k];
    }
    *hit = (struct search_hit){.photo = p,
                               .distance_m = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]),
                               .colour = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])};
    hit->by = q->sort == SEARCH_BY_DISTANCE ? hit->distance_m
              : q->sort == SEARCH_BY_COLOUR ? hit->colour
              : q->sort == SEARCH_BY_TIME   ? (p->timed ? (double)p->time_s : HUGE_VAL)
                                            : (double)p->number;
    return !q->radius_e3 || hit->distance_m <= q->radius_e3 / 1e3;
}

static int search_by(const void *pa, const void *pb)
{
    const struct search_hit *a = pa, *b = pb;
    if (a->by != b->by)
        return a->by < b->by ? -1 : 1;
    return a->photo->number < b->photo->number ? -1 : a->photo->number > b->photo->number;
}

static json_t *search_link(const char *rel, void (*to)(const struct link *l, struct buf *out),
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

static json_t *search_row(const struct dataset *d, const struct appearances_target *t,
                          const struct search_hit *hit)
{
    const struct search_photo *p = hit->photo;
    char text[64];
    json_t *o = json_pack("{s:s}", "name", p->name);
    if (hit->kept)
        json_object_set_new(o, "kept", json_true());
    else if (!hit->standard)
        json_object_set_new(o, "number", json_integer(p->number));
    if (p->timed)
        json_object_set_new(o, "time", json_string(p->time));
    if (p->posed) {
        json_object_set_new(o, "lon", json_real(p->lon_deg));
        json_object_set_new(o, "lat", json_real(p->lat_deg));
    }
    if (t->search.has_near)
        json_object_set_new(o, "distance_m", json_real(round(hit->distance_m * 1e3) / 1e3));
    snprintf(text, sizeof text, "%02x%02x%02x", p->rgb[0], p->rgb[1], p->rgb[2]);
    if (p->coloured)
        json_object_set_new(o, "colour", json_string(text));
    if (t->search.has_colour)
        json_object_set_new(o, "colour_distance", json_real(round(hit->colour * 100) / 100));
    struct link l = link_to(LINK_DATASET, NULL, d, NULL);
    l.row = &p->number;
    if (p->thumbnail)
        json_object_set_new(o, "thumbnail",
                            json_string(link_text(link_thumbnail, &l, text, sizeof text)));
    json_object_set_new(o, "links",
                        json_pack("[o,o]", search_link("item", link_appearance, p->name),
                                  search_link("tileset", link_tileset_moving, p->name)));
    return o;
}

static json_t *search_page(const struct dataset *d, const struct appearances_target *t,
                           const struct search_hit *hit, size_t n)
{
    const bool all = !t->search.asked;
    const size_t first = all ? 0 : t->page.after < n ? t->page.after : n;
    const size_t end = all || n - first < t->page.limit ? n : first + t->page.limit;
    json_t *list = json_array(), *links = json_array();
    const struct link here = {.from = LINK_DATASET};
    struct buf self = {0}, next = {0};
    link_appearances(&here, &self);
    link_appearances(&here, &next);
    for (size_t i = first; i < end; i++)
        json_array_append_new(list, search_row(d, t, &hit[i]));
    if (!all)
        target_query_search(t, t->page.after, &self);
    target_query_search(t, (uint32_t)end, &next);
    buf_u8(&self, 0);
    buf_u8(&next, 0);
    if (!self.failed)
        json_array_append_new(
            links, document_link("self", "application/json", (const char *)self.data, NULL));
    if (!next.failed && end < n)
        json_array_append_new(
            links, document_link("next", "application/json", (const char *)next.data, NULL));
    buf_free(&self);
    buf_free(&next);
    return json_pack("{s:s,s:i,s:i,s:i,s:o,s:o}", "default", d->appearance ? BAKE_DEFAULT : "",
                     "embeddingLength", d->appearance ? (int)d->appearance->len_image : 0,
                     "numberMatched", (int)n, "numberReturned", (int)(end - first), "appearances",
                     list, "links", links);
}

/* Names that are kept, as photographs that nobody took; numbers after that of the default. */
static size_t search_kept(const struct dataset *d, const struct search_index *s,
                          const struct named_appearance_row *row, size_t n,
                          struct search_photo *out)
{
    size_t n_out = 0;
    for (size_t i = 0; i < n; i++) {
        struct appearance_choice c;
        if (appearance_api_find_kept(d, &row[i], &c, NULL))
            continue; /* of another revision */
        out[n_out] = (struct search_photo){.name = row[i].name, .number = (uint32_t)(s->n + 1 + i)};
        if (c.set)
            search_colour(d->appearance, s, c.image, &out[n_out]);
        n_out++;
    }
    return n_out;
}

/* The page of all hits, sorted. */
static enum err_code search_write_hits(const struct dataset *d, const struct appearances_target *t,
                                       struct search_hit *hit, size_t n, struct buf *out,
                                       struct err *e)
{
    qsort(hit, n, sizeof *hit, search_by);
    return document_write(search_page(d, t, hit, n), out, e);
}

/* The default appearance, as a photograph that nobody took. */
static size_t search_standard(const struct dataset *d, const struct search_index *s,
                              struct search_photo *photo, struct search_hit *out)
{
    const ptrdiff_t row = appearance_find(d->appearance, BAKE_DEFAULT);
    *photo = (struct search_photo){.name = BAKE_DEFAULT, .number = (uint32_t)s->n};
    if (row < 0)
        return 0;
    search_colour(d->appearance, s, d->appearance->images + (size_t)row * d->appearance->len_image,
                  photo);
    *out = (struct search_hit){.photo = photo, .standard = true, .by = (double)s->n};
    return 1;
}

enum err_code search_write(const struct dataset *d, const struct appearances_target *t,
                           const struct named_appearance_table *kept, struct buf *out,
                           struct err *e)
{
    const struct search_index none = {0}, *s = d->search ? d->search : &none;
    const struct target_search *q = &t->search;
    const uint8_t rgb[3] = {(uint8_t)(q->rgb >> 16), (uint8_t)(q->rgb >> 8), (uint8_t)q->rgb};
    double near_m[3] = {0}, lab[3];
    const struct named_appearance_row *row = NULL;
    const size_t n_row = d->search ? named_appearance_of(kept, d->meta.name, &row) : 0;
    size_t n = 0;
    struct search_photo standard;
    struct search_hit *hit = mem_array(s->n + n_row + 1, sizeof *hit);
    struct search_photo *named = mem_array(n_row + 1, sizeof *named);
    enum err_code rc = hit && named ? geo_to_enu(&d->meta.origin, q->near_e7[0] * 1e-7,
                                                 q->near_e7[1] * 1e-7, 0, near_m, e)
                                    : err_set(e, ERR_MEM, "search: out of memory");
    search_index_lab(rgb, lab);
    for (size_t i = 0; !rc && !q->kept && i < s->n; i++)
        n += search_hits(t, near_m, lab, &s->photo[i], &hit[n]);
    if (!rc && !q->asked && d->search)
        n += search_standard(d, s, &standard, &hit[n]);
    const size_t n_named = !rc ? search_kept(d, s, row, n_row, named) : 0;
    for (size_t i = 0; i < n_named; i++)
        if (search_hits(t, near_m, lab, &named[i], &hit[n]))
            hit[n++].kept = true;
    if (!rc)
        rc = search_write_hits(d, t, hit, n, out, e);
    mem_free(hit);
    mem_free(named);
    return rc;
}

enum err_code search_all(const struct dataset *d, struct body **out, struct err *e)
{
    const struct appearances_target all = {0};
    struct buf b = {0};
    const enum err_code rc = search_write(d, &all, NULL, &b, e);
    return document_take(rc, &b, out, e);
}

size_t search_room(const struct dataset *d, const struct appearances_target *t,
                   const struct named_appearance_table *kept)
{
    const struct named_appearance_row *row = NULL;
    const size_t all = (d->appearance ? d->appearance->n_images : 0) +
                       named_appearance_of(kept, d->meta.name, &row);
    return (t->search.asked && t->page.limit < all ? t->page.limit : all) * SEARCH_ROW + 4096;
}
