/* What a polygon leaves of tiles: see crop.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/export/crop.h"

#include <math.h>

#include "core/splat/gauss.h"
#include "lod/export/clip.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

/* Degrees around a box: more than the ground bends within a tile, and less than anybody sees. */
static const double CROP_MARGIN_DEG = 1e-6;

/* Does the edge meet the rectangle west, south, east, north? By cutting it at the sides, one after
 * the other (Liang and Barsky 1984). */
static bool crop_edge_meets(const struct geojson_edge *edge, const double box[4])
{
    double from = 0, to = 1;
    for (int k = 0; k < 2; k++) {
        const double d = edge->to[k] - edge->from[k];
        const double low = box[k] - edge->from[k], high = box[k + 2] - edge->from[k];
        if (!(d != 0)) {
            if (low > 0 || high < 0)
                return false;
            continue;
        }
        from = fmax(from, fmin(low / d, high / d));
        to = fmin(to, fmax(low / d, high / d));
    }
    return from <= to;
}

enum err_code crop_box(const struct clip *c, const struct geo_origin *origin, const double min_m[3],
                       const double max_m[3], enum crop_side *out, struct err *e)
{
    double box[4] = {HUGE_VAL, HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
    for (int i = 0; i < 8; i++) {
        double lon, lat, h;
        const double at[3] = {i & 1 ? max_m[0] : min_m[0], i & 2 ? max_m[1] : min_m[1],
                              i & 4 ? max_m[2] : min_m[2]};
        enum err_code rc = geo_from_enu(origin, at, &lon, &lat, &h, e);
        if (rc)
            return rc;
        box[0] = fmin(box[0], lon - CROP_MARGIN_DEG);
        box[1] = fmin(box[1], lat - CROP_MARGIN_DEG);
        box[2] = fmax(box[2], lon + CROP_MARGIN_DEG);
        box[3] = fmax(box[3], lat + CROP_MARGIN_DEG);
    }
    *out = CROP_ACROSS;
    for (size_t i = 0; i < c->area.n; i++)
        if (crop_edge_meets(&c->area.edges[i], box))
            return ERR_OK;
    *out = geojson_holds(c->area.edges, c->area.n, box[0], box[1]) ? CROP_INSIDE : CROP_OUTSIDE;
    return ERR_OK;
}

struct crop {
    const struct clip *clip;
    struct store *store;
    const struct tree *tree;
    const struct store_tile *tiles;
    uint32_t start;
    bool one_document;
    size_t n_read;
    struct crop_node *node;
};

/* Of a tile across the border. */
static enum err_code crop_read(struct crop *c, const struct store_tile *tile, uint32_t *count,
                               struct err *e)
{
    struct gauss g = {0};
    *count = tile->count;
    if (c->n_read + tile->count > CROP_READ_MAX)
        return ERR_OK;
    c->n_read += tile->count;
    enum err_code rc = store_read_gauss(c->store, tile->key, &g, e);
    if (!rc)
        rc = clip_rows(c->clip, &store_info(c->store)->origin, &g, e);
    if (!rc)
        *count = (uint32_t)g.n;
    gauss_free(&g);
    return rc;
}

/* side: where the node above lies, and this one with it unless that lies across. */
static enum err_code crop_walk(struct crop *c, uint32_t index, enum crop_side side, struct err *e)
{
    const struct tree_node v = tree_node(c->tree, index);
    const struct geo_origin *origin = &store_info(c->store)->origin;
    const bool elsewhere = c->one_document && v.document && index != c->start;
    struct crop_node *n = &c->node[index];
    enum err_code rc = ERR_OK;
    if (side == CROP_ACROSS) {
        const struct tree_bounds b = tree_bounds(c->tree, index);
        rc = crop_box(c->clip, origin, b.min_enu_m, b.max_enu_m, &side, e);
    }
    if (rc || side == CROP_OUTSIDE)
        return rc;
    if (v.tile != TREE_NONE) {
        const struct store_tile *tile = &c->tiles[v.tile];
        const struct store_shape x = index_bounds(c->tree->index, v.tile);
        enum crop_side own = side;
        if (side == CROP_ACROSS)
            rc = crop_box(c->clip, origin, x.min_enu_m, x.max_enu_m, &own, e);
        n->count = own == CROP_OUTSIDE ? 0 : tile->count;
        n->across = own == CROP_ACROSS;
        if (!rc && own == CROP_ACROSS && !elsewhere)
            rc = crop_read(c, tile, &n->count, e);
    }
    n->any = n->count > 0 || elsewhere;
    for (uint32_t i = 0; !rc && !elsewhere && i < v.child_count; i++) {
        const uint32_t child = c->tree->children[v.child_first + i];
        rc = crop_walk(c, child, side, e); /* at most KEY_ZOOM_MAX + 1 deep */
        n->any = n->any || c->node[child].any;
    }
    return rc;
}

enum err_code crop_tiles(const struct clip *clip, struct store *s, uint32_t start,
                         bool one_document, struct crop_node **node, struct err *e)
{
    size_t n;
    struct crop c = {.clip = clip,
                     .store = s,
                     .tree = store_tree(s),
                     .tiles = store_tiles(s, &n),
                     .start = start,
                     .one_document = one_document};
    *node = NULL;
    c.node = mem_array(c.tree->n_nodes ? c.tree->n_nodes : 1, sizeof *c.node);
    if (!c.node)
        return err_set(e, ERR_MEM, "crop: out of memory for %zu tiles", n);
    enum err_code rc = crop_walk(&c, start, CROP_ACROSS, e);
    if (rc)
        mem_free(c.node);
    else
        *node = c.node;
    return rc;
}
