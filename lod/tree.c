/* The tiles of a store as a tree, in three passes over the sorted index. First each tile finds its
 * nearest existing ancestor. Then bounds are united from the leaves up; parents come first, so this
 * pass runs backwards. Last, geometric errors are made strictly smaller than those above.
 *
 * Large tilesets are cut into documents of about TREE_DOCUMENT_NODES. All parts of a document begin
 * at the same depth: the first below which every part fits one document, or the last that fits this
 * document. This avoids many small documents and needless chains of them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/tree.h"

#include <math.h>
#include <string.h>

#include "lod/key.h"

uint32_t tree_find(const struct store_tile *tiles, size_t n, struct key k)
{
    size_t lo = 0, hi = n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        int c = key_compare(tiles[mid].key, k);
        if (c == 0)
            return (uint32_t)mid;
        if (c < 0)
            lo = mid + 1;
        else
            hi = mid;
    }
    return TREE_NONE;
}

/* *near: what the tile before has. Mostly this one has the same, or the next. */
static uint32_t tree_ancestor(const struct store_tile *tiles, size_t n, struct key k,
                              uint32_t *near)
{
    while (k.z > 0) {
        k = key_parent(k);
        uint32_t i = TREE_NONE;
        for (size_t at = *near; at < n && at < (size_t)*near + 2 && i == TREE_NONE; at++)
            i = key_compare(tiles[at].key, k) ? TREE_NONE : (uint32_t)at;
        if (i == TREE_NONE)
            i = tree_find(tiles, n, k);
        if (i != TREE_NONE)
            return *near = i;
    }
    return TREE_NONE;
}

/* Fill the child slices from the parents; children come out ascending. */
static void tree_link(struct tree *t)
{
    for (size_t i = 0; i < t->n_nodes; i++)
        if (t->nodes[i].parent != TREE_NONE)
            t->nodes[t->nodes[i].parent].child_count++;
    uint32_t at = 0;
    for (size_t i = 0; i < t->n_nodes; i++) {
        t->nodes[i].child_first = at;
        at += t->nodes[i].child_count;
        t->nodes[i].child_count = 0;
    }
    for (size_t i = 0; i < t->n_nodes; i++) {
        if (t->nodes[i].parent == TREE_NONE)
            continue;
        struct tree_node *p = &t->nodes[t->nodes[i].parent];
        t->children[p->child_first + p->child_count++] = (uint32_t)i;
    }
}

/* Unite bounds along the edge from `c` to its parent `p`. */
static void tree_unite(struct tree_bounds *p, const struct tree_bounds *c)
{
    for (size_t k = 0; k < 3; k++) {
        p->min_enu_m[k] = fmin(p->min_enu_m[k], c->min_enu_m[k]);
        p->max_enu_m[k] = fmax(p->max_enu_m[k], c->max_enu_m[k]);
        p->core_min_enu_m[k] = fmin(p->core_min_enu_m[k], c->core_min_enu_m[k]);
        p->core_max_enu_m[k] = fmax(p->core_max_enu_m[k], c->core_max_enu_m[k]);
    }
    p->sigma_max_m = fmax(p->sigma_max_m, c->sigma_max_m);
}

/* A tile's own error, or less: errors fall towards the leaves because a tile's is cut to its
 * parent's, never because a parent's is raised. A few tiles at the border of a scene hold a handful
 * of background Gaussians of many metres; raised by those, everything above them would be refined
 * from kilometres away, and the dense tiles beside them with it. */
static double tree_error(const struct tree *t, const struct tree_node *v, double own_m)
{
    if (v->parent == TREE_NONE)
        return own_m;
    return fmin(own_m, t->nodes[v->parent].geometric_error_m / TREE_ERROR_GROWTH);
}

static void tree_measure(struct tree *t, const struct store_tile *tiles, size_t n)
{
    for (size_t i = n; i-- > 0;)
        if (t->nodes[i].parent != TREE_NONE) {
            const struct tree_bounds own = tree_bounds(t, (uint32_t)i);
            tree_unite(&t->bounds[t->nodes[t->nodes[i].parent].bounds], &own);
        }
    /* A root without content draws nothing, so its own error is that of an empty picture: twice the
     * tiles'. */
    if (t->root == n)
        for (size_t i = 0; i < n; i++)
            if (t->nodes[i].parent == n)
                t->nodes[n].geometric_error_m =
                    fmax(t->nodes[n].geometric_error_m, 2.0 * tiles[i].geometric_error_m);
    for (size_t i = 0; i < n; i++)
        t->nodes[i].geometric_error_m = tree_error(t, &t->nodes[i], tiles[i].geometric_error_m);
    for (size_t i = 0; i < n; i++)
        if (t->nodes[i].child_count == 0)
            t->nodes[i].geometric_error_m = 0.0;
}

/* End the document that begins at `root`: mark the nodes at which others begin. queue [n_nodes]. */
static void tree_divide_at(struct tree *t, uint32_t root, uint32_t *queue)
{
    size_t lo = 0, hi = 1; /* of the deepest level that is in */
    queue[0] = root;
    for (;;) {
        size_t n_next = 0, largest = 0;
        for (size_t i = lo; i < hi; i++) {
            n_next += t->nodes[queue[i]].child_count;
            largest = t->nodes[queue[i]].n_below > largest ? t->nodes[queue[i]].n_below : largest;
        }
        if (lo && (largest <= TREE_DOCUMENT_NODES || hi + n_next > TREE_DOCUMENT_NODES))
            break;
        size_t end = hi;
        for (size_t i = lo; i < hi; i++)
            for (uint32_t c = 0; c < t->nodes[queue[i]].child_count; c++)
                queue[end++] = t->children[t->nodes[queue[i]].child_first + c];
        lo = hi;
        hi = end;
    }
    for (size_t i = lo; i < hi; i++)
        t->nodes[queue[i]].document = t->nodes[queue[i]].n_below > TREE_DOCUMENT_FEW;
}

static enum err_code tree_divide(struct tree *t, size_t n_tiles, struct err *e)
{
    for (size_t i = 0; i < t->n_nodes; i++)
        t->nodes[i].n_below = 1;
    for (size_t i = n_tiles; i-- > 0;) /* children come after their parents, but for a root's */
        if (t->nodes[i].parent != TREE_NONE)
            t->nodes[t->nodes[i].parent].n_below += t->nodes[i].n_below;
    if (t->n_nodes <= TREE_DOCUMENT_NODES)
        return ERR_OK;
    uint32_t *queue = mem_array(t->n_nodes, sizeof *queue);
    if (!queue)
        return err_set(e, ERR_MEM, "tree: out of memory for %zu tiles", n_tiles);
    tree_divide_at(t, t->root, queue);
    for (size_t i = 0; i < n_tiles; i++)
        if (t->nodes[i].document && t->nodes[i].n_below > TREE_DOCUMENT_NODES)
            tree_divide_at(t, (uint32_t)i, queue);
    mem_free(queue);
    return ERR_OK;
}

/* Of one tile alone; NULL: of none. */
static struct tree_bounds tree_bounds_of(const struct store_tile *t)
{
    struct tree_bounds b = {.sigma_max_m = t ? t->sigma_max_m : 0.0};
    bool known = false;
    for (size_t k = 0; k < 3; k++) {
        known = known || (t && (t->core_min_enu_m[k] != 0.0 || t->core_max_enu_m[k] != 0.0));
        b.min_enu_m[k] = b.core_min_enu_m[k] = t ? t->min_enu_m[k] : HUGE_VAL;
        b.max_enu_m[k] = b.core_max_enu_m[k] = t ? t->max_enu_m[k] : -HUGE_VAL;
    }
    if (known) {
        memcpy(b.core_min_enu_m, t->core_min_enu_m, sizeof b.core_min_enu_m);
        memcpy(b.core_max_enu_m, t->core_max_enu_m, sizeof b.core_max_enu_m);
    }
    return b;
}

struct tree_bounds tree_bounds(const struct tree *t, uint32_t node)
{
    const struct tree_node *v = &t->nodes[node];
    return v->child_count ? t->bounds[v->bounds]
                          : tree_bounds_of(v->tile == TREE_NONE ? NULL : &t->tiles[v->tile]);
}

/* Those of their own tiles, for the nodes that have children. */
static enum err_code tree_add_bounds(struct tree *t, struct err *e)
{
    size_t n = 0;
    for (size_t i = 0; i < t->n_nodes; i++)
        n += t->nodes[i].child_count > 0;
    if (!(t->bounds = mem_array(n + 1, sizeof *t->bounds)))
        return err_set(e, ERR_MEM, "tree: out of memory for %zu tiles", t->n_nodes);
    n = 0;
    for (size_t i = 0; i < t->n_nodes; i++) {
        struct tree_node *v = &t->nodes[i];
        if (!v->child_count)
            continue;
        t->bounds[n] = tree_bounds_of(v->tile == TREE_NONE ? NULL : &t->tiles[v->tile]);
        v->bounds = (uint32_t)n++;
    }
    return ERR_OK;
}

enum err_code tree_build(const struct store_tile *tiles, size_t n, struct tree *out, struct err *e)
{
    *out = (struct tree){.root = TREE_NONE};
    if (n == 0)
        return ERR_OK;
    if (n >= TREE_NONE)
        return err_set(e, ERR_LIMIT, "tree: %zu tiles, at most 2^32 - 2", n);
    struct tree t = {.tiles = tiles,
                     .nodes = mem_array(n + 1, sizeof *t.nodes),
                     .children = mem_array(n + 1, sizeof *t.children),
                     .n_nodes = n,
                     .root = TREE_NONE};
    if (!t.nodes || !t.children) {
        tree_free(&t);
        return err_set(e, ERR_MEM, "tree: out of memory for %zu tiles", n);
    }
    size_t roots = 0;
    uint32_t near = 0;
    for (size_t i = 0; i < n; i++) {
        struct tree_node *v = &t.nodes[i];
        v->tile = (uint32_t)i;
        v->parent = tree_ancestor(tiles, n, tiles[i].key, &near);
        if (v->parent == TREE_NONE && roots++ == 0)
            t.root = (uint32_t)i;
    }
    if (roots > 1) {
        t.root = (uint32_t)n;
        t.n_nodes = n + 1;
        t.nodes[n] = (struct tree_node){.tile = TREE_NONE, .parent = TREE_NONE};
        for (size_t i = 0; i < n; i++)
            if (t.nodes[i].parent == TREE_NONE)
                t.nodes[i].parent = t.root;
    }
    tree_link(&t);
    enum err_code rc = tree_add_bounds(&t, e);
    if (!rc) {
        tree_measure(&t, tiles, n);
        rc = tree_divide(&t, n, e);
    }
    if (rc)
        tree_free(&t);
    else
        *out = t;
    return rc;
}

void tree_free(struct tree *t)
{
    mem_free(t->nodes);
    mem_free(t->bounds);
    mem_free(t->children);
    *t = (struct tree){.root = TREE_NONE};
}
