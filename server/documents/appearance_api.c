/* The appearance API: the appearances of a dataset, blends, and appearances in URLs.
 *
 * An appearance is one text everywhere (?appearance=, the key `appearance` of a posted camera,
 * --appearance of the programs): a photograph's name, a blend NAME:WEIGHT,NAME:WEIGHT, or =BASE64
 * of a whole embedding (bake_find). Nothing that a client posts is stored. A mix is answered with a
 * text that means the same on every server with the same store, so appearances can be cached,
 * linked and prefetched. Named appearances (named_appearance.h) are replaced by such a text first.
 * Two texts with one embedding are one appearance, because results are named by the embedding's
 * hash.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/appearance_api.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lod/store/bake.h"
#include "server/base/document.h"
#include "server/base/text.h"
#include "server/documents/link.h"

static const double APPEARANCE_API_MOST = 1e6; /* of a number in an embedding */
enum { APPEARANCE_API_NEAREST = 5, APPEARANCE_API_LINK_MAX = 3 * TARGET_APPEARANCE_MAX + 128 };

enum err_code appearance_api_find(const struct dataset *d, const char *text,
                                  struct appearance_choice *out, struct err *e)
{
    *out = (struct appearance_choice){0};
    if (!*text || !strcmp(text, BAKE_DEFAULT))
        return ERR_OK;
    if (!strcmp(text, APPEARANCE_NONE)) {
        out->trained = d->appearance != NULL;
        return ERR_OK;
    }
    enum err_code rc = bake_find(d->stores[0], text, out->image, e);
    if (rc)
        return rc;
    double norm2 = 0, most = 0;
    for (uint32_t i = 0; i < d->appearance->len_image; i++) {
        out->image[i] += 0.0f; /* -0 is 0: one embedding, one name */
        norm2 += (double)out->image[i] * (double)out->image[i];
        most = fmax(most, fabs((double)out->image[i]));
    }
    if (*text == '=' ? !(most <= APPEARANCE_API_MOST) : !(norm2 >= 1e-6 && norm2 <= 1e4)) {
        *out = (struct appearance_choice){0};
        return err_set(e, ERR_ARG,
                       *text == '=' ? "the embedding has a number beyond 1e6"
                                    : "the weights of the blend cancel or overflow");
    }
    if (*text == '=') {
        char one[BAKE_TEXT_MAX];
        bake_text(out->image, d->appearance->len_image, one);
        if (strcmp(one, text) != 0) {
            *out = (struct appearance_choice){0};
            return err_set(e, ERR_ARG, "an embedding has one spelling; this one's is %s", one);
        }
    }
    out->set = true;
    out->hash = hash_bytes(out->image, d->appearance->len_image * sizeof(float));
    return ERR_OK;
}

const float *appearance_api_image(const struct appearance_choice *c)
{
    return c->set ? c->image : NULL;
}

/* ---- documents ---- */

/* Relative to the dataset. */
static json_t *appearance_api_link(const char *rel, const char *type,
                                   void (*to)(const struct link *l, struct buf *out),
                                   const char *text)
{
    static const char key[] = "?appearance=";
    const struct link l = {.from = LINK_DATASET, .with = "fov"};
    char href[APPEARANCE_API_LINK_MAX];
    size_t n = strlen(link_text(to, &l, href, 120));
    memcpy(href + n, key, sizeof key);
    text_escape(text, href + n + sizeof key - 1);
    return document_link(rel, type, href, NULL);
}

static json_t *appearance_api_numbers(const float *v, uint32_t n)
{
    json_t *list = json_array();
    for (uint32_t i = 0; i < n; i++)
        json_array_append_new(list, json_real((double)v[i]));
    return list;
}

struct appearance_api_near {
    double cosine;
    size_t row;
};

/* Into the few that are nearest, the nearest first; of equals the one that came first. */
static void appearance_api_insert(struct appearance_api_near near[APPEARANCE_API_NEAREST],
                                  size_t *n, struct appearance_api_near x)
{
    size_t at = *n;
    while (at > 0 && near[at - 1].cosine < x.cosine)
        at--;
    if (at == APPEARANCE_API_NEAREST)
        return;
    *n += *n < APPEARANCE_API_NEAREST;
    for (size_t i = *n - 1; i > at; i--)
        near[i] = near[i - 1];
    near[at] = x;
}

/* The photographs whose embeddings point most nearly the same way: looked through, not sorted,
 * because a city has tens of thousands. */
static json_t *appearance_api_nearest(const struct appearance *a, const float *image)
{
    struct appearance_api_near near[APPEARANCE_API_NEAREST];
    size_t n = 0;
    json_t *list = json_array();
    double length = 0;
    for (uint32_t j = 0; j < a->len_image; j++)
        length += (double)image[j] * (double)image[j];
    length = fmax(sqrt(length), 1e-12);
    for (size_t i = 0; i < a->n_images; i++) {
        float unit[APPEARANCE_IMAGE_MAX];
        double dot = 0;
        bake_unit(a, i, unit);
        for (uint32_t j = 0; j < a->len_image; j++)
            dot += (double)unit[j] * (double)image[j];
        appearance_api_insert(near, &n, (struct appearance_api_near){dot / length, i});
    }
    for (size_t i = 0; i < n; i++)
        json_array_append_new(
            list, json_pack("{s:s,s:f}", "name", a->names[near[i].row], "cosine", near[i].cosine));
    return list;
}

/* name: in links. */
static json_t *appearance_api_json(const struct appearance *a, const char *text, const char *name,
                                   const float *image)
{
    return json_pack("{s:s,s:o,s:o,s:[o,o,o]}", "appearance", text, "embedding",
                     appearance_api_numbers(image, a->len_image), "nearest",
                     appearance_api_nearest(a, image), "links",
                     appearance_api_link("self", "application/json", link_appearance, name),
                     appearance_api_link("tileset", "application/json", link_tileset_moving, name),
                     appearance_api_link("view", "image/jpeg", link_view_moving, name));
}

/* The embedding of a choice, which the default one has as well. */
static enum err_code appearance_api_embedding_of(const struct dataset *d,
                                                 const struct appearance_choice *c, float *image,
                                                 struct err *e)
{
    if (c->trained)
        return err_set(e, ERR_ARG, "\"" APPEARANCE_NONE "\" is of tiles: it has no embedding");
    if (!c->set)
        return bake_find(d->stores[0], BAKE_DEFAULT, image, e);
    memcpy(image, c->image, sizeof c->image);
    return ERR_OK;
}

enum err_code appearance_api_describe(const struct dataset *d, const char *text, struct body **out,
                                      struct err *e)
{
    float image[APPEARANCE_IMAGE_MAX];
    const char *name = *text ? text : BAKE_DEFAULT;
    struct appearance_choice c;
    *out = NULL;
    enum err_code rc = appearance_api_find(d, text, &c, e);
    if (!rc)
        rc = appearance_api_embedding_of(d, &c, image, e);
    return rc ? rc : document_make(appearance_api_json(d->appearance, name, name, image), out, e);
}

/* ---- names that are kept ---- */

/* Of a network: an embedding means something to it alone. */
static struct hash128 appearance_api_model(const struct appearance *a)
{
    return hash_bytes(a->w1, appearance_weights(a) * sizeof *a->w1);
}

static enum err_code appearance_api_fits(const struct dataset *d,
                                         const struct named_appearance_row *row, struct err *e)
{
    if (*row->text != '=' || !d->appearance)
        return ERR_OK;
    const struct hash128 own = appearance_api_model(d->appearance);
    return own.lo == row->model.lo && own.hi == row->model.hi
               ? ERR_OK
               : err_set(e, ERR_NOENT,
                         "'%s' is kept as an embedding of another network than that of this "
                         "revision: keep it again",
                         row->name);
}

enum err_code appearance_api_find_kept(const struct dataset *d,
                                       const struct named_appearance_row *row,
                                       struct appearance_choice *out, struct err *e)
{
    enum err_code rc = appearance_api_fits(d, row, e);
    return rc ? rc : appearance_api_find(d, row->text, out, e);
}

enum err_code appearance_api_resolve(const struct dataset *d,
                                     const struct named_appearance_table *t,
                                     char text[TARGET_APPEARANCE_MAX], char name[TARGET_KEPT_MAX],
                                     struct err *e)
{
    const struct named_appearance_row *row = named_appearance_find(t, d->meta.name, text);
    name[0] = '\0';
    if (!row || !d->appearance || appearance_find(d->appearance, text) >= 0)
        return ERR_OK; /* a photograph of a later revision has its name */
    enum err_code rc = appearance_api_fits(d, row, e);
    if (rc)
        return rc;
    memcpy(name, row->name, sizeof row->name);
    memcpy(text, row->text, sizeof row->text);
    return ERR_OK;
}

enum err_code appearance_api_describe_kept(const struct dataset *d,
                                           const struct named_appearance_row *row,
                                           struct body **out, struct err *e)
{
    struct err why = {0};
    struct appearance_choice c;
    float image[APPEARANCE_IMAGE_MAX];
    char etag[BODY_ETAG_SIZE];
    *out = NULL;
    enum err_code rc = appearance_api_find_kept(d, row, &c, &why);
    if (!rc)
        rc = appearance_api_embedding_of(d, &c, image, &why);
    json_t *o = rc ? json_pack("{s:s,s:s}", "appearance", row->text, "problem", why.msg)
                   : appearance_api_json(d->appearance, row->text, row->name, image);
    json_object_set_new(o, "name", json_string(row->name));
    rc = document_make(o, out, e);
    named_appearance_etag(row, etag);
    if (!rc)
        memcpy((*out)->etag, etag, sizeof etag);
    return rc;
}

enum err_code appearance_api_read_kept(const struct dataset *d,
                                       const struct named_appearance_table *t, const void *body,
                                       size_t n, struct named_appearance_row *row, struct err *e)
{
    char of[TARGET_KEPT_MAX];
    struct appearance_choice c;
    if (d->appearance && appearance_find(d->appearance, row->name) >= 0)
        return err_set(e, ERR_ARG, "a photograph is called '%s': an appearance needs another name",
                       row->name);
    enum err_code rc = appearance_api_read_mix(d, body, n, row->text, e);
    if (!rc)
        rc = appearance_api_resolve(d, t, row->text, of, e);
    if (!rc)
        rc = appearance_api_find(d, row->text, &c, e);
    if (rc == ERR_ARG) /* of the blend: 409 is of the name alone */
        rc = err_set(e, ERR_DATA, "%s", e ? e->msg : "");
    if (!rc && c.trained)
        rc = err_set(e, ERR_DATA, "\"" APPEARANCE_NONE "\" is no appearance to keep");
    row->model = (struct hash128){0};
    if (!rc && *row->text == '=')
        row->model = appearance_api_model(d->appearance);
    return rc;
}

/* ---- the posted mix ---- */

/* {"NAME": WEIGHT, ...} -> NAME:WEIGHT,NAME:WEIGHT */
static enum err_code appearance_api_weights(const json_t *weights, struct buf *text, struct err *e)
{
    const char *name;
    json_t *v;
    json_object_foreach((json_t *)(uintptr_t)weights, name, v)
    {
        if (!json_is_number(v) || strpbrk(name, ","))
            return err_set(e, ERR_DATA,
                           "weights: a number for each photograph, and no name with a comma");
        buf_printf(text, "%s%s:%.9g", text->size ? "," : "", name, json_number_value(v));
    }
    return ERR_OK;
}

static enum err_code appearance_api_embedding(const struct appearance *a, const json_t *list,
                                              char *text, struct err *e)
{
    float image[APPEARANCE_IMAGE_MAX];
    if (json_array_size(list) != a->len_image)
        return err_set(e, ERR_DATA, "embedding: %u numbers are expected, there are %zu",
                       a->len_image, json_array_size(list));
    for (uint32_t i = 0; i < a->len_image; i++) {
        const json_t *v = json_array_get(list, i);
        if (!json_is_number(v) || !(fabs(json_number_value(v)) <= APPEARANCE_API_MOST))
            return err_set(e, ERR_DATA, "embedding: number %u is none, or beyond 1e6", i);
        image[i] = (float)json_number_value(v) + 0.0f; /* as in appearance_api_find */
    }
    bake_text(image, a->len_image, text);
    return ERR_OK;
}

enum err_code appearance_api_read_mix(const struct dataset *d, const void *body, size_t n,
                                      char text[TARGET_APPEARANCE_MAX], struct err *e)
{
    static const char expected[] = "the body must be a JSON object with either weights (a number "
                                   "for each photograph's name), embedding (a list of numbers) or "
                                   "appearance (its text)";
    json_t *o = NULL;
    struct buf b = {0};
    text[0] = '\0';
    enum err_code rc =
        n ? jsonc_parse(body, n, "body", &o, e) : err_set(e, ERR_FORMAT, "%s", expected);
    const json_t *weights = json_object_get(o, "weights"), *list = json_object_get(o, "embedding"),
                 *said = json_object_get(o, "appearance");
    if (!rc && (!json_is_object(o) || json_object_size(o) != 1 ||
                !(json_is_object(weights) || json_is_array(list) || json_is_string(said))))
        rc = err_set(e, ERR_DATA, "%s", expected);
    if (!rc && !d->appearance)
        rc = err_set(e, ERR_NOENT,
                     "this dataset was trained without appearance: it has one appearance");
    if (!rc && list)
        rc = appearance_api_embedding(d->appearance, list, text, e);
    if (!rc && weights)
        rc = appearance_api_weights(weights, &b, e);
    if (!rc && said)
        buf_printf(&b, "%s", json_string_value(said));
    if (!rc && said && (!b.size || b.size != json_string_length(said)))
        rc = err_set(e, ERR_DATA, "appearance: a text of 1 to %d bytes", TARGET_APPEARANCE_MAX - 1);
    weights = weights ? weights : said;
    if (!rc && weights && (!b.size || b.size >= TARGET_APPEARANCE_MAX))
        rc = err_set(e, ERR_DATA, "%s: 1 to 16 photographs, and %d bytes in all",
                     said ? "appearance" : "weights", TARGET_APPEARANCE_MAX - 1);
    if (!rc && weights)
        memcpy(text, b.data, b.size + 1);
    buf_free(&b);
    json_decref(o);
    return rc;
}
