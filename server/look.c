/* The appearance API: which looks a dataset has, what a blend of them is, and a look in a URL.
 *
 * A look is one text wherever it is said (?appearance=, the key `appearance` of a posted camera,
 * --appearance of the programs): a photograph's name, a blend NAME:WEIGHT,NAME:WEIGHT, or =BASE64
 * of a whole embedding (bake_find). Nothing that a client posts is kept: what a mix answers with is
 * a text that means the same on every server with the same store, so looks are cached, linked and
 * prefetched like everything else. Two texts of one embedding are one look: results are named by
 * the embedding's hash.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/quant.h"
#include "server/server.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LOOK_NEAREST = 5, LOOK_LINK_MAX = 3 * LOOK_TEXT_MAX + 128 };

enum err_code look_find(const struct dataset *d, const char *text, struct look *out, struct err *e)
{
    *out = (struct look){0};
    if (!*text || !strcmp(text, BAKE_DEFAULT))
        return ERR_OK;
    enum err_code rc = bake_find(d->stores[0], text, out->image, e);
    if (rc != ERR_OK)
        return rc;
    out->set = true;
    out->hash = hash_bytes(out->image, d->appearance->len_image * sizeof(float));
    return ERR_OK;
}

void look_mix(struct hash128 *id, const struct look *look)
{
    const struct hash128 both[2] = {*id, look->hash};
    if (look->set)
        *id = hash_bytes(both, sizeof(both));
}

/* Percent-encoded as a value of a query: RFC 3986's unreserved characters stay, and ',' ':' '=',
 * which it allows there. out holds LOOK_LINK_MAX. */
static void look_escape(const char *text, char *out)
{
    static const char hex[] = "0123456789ABCDEF";
    for (; *text; text++) {
        unsigned char c = (unsigned char)*text;
        bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                     strchr("-._~,:=", c);
        if (plain) {
            *out++ = (char)c;
        } else {
            *out++ = '%';
            *out++ = hex[c >> 4];
            *out++ = hex[c & 15];
        }
    }
    *out = '\0';
}

void look_query(const struct target *t, char out[LOOK_QUERY_MAX])
{
    const struct form *f = &t->form;
    size_t n = 0;
    out[0] = '\0';
    if (f->preset < QUANT_PRESETS)
        n += (size_t)snprintf(out, LOOK_QUERY_MAX, "?preset=%s",
                              quant_preset_name((enum quant_preset)f->preset));
    if (f->sh_degree <= GAUSS_SH_DEGREE_MAX)
        n += (size_t)snprintf(out + n, LOOK_QUERY_MAX - n, "%csh=%u", n ? '&' : '?', f->sh_degree);
    if (t->appearance[0]) {
        n += (size_t)snprintf(out + n, LOOK_QUERY_MAX - n, "%cappearance=", n ? '&' : '?');
        look_escape(t->appearance, out + n);
    }
}

/* ---- documents ---- */

static json_t *look_link(const char *rel, const char *type, const char *path, const char *text)
{
    char href[LOOK_LINK_MAX];
    int n = snprintf(href, sizeof(href), "%s?appearance=", path);
    look_escape(text, href + n);
    return json_pack("{s:s,s:s,s:s}", "rel", rel, "type", type, "href", href);
}

static json_t *look_numbers(const float *v, uint32_t n)
{
    json_t *list = json_array();
    for (uint32_t i = 0; i < n; i++)
        json_array_append_new(list, json_real((double)v[i]));
    return list;
}

enum err_code look_list(const struct dataset *d, struct body **out, struct err *e)
{
    const struct appearance *a = d->appearance;
    json_t *list = json_array();
    for (size_t i = 0; a && i < a->n_images; i++)
        json_array_append_new(
            list, json_pack("{s:s,s:[o,o]}", "name", a->names[i], "links",
                            look_link("item", "application/json", "appearance", a->names[i]),
                            look_link("tileset", "application/json", "tileset.json", a->names[i])));
    return describe_json(json_pack("{s:s,s:i,s:o}", "default", a ? BAKE_DEFAULT : "",
                                   "embeddingLength", a ? (int)a->len_image : 0, "appearances",
                                   list),
                         out, e);
}

struct look_near {
    double cosine;
    size_t row;
};

static int look_nearer(const void *pa, const void *pb)
{
    const struct look_near *a = pa, *b = pb;
    if (a->cosine != b->cosine)
        return a->cosine > b->cosine ? -1 : 1;
    return a->row < b->row ? -1 : 1;
}

/* The photographs whose embeddings point most nearly the same way. */
static json_t *look_nearest(const struct appearance *a, const float *image)
{
    struct look_near *near = mem_array(a->n_images, sizeof(*near));
    json_t *list = near ? json_array() : NULL;
    double length = 0;
    for (uint32_t j = 0; j < a->len_image; j++)
        length += (double)image[j] * (double)image[j];
    length = fmax(sqrt(length), 1e-12);
    for (size_t i = 0; near && i < a->n_images; i++) {
        float unit[APPEARANCE_IMAGE_MAX];
        double dot = 0;
        bake_unit(a, i, unit);
        for (uint32_t j = 0; j < a->len_image; j++)
            dot += (double)unit[j] * (double)image[j] / length;
        near[i] = (struct look_near){dot, i};
    }
    if (near)
        qsort(near, a->n_images, sizeof(*near), look_nearer);
    for (size_t i = 0; near && i < a->n_images && i < LOOK_NEAREST; i++)
        json_array_append_new(
            list, json_pack("{s:s,s:f}", "name", a->names[near[i].row], "cosine", near[i].cosine));
    mem_free(near);
    return list;
}

enum err_code look_describe(const struct dataset *d, const char *text, struct body **out,
                            struct err *e)
{
    const struct appearance *a = d->appearance;
    float image[APPEARANCE_IMAGE_MAX];
    const char *name = *text ? text : BAKE_DEFAULT;
    *out = NULL;
    enum err_code rc = bake_find(d->stores[0], name, image, e);
    if (rc != ERR_OK)
        return rc;
    return describe_json(
        json_pack("{s:s,s:o,s:o,s:[o,o,o]}", "appearance", name, "embedding",
                  look_numbers(image, a->len_image), "nearest", look_nearest(a, image), "links",
                  look_link("self", "application/json", "appearance", name),
                  look_link("tileset", "application/json", "tileset.json", name),
                  look_link("view", "image/jpeg",
                            "static/{lon},{lat},{h}@{heading},{pitch},{fov}/{w}x{h}.{fmt}", name)),
        out, e);
}

/* ---- the posted mix ---- */

/* {"NAME": WEIGHT, ...} -> NAME:WEIGHT,NAME:WEIGHT */
static enum err_code look_weights(const json_t *weights, struct buf *text, struct err *e)
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

static enum err_code look_embedding(const struct appearance *a, const json_t *list, char *text,
                                    struct err *e)
{
    float image[APPEARANCE_IMAGE_MAX];
    if (json_array_size(list) != a->len_image)
        return err_set(e, ERR_DATA, "embedding: %u numbers are expected, there are %zu",
                       a->len_image, json_array_size(list));
    for (uint32_t i = 0; i < a->len_image; i++) {
        const json_t *v = json_array_get(list, i);
        if (!json_is_number(v) || !(fabs(json_number_value(v)) <= 1e6))
            return err_set(e, ERR_DATA, "embedding: number %u is none, or beyond 1e6", i);
        image[i] = (float)json_number_value(v);
    }
    bake_text(image, a->len_image, text);
    return ERR_OK;
}

enum err_code look_read_mix(const struct dataset *d, const void *body, size_t n,
                            char text[LOOK_TEXT_MAX], struct err *e)
{
    static const char expected[] = "the body must be a JSON object with either weights (a number "
                                   "for each photograph's name) or embedding (a list of numbers)";
    json_t *o = NULL;
    struct buf b = {0};
    text[0] = '\0';
    enum err_code rc =
        n ? jsonc_parse(body, n, "body", &o, e) : err_set(e, ERR_FORMAT, "%s", expected);
    const json_t *weights = json_object_get(o, "weights"), *list = json_object_get(o, "embedding");
    if (rc == ERR_OK && (!json_is_object(o) || json_object_size(o) != 1 ||
                         !(json_is_object(weights) || json_is_array(list))))
        rc = err_set(e, ERR_DATA, "%s", expected);
    if (rc == ERR_OK && !d->appearance)
        rc = err_set(e, ERR_NOENT, "this dataset was trained without appearance: it has one look");
    if (rc == ERR_OK && list)
        rc = look_embedding(d->appearance, list, text, e);
    if (rc == ERR_OK && weights)
        rc = look_weights(weights, &b, e);
    if (rc == ERR_OK && weights && (!b.size || b.size >= LOOK_TEXT_MAX))
        rc = err_set(e, ERR_DATA, "weights: 1 to 16 photographs, and %d bytes in all",
                     LOOK_TEXT_MAX - 1);
    if (rc == ERR_OK && weights)
        memcpy(text, b.data, b.size + 1);
    buf_free(&b);
    json_decref(o);
    return rc;
}
