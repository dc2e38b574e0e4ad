/* The datasets at one moment, with their documents. A reload makes a new catalog and swaps a pointer,
 * requests under way keep the old one, and a revision that was replaced is served for another day from
 * the handles it holds, although its file has been renamed over.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/catalog.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lod/store.h"
#include "lod/tileset.h"
#include "server/appearance_api.h"
#include "server/collection.h"
#include "server/document.h"

static const double CATALOG_KEEP_S = 24 * 3600; /* of a revision that was replaced */

static enum err_code catalog_make_documents(struct dataset *d, const char *public_url,
                                            struct err *e)
{
    struct buf b = {0};
    char text[FILE_PATH_MAX];
    enum err_code rc = tileset_write(d->index, "t/{z}/{x}/{y}.glb", &b, e);
    rc = document_take(rc, &b, &d->tileset, e);
    if (!rc) {
        snprintf(text, sizeof text, "r/%s/t/{z}/{x}/{y}.glb", d->meta.revision);
        rc = tileset_write(d->index, text, &b, e);
        rc = document_take(rc, &b, &d->tileset_moving, e);
    }
    if (!rc) {
        size_t n = public_url ? strlen(public_url) : 0;
        while (n && public_url[n - 1] == '/')
            n--;
        snprintf(text, sizeof text, "%.*s/d/%s/r/%s/t/{z}/{x}/{y}.glb", n ? (int)n : 5,
                 n ? public_url : "../..", d->meta.name, d->meta.revision);
        rc = tileset_tilejson(d->index, text, &b, e);
        rc = document_take(rc, &b, &d->tilejson, e);
    }
    if (!rc)
        rc = appearance_api_list(d, &d->appearances, e);
    return !rc ? collection_describe(d, &d->collection, e) : rc;
}

static int catalog_by_name(const void *pa, const void *pb)
{
    const struct dataset *a = *(struct dataset *const *)pa, *b = *(struct dataset *const *)pb;
    int order = strcmp(a->meta.name, b->meta.name);
    if (order)
        return order;
    if ((a->retired_s > 0) != (b->retired_s > 0))
        return a->retired_s > 0 ? 1 : -1;
    return (a->retired_s < b->retired_s) - (a->retired_s > b->retired_s);
}

/* Revisions of `older` that were replaced less than a day ago, or just now. */
static void catalog_keep_retired(struct catalog *c, const struct catalog *older)
{
    size_t n_current = c->n;
    double now_s = clock_s();
    for (size_t i = 0; older && i < older->n; i++) {
        struct dataset *d = older->ds[i];
        bool named = false, present = false;
        for (size_t k = 0; k < n_current; k++) {
            bool same_name = !strcmp(c->ds[k]->meta.name, d->meta.name);
            named |= same_name;
            present |= same_name && !strcmp(c->ds[k]->meta.revision, d->meta.revision);
        }
        if (!named || present || (d->retired_s > 0 && now_s - d->retired_s > CATALOG_KEEP_S))
            continue;
        if (!(d->retired_s > 0))
            d->retired_s = now_s; /* only the reloading thread writes and reads it */
        c->ds[c->n++] = dataset_ref(d);
    }
}

/* The dataset of `older` at this path if the file still has its revision, else open it anew. */
static enum err_code catalog_open_or_keep(const char *path, size_t readers, const char *public_url,
                                          const struct catalog *older, struct dataset **out,
                                          struct err *e)
{
    struct store *now = NULL;
    enum err_code rc = older ? store_open(path, &now, e) : ERR_OK;
    if (rc)
        return rc;
    for (size_t i = 0; older && i < older->n && !*out; i++) {
        struct dataset *d = older->ds[i];
        if (!(d->retired_s > 0) && !atomic_load(&d->n_failed) && !strcmp(d->path, path) &&
            !strcmp(d->meta.revision, store_info(now)->revision))
            *out = dataset_ref(d);
    }
    store_close(&now);
    if (*out)
        return ERR_OK;
    rc = dataset_open(path, readers, out, e);
    if (!rc)
        rc = catalog_make_documents(*out, public_url, e);
    if (rc)
        dataset_drop(out);
    return rc;
}

enum err_code catalog_open(const char *const *paths, size_t n, size_t readers,
                           const char *public_url, struct catalog *older, struct catalog **out,
                           struct err *e)
{
    struct catalog *c = mem_array(1, sizeof *c);
    enum err_code rc = ERR_OK;
    *out = c;
    if (!c || !(c->ds = mem_array(n + (older ? older->n : 0), sizeof *c->ds))) {
        mem_free(c);
        *out = NULL;
        return err_set(e, ERR_MEM, "catalog: out of memory");
    }
    atomic_init(&c->refs, 1);
    for (; c->n < n && !rc; c->n += !rc)
        rc = catalog_open_or_keep(paths[c->n], readers, public_url, older, &c->ds[c->n], e);
    if (!rc) {
        catalog_keep_retired(c, older);
        qsort(c->ds, c->n, sizeof *c->ds, catalog_by_name);
        for (size_t i = 1; i < c->n && !rc; i++)
            if (!(c->ds[i]->retired_s > 0) && !strcmp(c->ds[i]->meta.name, c->ds[i - 1]->meta.name))
                rc = err_set(e, ERR_ARG,
                             "%s and %s : both hold a dataset named '%s' : serve one of them",
                             c->ds[i - 1]->path, c->ds[i]->path, c->ds[i]->meta.name);
    }
    if (!rc)
        rc = collection_list(c->ds, c->n, &c->collections, e);
    if (rc)
        catalog_drop(out);
    return rc;
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
