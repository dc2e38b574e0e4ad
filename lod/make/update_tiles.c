/* What an update knows of tiles: the tiles of the store, with the edits made so far.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/make/update_tiles.h"

#include <string.h>

#include "lod/store/key.h"

uint8_t update_zoom(const struct update *u, uint8_t level)
{
    return (uint8_t)(store_info(u->old)->zoom_max - (u->top - level));
}

bool update_is_carried(const struct update *u, const struct store_tile *t)
{
    return t->level > 0 && t->key.z != update_zoom(u, t->level);
}

bool update_has(const struct update *u, struct key k)
{
    const struct edit_tile *x = edit_find(&u->d, k);
    if (x)
        return x->g.n > 0 && !x->carried;
    const struct store_tile *t = store_find(u->old, k);
    return t && !update_is_carried(u, t);
}

bool update_under(struct key over, struct key k)
{
    return k.z > over.z && k.x >> (k.z - over.z) == over.x && k.y >> (k.z - over.z) == over.y;
}

bool update_has_below(const struct update *u, struct key k)
{
    for (size_t i = 0; i < u->d.n; i++)
        if (update_under(k, u->d.tile[i].key) && update_has(u, u->d.tile[i].key))
            return true;
    for (size_t i = 0; i < u->n_tiles; i++)
        if (update_under(k, u->tiles[i].key) && update_has(u, u->tiles[i].key))
            return true;
    return false;
}

enum err_code update_now(struct update *u, struct key k, struct gauss *out, struct err *e)
{
    struct edit_tile *x = edit_find(&u->d, k);
    *out = (struct gauss){0};
    if (!x)
        return store_read_gauss(u->old, k, out, e);
    enum err_code rc = edit_settle(&u->d, x, e);
    if (!rc)
        rc = gauss_alloc(out, x->g.n, x->g.sh_degree, x->g.embed_len, e);
    memcpy(out->origin_enu_m, x->g.origin_enu_m, sizeof out->origin_enu_m);
    out->antialiased = x->g.antialiased;
    return rc ? rc : gauss_append(out, &x->g, NULL, x->g.n, e);
}
