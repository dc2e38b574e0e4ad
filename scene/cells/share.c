/* See share.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/share.h"

#include "codec/scene/scene.h"
#include "scene/cells/partition.h"
#include "scene/cells/window.h"

/* Which cells each photograph shows enough of: shows [n_cells][n_images]. */
static enum err_code share_find(const struct scene *s, const struct partition *p, double share_min,
                                bool *shows, struct err *e)
{
    struct window w;
    enum err_code rc = window_open(s, p, &w, e);
    for (size_t i = 0; !rc && i < s->n_images; i++) {
        if (s->images[i].split != SCENE_TRAIN)
            continue;
        rc = window_look(&w, (uint32_t)i, e);
        for (size_t k = 0; !rc && k < p->n_cells; k++)
            shows[k * s->n_images + i] = window_share(&w, k) >= share_min;
    }
    window_free(&w);
    return rc;
}

/* Replaces a cell's list by what shows it, which is cleared. */
static void share_list(const struct scene *s, bool *shows, uint32_t *list, struct partition *p,
                       struct partition_cell *c)
{
    size_t n = 0, n_location = 0;
    for (size_t k = 0; k < c->n_location; k++)
        if (shows[c->images[k]]) {
            list[n++] = c->images[k];
            shows[c->images[k]] = false;
        }
    n_location = n;
    for (size_t i = 0; i < s->n_images; i++)
        if (shows[i])
            list[n++] = (uint32_t)i;
    if (!n)
        return;
    c->images = list;
    c->n_images = n;
    c->n_location = n_location;
    partition_count_azimuth(s, &p->grid, c);
}

enum err_code share_photographs(const struct scene *s, double share_min, struct partition *p,
                                struct err *e)
{
    enum err_code rc = ERR_OK;
    p->share_min = p->n_cells > 1 ? share_min : 0.0;
    if (!(p->share_min > 0.0))
        return ERR_OK;
    bool *shows = mem_array(p->n_cells * s->n_images, sizeof *shows);
    if (!shows)
        return err_set(e, ERR_MEM, "out of memory for %zu photographs", s->n_images);
    rc = share_find(s, p, share_min, shows, e);
    for (size_t i = 0; !rc && i < p->n_cells; i++) {
        struct partition_cell *c = &p->cells[i];
        if (c->parent >= 0)
            continue;
        uint32_t *list = arena_get(&p->arena, s->n_images + 1, sizeof *list);
        if (list)
            share_list(s, shows + i * s->n_images, list, p, c);
        else
            rc = err_set(e, ERR_MEM, "out of memory for %zu photographs", s->n_images);
    }
    mem_free(shows);
    return rc;
}
