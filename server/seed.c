/* Prefetch lists: coarse levels first, then tiles that hold more.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/seed.h"

#include <stdlib.h>
#include <string.h>

#include "lod/store.h"
#include "server/result_id.h"

/* Coarse levels first, since every view needs them; within a level, tiles that hold more. */
static int seed_by_importance(const void *pa, const void *pb)
{
    const struct store_tile *a = *(const struct store_tile *const *)pa;
    const struct store_tile *b = *(const struct store_tile *const *)pb;
    if (a->key.z != b->key.z)
        return a->key.z < b->key.z ? -1 : 1;
    if (a->count != b->count)
        return a->count > b->count ? -1 : 1;
    return key_compare(a->key, b->key);
}

static bool seed_in_bbox(struct key k, const int32_t bbox_e7[4])
{
    double west, south, east, north;
    key_bounds(k, &west, &south, &east, &north);
    return west * 1e7 < bbox_e7[2] && east * 1e7 > bbox_e7[0] && south * 1e7 < bbox_e7[3] &&
           north * 1e7 > bbox_e7[1];
}

enum err_code seed_write(const struct dataset *d, const struct target *t, struct form form,
                         const struct appearance_choice *a, struct buf *out, struct err *e)
{
    char query[TARGET_QUERY_MAX];
    const struct store_tile **pick = mem_array(d->n_tiles, sizeof *pick);
    size_t n = 0;
    if (!pick)
        return err_set(e, ERR_MEM, "seed list: out of memory");
    for (size_t i = 0; i < d->n_tiles; i++) {
        struct key k = d->tiles[i].key;
        if (k.z >= t->z_min && k.z <= t->z_max && (!t->has_bbox || seed_in_bbox(k, t->bbox_e7)))
            pick[n++] = &d->tiles[i];
    }
    qsort(pick, n, sizeof *pick, seed_by_importance);
    target_query(t, query);
    for (size_t i = 0; i < n; i++) {
        char etag[BODY_ETAG_SIZE];
        body_etag(result_id_tile(d, pick[i], form, a), etag);
        etag[strlen(etag) - 1] = 0; /* without its quotes, which JSON would have to escape */
        buf_printf(
            out, "{\"url\":\"r/%s-%s/t/%u/%u/%u.%s%s\",\"etag\":\"\\\"%s\\\"\",\"gaussians\":%u}\n",
            d->meta.revision, d->edition, pick[i]->key.z, pick[i]->key.x, pick[i]->key.y,
            target_ext(t->form.format), query, etag + 1, pick[i]->count);
    }
    mem_free(pick);
    return buf_check(out, e);
}
