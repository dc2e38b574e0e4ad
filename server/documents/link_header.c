/* Without hints the page's script finds these addresses one after another, each after a round trip:
 * catalogue, tileset and network, coarsest tile. Hints let them load while the script still loads.
 * They must be exactly the script's own addresses (web/src/source.ts), in its mode. Addresses in
 * tilesets and tiles are relative to these. An address without its signature would not open, so
 * answers of datasets that are not public have no hints (answer_*.c).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/documents/link_header.h"

#include <stdio.h>
#include <string.h>

#include "lod/store/store.h"
#include "lod/store/tree.h"
#include "server/base/text.h"
#include "server/documents/link.h"
#include "server/route/target_query.h"

enum link_header_depth { LINK_HEADER_NOTHING, LINK_HEADER_CATALOGUE, LINK_HEADER_SCENE };

/* How much of what the page asks for is known, and the scene's name, "" for the first. */
static enum link_header_depth link_header_read(const char *query, size_t n, char scene[64])
{
    static const char *const elsewhere[] = {"url=", "server="};
    static const char *const other_tiles[] = {"thin", "colours=", "appearance=", "light=", "ds="};
    enum link_header_depth depth = LINK_HEADER_SCENE;
    scene[0] = 0;
    for (const char *p = query, *end = query + n; p < end;) {
        const char *stop = memchr(p, '&', (size_t)(end - p));
        struct text one = {p, stop ? stop : end};
        for (size_t i = 0; i < sizeof elsewhere / sizeof *elsewhere; i++)
            if (text_take(&one, elsewhere[i]))
                return LINK_HEADER_NOTHING;
        for (size_t i = 0; i < sizeof other_tiles / sizeof *other_tiles; i++)
            if (text_take(&one, other_tiles[i]))
                depth = LINK_HEADER_CATALOGUE;
        if (text_take(&one, "scene=") && !text_take_decoded(&one, scene, 64))
            depth = LINK_HEADER_CATALOGUE;
        p = stop ? stop + 1 : end;
    }
    return depth;
}

/* One more link, with its query; left out where there is no room. */
static void link_header_add(char out[LINK_HEADER_SIZE],
                            void (*to)(const struct link *l, struct buf *url), const struct link *l,
                            const char *query)
{
    static const char how[] = ">; rel=preload; as=fetch; crossorigin";
    size_t used = strlen(out);
    char url[240];
    link_text(to, l, url, sizeof url);
    const size_t n = strlen(url) + strlen(query);
    if (*url && n < sizeof url && used + n + sizeof how + 4 < LINK_HEADER_SIZE)
        snprintf(out + used, LINK_HEADER_SIZE - used, "%s<%s%s%s", used ? ", " : "", url, query,
                 how);
}

/* The tile that every view begins with; NULL where a scene has several of them. */
static const struct store_tile *link_header_coarsest(const struct dataset *d)
{
    const struct store_tile *found = NULL;
    for (size_t i = 0; i < d->n_tiles; i++)
        if (d->tiles[i].key.z == d->meta.zoom_min) {
            if (found)
                return NULL;
            found = &d->tiles[i];
        }
    return found;
}

static void link_header_add_scene(const struct dataset *d, char out[LINK_HEADER_SIZE])
{
    const struct store_tile *tile = link_header_coarsest(d);
    struct link l = link_to(LINK_ROOT, NULL, d, d->edition);
    link_header_add(out, link_tileset_moving, &l, d->model ? "?appearance=none" : "");
    if (d->model)
        link_header_add(out, link_model, &l, "");
    l.key = tile ? &tile->key : NULL;
    l.ext = format_ext(FORMAT_DRC);
    if (tile)
        link_header_add(out, link_tile, &l,
                        d->model ? "?appearance=none&preset=preview&sh=0" : "?preset=preview&sh=0");
}

static const struct dataset *link_header_find(const struct catalog *c, const char *scene)
{
    return scene[0] ? catalog_find(c, scene, "") : c->n_current ? c->ds[0] : NULL;
}

const struct dataset *link_header_scene(const struct catalog *c, const char *query, size_t n)
{
    char scene[64];
    return link_header_read(query, n, scene) == LINK_HEADER_NOTHING ? NULL
                                                                    : link_header_find(c, scene);
}

void link_header_write(const struct catalog *c, const char *query, size_t n,
                       char out[LINK_HEADER_SIZE])
{
    char scene[64];
    enum link_header_depth depth = link_header_read(query, n, scene);
    out[0] = 0;
    if (depth == LINK_HEADER_NOTHING)
        return;
    link_header_add(out, link_collections, &(struct link){.from = LINK_ROOT}, "");
    const struct dataset *d = link_header_find(c, scene);
    if (depth == LINK_HEADER_SCENE && d)
        link_header_add_scene(d, out);
}

/* ---- tilesets and tiles ---- */

enum { LINK_HEADER_QUERY = 64 }; /* a longer one would be most of the field */

void link_header_tileset(const struct dataset *d, bool moving, const struct target_tiles *t,
                         char out[LINK_HEADER_SIZE])
{
    const struct tree *tree = store_tree(d->index);
    char query[TARGET_QUERY_MAX];
    struct link l = link_to(moving ? LINK_DATASET : LINK_REVISION, NULL, d, d->edition);
    target_query_tiles(t, query);
    out[0] = '\0';
    if (t->clip.n || strlen(query) > LINK_HEADER_QUERY || tree->root == TREE_NONE ||
        tree_node(tree, tree->root).tile == TREE_NONE)
        return;
    l.key = &d->tiles[tree_node(tree, tree->root).tile].key;
    l.ext = format_ext(d->meta.antialiased ? FORMAT_GLB_LOWPASS : FORMAT_GLB);
    link_header_add(out, link_tile, &l, query);
}

void link_header_tile(const struct dataset *d, const struct store_tile *tile,
                      const struct target_tiles *t, char out[LINK_HEADER_SIZE])
{
    enum { NUMBERS = 3 * TEXT_UINT + 48 /* and the words between */ };
    const struct tree *tree = store_tree(d->index);
    const struct tree_node v = tree_node(tree, (size_t)(tile - d->tiles));
    char query[TARGET_QUERY_MAX], *p = out;
    *p = '\0';
    if (!v.child_count || t->clip.n) /* what is left of the others is not known here */
        return;
    target_query_tiles(t, query);
    const char *ext = format_ext(t->form.format);
    const size_t each = NUMBERS + strlen(ext) + strlen(query);
    for (uint32_t i = 0; i < v.child_count && strlen(query) <= LINK_HEADER_QUERY; i++) {
        const struct key k = d->tiles[tree->children[v.child_first + i]].key;
        if ((size_t)(p - out) + each > LINK_HEADER_SIZE)
            break;
        p = text_put(p, i ? ", <../../" : "<../../"); /* a tile lies in {z}/{x}/ */
        p = text_put_uint(p, k.z);
        *p++ = '/';
        p = text_put_uint(p, k.x);
        *p++ = '/';
        p = text_put_uint(p, k.y);
        *p++ = '.';
        p = text_put(text_put(p, ext), query);
        p = text_put(p, ">; rel=prefetch");
    }
    *p = '\0';
}
