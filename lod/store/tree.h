/* The tiles of a store as a tree, for level selection, the tileset writer and the store. Internal
 * to lod/.
 *
 * Node i is tile i of the index. The index is sorted by key_compare, so a parent comes before its
 * children. The parent of a tile is its nearest ancestor that exists, so sparse pyramids need no
 * empty nodes. If several tiles have no ancestor, one node without content stands above them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_TREE_H
#define LOD_TREE_H

#include "lod/store/index.h"
#include "lod/store/store.h"

#define TREE_NONE INDEX_NONE
#define TREE_ERROR_GROWTH 1.01 /* least factor by which errors fall from a node to its children */
/* Approximate number of nodes in a tileset document: 350 bytes each, 35 compressed. */
enum { TREE_DOCUMENT_NODES = 1024, TREE_DOCUMENT_FEW = 8 /* a part has more */ };

struct tree_node {                     /* as tree_node tells it */
    uint32_t tile;                     /* index into the tiles; TREE_NONE: root without content */
    uint32_t parent;                   /* TREE_NONE at the root */
    uint32_t child_first, child_count; /* slice of tree.children */
    uint32_t n_below;                  /* number of nodes in its subtree, itself included */
    /* 0 at leaves; else the tile's, limited to less than the parent's */
    double geometric_error_m;
    /* A tileset document begins here. It has this node and all below, down to the next document.
     * False for the root, where tileset.json begins. */
    bool document;
};

struct tree_bounds {                             /* of a node and all below it */
    double min_enu_m[3], max_enu_m[3];           /* box around */
    double core_min_enu_m[3], core_max_enu_m[3]; /* around cores */
    double sigma_max_m;
};

/* Most nodes are leaves, of which there is little to keep. */
struct tree_place {
    uint32_t parent;
    uint32_t inner; /* place in tree.inner; TREE_NONE at leaves */
};
struct tree_inner { /* a node with children */
    double geometric_error_m;
    uint32_t child_first, child_count;
    uint32_t n_below : 31, document : 1;
    uint32_t bounds; /* place in tree.bounds; TREE_NONE: few leaves below, and united when asked */
};

struct tree {                  /* {0} is empty */
    const struct index *index; /* borrowed */
    struct tree_place *places;
    struct tree_inner *inner;
    struct tree_bounds *bounds;
    uint32_t *children; /* node indices, ascending within a node */
    size_t n_tiles, n_nodes;
    uint32_t root; /* TREE_NONE when there are no tiles */
};

/* Builds the tree. The index must be sorted by key_compare, without duplicates, and must outlive
 * the tree. Free *out with tree_free. ERR_LIMIT (2^31 - 1 tiles), ERR_MEM. */
enum err_code tree_build(const struct index *x, struct tree *out, struct err *e) ERR_USE;
void tree_free(struct tree *t);
/* What the tree knows of a node, below t->n_nodes. */
struct tree_node tree_node(const struct tree *t, size_t node);
/* Whether a node has no children. */
bool tree_leaf(const struct tree *t, size_t node);
struct tree_bounds tree_bounds(const struct tree *t, uint32_t node);
/* Where most of a scene's Gaussians are, m in its frame: from about 5 to 95 % of the means along
 * each axis (their 2 and 98 % are known), of the coarsest tile, or of all that have none above
 * them. All 0 without tiles. Sky and ground of the viewer and of the server's pictures are made for
 * it. */
void tree_extent(const struct tree *t, double min_enu_m[3], double max_enu_m[3]);

/* The tree of an opened store; borrowed. */
const struct tree *store_tree(const struct store *s);

#endif
