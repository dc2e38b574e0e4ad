/* Streamed SOG for PlayCanvas' engine: see export_sog.h. lod-meta.json has a tree. Its leaves are
 * boxes, each with one run of Gaussians a level ("lods"). A run is a part of a chunk, and a chunk
 * is a SOG of about half a million Gaussians. Level 0 is the finest.
 *
 * Each leaf of the tile tree becomes a leaf there. A tile above several leaves is divided among
 * them by the means of its Gaussians, so that each box can change its level alone. Chunks are
 * filled level by level in the order of the tree, so each tile is read once and memory holds one
 * chunk.
 *
 * If a box lacks a level between others, a finer one is drawn. Above its coarsest level a box would
 * be empty. If the tops of the pyramid lie at different zooms, levels therefore end at the lowest
 * top.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/tiles/export_sog.h"

#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/splat/axes.h"
#include "codec/splat/sog.h"
#include "core/outdir.h"
#include "core/splat/camera.h"
#include "core/splat/gauss.h"
#include "lod/store/bake.h"
#include "lod/store/locate.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

enum { EXPORT_SOG_CHUNK = 512 << 10, EXPORT_SOG_LEVELS = KEY_ZOOM_MAX + 1 };

struct export_sog_run { /* of a leaf at a level */
    uint32_t file;
    uint64_t offset, count; /* count 0: none */
};
struct export_sog {
    struct store *s;
    const struct store_tile *tiles;
    const struct tree *tree;
    const float *image;
    const char *dir;
    struct locate locate;
    uint32_t *first; /* [n_nodes] leaves before a node, in the order of the tree */
    size_t n_leaves, n_levels;
    double (*box)[6];           /* [n_leaves] min, max; in SOG's axes */
    struct export_sog_run *run; /* [n_leaves][n_levels] */
    struct gauss chunk;
    size_t level, n_chunks; /* of the level that is being written */
    json_t *files;
    uint64_t count[EXPORT_SOG_LEVELS];
};

/* ---- the tree ---- */

static bool export_sog_is_leaf(const struct export_sog *x, uint32_t node)
{
    return tree_leaf(x->tree, node);
}

/* Number the leaves below a node. */
static void export_sog_number(struct export_sog *x, uint32_t node)
{
    const struct tree_node n = tree_node(x->tree, node);
    x->first[node] = (uint32_t)x->n_leaves;
    x->n_leaves += !n.child_count;
    for (uint32_t i = 0; i < n.child_count; i++)
        export_sog_number(x, x->tree->children[n.child_first + i]);
}

static size_t export_sog_count_levels(const struct export_sog *x)
{
    const uint8_t finest = store_info(x->s)->zoom_max;
    const struct tree_node root = tree_node(x->tree, x->tree->root);
    uint8_t top = root.tile == TREE_NONE ? 0 : x->tiles[root.tile].key.z;
    for (uint32_t i = 0; root.tile == TREE_NONE && i < root.child_count; i++) {
        const struct tree_node n = tree_node(x->tree, x->tree->children[root.child_first + i]);
        const uint8_t z = x->tiles[n.tile].key.z;
        top = z > top ? z : top;
    }
    return (size_t)(finest - top) + 1;
}

/* Its level, or n_levels: it is above all of them. A leaf above is of the coarsest. */
static size_t export_sog_level(const struct export_sog *x, uint32_t node)
{
    const uint32_t tile = tree_node(x->tree, node).tile;
    if (tile == TREE_NONE)
        return x->n_levels;
    const size_t level = (size_t)(store_info(x->s)->zoom_max - x->tiles[tile].key.z);
    return level >= x->n_levels && export_sog_is_leaf(x, node) ? x->n_levels - 1
           : level > x->n_levels                               ? x->n_levels
                                                               : level;
}

static double export_sog_far(const struct export_sog *x, uint32_t node, const double enu_m[3])
{
    const struct tree_bounds b = tree_bounds(x->tree, node);
    double sum = 0;
    for (int k = 0; k < 2; k++) {
        const double d = enu_m[k] - 0.5 * (b.min_enu_m[k] + b.max_enu_m[k]);
        sum += d * d;
    }
    return sum;
}

/* The leaf below a node that holds a place, else the nearest. */
static uint32_t export_sog_leaf(const struct export_sog *x, uint32_t node, struct key at,
                                const double enu_m[3])
{
    while (!export_sog_is_leaf(x, node)) {
        const struct tree_node n = tree_node(x->tree, node);
        uint32_t found = TREE_NONE;
        double far = (double)INFINITY;
        for (uint32_t i = 0; i < n.child_count; i++) {
            const uint32_t child = x->tree->children[n.child_first + i];
            const struct key k = x->tiles[tree_node(x->tree, child).tile].key;
            const unsigned down = (unsigned)(at.z - k.z);
            const double d =
                at.x >> down == k.x && at.y >> down == k.y ? -1 : export_sog_far(x, child, enu_m);
            if (found == TREE_NONE || d < far) {
                found = child;
                far = d;
            }
        }
        node = found;
    }
    return x->first[node];
}

/* ---- chunks ---- */

static enum err_code export_sog_flush(struct export_sog *x, struct err *e)
{
    char name[64], path[FILE_PATH_MAX];
    if (!x->chunk.n)
        return ERR_OK;
    snprintf(name, sizeof name, "%zu_%zu", x->level, x->n_chunks++);
    enum err_code rc = file_join(path, x->dir, name, e);
    axes_enu_to_gltf(&x->chunk);
    if (!rc)
        rc = sog_write(&x->chunk, x->chunk.sh_degree, path, e);
    snprintf(name + strlen(name), sizeof name - strlen(name), "/meta.json");
    json_array_append_new(x->files, json_string(name));
    const struct store_meta *m = store_info(x->s);
    gauss_free(&x->chunk);
    if (!rc)
        rc = gauss_alloc(&x->chunk, 0, m->sh_degree, 0, e);
    x->chunk.antialiased = m->antialiased;
    return rc;
}

/* Grow a leaf's box by a Gaussian out to one sigma, as PlayCanvas' own tool does. ENU is (x, z, -y)
 * of SOG's axes. */
static void export_sog_widen(double box[6], const struct gauss *g, size_t i)
{
    double quat[4], rot[9];
    for (size_t k = 0; k < 4; k++)
        quat[k] = (double)g->quat_wxyz[4 * i + k];
    camera_quat_to_rot(quat, rot);
    double lo[3], hi[3];
    for (int k = 0; k < 3; k++) {
        double reach = 0;
        for (int j = 0; j < 3; j++)
            reach += fabs(rot[3 * k + j]) * exp((double)g->scale_log[3 * i + (size_t)j]);
        const double at = (double)g->mean_m[3 * i + (size_t)k] + g->origin_enu_m[k];
        lo[k] = at - reach;
        hi[k] = at + reach;
    }
    const double out[6] = {lo[0], -hi[2], lo[1], hi[0], -lo[2], hi[1]};
    for (int k = 0; k < 3; k++) {
        box[k] = fmin(box[k], out[k]);
        box[3 + k] = fmax(box[3 + k], out[3 + k]);
    }
}

/* Rows order[n] of g are a leaf's at this level. */
static enum err_code export_sog_add(struct export_sog *x, uint32_t leaf, const struct gauss *g,
                                    const uint32_t *order, size_t n, struct err *e)
{
    struct export_sog_run *run = &x->run[leaf * x->n_levels + x->level];
    *run = (struct export_sog_run){(uint32_t)json_array_size(x->files), x->chunk.n, n};
    for (size_t i = 0; i < n; i++)
        export_sog_widen(x->box[leaf], g, order[i]);
    x->count[x->level] += n;
    enum err_code rc = gauss_append(&x->chunk, g, order, n, e);
    return !rc && x->chunk.n >= EXPORT_SOG_CHUNK ? export_sog_flush(x, e) : rc;
}

/* order: rows by leaf, each in its order; begin[n + 1]: where those of a leaf begin. */
static enum err_code export_sog_sort(const struct export_sog *x, uint32_t node,
                                     const struct gauss *g, uint32_t *leaf, uint32_t *order,
                                     size_t *begin, size_t n, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < g->n; i++) {
        struct key at = {0};
        double enu_m[3];
        for (int k = 0; k < 3; k++)
            enu_m[k] = g->origin_enu_m[k] + (double)g->mean_m[3 * i + (size_t)k];
        rc = n > 1 ? locate_key(&x->locate, enu_m, &at, e) : ERR_OK;
        leaf[i] = n > 1 && !rc ? export_sog_leaf(x, node, at, enu_m) - x->first[node] : 0;
        begin[leaf[i] + 1]++;
    }
    for (size_t k = 0; k < n; k++)
        begin[k + 1] += begin[k];
    for (size_t i = 0; !rc && i < g->n; i++)
        order[begin[leaf[i]]++] = (uint32_t)i;
    memmove(begin + 1, begin, n * sizeof *begin); /* they have moved on to their ends */
    begin[0] = 0;
    return rc;
}

static size_t export_sog_leaves(const struct export_sog *x, uint32_t node)
{
    const struct tree_node n = tree_node(x->tree, node);
    if (!n.child_count)
        return 1;
    const uint32_t last = x->tree->children[n.child_first + n.child_count - 1];
    return x->first[last] + export_sog_leaves(x, last) - x->first[node];
}

static enum err_code export_sog_tile(struct export_sog *x, uint32_t node, struct err *e)
{
    struct gauss g = {0};
    const size_t n = export_sog_leaves(x, node);
    enum err_code rc =
        bake_read(x->s, x->tiles[tree_node(x->tree, node).tile].key, x->image, &g, e);
    uint32_t *leaf = mem_array(g.n + 1, sizeof *leaf), *order = mem_array(g.n + 1, sizeof *order);
    size_t *begin = mem_array(n + 1, sizeof *begin);
    if (!rc && (!leaf || !order || !begin))
        rc = err_set(e, ERR_MEM, "export: out of memory");
    if (!rc)
        rc = export_sog_sort(x, node, &g, leaf, order, begin, n, e);
    for (size_t k = 0; !rc && k < n; k++)
        if (begin[k + 1] > begin[k])
            rc = export_sog_add(x, x->first[node] + (uint32_t)k, &g, order + begin[k],
                                begin[k + 1] - begin[k], e);
    mem_free(leaf);
    mem_free(order);
    mem_free(begin);
    gauss_free(&g);
    return rc;
}

/* The tiles of a level below a node, in the order of the tree. */
static enum err_code export_sog_walk(struct export_sog *x, uint32_t node, struct progress *p,
                                     size_t *done, struct err *e)
{
    const struct tree_node n = tree_node(x->tree, node);
    enum err_code rc = ERR_OK;
    if (export_sog_level(x, node) == x->level) {
        rc = export_sog_tile(x, node, e);
        progress_step(p, ++*done, NULL);
    }
    if (!rc && signals_stopping())
        rc = err_set(e, ERR_CANCEL, "stopped");
    for (uint32_t i = 0; !rc && i < n.child_count; i++)
        rc = export_sog_walk(x, x->tree->children[n.child_first + i], p, done, e);
    return rc;
}

/* ---- the document ---- */

static json_t *export_sog_box(const double box[6])
{
    return json_pack("{s:[f,f,f],s:[f,f,f]}", "min", box[0], box[1], box[2], "max", box[3], box[4],
                     box[5]);
}

/* NULL where nothing is below. box: around it. */
static json_t *export_sog_node(const struct export_sog *x, uint32_t node, double box[6])
{
    const struct tree_node n = tree_node(x->tree, node);
    json_t *list = n.child_count ? json_array() : json_object();
    const uint32_t leaf = x->first[node];
    for (int k = 0; k < 3; k++) {
        box[k] = n.child_count ? (double)INFINITY : x->box[leaf][k];
        box[3 + k] = n.child_count ? -(double)INFINITY : x->box[leaf][3 + k];
    }
    for (uint32_t i = 0; i < n.child_count; i++) {
        double own[6];
        json_t *child = export_sog_node(x, x->tree->children[n.child_first + i], own);
        if (!child)
            continue;
        json_array_append_new(list, child);
        for (int k = 0; k < 3; k++) {
            box[k] = fmin(box[k], own[k]);
            box[3 + k] = fmax(box[3 + k], own[3 + k]);
        }
    }
    for (size_t level = 0; !n.child_count && level < x->n_levels; level++) {
        const struct export_sog_run *run = &x->run[leaf * x->n_levels + level];
        char name[24];
        snprintf(name, sizeof name, "%zu", level);
        if (run->count)
            json_object_set_new(list, name,
                                json_pack("{s:I,s:I,s:I}", "file", (json_int_t)run->file, "offset",
                                          (json_int_t)run->offset, "count",
                                          (json_int_t)run->count));
    }
    if (!json_array_size(list) && !json_object_size(list)) {
        json_decref(list);
        return NULL;
    }
    return json_pack("{s:o,s:o}", "bound", export_sog_box(box), n.child_count ? "children" : "lods",
                     list);
}

static enum err_code export_sog_describe(struct export_sog *x, struct err *e)
{
    double box[6];
    char path[FILE_PATH_MAX];
    json_int_t all = 0;
    json_t *counts = json_array(), *tree = export_sog_node(x, x->tree->root, box);
    for (size_t i = 0; i < x->n_levels; i++) {
        json_array_append_new(counts, json_integer((json_int_t)x->count[i]));
        all += (json_int_t)x->count[i];
    }
    json_t *o =
        json_pack("{s:i,s:{s:s},s:I,s:o,s:I,s:O,s:o}", "version", 1, "asset", "generator",
                  "citysplat " CITYSPLAT_VERSION, "count", all, "counts", counts, "lodLevels",
                  (json_int_t)x->n_levels, "filenames", x->files, "tree", tree);
    char *text = o ? json_dumps(o, JSON_COMPACT | JSON_REAL_PRECISION(9)) : NULL;
    json_decref(o);
    enum err_code rc = text ? file_join(path, x->dir, "lod-meta.json", e)
                            : err_set(e, ERR_MEM, "export: out of memory");
    if (!rc)
        rc = file_write(path, text, strlen(text), e);
    free(text);
    return rc;
}

/* ---- all of it ---- */

static enum err_code export_sog_open(struct export_sog *x, struct err *e)
{
    size_t n;
    const struct store_meta *m = store_info(x->s);
    x->tiles = store_tiles(x->s, &n);
    x->tree = store_tree(x->s);
    if (!n)
        return err_set(e, ERR_DATA, "export: the store has no tiles");
    x->first = mem_array(x->tree->n_nodes, sizeof *x->first);
    x->files = json_array();
    if (!x->first || !x->files)
        return err_set(e, ERR_MEM, "export: out of memory");
    export_sog_number(x, x->tree->root);
    x->n_levels = export_sog_count_levels(x);
    x->box = mem_array(x->n_leaves, sizeof *x->box);
    x->run = mem_array(x->n_leaves * x->n_levels, sizeof *x->run);
    if (!x->box || !x->run)
        return err_set(e, ERR_MEM, "export: out of memory");
    for (size_t i = 0; i < x->n_leaves; i++)
        for (int k = 0; k < 3; k++) {
            x->box[i][k] = (double)INFINITY;
            x->box[i][3 + k] = -(double)INFINITY;
        }
    enum err_code rc = locate_open(&m->origin, &x->locate, e);
    if (!rc)
        rc = gauss_alloc(&x->chunk, 0, m->sh_degree, 0, e);
    x->chunk.antialiased = m->antialiased;
    return rc;
}

static enum err_code export_sog_write(struct export_sog *x, struct err *e)
{
    struct progress p;
    size_t n, done = 0;
    enum err_code rc = ERR_OK;
    (void)store_tiles(x->s, &n);
    progress_start(&p, "export", n);
    for (x->level = 0; !rc && x->level < x->n_levels; x->level++) {
        x->n_chunks = 0;
        rc = export_sog_walk(x, x->tree->root, &p, &done, e);
        if (!rc)
            rc = export_sog_flush(x, e);
    }
    progress_end(&p, NULL);
    return !rc ? export_sog_describe(x, e) : rc;
}

enum err_code export_sog_folder(struct store *s, const float *image, const char *output,
                                bool overwrite, struct err *e)
{
    struct outdir d = {0};
    struct export_sog x = {.s = s, .image = image, .dir = d.part};
    enum err_code rc = outdir_begin(output, "lod-meta.json", overwrite, &d, e);
    if (!rc)
        rc = export_sog_open(&x, e);
    if (!rc)
        rc = export_sog_write(&x, e);
    if (!rc)
        rc = outdir_commit(&d, e);
    outdir_abort(&d);
    if (!rc)
        printf("%s/lod-meta.json: %" PRIu64 " Gaussians at the finest of %zu levels, %zu chunks\n",
               output, x.count[0], x.n_levels, json_array_size(x.files));
    json_decref(x.files);
    mem_free(x.first);
    mem_free(x.box);
    mem_free(x.run);
    gauss_free(&x.chunk);
    return rc;
}
