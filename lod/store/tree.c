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
#include "lod/store/tree.h"

#include <math.h>
#include <string.h>

#include "lod/store/key.h"

/* *near: what the tile before has. Mostly this one has the same, or the next. */
static uint32_t tree_ancestor(const struct index *x, struct key k, uint32_t *near)
{
    while (k.z > 0) {
        k = key_parent(k);
        uint32_t i = TREE_NONE;
        for (size_t at = *near; at < x->n && at < (size_t)*near + 2 && i == TREE_NONE; at++)
            i = key_compare(x->tiles[at].key, k) ? TREE_NONE : (uint32_t)at;
        if (i == TREE_NONE)
            i = index_find(x, k);
        if (i != TREE_NONE)
            return *near = i;
    }
    return TREE_NONE;
}

struct tree_node tree_node(const struct tree *t, size_t node)
{
    const struct tree_place *p = &t->places[node];
    struct tree_node v = {
        .tile = node < t->n_tiles ? (uint32_t)node : TREE_NONE, .parent = p->parent, .n_below = 1};
    if (p->inner == TREE_NONE)
        return v;
    const struct tree_inner *in = &t->inner[p->inner];
    v.child_first = in->child_first;
    v.child_count = in->child_count;
    v.n_below = in->n_below;
    v.geometric_error_m = in->geometric_error_m;
    v.document = in->document;
    return v;
}

bool tree_leaf(const struct tree *t, size_t node)
{
    return t->places[node].inner == TREE_NONE;
}

/* Of a node with children. */
static struct tree_inner *tree_inner(const struct tree *t, uint32_t node)
{
    return &t->inner[t->places[node].inner];
}

/* Fill the child slices from the parents; children come out ascending. Until a node's place among
 * those with children is known, `inner` counts them. */
static enum err_code tree_link(struct tree *t, struct err *e)
{
    size_t n = 0;
    for (size_t i = 0; i < t->n_nodes; i++)
        if (t->places[i].parent != TREE_NONE)
            n += t->places[t->places[i].parent].inner++ == 0;
    if (!(t->inner = mem_array(n + 1, sizeof *t->inner)))
        return err_set(e, ERR_MEM, "tree: out of memory for %zu tiles", t->n_tiles);
    n = 0;
    uint32_t at = 0;
    for (size_t i = 0; i < t->n_nodes; i++) {
        struct tree_place *p = &t->places[i];
        const uint32_t count = p->inner;
        p->inner = count ? (uint32_t)n : TREE_NONE;
        if (count)
            t->inner[n++].child_first = at;
        at += count;
    }
    for (size_t i = 0; i < t->n_nodes; i++) {
        if (t->places[i].parent == TREE_NONE)
            continue;
        struct tree_inner *p = tree_inner(t, t->places[i].parent);
        t->children[p->child_first + p->child_count++] = (uint32_t)i;
    }
    return ERR_OK;
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
static double tree_error(const struct tree *t, uint32_t parent, double own_m)
{
    if (parent == TREE_NONE)
        return own_m;
    return fmin(own_m, tree_inner(t, parent)->geometric_error_m / TREE_ERROR_GROWTH);
}

static double tree_own_error(const struct tree *t, size_t i)
{
    return index_shape(t->index, i).geometric_error_m;
}

static void tree_measure(struct tree *t)
{
    const size_t n = t->n_tiles;
    for (size_t i = n; i-- > 0;) {
        const uint32_t up = t->places[i].parent;
        const uint32_t to = up == TREE_NONE ? TREE_NONE : tree_inner(t, up)->bounds;
        if (to == TREE_NONE)
            continue;
        const struct tree_bounds own = tree_bounds(t, (uint32_t)i);
        tree_unite(&t->bounds[to], &own);
    }
    /* A root without content draws nothing, so its own error is that of an empty picture: twice the
     * tiles'. */
    if (t->root == n) {
        struct tree_inner *root = tree_inner(t, t->root);
        for (uint32_t c = 0; c < root->child_count; c++)
            root->geometric_error_m =
                fmax(root->geometric_error_m,
                     2.0 * tree_own_error(t, t->children[root->child_first + c]));
    }
    for (uint32_t i = 0; i < n; i++)
        if (!tree_leaf(t, i))
            tree_inner(t, i)->geometric_error_m =
                tree_error(t, t->places[i].parent, tree_own_error(t, i));
}

/* End the document that begins at `root`: mark the nodes at which others begin. The queue has room
 * for TREE_DOCUMENT_NODES, and for a node with its children. */
static void tree_divide_at(struct tree *t, uint32_t root, uint32_t *queue)
{
    size_t lo = 0, hi = 1; /* of the deepest level that is in */
    queue[0] = root;
    for (;;) {
        size_t n_next = 0, largest = 0;
        for (size_t i = lo; i < hi; i++) {
            const struct tree_node v = tree_node(t, queue[i]);
            n_next += v.child_count;
            largest = v.n_below > largest ? v.n_below : largest;
        }
        if (lo && (largest <= TREE_DOCUMENT_NODES || hi + n_next > TREE_DOCUMENT_NODES))
            break;
        size_t end = hi;
        for (size_t i = lo; i < hi; i++) {
            const struct tree_node v = tree_node(t, queue[i]);
            for (uint32_t c = 0; c < v.child_count; c++)
                queue[end++] = t->children[v.child_first + c];
        }
        lo = hi;
        hi = end;
    }
    for (size_t i = lo; i < hi; i++)
        if (!tree_leaf(t, queue[i])) {
            struct tree_inner *in = tree_inner(t, queue[i]);
            in->document = in->n_below > TREE_DOCUMENT_FEW;
        }
}

static enum err_code tree_divide(struct tree *t, struct err *e)
{
    size_t widest = TREE_DOCUMENT_NODES;
    for (size_t i = 0; i < t->n_nodes; i++)
        if (t->places[i].inner != TREE_NONE) {
            struct tree_inner *in = &t->inner[t->places[i].inner];
            in->n_below = 1;
            widest = in->child_count > widest ? in->child_count : widest;
        }
    for (size_t i = t->n_tiles; i-- > 0;) /* children come after their parents, but for a root's */
        if (t->places[i].parent != TREE_NONE) {
            struct tree_inner *up = tree_inner(t, t->places[i].parent);
            up->n_below = (up->n_below + tree_node(t, (uint32_t)i).n_below) & INT32_MAX;
        }
    if (t->n_nodes <= TREE_DOCUMENT_NODES)
        return ERR_OK;
    uint32_t *queue = mem_array(widest + 1, sizeof *queue);
    if (!queue)
        return err_set(e, ERR_MEM, "tree: out of memory for %zu tiles", t->n_tiles);
    tree_divide_at(t, t->root, queue);
    for (uint32_t i = 0; i < t->n_tiles; i++) {
        const struct tree_node v = tree_node(t, i);
        if (v.document && v.n_below > TREE_DOCUMENT_NODES)
            tree_divide_at(t, i, queue);
    }
    mem_free(queue);
    return ERR_OK;
}

/* Of one tile alone; NULL: of none. */
static struct tree_bounds tree_bounds_of(const struct store_shape *t)
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

static struct tree_bounds tree_bounds_alone(const struct tree *t, uint32_t node)
{
    if (node >= t->n_tiles)
        return tree_bounds_of(NULL);
    const struct store_shape own = index_bounds(t->index, node);
    return tree_bounds_of(&own);
}

struct tree_bounds tree_bounds(const struct tree *t, uint32_t node)
{
    const struct tree_place *p = &t->places[node];
    const struct tree_inner *in = p->inner == TREE_NONE ? NULL : &t->inner[p->inner];
    if (in && in->bounds != TREE_NONE)
        return t->bounds[in->bounds];
    struct tree_bounds b = tree_bounds_alone(t, node);
    for (uint32_t c = in ? in->child_count : 0; c-- > 0;) {
        const struct tree_bounds below = tree_bounds_alone(t, t->children[in->child_first + c]);
        tree_unite(&b, &below);
    }
    return b;
}

void tree_extent(const struct tree *t, double min_enu_m[3], double max_enu_m[3])
{
    const double less = (0.96 - 0.9) / (2 * 0.96); /* a core is from 2 to 98 % */
    struct tree_bounds b = {0};
    if (t->root != TREE_NONE) {
        const struct tree_node v = tree_node(t, t->root);
        b = tree_bounds_alone(t, t->root);
        for (uint32_t c = 0; v.tile == TREE_NONE && c < v.child_count; c++) {
            const struct tree_bounds top = tree_bounds_alone(t, t->children[v.child_first + c]);
            tree_unite(&b, &top);
        }
    }
    for (int a = 0; a < 3; a++) {
        const double cut = less * (b.core_max_enu_m[a] - b.core_min_enu_m[a]);
        min_enu_m[a] = b.core_min_enu_m[a] + cut;
        max_enu_m[a] = b.core_max_enu_m[a] - cut;
    }
}

/* Are the node's bounds cheap to unite: has it few children, none of which has any? */
static bool tree_is_low(const struct tree *t, const struct tree_inner *in)
{
    enum { FEW = 4 };
    bool low = in->child_count <= FEW;
    for (uint32_t c = 0; low && c < in->child_count; c++)
        low = tree_leaf(t, t->children[in->child_first + c]);
    return low;
}

/* Those of their own tiles, for the nodes that keep some. */
static enum err_code tree_add_bounds(struct tree *t, struct err *e)
{
    size_t n = 0;
    for (uint32_t i = 0; i < t->n_nodes; i++)
        n += !tree_leaf(t, i) && !tree_is_low(t, tree_inner(t, i));
    if (!(t->bounds = mem_uninit(n + 1, sizeof *t->bounds)))
        return err_set(e, ERR_MEM, "tree: out of memory for %zu tiles", t->n_nodes);
    n = 0;
    for (uint32_t i = 0; i < t->n_nodes; i++) {
        if (tree_leaf(t, i))
            continue;
        struct tree_inner *in = tree_inner(t, i);
        in->bounds = tree_is_low(t, in) ? TREE_NONE : (uint32_t)n++;
        if (in->bounds != TREE_NONE)
            t->bounds[in->bounds] = tree_bounds_alone(t, i);
    }
    return ERR_OK;
}

enum err_code tree_build(const struct index *x, struct tree *out, struct err *e)
{
    const size_t n = x->n;
    *out = (struct tree){.root = TREE_NONE};
    if (n == 0)
        return ERR_OK;
    if (n >= INT32_MAX)
        return err_set(e, ERR_LIMIT, "tree: %zu tiles, at most 2^31 - 2", n);
    struct tree t = {.index = x,
                     .places = mem_array(n + 1, sizeof *t.places),
                     .children = mem_uninit(n + 1, sizeof *t.children),
                     .n_tiles = n,
                     .n_nodes = n,
                     .root = TREE_NONE};
    if (!t.places || !t.children) {
        tree_free(&t);
        return err_set(e, ERR_MEM, "tree: out of memory for %zu tiles", n);
    }
    size_t roots = 0;
    uint32_t near = 0;
    for (size_t i = 0; i < n; i++) {
        t.places[i].parent = tree_ancestor(x, x->tiles[i].key, &near);
        if (t.places[i].parent == TREE_NONE && roots++ == 0)
            t.root = (uint32_t)i;
    }
    if (roots > 1) {
        t.root = (uint32_t)n;
        t.n_nodes = n + 1;
        t.places[n].parent = TREE_NONE;
        for (size_t i = 0; i < n; i++)
            if (t.places[i].parent == TREE_NONE)
                t.places[i].parent = t.root;
    }
    enum err_code rc = tree_link(&t, e);
    if (!rc)
        rc = tree_add_bounds(&t, e);
    if (!rc) {
        tree_measure(&t);
        rc = tree_divide(&t, e);
    }
    if (rc)
        tree_free(&t);
    else
        *out = t;
    return rc;
}

void tree_free(struct tree *t)
{
    mem_free(t->places);
    mem_free(t->inner);
    mem_free(t->bounds);
    mem_free(t->children);
    *t = (struct tree){.root = TREE_NONE};
}
