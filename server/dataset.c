/* The stores that are served. A dataset is one revision of one store: its index (read without
 * locks, it never changes), one store handle a worker, and the documents that describe it, made
 * once. A catalog is all datasets at one moment. Both are immutable and counted: a reload makes a
 * new catalog and swaps a pointer, requests under way keep the old one, and a revision that was
 * replaced is served for another day from the handles it holds, although its file has been renamed
 * over.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/server.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double RETIRED_KEEP_S = 24 * 3600;

/* West south hmin east north hmax of the coarsest level's boxes: it covers every Gaussian. */
static enum err_code find_bbox(struct dataset *d, struct err *e)
{
    const double start[6] = {180, 90, HUGE_VAL, -180, -90, -HUGE_VAL};
    memcpy(d->bbox, start, sizeof(start));
    for (size_t i = 0; i < d->n_tiles; i++) {
        const struct store_tile *t = &d->tiles[i];
        if (t->key.z != d->tiles[0].key.z)
            break;
        for (int corner = 0; corner < 8; corner++) {
            double p[3], at[3];
            for (int a = 0; a < 3; a++)
                p[a] = corner >> a & 1 ? t->max_enu_m[a] : t->min_enu_m[a];
            enum err_code rc = geo_from_enu(&d->meta.origin, p, &at[0], &at[1], &at[2], e);
            if (rc != ERR_OK)
                return rc;
            for (int a = 0; a < 3; a++) {
                d->bbox[a] = fmin(d->bbox[a], at[a]);
                d->bbox[a + 3] = fmax(d->bbox[a + 3], at[a]);
            }
        }
    }
    if (!d->n_tiles) {
        const double *o =
            (const double[]){d->meta.origin.lon_deg, d->meta.origin.lat_deg, d->meta.origin.h_m};
        for (int a = 0; a < 6; a++)
            d->bbox[a] = o[a % 3];
    }
    return ERR_OK;
}

/* Take a document's bytes: hash, compress. */
static enum err_code take_document(enum err_code rc, struct buf *b, struct body **out,
                                   struct err *e)
{
    if (rc != ERR_OK) {
        buf_free(b);
        return rc;
    }
    *out = body_take(b, NULL);
    if (!*out)
        return err_set(e, ERR_MEM, "dataset: out of memory for its documents");
    body_compress(*out);
    return ERR_OK;
}

static enum err_code make_documents(struct dataset *d, const char *public_url, struct err *e)
{
    struct buf b = {0};
    char text[FILE_PATH_MAX];
    enum err_code rc = tileset_write(d->index, "t/{z}/{x}/{y}.glb", &b, e);
    rc = take_document(rc, &b, &d->tileset, e);
    if (rc == ERR_OK) {
        snprintf(text, sizeof(text), "r/%s/t/{z}/{x}/{y}.glb", d->meta.revision);
        rc = tileset_write(d->index, text, &b, e);
        rc = take_document(rc, &b, &d->tileset_moving, e);
    }
    if (rc == ERR_OK) {
        size_t n = public_url ? strlen(public_url) : 0;
        while (n && public_url[n - 1] == '/')
            n--;
        snprintf(text, sizeof(text), "%.*s/d/%s/r/%s/t/{z}/{x}/{y}.glb", n ? (int)n : 5,
                 n ? public_url : "../..", d->meta.name, d->meta.revision);
        rc = tileset_tilejson(d->index, text, &b, e);
        rc = take_document(rc, &b, &d->tilejson, e);
    }
    if (rc == ERR_OK)
        rc = look_list(d, &d->appearances, e);
    return rc == ERR_OK ? describe_collection(d, &d->collection, e) : rc;
}

static enum err_code open_stores(struct dataset *d, size_t n, struct err *e)
{
    d->stores = mem_array(n, sizeof(*d->stores));
    d->free_store = mem_array(n, sizeof(*d->free_store));
    if (!d->stores || !d->free_store)
        return err_set(e, ERR_MEM, "dataset %s: out of memory", d->path);
    for (size_t i = 0; i < n; i++) {
        enum err_code rc = store_open(d->path, &d->stores[i], e);
        if (rc != ERR_OK)
            return rc;
        d->n_stores++;
        if (i && strcmp(store_info(d->stores[i])->revision, store_info(d->stores[0])->revision))
            return err_set(e, ERR_BUSY, "dataset %s: replaced while it was opened; try again",
                           d->path);
        if (i)
            d->free_store[d->n_free++] = d->stores[i];
    }
    return ERR_OK;
}

/* Tiles are sent in the store's default look: another appearance model makes other bytes of the
 * same payload. */
static enum err_code salt_look(struct dataset *d, struct err *e)
{
    struct hash128 both[2] = {d->salt};
    enum err_code rc = bake_hash(d->stores[0], &both[1], e);
    if (rc == ERR_OK && (both[1].lo || both[1].hi))
        d->salt = hash_bytes(both, sizeof(both));
    return rc;
}

enum err_code dataset_open(const char *path, size_t readers, const char *public_url,
                           struct dataset **out, struct err *e)
{
    struct dataset *d = mem_array(1, sizeof(*d));
    *out = d;
    if (!d)
        return err_set(e, ERR_MEM, "dataset %s: out of memory", path);
    atomic_init(&d->refs, 1);
    pthread_mutex_init(&d->lock, NULL);
    enum err_code rc = ERR_OK;
    if (!(d->path = mem_text(path)))
        rc = err_set(e, ERR_MEM, "dataset %s: out of memory", path);
    if (rc == ERR_OK)
        rc = open_stores(d, readers + 1, e);
    if (rc == ERR_OK) {
        d->index = d->stores[0];
        d->meta = *store_info(d->index);
        d->tiles = store_tiles(d->index, &d->n_tiles);
        rc = find_bbox(d, e);
    }
    if (rc == ERR_OK)
        rc = encode_fingerprint(&d->meta, &d->salt, e);
    if (rc == ERR_OK)
        rc = salt_look(d, e);
    if (rc == ERR_OK)
        rc = bake_of(d->stores[0], &d->appearance, e);
    if (rc == ERR_OK)
        rc = make_documents(d, public_url, e);
    if (rc != ERR_OK)
        dataset_drop(out);
    return rc;
}

struct dataset *dataset_ref(struct dataset *d)
{
    atomic_fetch_add_explicit(&d->refs, 1, memory_order_relaxed);
    return d;
}

void dataset_drop(struct dataset **out)
{
    struct dataset *d = *out;
    *out = NULL;
    if (!d || atomic_fetch_sub_explicit(&d->refs, 1, memory_order_acq_rel) != 1)
        return;
    for (size_t i = 0; i < d->n_stores; i++)
        store_close(&d->stores[i]);
    mem_free(d->stores);
    mem_free(d->free_store);
    body_drop(&d->tileset);
    body_drop(&d->tileset_moving);
    body_drop(&d->tilejson);
    body_drop(&d->collection);
    body_drop(&d->appearances);
    pthread_mutex_destroy(&d->lock);
    mem_free(d->path);
    mem_free(d);
}

struct store *dataset_borrow(struct dataset *d)
{
    struct store *s = NULL;
    pthread_mutex_lock(&d->lock);
    if (d->n_free)
        s = d->free_store[--d->n_free];
    pthread_mutex_unlock(&d->lock);
    return s;
}

void dataset_return(struct dataset *d, struct store *s)
{
    pthread_mutex_lock(&d->lock);
    d->free_store[d->n_free++] = s;
    pthread_mutex_unlock(&d->lock);
}

/* ---- catalog ---- */

static int by_name(const void *pa, const void *pb)
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
static void keep_retired(struct catalog *c, const struct catalog *older)
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
        if (!named || present || (d->retired_s > 0 && now_s - d->retired_s > RETIRED_KEEP_S))
            continue;
        if (!(d->retired_s > 0))
            d->retired_s = now_s; /* only the reloading thread writes and reads it */
        c->ds[c->n++] = dataset_ref(d);
    }
}

/* The dataset of `older` at this path if the file still has its revision, else open it anew. */
static enum err_code open_or_keep(const char *path, size_t readers, const char *public_url,
                                  const struct catalog *older, struct dataset **out, struct err *e)
{
    struct store *now = NULL;
    enum err_code rc = older ? store_open(path, &now, e) : ERR_OK;
    if (rc != ERR_OK)
        return rc;
    for (size_t i = 0; older && i < older->n && !*out; i++) {
        struct dataset *d = older->ds[i];
        if (!(d->retired_s > 0) && !strcmp(d->path, path) &&
            !strcmp(d->meta.revision, store_info(now)->revision))
            *out = dataset_ref(d);
    }
    store_close(&now);
    return *out ? ERR_OK : dataset_open(path, readers, public_url, out, e);
}

enum err_code catalog_open(const char *const *paths, size_t n, size_t readers,
                           const char *public_url, struct catalog *older, struct catalog **out,
                           struct err *e)
{
    struct catalog *c = mem_array(1, sizeof(*c));
    enum err_code rc = ERR_OK;
    *out = c;
    if (!c || !(c->ds = mem_array(n + (older ? older->n : 0), sizeof(*c->ds)))) {
        mem_free(c);
        *out = NULL;
        return err_set(e, ERR_MEM, "catalog: out of memory");
    }
    atomic_init(&c->refs, 1);
    for (; c->n < n && rc == ERR_OK; c->n += rc == ERR_OK)
        rc = open_or_keep(paths[c->n], readers, public_url, older, &c->ds[c->n], e);
    if (rc == ERR_OK) {
        keep_retired(c, older);
        qsort(c->ds, c->n, sizeof(*c->ds), by_name);
        for (size_t i = 1; i < c->n && rc == ERR_OK; i++)
            if (!(c->ds[i]->retired_s > 0) && !strcmp(c->ds[i]->meta.name, c->ds[i - 1]->meta.name))
                rc = err_set(e, ERR_ARG,
                             "%s and %s : both hold a dataset named '%s' : serve one of them",
                             c->ds[i - 1]->path, c->ds[i]->path, c->ds[i]->meta.name);
    }
    if (rc == ERR_OK)
        rc = describe_collections(c, &c->collections, e);
    if (rc != ERR_OK)
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
