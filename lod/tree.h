/* The tiles of a store as a tree, shared by level selection, the tileset writer and the store:
 * internal to lod/.
 *
 * Node i is tile i of the index (sorted by key_compare, so a parent comes before its children). A
 * tile's parent is its nearest ancestor that exists, so sparse pyramids need no empty nodes. Where
 * several tiles have no ancestor one node without content stands above them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_TREE_H
#define LOD_TREE_H

#include "lod/store.h"

#define TREE_NONE UINT32_MAX
#define TREE_ERROR_GROWTH 1.01 /* errors fall strictly, at least by this, towards the leaves */
#define TREE_PX_PER_SIGMA 16.0 /* geometric error over sigma: 16 px of error are 1 px of sigma */
/* Nodes of a tileset's document, about: 350 bytes each, a tenth of it compressed. */
enum { TREE_DOCUMENT_NODES = 1024, TREE_DOCUMENT_FEW = 8 /* are no document of their own */ };

struct tree_node {
    uint32_t tile;   /* index into the tiles, TREE_NONE for a root without content */
    uint32_t parent; /* TREE_NONE at the root */
    uint32_t child_first, child_count;           /* slice of tree.children */
    double min_enu_m[3], max_enu_m[3];           /* around this tile and all below it */
    double core_min_enu_m[3], core_max_enu_m[3]; /* likewise */
    double sigma_max_m;                          /* likewise */
    double geometric_error_m; /* 0 at leaves, else the tile's, cut to less than the parent's */
    uint32_t n_below;         /* nodes of its subtree, itself counted */
    bool document; /* a tileset's document begins here: this node and all below it, down to the next
                      such. Never of the root, which the tileset itself begins with. */
};

struct tree { /* {0} is empty */
    struct tree_node *nodes;
    uint32_t *children; /* node indices, ascending within a node */
    size_t n_nodes;
    uint32_t root; /* TREE_NONE when there are no tiles */
};

/* `tiles` must be sorted by key_compare without duplicates. tree_free it. ERR_LIMIT (2^32 - 1
 * tiles), ERR_MEM. */
enum err_code tree_build(const struct store_tile *tiles, size_t n, struct tree *out,
                         struct err *e) ERR_USE;
void tree_free(struct tree *t);
/* Index of `k` in sorted tiles, TREE_NONE when absent. */
uint32_t tree_find(const struct store_tile *tiles, size_t n, struct key k);

/* The tree of an opened store; borrowed. */
const struct tree *store_tree(const struct store *s);

#endif
