/* See roofline_count.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/roofline_count.h"

#include "render/frame.h" /* the lists of a frame */

enum err_code roofline_count_lists(struct dev *d, const struct render *r, struct roofline_work *out,
                                   struct err *e)
{
    const size_t bytes = r->tiles * sizeof(uint32_t), n = (size_t)r->intersections;
    uint32_t *start = mem_array(r->tiles, sizeof *start), *stop = mem_array(r->tiles, sizeof *stop);
    uint16_t *hits = mem_array(n + 1, sizeof *hits);
    enum err_code rc = start && stop && hits ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
    if (!rc)
        rc = dev_read(d, r->tile_start.mem, 0, bytes, start, e);
    if (!rc)
        rc = dev_read(d, r->tile_stop.mem, 0, bytes, stop, e);
    if (!rc && n)
        rc = dev_read(d, r->hits.mem, 0, n * sizeof *hits, hits, e);
    out->entries = out->drawn = out->blocks = 0.0;
    for (size_t i = 0; !rc && i < r->tiles; i++) {
        out->entries += (double)(stop[i] - start[i]);
        for (uint32_t k = start[i]; k < stop[i]; k++) {
            out->drawn += hits[k] != 0;
            out->blocks += __builtin_popcount(hits[k]);
        }
    }
    mem_free(start);
    mem_free(stop);
    mem_free(hits);
    return rc;
}

/* Gaussians in groups of which one is visible; VW 1: those that are. */
static enum err_code roofline_count_groups(struct dev *d, const struct render *r, double *out,
                                           struct err *e)
{
    const size_t lanes = (size_t)r->view.groups * LAYOUT_LANES;
    uint32_t *tiles = mem_array(lanes + 1, sizeof *tiles);
    enum err_code rc = tiles ? ERR_OK : err_set(e, ERR_MEM, "out of memory");
    if (!rc)
        rc = dev_read(d, r->tiles_of.mem, 0, lanes * sizeof *tiles, tiles, e);
    *out = 0.0;
    for (size_t i = 0; !rc && i < lanes; i += LAYOUT_LANES) {
        uint32_t any = 0;
        for (size_t k = 0; k < LAYOUT_LANES; k++)
            any |= tiles[i + k];
        *out += any ? LAYOUT_LANES : 0;
    }
    mem_free(tiles);
    return rc;
}

enum err_code roofline_count(struct dev *d, const struct render *r, struct roofline_work *out,
                             struct err *e)
{
    enum err_code rc = ERR_OK;
    *out = (struct roofline_work){.gpu = d->vector_width == 1,
                                  .n = r->view.n,
                                  .visible = r->stats.visible,
                                  .grouped = r->stats.visible,
                                  .lists = (double)r->intersections,
                                  .pixels = (double)r->view.width * r->view.height,
                                  .tiles = r->tiles};
    if (!out->gpu)
        rc = roofline_count_lists(d, r, out, e);
    return !rc && !out->gpu ? roofline_count_groups(d, r, &out->grouped, e) : rc;
}
