/* Prefetch lists: coarse levels first, then tiles with more Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/prefetch_list.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lod/export/crop.h"
#include "lod/store/store.h"
#include "server/data/encode.h"
#include "server/documents/link.h"
#include "server/documents/result_id.h"
#include "server/route/target_query.h"

enum { PREFETCH_LIST_ROW = 256 }; /* bytes of a line without its query, from above */

struct prefetch_list {
    const struct dataset *d;
    const struct seed_target *t;
    const struct crop_node *left;  /* of each tile; NULL: all of it */
    const struct store_tile **row; /* [n] */
    size_t n;
};

/* Coarse levels first, since every view needs them; within a level, tiles that hold more. */
static int prefetch_list_by_importance(const void *pa, const void *pb)
{
    const struct store_tile *a = *(const struct store_tile *const *)pa,
                            *b = *(const struct store_tile *const *)pb;
    if (a->key.z != b->key.z)
        return a->key.z < b->key.z ? -1 : 1;
    if (a->count != b->count)
        return a->count > b->count ? -1 : 1;
    return key_compare(a->key, b->key);
}

static bool prefetch_list_in_bbox(struct key k, const int32_t bbox_e7[4])
{
    double west, south, east, north;
    key_bounds(k, &west, &south, &east, &north);
    return west * 1e7 < bbox_e7[2] && east * 1e7 > bbox_e7[0] && south * 1e7 < bbox_e7[3] &&
           north * 1e7 > bbox_e7[1];
}

static bool prefetch_list_lists(const struct prefetch_list *s, const struct store_tile *x)
{
    return !(s->left && !s->left[x - s->d->tiles].count) && x->key.z >= s->t->zooms.z_min &&
           x->key.z <= s->t->zooms.z_max &&
           !(s->t->page.has_bbox && !prefetch_list_in_bbox(x->key, s->t->page.bbox_e7));
}

/* list: what addresses are relative to. */
static void prefetch_list_write_row(const struct prefetch_list *s, const struct store_tile *tile,
                                    const struct link *list, const char *query, struct form form,
                                    const struct appearance_choice *a, struct buf *out)
{
    struct link at = *list;
    char etag[BODY_ETAG_SIZE];
    const struct crop_node *left = s->left ? &s->left[tile - s->d->tiles] : NULL;
    const uint32_t count = left ? left->count : tile->count;
    struct hash128 id = result_id_tile(s->d, tile, form, a);
    if (left && left->across)
        result_id_clip(&id, &s->t->tiles.clip);
    body_etag(id, etag);
    etag[strlen(etag) - 1] = 0; /* without its quotes, which JSON would have to escape */
    at.key = &tile->key;
    at.ext = format_ext(s->t->tiles.form.format);
    buf_printf(out, "{\"url\":\"");
    link_tile(&at, out);
    buf_printf(out, "%s\",\"etag\":\"\\\"%s\\\"\",\"gaussians\":%u,\"bytes\":%llu}\n", query,
               etag + 1, count, (unsigned long long)encode_bytes(&s->d->meta, form, count));
}

static void prefetch_list_write_page(const struct prefetch_list *s, struct form form,
                                     const struct appearance_choice *a, struct buf *out)
{
    char query[TARGET_QUERY_MAX];
    const struct link list =
        link_to(s->t->all.names.rev[0] ? LINK_REVISION : LINK_DATASET, NULL, s->d, s->d->edition);
    size_t first = s->t->page.after < s->n ? s->t->page.after : s->n;
    size_t end = s->n - first < s->t->page.limit ? s->n : first + s->t->page.limit;
    target_query_tiles(&s->t->tiles, query);
    for (size_t i = first; i < end; i++)
        prefetch_list_write_row(s, s->row[i], &list, query, form, a, out);
    if (end < s->n) {
        buf_printf(out, "{\"next\":\"");
        link_seed(&list, out);
        target_query_seed(s->t, (uint32_t)end, out);
        buf_printf(out, "\"}\n");
    }
}

enum err_code prefetch_list_write(const struct dataset *d, const struct seed_target *t,
                                  const struct crop_node *left, struct form form,
                                  const struct appearance_choice *a, struct buf *out, struct err *e)
{
    struct prefetch_list s = {.d = d, .t = t, .left = left};
    s.row = mem_array(d->n_tiles, sizeof *s.row);
    if (!s.row)
        return err_set(e, ERR_MEM, "prefetch list: out of memory");
    for (size_t i = 0; i < d->n_tiles; i++)
        if (prefetch_list_lists(&s, &d->tiles[i]))
            s.row[s.n++] = &d->tiles[i];
    qsort(s.row, s.n, sizeof(void *), prefetch_list_by_importance);
    prefetch_list_write_page(&s, form, a, out);
    mem_free(s.row);
    return buf_check(out, e);
}

size_t prefetch_list_room(const struct dataset *d, const struct seed_target *t)
{
    char query[TARGET_QUERY_MAX];
    size_t n = d->n_tiles < t->page.limit ? d->n_tiles : t->page.limit;
    target_query_tiles(&t->tiles, query);
    return n * (PREFETCH_LIST_ROW + strlen(query)) + 1024 + strlen(query);
}
