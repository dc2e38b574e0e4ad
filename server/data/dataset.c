/* A dataset is one revision of one store: its index (read without locks, because it never changes),
 * one store handle for each worker, and its documents. It is immutable and counted. Requests in
 * progress keep the one that they began with.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/data/dataset.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "lod/store/bake.h"
#include "server/data/appearance_rows.h"
#include "server/data/encode.h"

/* West south hmin east north hmax of the coarsest level's boxes: it covers every Gaussian. */
static enum err_code dataset_find_bbox(struct dataset *d, struct err *e)
{
    const double start[6] = {180, 90, HUGE_VAL, -180, -90, -HUGE_VAL};
    memcpy(d->bbox, start, sizeof start);
    for (size_t i = 0; i < d->n_tiles; i++) {
        const struct store_tile *t = &d->tiles[i];
        if (t->key.z != d->tiles[0].key.z)
            break;
        const struct store_shape x = store_shape(d->index, t);
        for (int corner = 0; corner < 8; corner++) {
            double p[3], at[3];
            for (int a = 0; a < 3; a++)
                p[a] = corner >> a & 1 ? x.max_enu_m[a] : x.min_enu_m[a];
            enum err_code rc = geo_from_enu(&d->meta.origin, p, &at[0], &at[1], &at[2], e);
            if (rc)
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

/* Heights above the sea become ellipsoidal, as clients of 3D Tiles read them. One number is enough:
 * the geoid's slope is some centimetres a kilometre. */
static void dataset_find_lift(struct dataset *d, const struct geoid *geoid)
{
    const struct store_meta *m = store_info(d->stores[0]);
    char words[HEIGHTS_WORDS_MAX];
    heights_words(m->heights, words);
    if (geoid && heights_of_sea(m->heights)) {
        const double above_m = geoid_above(geoid, m->origin.lon_deg, m->origin.lat_deg);
        if (!isfinite(above_m)) {
            log_warn("serve", "%s lies outside of the geoid %s: its heights stay above %s", m->name,
                     geoid_name(geoid), words);
            return;
        }
        d->lift_m = above_m;
        log_info("serve", "heights name=%s above=\"%s\" geoid=%s raised_m=%.2f", m->name, words,
                 geoid_name(geoid), d->lift_m);
    } else if (heights_of_sea(m->heights)) {
        log_warn("serve",
                 "heights of %s are above %s, and clients of 3D Tiles take them as ellipsoidal: up "
                 "to 100 m off; --geoid egm96 converts them",
                 m->name, words);
    }
}

/* The handle with the index of all; the others come later, and take over its heights. */
static enum err_code dataset_open_first(struct dataset *d, size_t n, const struct geoid *geoid,
                                        struct err *e)
{
    d->stores = mem_array(n, sizeof *d->stores);
    d->free_store = mem_array(n, sizeof *d->free_store);
    if (!d->stores || !d->free_store)
        return err_set(e, ERR_MEM, "out of memory for a dataset");
    enum err_code rc = store_open_fd(d->fd, d->path, &d->stores[0], e);
    d->n_most = n;
    d->n_begun = d->n_stores = !rc;
    if (rc)
        return rc;
    memcpy(d->source, store_info(d->stores[0])->revision, sizeof d->source);
    dataset_find_lift(d, geoid);
    store_lift(d->stores[0], d->lift_m);
    return ERR_OK;
}

/* Tiles are sent in the store's default appearance: another appearance model makes other bytes of
 * the same payload. */
static enum err_code dataset_salt_appearance(struct dataset *d, struct err *e)
{
    struct hash128 both[2] = {d->salt};
    enum err_code rc = bake_hash(d->stores[0], &both[1], e);
    if (!rc && (both[1].lo || both[1].hi))
        d->salt = hash_bytes(both, sizeof both);
    return rc;
}

/* A store without Gaussians has no maps, and is served. */
static enum err_code dataset_find_area(struct dataset *d, struct err *e)
{
    enum err_code rc = area_make(d->index, &d->area, e);
    return rc == ERR_DATA ? ERR_OK : rc;
}

static enum err_code dataset_open_store(struct dataset *d, size_t readers,
                                        const struct geoid *geoid, struct err *e)
{
    enum err_code rc = store_open_file(d->path, &d->fd, e);
    if (!rc)
        rc = dataset_open_first(d, readers + 1, geoid, e);
    if (!rc) {
        d->index = d->stores[0];
        d->meta = *store_info(d->index);
        d->tiles = store_tiles(d->index, &d->n_tiles);
        rc = dataset_find_bbox(d, e);
    }
    if (!rc)
        rc = dataset_find_area(d, e);
    if (!rc)
        rc = encode_fingerprint(&d->meta, &d->salt, e);
    if (!rc)
        rc = dataset_salt_appearance(d, e);
    return !rc ? bake_of(d->stores[0], &d->appearance, e) : rc;
}

enum err_code dataset_open(const char *path, size_t readers, const struct geoid *geoid,
                           struct dataset **out, struct err *e)
{
    struct dataset *d = mem_array(1, sizeof *d);
    *out = d;
    if (!d)
        return err_set(e, ERR_MEM, "out of memory for a dataset");
    atomic_init(&d->refs, 1);
    d->fd = -1;
    pthread_mutex_init(&d->lock, NULL);
    enum err_code rc = ERR_OK;
    if (!(d->path = mem_text(path)))
        rc = err_set(e, ERR_MEM, "out of memory for a dataset");
    if (!rc)
        rc = dataset_open_store(d, readers, geoid, e);
    if (rc)
        dataset_drop(out);
    return rc;
}

enum err_code dataset_open_all(struct dataset *d, struct err *e)
{
    enum err_code rc = ERR_OK;
    while (!rc && d->n_begun < d->n_most) {
        struct store **s = &d->stores[d->n_stores];
        rc = store_open_more(d->fd, d->stores[0], s, e);
        if (rc)
            break;
        d->free_store[d->n_free++] = *s;
        d->n_stores++;
        d->n_begun++;
    }
    return rc;
}

struct dataset *dataset_ref(struct dataset *d)
{
    atomic_fetch_add_explicit(&d->refs, 1, memory_order_relaxed);
    return d;
}

bool dataset_is_last(const struct dataset *d, unsigned held)
{
    return (unsigned)atomic_load_explicit(&d->refs, memory_order_acquire) == held;
}

void dataset_drop(struct dataset **out)
{
    struct dataset *d = *out;
    *out = NULL;
    if (!d || atomic_fetch_sub_explicit(&d->refs, 1, memory_order_acq_rel) != 1)
        return;
    area_free(&d->area);
    for (size_t i = d->n_stores; i-- > 0;) /* the first has the index of all */
        store_close(&d->stores[i]);
    if (d->fd >= 0)
        close(d->fd);
    mem_free(d->stores);
    mem_free(d->free_store);
    for (size_t i = 0; i < DATASET_DOCUMENTS; i++) {
        struct body *b = atomic_load(&d->document[i]);
        body_drop(&b);
    }
    body_drop(&d->model);
    body_drop(&d->photographs);
    appearance_rows_close(&d->rows);
    pthread_mutex_destroy(&d->lock);
    mem_free(d->path);
    mem_free(d);
}

enum err_code dataset_borrow(struct dataset *d, struct store **out, struct err *e)
{
    *out = NULL;
    pthread_mutex_lock(&d->lock);
    if (d->n_free)
        *out = d->free_store[--d->n_free];
    const bool more = !*out && d->n_begun < d->n_most;
    d->n_begun += more;
    pthread_mutex_unlock(&d->lock);
    if (*out)
        return ERR_OK;
    if (!more)
        return err_set(e, ERR_INTERNAL, "dataset %s: fewer store handles than workers",
                       d->meta.name);
    enum err_code rc = store_open_more(d->fd, d->stores[0], out, e);
    pthread_mutex_lock(&d->lock);
    if (!rc)
        d->stores[d->n_stores++] = *out;
    else
        d->n_begun--;
    pthread_mutex_unlock(&d->lock);
    return rc;
}

void dataset_return(struct dataset *d, struct store *s)
{
    pthread_mutex_lock(&d->lock);
    d->free_store[d->n_free++] = s;
    pthread_mutex_unlock(&d->lock);
}
