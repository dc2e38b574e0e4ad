/* PMTiles of the map: see export_map.h. Tiles are drawn in the order of the file: zoom by zoom, and
 * within a zoom along a Hilbert curve. Neighbours on the curve show the same Gaussians, which stay
 * in memory, and the file is written in one pass.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/tiles/export_map.h"

#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "codec/container/pmtiles.h"
#include "lod/surface/raster.h"
#include "server/drawing/map_tile.h"

enum { EXPORT_MAP_QUALITY = 85 }; /* of webp and jpg, as `citysplat serve` has it */

struct export_map_place {
    uint64_t id;
    struct key key;
};
struct export_map_run {
    const struct export_map *o;
    struct nadir *nadir;
    uint8_t zoom_min, zoom_max;
    struct export_map_place *place; /* [n] */
    size_t n;
};

static int export_map_compare(const void *pa, const void *pb)
{
    const struct export_map_place *a = pa, *b = pb;
    return a->id < b->id ? -1 : a->id > b->id;
}

/* "14-18" or "14"; those of map.json where nothing is said. */
static enum err_code export_map_zooms(struct export_map_run *r, struct err *e)
{
    const struct area *a = nadir_area(r->nadir);
    const long most = raster_zoom_max(a) + RASTER_ZOOM_OVER;
    char *end;
    r->zoom_min = raster_zoom_min(a);
    r->zoom_max = raster_zoom_max(a);
    if (!r->o->zooms)
        return ERR_OK;
    const long lo = strtol(r->o->zooms, &end, 10);
    long hi = lo;
    bool fine = end != r->o->zooms;
    if (fine && *end == '-') {
        const char *second = end + 1;
        hi = strtol(second, &end, 10);
        fine = end != second;
    }
    if (!fine || *end || lo < 0 || hi < lo || hi > most)
        return err_set(e, ERR_ARG,
                       "--zooms: '%s': one zoom or two, as in 14-18, is expected, from 0 to %ld, "
                       "beyond which nothing new is seen",
                       r->o->zooms, most);
    r->zoom_min = (uint8_t)lo;
    r->zoom_max = (uint8_t)hi;
    return ERR_OK;
}

static struct key export_map_corner(const struct area *a, bool south_east, uint8_t z)
{
    return key_at(south_east ? a->east_deg : a->west_deg, south_east ? a->south_deg : a->north_deg,
                  z);
}

/* Every tile that touches the survey, in the order of the file. */
static enum err_code export_map_plan(struct export_map_run *r, struct err *e)
{
    const uint64_t most = (uint64_t)1 << 26;
    const struct area *a = nadir_area(r->nadir);
    uint64_t room = 0;
    /* The box is of smallest and largest degrees, also over the antimeridian. Of a store that was
     * clipped beside its footprint it is turned inside out. */
    if (!(a->west_deg < a->east_deg && a->south_deg < a->north_deg))
        return err_set(e, ERR_DATA,
                       "there is no ground to draw: what was surveyed and what the store was "
                       "clipped to do not meet");
    for (unsigned z = r->zoom_min; z <= r->zoom_max; z++) {
        const struct key from = export_map_corner(a, false, (uint8_t)z),
                         to = export_map_corner(a, true, (uint8_t)z);
        room += ((uint64_t)to.x - from.x + 1) * ((uint64_t)to.y - from.y + 1);
    }
    if (room > most)
        return err_set(e, ERR_LIMIT,
                       "%" PRIu64 " tiles: at most %" PRIu64 " are written; say fewer "
                       "--zooms",
                       room, most);
    r->place = mem_array((size_t)room, sizeof *r->place);
    if (!r->place)
        return err_set(e, ERR_MEM, "out of memory for a list of %" PRIu64 " tiles", room);
    for (unsigned z = r->zoom_min; z <= r->zoom_max; z++) {
        const struct key from = export_map_corner(a, false, (uint8_t)z),
                         to = export_map_corner(a, true, (uint8_t)z);
        for (uint32_t y = from.y; y <= to.y; y++)
            for (uint32_t x = from.x; x <= to.x; x++) {
                const struct key k = {(uint8_t)z, x, y};
                if (area_touches(a, k))
                    r->place[r->n++] = (struct export_map_place){pmtiles_id(k.z, x, y), k};
            }
    }
    qsort(r->place, r->n, sizeof *r->place, export_map_compare);
    return ERR_OK;
}

static enum err_code export_map_draw(const struct export_map_run *r, struct pmtiles *out,
                                     struct err *e)
{
    static const enum format formats[] = {FORMAT_WEBP, FORMAT_PNG, FORMAT_JPG};
    struct buf b = {0};
    struct progress p;
    enum err_code rc = ERR_OK;
    progress_start(&p, "export", r->n);
    for (size_t i = 0; !rc && i < r->n; i++) {
        const struct map_tile tile = {.key = r->place[i].key,
                                      .size_px = (uint32_t)RASTER_PX << r->o->dense,
                                      .format = formats[r->o->format],
                                      .quality = EXPORT_MAP_QUALITY};
        b.size = 0;
        rc = map_tile_make(r->nadir, &tile, &b, e);
        if (!rc)
            rc = pmtiles_add(out, r->place[i].id, b.data, b.size, e);
        else
            err_add(e, "map tile %u/%u/%u", tile.key.z, tile.key.x, tile.key.y);
        progress_step(&p, i + 1, NULL);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    progress_end(&p, NULL);
    buf_free(&b);
    return rc;
}

static enum err_code export_map_commit(const struct export_map_run *r, struct pmtiles **out,
                                       struct err *e)
{
    static const enum pmtiles_type types[] = {PMTILES_WEBP, PMTILES_PNG, PMTILES_JPEG};
    const struct area *a = nadir_area(r->nadir);
    const struct store_meta *m = store_info(nadir_store(r->nadir));
    const int center = r->zoom_min + 3 < r->zoom_max ? r->zoom_min + 3 : r->zoom_max;
    json_t *o =
        json_pack("{s:s,s:s,s:s,s:s,s:i}", "name", m->name, "attribution", m->attribution, "type",
                  "overlay", "revision", m->revision, "tileSize", RASTER_PX << r->o->dense);
    char *text = o ? json_dumps(o, JSON_COMPACT) : NULL;
    const struct pmtiles_about about = {
        .type = types[r->o->format],
        .zoom_min = r->zoom_min,
        .zoom_max = r->zoom_max,
        .zoom_center = (uint8_t)center,
        .bbox_deg = {a->west_deg, a->south_deg, a->east_deg, a->north_deg},
        .metadata = text};
    enum err_code rc =
        text ? pmtiles_commit(out, &about, e) : err_set(e, ERR_MEM, "export: out of memory");
    json_decref(o);
    free(text);
    return rc;
}

enum err_code export_map(const char *store, const struct export_map *o, struct err *e)
{
    struct export_map_run r = {.o = o};
    struct pmtiles *out = NULL;
    uint64_t tiles = 0, contents = 0, bytes = 0;
    const struct nadir_options no = {
        .device = o->device, .appearance = o->appearance, .ceiling_m = (double)NAN};
    enum err_code rc = nadir_open(store, &no, &r.nadir, e);
    if (!rc)
        rc = export_map_zooms(&r, e);
    if (!rc)
        rc = export_map_plan(&r, e);
    if (!rc)
        rc = pmtiles_begin(o->output, &out, e);
    if (!rc)
        rc = export_map_draw(&r, out, e);
    if (!rc) {
        pmtiles_count(out, &tiles, &contents, &bytes);
        rc = export_map_commit(&r, &out, e);
    }
    pmtiles_abort(&out);
    nadir_close(&r.nadir);
    mem_free(r.place);
    if (!rc)
        printf("%s: %" PRIu64 " map tiles of zooms %u to %u, %" PRIu64 " different, %" PRIu64
               " bytes\n",
               o->output, tiles, r.zoom_min, r.zoom_max, contents, bytes);
    return rc;
}
