/* Level selection: a cut through the tree, so that the tiles cover the scene exactly once.
 *
 * The cut starts at the root. The tile with the largest screen error is refined next, until all
 * errors are small enough or the budget of Gaussians is used up. The screen error is
 * geometric_error * f / d, as in 3D Tiles clients. d is the distance to the tile's core, which
 * holds nearly all of it, instead of to the box around all splats. Our tilesets contain the core
 * and our viewer uses it. Other clients know only the box; they may show a finer level than the
 * server's picture, never a coarser one. The distance metric is that of the CityGaussian family:
 * horizontal distance against one threshold a level.
 *
 * A tile is left out only if no splat in it can touch the picture: frustum.h.
 *
 * The same input gives the same cut, so pictures can be cached. The caller keeps the last cut,
 * which prevents flicker of a moving camera.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "lod/choose/frustum.h"
#include "lod/choose/pick.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

#define PICK_ERROR_PX 1.0 /* default: one pixel of median sigma */

struct pick_entry { /* of the heap: the node with the largest error on top */
    double error;
    uint32_t node;
};

struct pick {
    const struct store_tile *tiles;
    const struct tree *tree;
    const struct pick_options *o;
    struct frustum frustum;
    double eye[3], focal_px, limit;
    uint8_t zoom_max;
    struct pick_entry *heap;
    size_t n_heap;
    uint64_t total, bytes; /* Gaussians and payload bytes of the heap and of what was chosen */
    bool *refined;         /* [n_nodes] in the cut before; NULL: there was none */
};

/* Distance from the eye to where nearly all of the tile is, over the axes [0, n_axes). */
static double pick_distance(const struct pick *p, uint32_t node, size_t n_axes)
{
    const struct tree_bounds b = tree_bounds(p->tree, node);
    double sum = 0.0;
    for (size_t k = 0; k < n_axes; k++) {
        double d =
            fmax(fmax(b.core_min_enu_m[k] - p->eye[k], p->eye[k] - b.core_max_enu_m[k]), 0.0);
        sum += d * d;
    }
    return sqrt(sum);
}

/* How much the node wants to be refined; above 1 it must be. Leaves never do. */
static double pick_error(const struct pick *p, uint32_t node)
{
    const struct tree_node v = tree_node(p->tree, node);
    if (v.child_count == 0)
        return 0.0;
    if (v.tile == TREE_NONE || p->o->no_lod)
        return HUGE_VAL;
    if (p->o->orthographic)
        return v.geometric_error_m * p->focal_px / p->limit;
    if (p->o->metric == PICK_SCREEN)
        return v.geometric_error_m * p->focal_px / (pick_distance(p, node, 3) * p->limit);
    /* Threshold i holds for the level i below the finest; past the last one tiles are always
     * refined. */
    uint8_t below = (uint8_t)(p->zoom_max - p->tiles[v.tile].key.z);
    double far = below >= 1 && below <= 8 ? p->o->distance_m[below - 1] : 0.0;
    if (!(far > 0.0))
        return HUGE_VAL;
    double d = pick_distance(p, node, 2);
    return d > 0.0 ? far / d : HUGE_VAL;
}

static bool pick_above(const struct pick_entry *a, const struct pick_entry *b)
{
    return a->error != b->error ? a->error > b->error : a->node < b->node;
}

static void pick_push(struct pick *p, uint32_t node)
{
    struct pick_entry x = {.error = pick_error(p, node), .node = node};
    size_t i = p->n_heap++;
    for (; i > 0 && pick_above(&x, &p->heap[(i - 1) / 2]); i = (i - 1) / 2)
        p->heap[i] = p->heap[(i - 1) / 2];
    p->heap[i] = x;
}

static struct pick_entry pick_pop(struct pick *p)
{
    struct pick_entry top = p->heap[0], x = p->heap[--p->n_heap];
    size_t i = 0;
    for (;;) {
        size_t c = 2 * i + 1;
        if (c + 1 < p->n_heap && pick_above(&p->heap[c + 1], &p->heap[c]))
            c++;
        if (c >= p->n_heap || !pick_above(&p->heap[c], &x))
            break;
        p->heap[i] = p->heap[c];
        i = c;
    }
    p->heap[i] = x;
    return top;
}

/* Add (or take away) a node to what is drawn. */
static void pick_account(const struct pick *p, uint32_t node, int sign, uint64_t *total,
                         uint64_t *bytes)
{
    uint32_t tile = tree_node(p->tree, node).tile;
    if (tile == TREE_NONE)
        return;
    *total += sign > 0 ? p->tiles[tile].count : 0 - (uint64_t)p->tiles[tile].count;
    *bytes += sign > 0 ? p->tiles[tile].bytes : 0 - (uint64_t)p->tiles[tile].bytes;
}

static bool pick_node_visible(const struct pick *p, uint32_t node)
{
    const struct tree_bounds b = tree_bounds(p->tree, node);
    return frustum_sees(&p->frustum, b.min_enu_m, b.max_enu_m, b.sigma_max_m);
}

/* Replace the node by its visible children, unless that would break a budget. */
static bool pick_refine(struct pick *p, uint32_t node)
{
    const struct tree_node v = tree_node(p->tree, node);
    const uint32_t *child = p->tree->children + v.child_first;
    struct pick_entry *seen = p->heap + p->n_heap; /* behind the heap there is room for all */
    size_t n = 0;
    uint64_t total = p->total, bytes = p->bytes;
    pick_account(p, node, -1, &total, &bytes);
    for (uint32_t i = 0; i < v.child_count; i++) {
        if (!pick_node_visible(p, child[i]))
            continue;
        seen[n++].node = child[i];
        pick_account(p, child[i], 1, &total, &bytes);
    }
    uint64_t most = p->o->max_gaussians, most_bytes = p->o->max_bytes;
    if (v.tile != TREE_NONE && ((most && total > most && total > p->total) ||
                                (most_bytes && bytes > most_bytes && bytes > p->bytes)))
        return false;
    for (size_t i = 0; i < n; i++) /* each takes the place that it stood in, or one before */
        pick_push(p, seen[i].node);
    p->total = total;
    p->bytes = bytes;
    return true;
}

/* What stood refined in the cut before: everything above its tiles. */
static enum err_code pick_remember(struct pick *p, size_t n_tiles, struct err *e)
{
    const struct tree *t = p->tree;
    if (!(p->o->hysteresis > 0.0) || !p->o->before)
        return ERR_OK;
    if (p->o->hysteresis > 0.5)
        return err_set(e, ERR_ARG, "pick: a hysteresis of %g, at most 0.5", p->o->hysteresis);
    p->refined = mem_array(t->n_nodes, sizeof *p->refined);
    if (!p->refined)
        return err_set(e, ERR_MEM, "pick: out of memory for %zu tiles", t->n_nodes);
    for (size_t i = 0; i < p->o->n_before; i++) {
        uint32_t at = p->o->before[i];
        if (at >= n_tiles)
            return err_set(e, ERR_ARG, "pick: the cut before has tile %u of %zu", at, n_tiles);
        for (at = tree_node(t, at).parent; at != TREE_NONE && !p->refined[at];
             at = tree_node(t, at).parent)
            p->refined[at] = true;
    }
    return ERR_OK;
}

static bool pick_too_coarse(const struct pick *p, const struct pick_entry *x)
{
    return x->error > (p->refined && p->refined[x->node] ? 1.0 - p->o->hysteresis : 1.0);
}

/* The tiles of a set of bits, ascending. */
static size_t pick_list(const uint64_t *set, size_t n_tiles, uint32_t *out)
{
    size_t n = 0;
    for (size_t w = 0; w <= n_tiles / 64; w++)
        for (uint64_t bits = set[w], i = 0; bits; bits >>= 1, i++)
            if (bits & 1)
                out[n++] = (uint32_t)(64 * w + i);
    return n;
}

enum err_code pick_select(const struct tree *t, const struct camera *cam,
                          const struct pick_options *o, uint32_t *out, size_t *n_out, struct err *e)
{
    static const struct pick_options defaults = {0};
    struct pick p = {.tree = t, .o = o ? o : &defaults};
    *n_out = 0;
    if (t->n_nodes == 0)
        return ERR_OK;
    p.tiles = t->index->tiles;
    if (!(cam->fx_px > 0.0 && cam->fy_px > 0.0 && cam->width_px > 0 && cam->height_px > 0))
        return err_set(e, ERR_ARG, "pick: the camera has no focal length or no pixels");
    p.heap = mem_array(t->n_nodes, sizeof *p.heap); /* a node enters at most once */
    uint64_t *set = mem_array(t->n_nodes / 64 + 1, sizeof *set);
    if (!p.heap || !set) {
        mem_free(p.heap);
        mem_free(set);
        return err_set(e, ERR_MEM, "pick: out of memory for %zu tiles", t->n_nodes);
    }
    p.limit = STORE_PX_PER_SIGMA * (p.o->error_px > 0.0 ? p.o->error_px : PICK_ERROR_PX);
    if (p.o->orthographic)
        frustum_make_orthographic(cam, &p.frustum);
    else
        frustum_make(cam, &p.frustum);
    camera_center(cam, p.eye);
    p.focal_px = fmax(cam->fx_px, cam->fy_px);
    /* Nodes ascend with zoom but for a root without content, which stands last. */
    size_t last = tree_node(t, t->n_nodes - 1).tile == TREE_NONE ? t->n_nodes - 2 : t->n_nodes - 1;
    p.zoom_max = p.tiles[last].key.z;
    enum err_code rc = pick_remember(&p, last + 1, e);
    if (!rc && pick_node_visible(&p, t->root)) {
        pick_account(&p, t->root, 1, &p.total, &p.bytes);
        pick_push(&p, t->root);
    }
    while (p.n_heap > 0) {
        struct pick_entry top = pick_pop(&p);
        const struct tree_node v = tree_node(t, top.node);
        if (v.child_count > 0 && pick_too_coarse(&p, &top) && pick_refine(&p, top.node))
            continue;
        if (v.tile == TREE_NONE)
            continue;
        const struct store_shape own = index_bounds(t->index, v.tile);
        if (frustum_sees(&p.frustum, own.min_enu_m, own.max_enu_m, own.sigma_max_m))
            set[v.tile / 64] |= UINT64_C(1) << v.tile % 64;
        else
            pick_account(&p, top.node, -1, &p.total, &p.bytes);
    }
    if (!rc)
        *n_out = pick_list(set, last + 1, out);
    mem_free(p.heap);
    mem_free(p.refined);
    mem_free(set);
    return rc;
}

enum err_code pick_tiles(const struct store *s, const struct camera *cam,
                         const struct pick_options *o, uint32_t *out, size_t *n_out, struct err *e)
{
    return pick_select(store_tree(s), cam, o, out, n_out, e);
}
