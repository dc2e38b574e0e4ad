/* Bringing tiles of a store to the device, as a view does that sees them for the first time: read,
 * hash, unpack, order, copy. All finest tiles at once, from nothing.
 *
 * Checked before timing: as many Gaussians are drawn as the index has.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <stdio.h>

#include "lod/choose/resident.h"
#include "lod/store/store.h"

struct bring {
    struct resident resident;
    uint32_t *tile;
    size_t n;
    uint64_t brought;
};

static enum err_code bring_again(void *user, struct err *e)
{
    struct bring *c = user;
    resident_shrink(&c->resident);
    return resident_show(&c->resident, c->tile, c->n, NULL, &c->brought, e);
}

/* The tiles of the finest zoom, in a list for resident_show. */
static enum err_code bring_pick(const struct store *s, struct bring *c, uint64_t *total,
                                struct err *e)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    *total = 0;
    c->tile = mem_array(n + 1, sizeof *c->tile);
    if (!c->tile)
        return err_set(e, ERR_MEM, "out of memory for %zu tiles", n);
    for (size_t i = 0; i < n; i++)
        if (t[i].key.z == store_info(s)->zoom_max) {
            c->tile[c->n++] = (uint32_t)i;
            *total += t[i].count;
        }
    return ERR_OK;
}

static enum err_code bring_time(struct bench *b, struct bring *c, uint64_t total, struct err *e)
{
    double ms = 0.0, core_ms = 0.0;
    char text[96];
    enum err_code rc = bring_again(c, e);
    if (!rc && c->brought != total)
        rc = err_set(e, ERR_INTERNAL, "check: %llu Gaussians of %llu are drawn",
                     (unsigned long long)c->brought, (unsigned long long)total);
    if (!rc)
        rc = bench_cpu_time(b, bring_again, c, &core_ms, NULL, e);
    if (!rc)
        rc = bench_time(b, bring_again, c, &ms, NULL, e);
    if (!rc) {
        snprintf(text, sizeof text, "%zu tiles, %llu k Gaussians, a core's time", c->n,
                 (unsigned long long)(total / 1000));
        bench_report(b, text, (double)total / core_ms / 1e3, "M Gaussians/s", 0, NULL);
        snprintf(text, sizeof text, "%zu tiles, %llu k Gaussians, by the clock", c->n,
                 (unsigned long long)(total / 1000));
        bench_report(b, text, (double)total / ms / 1e3, "M Gaussians/s", 0, NULL);
    }
    return rc;
}

enum err_code bench_bring(struct bench *b, struct err *e)
{
    struct bring c = {0};
    struct render *r = NULL;
    struct store *s = NULL;
    uint64_t total = 0;
    enum err_code rc = b->tiles ? ERR_OK : err_set(e, ERR_ARG, "give --tiles FILE, a store");
    if (!rc)
        rc = store_open(b->tiles, &s, e);
    if (!rc)
        rc = render_open(b->dev, &r, e);
    if (!rc)
        rc = resident_open(s, r, store_info(s)->embed_len, (size_t)4 << 30, &c.resident, e);
    if (!rc)
        rc = bring_pick(s, &c, &total, e);
    if (!rc)
        rc = bring_time(b, &c, total, e);
    resident_close(&c.resident);
    mem_free(c.tile);
    render_close(&r);
    store_close(&s);
    return rc;
}
