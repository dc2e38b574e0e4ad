/* The page's script would find these addresses one after the other, each behind a round trip:
 * catalogue, tileset and network, coarsest tile. As hints they are on their way while the script
 * still is. They have to be the script's own addresses, letter by letter (web/src/source.ts), and
 * in its mode. Addresses in tilesets and tiles are relative to these; one that leaves out how it
 * was signed would not open, so answers of datasets that are not public have none (answer_*.c).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/hint.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "lod/store.h"
#include "lod/tree.h"
#include "server/text.h"

enum hint_depth { HINT_NOTHING, HINT_CATALOGUE, HINT_SCENE };

/* How much of what the page asks for is known, and the scene's name, "" for the first. */
static enum hint_depth hint_read(const char *query, size_t n, char scene[64])
{
    static const char *const elsewhere[] = {"url=", "server="};
    static const char *const other_tiles[] = {"thin", "colours=", "appearance=", "light=", "ds="};
    enum hint_depth depth = HINT_SCENE;
    scene[0] = 0;
    for (const char *p = query, *end = query + n; p < end;) {
        const char *stop = memchr(p, '&', (size_t)(end - p));
        struct text one = {p, stop ? stop : end};
        for (size_t i = 0; i < sizeof elsewhere / sizeof *elsewhere; i++)
            if (text_take(&one, elsewhere[i]))
                return HINT_NOTHING;
        for (size_t i = 0; i < sizeof other_tiles / sizeof *other_tiles; i++)
            if (text_take(&one, other_tiles[i]))
                depth = HINT_CATALOGUE;
        if (text_take(&one, "scene=") && !text_take_decoded(&one, scene, 64))
            depth = HINT_CATALOGUE;
        p = stop ? stop + 1 : end;
    }
    return depth;
}

/* One more link; left out where there is no room. */
static void hint_add(char out[HINT_SIZE], const char *format, ...) ERR_PRINTF(2, 3);
static void hint_add(char out[HINT_SIZE], const char *format, ...)
{
    static const char how[] = ">; rel=preload; as=fetch; crossorigin";
    size_t used = strlen(out);
    char url[240];
    va_list ap;
    va_start(ap, format);
    int n = vsnprintf(url, sizeof url, format, ap);
    va_end(ap);
    if (n > 0 && (size_t)n < sizeof url && used + (size_t)n + sizeof how + 4 < HINT_SIZE)
        snprintf(out + used, HINT_SIZE - used, "%s<%s%s", used ? ", " : "", url, how);
}

/* The tile that every view begins with; NULL where a scene has several of them. */
static const struct store_tile *hint_coarsest(const struct dataset *d)
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

static void hint_add_scene(const struct dataset *d, char out[HINT_SIZE])
{
    const char *name = d->meta.name, *rev = d->meta.revision;
    const char *trained = d->model ? "?appearance=none" : "";
    const char *draft = "preset=preview&sh=0";
    const struct store_tile *tile = hint_coarsest(d);
    hint_add(out, "d/%s/tileset.json%s", name, trained);
    if (d->model)
        hint_add(out, "d/%s/r/%s-%s/appearance.json", name, rev, d->edition);
    if (tile)
        hint_add(out, "d/%s/r/%s-%s/t/%u/%u/%u.drc%s%c%s", name, rev, d->edition, tile->key.z,
                 tile->key.x, tile->key.y, trained, *trained ? '&' : '?', draft);
}

void hint_write(const struct catalog *c, const char *query, size_t n, char out[HINT_SIZE])
{
    char scene[64];
    enum hint_depth depth = hint_read(query, n, scene);
    out[0] = 0;
    if (depth == HINT_NOTHING)
        return;
    hint_add(out, "collections");
    const struct dataset *d = scene[0]       ? catalog_find(c, scene, "")
                              : c->n_current ? c->ds[0]
                                             : NULL;
    if (depth == HINT_SCENE && d)
        hint_add_scene(d, out);
}

/* ---- tilesets and tiles ---- */

enum { HINT_QUERY = 64 }; /* a longer one would be most of the field */

void hint_tileset(const struct dataset *d, const struct target *t, char out[HINT_SIZE])
{
    const struct tree *tree = store_tree(d->index);
    char query[TARGET_QUERY_MAX], base[40] = "";
    target_query(t, query);
    out[0] = '\0';
    if (t->clip.n || strlen(query) > HINT_QUERY || tree->root == TREE_NONE ||
        tree->nodes[tree->root].tile == TREE_NONE)
        return;
    const struct key k = d->tiles[tree->nodes[tree->root].tile].key;
    if (t->route == ROUTE_TILESET_MOVING)
        snprintf(base, sizeof base, "r/%s-%s/", d->meta.revision, d->edition);
    hint_add(out, "%st/%u/%u/%u.glb%s", base, k.z, k.x, k.y, query);
}

void hint_tile(const struct dataset *d, const struct store_tile *tile, const struct target *t,
               char out[HINT_SIZE])
{
    enum { NUMBERS = 3 * TEXT_UINT + 48 /* and the words between */ };
    const struct tree *tree = store_tree(d->index);
    const struct tree_node *v = &tree->nodes[tile - d->tiles];
    char query[TARGET_QUERY_MAX], *p = out;
    *p = '\0';
    if (!v->child_count || t->clip.n) /* what is left of the others is not known here */
        return;
    target_query(t, query);
    const char *ext = target_ext(t->form.format);
    const size_t each = NUMBERS + strlen(ext) + strlen(query);
    for (uint32_t i = 0; i < v->child_count && strlen(query) <= HINT_QUERY; i++) {
        const struct key k = d->tiles[tree->children[v->child_first + i]].key;
        if ((size_t)(p - out) + each > HINT_SIZE)
            break;
        p = text_put(p, i ? ", <../../" : "<../../"); /* from t/z/x/ */
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
