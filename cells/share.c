/* See share.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cells/share.h"

#include "cells/cell.h"
#include "cells/partition.h"
#include "cells/window.h"
#include "codec/scene.h"

/* Whether each photograph shows enough of a cell. */
static enum err_code share_find(const struct scene *s, const struct cell *cell, double share_min,
                                bool all_images, bool *shows, struct err *e)
{
    struct window_points points;
    enum err_code rc = window_open(s, cell, &points, e);
    for (size_t i = 0; !rc && i < s->n_images; i++)
        shows[i] = (all_images || s->images[i].split == SCENE_TRAIN) &&
                   window_share(&points, cell, (uint32_t)i) >= share_min;
    window_free(&points);
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

enum err_code share_photographs(const struct scene *s, double share_min, bool all_images,
                                struct partition *p, struct err *e)
{
    enum err_code rc = ERR_OK;
    p->share_min = p->n_cells > 1 ? share_min : 0.0;
    bool *shows = mem_array(s->n_images, sizeof *shows);
    if (!shows)
        return err_set(e, ERR_MEM, "out of memory for %zu photographs", s->n_images);
    for (size_t i = 0; !rc && p->share_min > 0.0 && i < p->n_cells; i++) {
        struct partition_cell *c = &p->cells[i];
        struct cell cell;
        if (c->parent >= 0)
            continue;
        uint32_t *list = arena_get(&p->arena, s->n_images + 1, sizeof *list);
        if (!list) {
            rc = err_set(e, ERR_MEM, "out of memory for %zu photographs", s->n_images);
            break;
        }
        cell_planned(s, p, i, c->images, c->n_location ? c->n_location : c->n_images, &cell);
        rc = share_find(s, &cell, share_min, all_images, shows, e);
        if (!rc)
            share_list(s, shows, list, p, c);
    }
    mem_free(shows);
    return rc;
}
