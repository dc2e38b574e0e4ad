/* See leaves.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/leaves.h"

#include "lod/store/store.h"
#include "lod/store/tree.h"

enum err_code leaves_read(const char *store_path, struct leaves *out, struct err *e)
{
    struct store *s = NULL;
    size_t n = 0;
    *out = (struct leaves){0};
    enum err_code rc = store_open(store_path, &s, e);
    const struct store_tile *t = rc ? NULL : store_tiles(s, &n);
    out->tile = mem_array(n, sizeof *out->tile);
    if (!rc && !out->tile)
        rc = err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    for (size_t i = 0; !rc && i < n; i++) {
        if (!tree_leaf(store_tree(s), i))
            continue;
        rc = store_read_gauss(s, t[i].key, &out->tile[out->n_tiles], e);
        if (!rc)
            out->n += out->tile[out->n_tiles++].n;
    }
    if (!rc && !out->n)
        rc = err_set(e, ERR_DATA, "%s: no Gaussians", store_path);
    store_close(&s);
    return rc;
}

void leaves_free(struct leaves *l)
{
    for (size_t i = 0; i < l->n_tiles; i++)
        gauss_free(&l->tile[i]);
    mem_free(l->tile);
    *l = (struct leaves){0};
}
