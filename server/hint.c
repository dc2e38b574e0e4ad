/* The page's script would find these addresses one after the other, each behind a round trip:
 * catalogue, tileset and network, coarsest tile. As hints they are on their way while the script
 * still is. They have to be the script's own addresses, letter by letter (web/src/source.ts), and
 * in its mode.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/hint.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

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
    const struct store_tile *tile = hint_coarsest(d);
    hint_add(out, "d/%s/tileset.json%s", name, trained);
    if (d->model)
        hint_add(out, "d/%s/r/%s/appearance.json", name, rev);
    if (tile)
        hint_add(out, "d/%s/r/%s/t/%u/%u/%u.%s%s", name, rev, tile->key.z, tile->key.x, tile->key.y,
                 d->model ? "drc" : "glb", trained);
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
