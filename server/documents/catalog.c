/* The datasets at one moment, with their documents. A reload makes a new catalog and swaps a
 * pointer. Requests in progress keep the old one. A replaced revision is served for another day
 * from its open handles, although its file was replaced. A reload that fails changes nothing.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/catalog.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "lod/export/clip.h"
#include "lod/store/store.h"
#include "server/base/document.h"
#include "server/documents/appearance_api.h"
#include "server/documents/appearance_model.h"
#include "server/documents/collection.h"
#include "server/documents/link.h"
#include "server/documents/result_id.h"
#include "server/documents/search.h"
#include "server/documents/tileset_links.h"

static struct collection_options catalog_collection(const struct catalog_options *o)
{
    return (struct collection_options){o->public_url, o->base_path, o->basemap,
                                       o->basemap_attribution, o->city_gaussians};
}

static enum err_code catalog_make_tileset(struct dataset *d, enum tileset_links_of of,
                                          struct body **out, struct err *e)
{
    struct buf text = {0}, b = {0};
    struct tileset_links links;
    enum err_code rc = tileset_links_make(d, of, "", &text, &links, e);
    if (!rc)
        rc = tileset_write(d->index, &links, NULL, NULL, &b, e);
    buf_free(&text);
    return document_take(rc, &b, out, e);
}

static enum err_code catalog_make_documents(struct dataset *d, const struct catalog_options *o,
                                            struct err *e)
{
    const struct collection_options collection = catalog_collection(o);
    enum err_code rc = catalog_make_tileset(d, TILESET_LINKS_ENTRY, &d->tileset, e);
    if (!rc)
        rc = catalog_make_tileset(d, TILESET_LINKS_MOVING, &d->tileset_moving, e);
    if (!rc && d->appearance)
        rc = appearance_model_describe(d, &d->model, e);
    if (!rc && d->appearance)
        rc = appearance_model_photographs(d, &d->photographs, d->taken, e);
    if (!rc && d->appearance)
        rc = search_open(d, &d->search, e);
    if (!rc)
        rc = search_all(d, &d->appearances, e);
    if (!rc)
        rc = collection_describe(d, &collection, &d->collection, e);
    struct body *const documents[] = {d->tileset,     d->tileset_moving, d->collection,
                                      d->appearances, d->model,          d->photographs};
    for (size_t i = 0; !rc && i < sizeof documents / sizeof *documents; i++)
        if (documents[i])
            documents[i]->modified_s = (int64_t)time(NULL); /* of options and program, too */
    return rc;
}

static int catalog_by_name(const void *pa, const void *pb)
{
    const struct dataset *a = *(struct dataset *const *)pa, *b = *(struct dataset *const *)pb;
    return strcmp(a->meta.name, b->meta.name);
}

/* Is it of this revision of its file, and of what the clip leaves of it? */
static bool catalog_is_of(const struct dataset *d, const char *revision, struct hash128 clip)
{
    return !strcmp(d->source, revision) && d->clip.lo == clip.lo && d->clip.hi == clip.hi;
}

/* The sound dataset of `older` at this path. NULL: there is none. */
static struct dataset *catalog_at(const struct catalog *older, const char *path)
{
    for (size_t i = 0; older && i < older->n_current; i++) {
        struct dataset *d = older->ds[i];
        if (!atomic_load(&d->n_failed) && !store_replaced(d->index) && !strcmp(d->path, path))
            return d;
    }
    return NULL;
}

/* Is the store at a path still the one of d? */
static enum err_code catalog_is_store(const struct dataset *d, const char *path,
                                      const struct catalog_options *o, bool *same, struct err *e)
{
    struct store *now = NULL;
    enum err_code rc = store_open(path, &now, e);
    *same = !rc && catalog_is_of(d, store_info(now)->revision, clip_hash(o->clip));
    store_close(&now);
    return rc;
}

/* The dataset of `older` at this path if file and clip are still the same, else open it anew. */
static enum err_code catalog_open_or_keep(const char *path, const struct catalog_options *o,
                                          const struct catalog *older, struct dataset **out,
                                          struct err *e)
{
    struct dataset *was = catalog_at(older, path);
    bool same = false;
    enum err_code rc = was ? catalog_is_store(was, path, o, &same, e) : ERR_OK;
    if (!rc && !same)
        rc = dataset_open(path, o->readers, o->clip, o->clip_dir, o->geoid, out, e);
    if (!rc && !same)
        result_id_tiles_edition(*out, o->preset, (*out)->edition);
    if (!rc && same)
        *out = dataset_ref(was);
    else if (!rc)
        rc = catalog_make_documents(*out, o, e);
    if (rc)
        dataset_drop(out);
    return rc;
}

/* ---- revisions that were replaced ---- */

/* Is this revision, or (any: NULL) another one of the name, among the first n? */
static bool catalog_has(const struct catalog *c, size_t n, const char *name, const char *revision)
{
    for (size_t i = 0; i < n; i++)
        if (!strcmp(c->ds[i]->meta.name, name) &&
            (!revision || !strcmp(c->ds[i]->meta.revision, revision)))
            return true;
    return false;
}

/* Add an older revision, unless its time is over, or it is there, or as many as may be; they come
 * latest first. */
static void catalog_keep(struct catalog *c, struct dataset *d, double replaced_s, double now_s,
                         const struct catalog_options *o)
{
    const char *name = d->meta.name;
    size_t n_same = 0;
    for (size_t i = c->n_current; i < c->n; i++)
        n_same += !strcmp(c->ds[i]->meta.name, name);
    if (!catalog_has(c, c->n_current, name, NULL) || catalog_has(c, c->n, name, d->meta.revision))
        return;
    if (now_s - replaced_s > o->keep_s || n_same >= o->keep_revisions) {
        log_info("serve", "revision dropped name=%s revision=%s age_s=%.0f", name, d->meta.revision,
                 now_s - replaced_s);
        return;
    }
    c->replaced_s[c->n] = replaced_s;
    c->ds[c->n++] = dataset_ref(d);
}

static void catalog_keep_older(struct catalog *c, const struct catalog *older, double now_s,
                               const struct catalog_options *o)
{
    for (size_t i = 0; i < older->n; i++) /* those that are replaced now come first in it */
        catalog_keep(c, older->ds[i], older->replaced_s[i] > 0 ? older->replaced_s[i] : now_s,
                     now_s, o);
}

static enum err_code catalog_alloc(size_t n, struct catalog **out, struct err *e)
{
    struct catalog *c = mem_array(1, sizeof *c);
    *out = c;
    if (c) {
        atomic_init(&c->refs, 1);
        c->ds = mem_array(n, sizeof *c->ds);
        c->replaced_s = mem_array(n, sizeof *c->replaced_s);
    }
    if (c && c->ds && c->replaced_s)
        return ERR_OK;
    catalog_drop(out);
    return err_set(e, ERR_MEM, "catalog: out of memory");
}

enum err_code catalog_open(const char *const *paths, size_t n, const struct catalog_options *o,
                           const struct catalog *older, struct catalog **out, struct err *e)
{
    enum err_code rc = catalog_alloc(n + (older ? older->n : 0), out, e);
    struct catalog *c = *out;
    if (rc)
        return rc;
    for (; c->n < n && !rc; c->n += !rc)
        rc = catalog_open_or_keep(paths[c->n], o, older, &c->ds[c->n], e);
    c->n_current = c->n;
    if (!rc)
        qsort(c->ds, c->n, sizeof *c->ds, catalog_by_name);
    for (size_t i = 1; i < c->n && !rc; i++)
        if (!strcmp(c->ds[i]->meta.name, c->ds[i - 1]->meta.name))
            rc = err_set(e, ERR_ARG, "%s and %s: both hold a dataset named '%s': serve one of them",
                         store_path(c->ds[i - 1]->index), store_path(c->ds[i]->index),
                         c->ds[i]->meta.name);
    const struct collection_options collection = catalog_collection(o);
    if (!rc)
        rc = collection_list(c->ds, c->n_current, &collection, &c->collections, e);
    if (!rc)
        c->collections->modified_s = (int64_t)time(NULL);
    if (!rc && older)
        catalog_keep_older(c, older, clock_s(), o);
    if (rc)
        catalog_drop(out);
    return rc;
}

enum err_code catalog_expire(const struct catalog *c, const struct catalog_options *o, double now_s,
                             struct catalog **out, struct err *e)
{
    bool over = false;
    *out = NULL;
    for (size_t i = c->n_current; i < c->n; i++)
        over |= now_s - c->replaced_s[i] > o->keep_s;
    enum err_code rc = over ? catalog_alloc(c->n, out, e) : ERR_OK;
    if (rc || !over)
        return rc;
    for (; (*out)->n < c->n_current; (*out)->n++)
        (*out)->ds[(*out)->n] = dataset_ref(c->ds[(*out)->n]);
    (*out)->n_current = c->n_current;
    (*out)->collections = body_ref(c->collections);
    for (size_t i = c->n_current; i < c->n; i++)
        catalog_keep(*out, c->ds[i], c->replaced_s[i], now_s, o);
    return ERR_OK;
}

struct catalog *catalog_ref(struct catalog *c)
{
    atomic_fetch_add_explicit(&c->refs, 1, memory_order_relaxed);
    return c;
}

void catalog_drop(struct catalog **out)
{
    struct catalog *c = *out;
    *out = NULL;
    if (!c || atomic_fetch_sub_explicit(&c->refs, 1, memory_order_acq_rel) != 1)
        return;
    for (size_t i = 0; i < c->n; i++)
        dataset_drop(&c->ds[i]);
    mem_free(c->ds);
    mem_free(c->replaced_s);
    body_drop(&c->collections);
    mem_free(c);
}

struct dataset *catalog_find(const struct catalog *c, const char *name, const char *rev)
{
    for (size_t i = 0; i < c->n; i++)
        if (!strcmp(c->ds[i]->meta.name, name) && (!*rev || !strcmp(c->ds[i]->meta.revision, rev)))
            return c->ds[i];
    return NULL;
}
