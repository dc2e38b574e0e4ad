/* Named appearances that several servers share: see kept_shared.h.
 *
 * One object holds all names, so one conditional request tells whether any of them has changed, and
 * a list needs no listing of a bucket:
 *
 *     {"format": "citysplat-names-1",
 *      "names": [{"dataset": "toy", "name": "evening", "appearance": "dawn:1,dusk:2"},
 *                {..., "appearance": "=AAAA...", "model": "32 hexadecimal digits"}]}
 *
 * Its entity tag is the version of a table. A change replaces the object if it still has that tag.
 *
 * Ceph's gateway compares If-Match of a PUT with the tag without its quotes, so that what RFC 9110
 * asks for is always 412 there. If a tag is refused that a read then finds unchanged, it is sent
 * bare from then on.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/kept_shared.h"

#include <assert.h>
#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "lod/range.h"
#include "server/document.h"

/* Of the object: twice what KEPT_MAX rows take at most. */
static const size_t KEPT_SHARED_MAX = (size_t)2 * KEPT_MAX * sizeof(struct kept_row);
static_assert((int)KEPT_TAG_MAX == (int)RANGE_TAG_MAX, "tags are copied");
static const char kept_shared_format[] = "citysplat-names-1";

struct kept_shared {
    struct range *range;
    char shown[RANGE_URL_MAX];
    char refused[RANGE_TAG_MAX]; /* tag of the last write that was refused; "": it was not */
    bool bare;                   /* tags are sent without their quotes */
};

enum err_code kept_shared_open(const char *url, struct kept_shared **out, struct err *e)
{
    struct kept_shared *k = mem_array(1, sizeof *k);
    *out = k;
    if (!k)
        return err_set(e, ERR_MEM, "--state-url: out of memory");
    range_show(url, k->shown);
    enum err_code rc = range_is_url(url) ? range_open(url, &k->range, e)
                                         : err_set(e, ERR_ARG,
                                                   "--state-url %s: give an address that begins "
                                                   "with https://, http:// or s3://",
                                                   k->shown);
    if (rc)
        kept_shared_close(out);
    return rc;
}

void kept_shared_close(struct kept_shared **out)
{
    struct kept_shared *k = *out;
    *out = NULL;
    if (!k)
        return;
    range_close(&k->range);
    mem_free(k);
}

/* ---- the object ---- */

static bool kept_shared_take(const json_t *o, const char *key, char *out, size_t room)
{
    const json_t *v = json_object_get(o, key);
    const size_t n = json_string_length(v);
    if (!n || n >= room || strlen(json_string_value(v)) != n)
        return false;
    memcpy(out, json_string_value(v), n + 1);
    return true;
}

/* As hash_text writes it. */
static bool kept_shared_take_hash(const json_t *o, struct hash128 *out)
{
    static const char digits[] = "0123456789abcdef";
    char text[33], again[33];
    if (!json_object_get(o, "model"))
        return true;
    if (!kept_shared_take(o, "model", text, sizeof text) || strlen(text) != 32 ||
        strspn(text, digits) != 32)
        return false;
    for (int i = 0; i < 32; i++) {
        uint64_t *half = i < 16 ? &out->hi : &out->lo;
        *half = *half << 4 | (uint64_t)(strchr(digits, text[i]) - digits);
    }
    hash_text(*out, again);
    return !strcmp(again, text);
}

static bool kept_shared_take_row(const json_t *o, struct kept_row *row)
{
    memset(row, 0, sizeof *row);
    return kept_shared_take(o, "dataset", row->ds, sizeof row->ds) &&
           kept_shared_take(o, "name", row->name, sizeof row->name) &&
           kept_shared_take(o, "appearance", row->text, sizeof row->text) &&
           kept_shared_take_hash(o, &row->model) && kept_table_row_ok(row);
}

enum err_code kept_shared_parse(const char *shown, const void *bytes, size_t n_bytes,
                                struct kept_table **out, struct err *e)
{
    json_error_t je = {.text = ""};
    json_t *all = json_loadb(bytes, n_bytes, JSON_REJECT_DUPLICATES, &je);
    const json_t *names = json_object_get(all, "names");
    const char *format = json_string_value(json_object_get(all, "format"));
    const size_t n = json_array_size(names);
    struct kept_table *t = n <= KEPT_MAX ? kept_table_alloc(n) : NULL;
    enum err_code rc = ERR_OK;
    if (!all || !format || strcmp(format, kept_shared_format) != 0 || !json_is_array(names))
        rc = err_set(e, ERR_FORMAT,
                     "%s: is no list of names (\"format\": \"%s\")%s%s: put a copy back, or remove "
                     "it to begin without names",
                     shown, kept_shared_format, je.text[0] ? ": " : "", je.text);
    else if (n > KEPT_MAX)
        rc = err_set(e, ERR_FORMAT, "%s: more than %d names", shown, KEPT_MAX);
    else if (!t)
        rc = err_set(e, ERR_MEM, "%s: out of memory", shown);
    for (size_t i = 0; t && !rc && i < n; i++, t->n++)
        if (!kept_shared_take_row(json_array_get(names, i), &t->row[i]))
            rc = err_set(e, ERR_FORMAT, "%s: name %zu: is damaged", shown, i);
    json_decref(all);
    if (t && !rc)
        kept_table_sort(t);
    for (size_t i = 1; t && !rc && i < n; i++)
        if (!strcmp(t->row[i].ds, t->row[i - 1].ds) && !strcmp(t->row[i].name, t->row[i - 1].name))
            rc = err_set(e, ERR_FORMAT, "%s: '%s' of %s: is there twice", shown, t->row[i].name,
                         t->row[i].ds);
    if (rc)
        kept_drop(&t);
    *out = t;
    return rc;
}

enum err_code kept_shared_text(const struct kept_table *t, struct buf *out, struct err *e)
{
    json_t *names = json_array();
    for (size_t i = 0; i < t->n; i++) {
        const struct kept_row *row = &t->row[i];
        char model[33];
        json_t *o = json_pack("{s:s,s:s,s:s}", "dataset", row->ds, "name", row->name, "appearance",
                              row->text);
        hash_text(row->model, model);
        if ((row->model.lo || row->model.hi) &&
            json_object_set_new(o, "model", json_string(model))) {
            json_decref(o);
            o = NULL;
        }
        json_array_append_new(names, o);
    }
    if (json_array_size(names) != t->n) { /* one that is missing would be lost for good */
        json_decref(names);
        return err_set(e, ERR_MEM, "names: out of memory");
    }
    return document_write(json_pack("{s:s,s:o}", "format", kept_shared_format, "names", names), out,
                          e);
}

/* ---- requests ---- */

enum err_code kept_shared_read(struct kept_shared *k, const struct kept_table *have, double until_s,
                               struct kept_table **newer, struct err *e)
{
    struct range_object o = {0};
    struct err none = {0};
    struct buf b = {0};
    bool same = false;
    *newer = NULL;
    memcpy(o.etag, have->etag, sizeof o.etag);
    enum err_code rc = range_whole(k->range, &o, KEPT_SHARED_MAX, &b, &same, until_s, &none);
    if (rc == ERR_NOENT) {
        same = !have->n && !have->etag[0];
        *newer = same ? NULL : kept_table_alloc(0);
        rc = same || *newer ? ERR_OK : err_set(e, ERR_MEM, "%s: out of memory", k->shown);
    } else if (rc) {
        rc = err_set(e, rc == ERR_LIMIT ? ERR_FORMAT : rc, "%s", none.msg);
    } else if (!same) {
        rc = kept_shared_parse(k->shown, b.data, b.size, newer, e);
        if (!rc)
            memcpy((*newer)->etag, o.etag, sizeof o.etag);
    }
    buf_free(&b);
    return rc;
}

/* What If-Match is to be: the tag, or the tag without its quotes, unless it then looked weak. */
static void kept_shared_condition(const struct kept_shared *k, const char *etag,
                                  struct range_object *o)
{
    const size_t n = strlen(etag);
    const bool bare = k->bare && n > 2 && etag[1] != 'W';
    *o = (struct range_object){0};
    memcpy(o->etag, etag + bare, bare ? n - 2 : n);
}

/* Tries a condition that cannot hold. ERR_FORMAT: the server ignores it. */
static enum err_code kept_shared_refuses(struct kept_shared *k, const char *etag,
                                         const struct buf *text, double until_s, struct err *e)
{
    struct range_object o;
    kept_shared_condition(k, etag, &o);
    const enum err_code rc = range_put(k->range, &o, text->data, text->size, until_s, e);
    if (rc)
        return rc == ERR_DATA ? ERR_OK : rc;
    return err_set(e, ERR_FORMAT,
                   "%s: its server ignores %s of a PUT, so changes of two servers would overwrite "
                   "each other: use a bucket, or a server that heeds it",
                   k->shown, etag[0] ? "If-Match" : "If-None-Match");
}

static const char kept_shared_no_tag[] = "\"of-no-state\"";

/* A tag was refused, and a read after that found it unchanged: the other way to write it. */
static enum err_code kept_shared_turn(struct kept_shared *k, const struct buf *text, double until_s,
                                      struct err *e)
{
    k->refused[0] = '\0';
    k->bare = !k->bare;
    enum err_code rc =
        k->bare ? kept_shared_refuses(k, kept_shared_no_tag, text, until_s, e) : ERR_OK;
    if (rc)
        k->bare = false;
    return rc;
}

enum err_code kept_shared_write(struct kept_shared *k, const char *etag, struct kept_table *t,
                                double until_s, struct err *e)
{
    struct range_object o;
    struct buf b = {0};
    enum err_code rc = kept_shared_text(t, &b, e);
    if (!rc && etag[0] && !strcmp(etag, k->refused))
        rc = kept_shared_turn(k, &b, until_s, e);
    kept_shared_condition(k, etag, &o);
    if (!rc) {
        rc = range_put(k->range, &o, b.data, b.size, until_s, e);
        snprintf(k->refused, sizeof k->refused, "%s", rc == ERR_DATA ? etag : "");
    }
    if (!rc)
        memcpy(t->etag, o.etag, sizeof o.etag);
    buf_free(&b);
    return rc == ERR_NOENT ? ERR_IO : rc; /* no bucket; not: no such name */
}

enum err_code kept_shared_probe(struct kept_shared *k, const struct kept_table *have,
                                double until_s, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = kept_shared_text(have, &b, e);
    if (!rc)
        rc = kept_shared_refuses(k, kept_shared_no_tag, &b, until_s, e);
    if (!rc && have->etag[0]) /* and it is there already */
        rc = kept_shared_refuses(k, "", &b, until_s, e);
    buf_free(&b);
    return rc;
}
