/* Connected regions of pixels: see region.h. Union-find over labels of runs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/region.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"

enum err_code region_begin(struct region_map *m, uint32_t width, struct err *e)
{
    if (!m->sign) {
        m->width = width;
        m->sign = mem_array(width, sizeof *m->sign);
        m->label = mem_array(width, sizeof *m->label);
        if (!m->sign || !m->label)
            return err_set(e, ERR_MEM, "out of memory for a row of %u px", width);
    }
    memset(m->sign, 0, m->width * sizeof *m->sign);
    memset(m->label, 0, m->width * sizeof *m->label);
    m->n = 1;
    return ERR_OK;
}

static uint32_t region_root(struct region_map *m, uint32_t label)
{
    uint32_t root = label;
    while (m->list[root].of != root)
        root = m->list[root].of;
    while (m->list[label].of != root) {
        uint32_t next = m->list[label].of;
        m->list[label].of = root;
        label = next;
    }
    return root;
}

static void region_join(struct region_map *m, uint32_t a, uint32_t b)
{
    a = region_root(m, a);
    b = region_root(m, b);
    if (a == b)
        return;
    struct region *to = &m->list[a < b ? a : b], *from = &m->list[a < b ? b : a];
    from->of = to->of;
    to->pixels += from->pixels;
    to->seeds += from->seeds;
    to->firm += from->firm;
    to->sum += from->sum;
    to->variance += from->variance;
    to->edge += from->edge;
    to->most = fabs(from->most) > fabs(to->most) ? from->most : to->most;
}

static enum err_code region_more(struct region_map *m, struct err *e)
{
    if (m->n == REGION_MAX)
        return err_set(
            e, ERR_LIMIT,
            "more than %d pieces differ: take larger pixels, a larger least difference or "
            "a smaller area",
            REGION_MAX);
    if (m->n >= m->cap) {
        uint32_t cap = m->cap ? 2 * m->cap : 1024;
        struct region *list = mem_resize(m->list, m->cap, cap, sizeof *list);
        if (!list)
            return err_set(e, ERR_MEM, "out of memory for %u regions", cap);
        m->list = list;
        m->cap = cap;
    }
    m->list[m->n] = (struct region){.of = m->n};
    m->n++;
    return ERR_OK;
}

/* Labels are given in the same order in both passes: by row, then by column, one wherever neither
 * the pixel to the left nor the one above is of the same sign. */
static int8_t region_sign(int8_t kind)
{
    return (int8_t)((kind > 0) - (kind < 0));
}

enum err_code region_add(struct region_map *m, const int8_t *kind, const float *value,
                         const float *sigma, const float *edge, struct err *e)
{
    for (uint32_t x = 0; x < m->width; x++) {
        int8_t sign = region_sign(kind[x]);
        bool above = sign && m->sign[x] == sign,
             left = sign && x && region_sign(kind[x - 1]) == sign;
        uint32_t label = left ? m->label[x - 1] : above ? m->label[x] : 0;
        if (sign && !label) {
            enum err_code rc = region_more(m, e);
            if (rc)
                return rc;
            label = m->n - 1;
        }
        if (left && above)
            region_join(m, label, m->label[x]);
        m->sign[x] = sign;
        m->label[x] = label;
        if (!sign)
            continue;
        struct region *r = &m->list[region_root(m, label)];
        r->pixels++;
        r->seeds += (abs(kind[x]) & REGION_SEED) != 0;
        r->firm += (abs(kind[x]) & REGION_FIRM) != 0;
        r->sum += (double)value[x];
        r->variance +=
            fmax((double)sigma[x] * (double)sigma[x] - (double)edge[x] * (double)edge[x], 0);
        r->edge += (double)edge[x];
        r->most = fabs((double)value[x]) > fabs(r->most) ? (double)value[x] : r->most;
    }
    return ERR_OK;
}

const uint32_t *region_tell(struct region_map *m, const int8_t *kind)
{
    for (uint32_t x = 0; x < m->width; x++) {
        int8_t sign = region_sign(kind[x]);
        bool above = sign && m->sign[x] == sign,
             left = sign && x && region_sign(kind[x - 1]) == sign;
        /* m->label holds regions here: of one region are all labels that meet. */
        if (!left && !above && sign)
            m->label[x] = region_root(m, m->n++);
        else if (left)
            m->label[x] = m->label[x - 1];
        else if (!sign)
            m->label[x] = 0;
        m->sign[x] = sign;
    }
    return m->label;
}

void region_free(struct region_map *m)
{
    mem_free(m->sign);
    mem_free(m->label);
    mem_free(m->list);
    *m = (struct region_map){0};
}
