/* Prefetch lists: coarse levels first, then tiles with more Gaussians.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/prefetch_list.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lod/export/crop.h"
#include "lod/export/lowpass.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "server/base/text.h"
#include "server/data/encode.h"
#include "server/documents/link.h"
#include "server/documents/result_id.h"
#include "server/route/target_query.h"

enum { PREFETCH_LIST_ROW = 256 }; /* bytes of a line without its query, from above */

struct prefetch_list {
    const struct server_config *cfg;
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

/* ---- what clients ask for ---- */

/* Which tiles a client asks for in a form. */
enum prefetch_tiles {
    PREFETCH_ALL,   /* all of them */
    PREFETCH_ENTRY, /* as tilesets name them: filtered where tiles are (lod/export/tileset.c) */
    PREFETCH_NEAR,  /* leaves of which the filtered form comes first */
    PREFETCH_FIRST  /* the one that every view begins with */
};
/* The forms by client: what they ask for letter by letter, because a cache keeps answers by their
 * addresses. tests/web/seed.test.mjs compares the rows with what the clients ask for. */
static const struct prefetch_form {
    enum client client;
    enum prefetch_tiles tiles;
    enum format format;
    bool versioned; /* CesiumJS adds the version that tilesets have */
    bool draft;
} prefetch_forms[] = {
    {CLIENT_CESIUM, PREFETCH_ENTRY, FORMAT_GLB_LOWPASS, true, false},
    {CLIENT_CESIUM, PREFETCH_NEAR, FORMAT_GLB, true, false},
    {CLIENT_THREE, PREFETCH_ENTRY, FORMAT_GLB_LOWPASS, false, false},
    {CLIENT_THREE, PREFETCH_NEAR, FORMAT_GLB, false, false},
    {CLIENT_VIEWER, PREFETCH_FIRST, FORMAT_DRC, false, true},
    {CLIENT_VIEWER, PREFETCH_ALL, FORMAT_DRC, false, false},
};
enum { PREFETCH_FORMS = sizeof prefetch_forms / sizeof *prefetch_forms };

/* Is the form asked for of this tile? *format: in which format. */
static bool prefetch_list_wants(const struct prefetch_list *s, const struct prefetch_form *f,
                                const struct store_tile *tile, enum format *format)
{
    const struct tree *tree = store_tree(s->d->index);
    const uint32_t node = (uint32_t)(tile - s->d->tiles);
    const bool filtered = s->d->meta.antialiased && lowpass_pixel_m(tree, node) > 0;
    *format = f->tiles == PREFETCH_ENTRY && !filtered ? FORMAT_GLB : f->format;
    switch (f->tiles) {
    case PREFETCH_NEAR:
        return filtered && !tree_node(tree, node).child_count;
    case PREFETCH_FIRST:
        return node == tree->root;
    default:
        return true;
    }
}

/* A line: a tile in a form. list: what addresses are relative to. */
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
    at.ext = format_ext(form.format);
    buf_printf(out, "{\"url\":\"");
    link_tile(&at, out);
    buf_printf(out, "%s\",\"etag\":\"\\\"%s\\\"\",\"gaussians\":%u,\"bytes\":%llu}\n", query,
               etag + 1, count, (unsigned long long)encode_bytes(&s->d->meta, form, count));
}

/* A tile as a client asks for it. The viewer computes appearances itself, so the one that is asked
 * for, presets and degrees are of the others. */
static void prefetch_list_write_form(const struct prefetch_list *s, const struct store_tile *tile,
                                     const struct link *list, const char *query,
                                     const struct prefetch_form *f,
                                     const struct appearance_choice *a, struct buf *out)
{
    static const struct appearance_choice none = {0};
    char own[TARGET_QUERY_MAX + 32], *p = own;
    enum format format;
    if (!prefetch_list_wants(s, f, tile, &format))
        return;
    const bool viewer = f->client == CLIENT_VIEWER;
    struct form asked = f->draft ? encode_draft()
                        : viewer ? encode_form_of(format)
                                 : s->t->tiles.form;
    asked.format = format;
    struct form form = encode_form(s->cfg, &s->d->meta, &asked);
    form.trained = viewer && s->d->model;
    if (!viewer)
        p = text_put(p, query);
    if (form.trained)
        p = text_put(p, "&appearance=none");
    if (f->draft)
        p = text_put(p, "&preset=preview&sh=0");
    if (f->versioned)
        p = text_put(text_put(p, "&v="), s->d->meta.revision);
    *p = '\0';
    own[0] = own[0] ? '?' : '\0';
    prefetch_list_write_row(s, tile, list, own, form, viewer ? &none : a, out);
}

static void prefetch_list_write_tile(const struct prefetch_list *s, const struct store_tile *tile,
                                     const struct link *list, const char *query, struct form form,
                                     const struct appearance_choice *a, struct buf *out)
{
    const enum client client = (enum client)s->t->zooms.client;
    if (!client)
        prefetch_list_write_row(s, tile, list, query, form, a, out);
    for (size_t i = 0; client && i < PREFETCH_FORMS; i++)
        if (client == CLIENT_ALL || client == prefetch_forms[i].client)
            prefetch_list_write_form(s, tile, list, query, &prefetch_forms[i], a, out);
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
        prefetch_list_write_tile(s, s->row[i], &list, query, form, a, out);
    if (end < s->n) {
        buf_printf(out, "{\"next\":\"");
        link_seed(&list, out);
        target_query_seed(s->t, (uint32_t)end, out);
        buf_printf(out, "\"}\n");
    }
}

enum err_code prefetch_list_write(const struct server_config *cfg, const struct dataset *d,
                                  const struct seed_target *t, const struct crop_node *left,
                                  struct form form, const struct appearance_choice *a,
                                  struct buf *out, struct err *e)
{
    struct prefetch_list s = {.cfg = cfg, .d = d, .t = t, .left = left};
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
    const size_t lines = t->zooms.client ? PREFETCH_FORMS : 1;
    return n * lines * (PREFETCH_LIST_ROW + strlen(query)) + 1024 + strlen(query);
}
