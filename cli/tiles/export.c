/* citysplat export: writes a tile store in other forms:
 * - one .ply, .compressed.ply, .spz, .sog or .glb of a level
 * - a static 3D Tiles folder for any web server or CDN, or that folder as one .3tz
 * - its map as one .pmtiles
 *
 * The .glb files and map tiles have the same bytes that `citysplat serve` would send.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/tiles/export_map.h"
#include "codec/container/package.h"
#include "codec/splat/axes.h"
#include "codec/splat/glb.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/spz.h"
#include "core/outdir.h"
#include "core/pool.h"
#include "core/splat/appearance.h"
#include "lod/export/lowpass.h"
#include "lod/export/tileset.h"
#include "lod/store/bake.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

enum {
    EXPORT_AUTO,
    EXPORT_PLY,
    EXPORT_SPZ,
    EXPORT_SOG,
    EXPORT_GLB,
    EXPORT_PLY_PACKED,
    EXPORT_3DTILES,
    EXPORT_3TZ,
    EXPORT_PMTILES
};

struct export_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/export.def"
};

static const struct options_def export_defs[] = {
#define OPT(...) OPTIONS_ROW(struct export_options, __VA_ARGS__)
#include "cli/tiles/export.def"
};

static const struct options_spec export_spec = {
    .command = "export",
    .usage = "citysplat export CITY.tiles -o FILE [options]",
    .about = "Writes one level of a tile store as .ply (east-north-up, every bit of a lossless "
             "store), .compressed.ply, .spz, .sog or plain .glb. Or writes all levels: as a folder "
             "with tileset.json and .glb tiles for a web server or CDN, or as that folder in one "
             ".3tz file. Or writes the map from straight above as one .pmtiles file.",
    .example = "citysplat export city.tiles -o city.ply\n"
               "citysplat export city.tiles -o public/city --format 3dtiles\n"
               "citysplat export city.tiles -o city.3tz\n"
               "citysplat export city.tiles -o city.pmtiles",
    .defs = export_defs,
    .n_defs = sizeof export_defs / sizeof *export_defs,
    .min_args = 1,
    .max_args = 1};

/* Zoom of a level by its name: tiles above it count only where nothing finer is. */
static enum err_code export_zoom(const struct store *s, const char *level, uint8_t *zoom,
                                 struct err *e)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    uint8_t top = 0;
    char *end;
    for (size_t i = 0; i < n; i++)
        top = t[i].level > top ? t[i].level : top;
    *zoom = store_info(s)->zoom_max;
    if (!strcmp(level, "finest"))
        return ERR_OK;
    long l = strtol(level, &end, 10);
    if (end == level || *end || l < 1 || l > top)
        return err_set(e, ERR_ARG, "--level: '%s': finest or 1 to %u is expected", level, top);
    *zoom = (uint8_t)(store_info(s)->zoom_max - (top - l));
    return ERR_OK;
}

static enum err_code export_gather(struct store *s, uint8_t zoom, const float *image,
                                   struct gauss *out, struct err *e)
{
    size_t n;
    struct progress p;
    (void)store_tiles(s, &n);
    progress_start(&p, "export", n);
    const enum err_code rc = bake_read_cut(s, zoom, image, &p, out, e);
    progress_end(&p, NULL);
    return rc;
}

static enum err_code export_spz(struct gauss *g, const struct quant_grid *grid, struct buf *out,
                                struct err *e)
{
    struct quant q = {0};
    axes_enu_to_gltf(g);
    enum err_code rc = quant_from_gauss(g, g->sh_degree, grid, &q, e);
    if (!rc)
        rc = spz_encode(&q, 3, out, e);
    quant_free(&q);
    return rc;
}

/* glTF with KHR_gaussian_splatting, every float as it is. */
static enum err_code export_plain(struct gauss *g, const char *copyright, struct buf *out,
                                  struct err *e)
{
    axes_enu_to_gltf(g);
    return glb_encode_plain(g, copyright[0] ? copyright : NULL, out, e);
}

/* One texture of the whole level: rows that are neighbours in it should be so in space. */
static enum err_code export_sog(const struct gauss *g, struct buf *out, struct err *e)
{
    struct gauss sorted = {0};
    enum err_code rc = gauss_sorted(g, &sorted, e);
    if (!rc) {
        axes_enu_to_gltf(&sorted);
        rc = sog_encode(&sorted, sorted.sh_degree, out, e);
    }
    gauss_free(&sorted);
    return rc;
}

static enum err_code export_ply_packed(const struct gauss *g, const struct ply_info *info,
                                       struct buf *out, struct err *e)
{
    struct gauss sorted = {0};
    enum err_code rc = gauss_sorted(g, &sorted, e);
    if (!rc)
        rc = ply_packed_encode(&sorted, sorted.sh_degree, info, out, e);
    gauss_free(&sorted);
    return rc;
}

static enum err_code export_file(struct store *s, const struct export_options *o, int format,
                                 const float *image, struct err *e)
{
    struct gauss g = {0};
    struct buf b = {0};
    uint8_t zoom = 0;
    const struct quant_grid *grid = quant_preset_grid((enum quant_preset)o->preset);
    struct ply_info info = {
        .has_origin = true, .origin = store_info(s)->origin, .axes = PLY_AXES_ENU};
    memcpy(info.heights, store_info(s)->heights, sizeof info.heights);
    enum err_code rc = export_zoom(s, o->level, &zoom, e);
    if (!rc)
        rc = export_gather(s, zoom, image, &g, e);
    if (!rc)
        rc = format == EXPORT_PLY          ? ply_encode(&g, &info, &b, e)
             : format == EXPORT_PLY_PACKED ? export_ply_packed(&g, &info, &b, e)
             : format == EXPORT_SOG        ? export_sog(&g, &b, e)
             : format == EXPORT_GLB        ? export_plain(&g, store_info(s)->attribution, &b, e)
                                           : export_spz(&g, grid, &b, e);
    if (!rc)
        rc = file_write(o->output, b.data, b.size, e);
    if (!rc)
        printf("%s: %zu Gaussians, %zu bytes, origin %.9g, %.9g, %.3f m\n", o->output, g.n, b.size,
               info.origin.lon_deg, info.origin.lat_deg, info.origin.h_m);
    buf_free(&b);
    gauss_free(&g);
    return rc;
}

/* ---- a folder of 3D Tiles ---- */

/* Metres of the pixels of a tile's low-pass form (lod/export/lowpass.h). 0: the folder has none. */
static double export_pixel_m(const struct store *s, bool lowpass, uint32_t index)
{
    return lowpass && store_info(s)->antialiased ? lowpass_pixel_m(store_tree(s), index) : 0.0;
}

/* A tile as it is, or in its low-pass form: g (in glTF axes) is changed for pixels of pixel_m. */
static enum err_code export_form(struct gauss *g, double pixel_m, const struct store_meta *m,
                                 const struct quant_grid *grid, const char *path, struct err *e)
{
    struct quant q = {0};
    struct buf b = {0};
    lowpass_gauss(g, pixel_m);
    enum err_code rc = quant_from_gauss(g, m->sh_degree, grid, &q, e);
    if (!rc)
        rc = glb_encode_spz(&q, m->attribution[0] ? m->attribution : NULL, &b, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    quant_free(&q);
    return rc;
}

/* Both forms of a tile that the folder's tileset names, as `citysplat serve` sends them. */
static enum err_code export_glb(struct store *s, uint32_t index, const struct export_options *o,
                                const char *dir, const float *image, struct err *e)
{
    const struct quant_grid *grid = quant_preset_grid((enum quant_preset)o->preset);
    const struct store_meta *m = store_info(s);
    struct gauss g = {0};
    char path[FILE_PATH_MAX];
    size_t n_tiles;
    const struct key k = store_tiles(s, &n_tiles)[index].key;
    const double pixel_m = export_pixel_m(s, o->lowpass, index);
    int n = snprintf(path, sizeof path, "%s/t/%u/%u", dir, k.z, k.x);
    enum err_code rc = n > 0 && n + 24 < FILE_PATH_MAX
                           ? file_mkdir(path, e)
                           : err_set(e, ERR_LIMIT, "%s: path too long", dir);
    if (!rc)
        rc = bake_read(s, k, image, &g, e);
    if (!rc) {
        axes_enu_to_gltf(&g);
        snprintf(path + n, sizeof path - (size_t)n, "/%u.glb", k.y);
        rc = export_form(&g, 0.0, m, grid, path, e);
    }
    if (!rc && pixel_m > 0.0) {
        snprintf(path + n, sizeof path - (size_t)n, "/%u.lowpass.glb", k.y);
        rc = export_form(&g, pixel_m, m, grid, path, e);
    }
    if (rc)
        err_add(e, "tile %u/%u/%u", k.z, k.x, k.y);
    gauss_free(&g);
    return rc;
}

static enum err_code export_tilejson(const struct store *s, const char *dir, struct err *e)
{
    struct buf b = {0};
    char path[FILE_PATH_MAX];
    enum err_code rc = file_join(path, dir, "tiles.json", e);
    if (!rc)
        rc = tileset_tilejson(s, tileset_of_entry.tile, &b, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

/* tileset.json (part NULL), or the document that begins at a tile: tileset/z/x/y.json. */
static enum err_code export_tileset(const struct store *s, bool lowpass, const struct key *part,
                                    const char *dir, struct err *e)
{
    struct tileset_links links = part ? tileset_of_part : tileset_of_entry;
    struct buf b = {0};
    char name[64] = "tileset.json", path[FILE_PATH_MAX];
    if (!lowpass)
        links.lowpass = NULL;
    if (part)
        snprintf(name, sizeof name, "tileset/%u/%u", part->z, part->x);
    enum err_code rc = file_join(path, dir, name, e);
    if (!rc && part)
        rc = file_mkdir(path, e);
    if (!rc && part) {
        snprintf(name, sizeof name, "tileset/%u/%u/%u.json", part->z, part->x, part->y);
        rc = file_join(path, dir, name, e);
    }
    if (!rc)
        rc = tileset_write(s, &links, part, NULL, &b, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

static enum err_code export_documents(const struct store *s, bool lowpass, const char *dir,
                                      struct err *e)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    enum err_code rc = export_tileset(s, lowpass, NULL, dir, e);
    for (size_t i = 0; !rc && i < n; i++)
        if (tree_node(store_tree(s), i).document)
            rc = export_tileset(s, lowpass, &t[i].key, dir, e);
    return !rc ? export_tilejson(s, dir, e) : rc;
}

/* All files below dir. */
static enum err_code export_folder(struct store *s, const struct export_options *o,
                                   const float *image, const char *dir, struct err *e)
{
    struct progress p;
    size_t n;
    enum err_code rc = ERR_OK;
    (void)store_tiles(s, &n);
    progress_start(&p, "export", n);
    for (size_t i = 0; !rc && i < n; i++) {
        rc = export_glb(s, (uint32_t)i, o, dir, image, e);
        progress_step(&p, i + 1, NULL);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    progress_end(&p, NULL);
    return !rc ? export_documents(s, o->lowpass, dir, e) : rc;
}

static enum err_code export_3dtiles(struct store *s, const struct export_options *o,
                                    const float *image, struct err *e)
{
    struct outdir d = {0};
    size_t n;
    (void)store_tiles(s, &n);
    enum err_code rc = outdir_begin(o->output, "tileset.json", o->overwrite, &d, e);
    if (!rc)
        rc = export_folder(s, o, image, d.part, e);
    if (!rc)
        rc = outdir_commit(&d, e);
    outdir_abort(&d);
    if (!rc)
        printf("%s/tileset.json: %zu tiles\n", o->output, n);
    return rc;
}

/* What export_folder writes, tileset.json first; names live in the arena. */
static enum err_code export_names(const struct store *s, bool lowpass, struct arena *a,
                                  char ***names, size_t *n, struct err *e)
{
    enum { NAME = 48 };
    size_t n_tiles, at = 0;
    const struct store_tile *t = store_tiles(s, &n_tiles);
    const size_t n_max = 3 * n_tiles + 2;
    char **list = arena_get(a, n_max, sizeof *list);
    char *text = arena_get(a, n_max, NAME);
    if (!list || !text)
        return err_set(e, ERR_MEM, "export: out of memory for %zu names", n_tiles);
    for (size_t i = 0; i < n_max; i++)
        list[i] = text + i * NAME;
    snprintf(list[at++], NAME, "tileset.json");
    snprintf(list[at++], NAME, "tiles.json");
    for (size_t i = 0; i < n_tiles; i++) {
        const struct key k = t[i].key;
        if (tree_node(store_tree(s), i).document)
            snprintf(list[at++], NAME, "tileset/%u/%u/%u.json", k.z, k.x, k.y);
        snprintf(list[at++], NAME, "t/%u/%u/%u.glb", k.z, k.x, k.y);
        if (export_pixel_m(s, lowpass, (uint32_t)i) > 0.0)
            snprintf(list[at++], NAME, "t/%u/%u/%u.lowpass.glb", k.z, k.x, k.y);
    }
    *names = list;
    *n = at;
    return ERR_OK;
}

/* The folder beside the archive, packed and removed. */
static enum err_code export_3tz(struct store *s, const struct export_options *o, const float *image,
                                struct err *e)
{
    struct outdir d = {0};
    struct arena a = {0};
    char folder[FILE_PATH_MAX], **names = NULL;
    size_t n = 0, n_tiles;
    (void)store_tiles(s, &n_tiles);
    int size = snprintf(folder, sizeof folder, "%s.files", o->output);
    enum err_code rc = size > 0 && (size_t)size < sizeof folder
                           ? outdir_begin(folder, "tileset.json", false, &d, e)
                           : err_set(e, ERR_LIMIT, "%.80s...: path too long", o->output);
    if (!rc)
        rc = export_folder(s, o, image, d.part, e);
    if (!rc)
        rc = export_names(s, o->lowpass, &a, &names, &n, e);
    if (!rc)
        rc = package_write(d.part, names, n, o->output, e);
    outdir_abort(&d);
    arena_free(&a);
    if (!rc)
        printf("%s: %zu tiles\n", o->output, n_tiles);
    return rc;
}

static enum err_code export_format(const char *output, int *out, struct err *e)
{
    static const struct {
        const char *ending;
        int format;
    } known[] = {{".compressed.ply", EXPORT_PLY_PACKED},
                 {".ply", EXPORT_PLY},
                 {".spz", EXPORT_SPZ},
                 {".sog", EXPORT_SOG},
                 {".glb", EXPORT_GLB},
                 {".3tz", EXPORT_3TZ},
                 {".pmtiles", EXPORT_PMTILES}};
    const char *slash = strrchr(output, '/'), *name = slash ? slash + 1 : output;
    size_t n = strlen(name);
    for (size_t i = 0; i < sizeof known / sizeof *known; i++) {
        size_t m = strlen(known[i].ending);
        if (n > m && !strcasecmp(name + n - m, known[i].ending)) {
            *out = known[i].format;
            return ERR_OK;
        }
    }
    *out = EXPORT_3DTILES;
    const char *dot = strrchr(name, '.');
    return !dot || dot == name || !dot[1] || file_is_dir(output)
               ? ERR_OK
               : err_set(e, ERR_ARG,
                         "%s: no format ends in %s: .ply, .compressed.ply, .spz, .sog, .glb, .3tz "
                         "and .pmtiles are written; for a folder of that name give --format "
                         "3dtiles",
                         output, dot);
}

/* Options of a map would have no effect on another format, nor has --level on all levels. */
static enum err_code export_check_options(const struct export_options *o, int format, struct err *e)
{
    const bool map = format == EXPORT_PMTILES;
    if (!map && (o->zooms || o->map_format || o->dense))
        return err_set(e, ERR_ARG, "--%s is for pmtiles alone; leave it out, or write .pmtiles",
                       o->zooms        ? "zooms"
                       : o->map_format ? "map-format"
                                       : "dense");
    if ((map || format == EXPORT_3DTILES || format == EXPORT_3TZ) && strcmp(o->level, "finest"))
        return err_set(e, ERR_ARG, "--level is not for 3dtiles, 3tz and pmtiles; leave it out");
    if (map && o->geoid)
        return err_set(e, ERR_ARG,
                       "--geoid is not for pmtiles, which has no heights; leave it out");
    return ERR_OK;
}

/* The map is drawn from the store itself. */
static enum err_code export_pmtiles(const char *store, const struct export_options *o,
                                    struct err *e)
{
    const struct export_map m = {.output = o->output,
                                 .device = o->device,
                                 .appearance = o->appearance,
                                 .zooms = o->zooms,
                                 .format = o->map_format,
                                 .dense = o->dense};
    return export_map(store, &m, e);
}

/* Clients of 3D Tiles take heights as ellipsoidal. */
static enum err_code export_raise(struct store *s, const char *name, bool tileset, struct err *e)
{
    const struct store_meta *m = store_info(s);
    struct geoid *geoid = NULL;
    char words[HEIGHTS_WORDS_MAX];
    heights_words(m->heights, words);
    if (heights_ellipsoidal(m->heights))
        return ERR_OK;
    if (!name) {
        if (tileset)
            log_warn("export",
                     "heights count from %s, and clients of 3D Tiles take them as ellipsoidal: up "
                     "to 100 m off%s",
                     words, heights_of_sea(m->heights) ? "; --geoid egm96 converts them" : "");
        return ERR_OK;
    }
    if (!heights_of_sea(m->heights))
        return err_set(e, ERR_DATA, "--geoid %s: heights count from %s, not from the sea", name,
                       words);
    enum err_code rc = geoid_open(name, &geoid, e);
    if (rc)
        return rc;
    const double up_m = geoid_above(geoid, m->origin.lon_deg, m->origin.lat_deg);
    if (isfinite(up_m))
        store_lift(s, up_m);
    else
        rc = err_set(e, ERR_DATA, "--geoid %s: the city lies outside of it", name);
    geoid_close(&geoid);
    return rc;
}

/* The format, and whether the output may be written. */
static enum err_code export_check(const struct export_options *o, const char *store, int *format,
                                  struct err *e)
{
    enum err_code rc = o->output ? ERR_OK : output_needed(o->output, o->overwrite, e);
    if (!rc && *format == EXPORT_AUTO)
        rc = export_format(o->output, format, e);
    if (!rc && *format != EXPORT_3DTILES) /* folders are looked at by their writer */
        rc = output_check(o->output, o->overwrite, e);
    return rc ? rc : output_apart(o->output, store, e);
}

enum err_code cli_export(int argc, char **argv, struct err *e)
{
    struct export_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct store *s = NULL;
    enum err_code rc = options_parse(&export_spec, argc, argv, &o, &args, &arena, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    int format = (int)o.format;
    rc = export_check(&o, args.arg[0], &format, e);
    if (!rc)
        rc = export_check_options(&o, format, e);
    if (!rc && format == EXPORT_PMTILES) {
        rc = export_pmtiles(args.arg[0], &o, e);
        goto out;
    }
    if (!rc)
        rc = store_open(args.arg[0], &s, e);
    if (!rc)
        rc = export_raise(s, o.geoid, format == EXPORT_3DTILES || format == EXPORT_3TZ, e);
    float image[APPEARANCE_IMAGE_MAX];
    const float *chosen = o.appearance ? image : NULL;
    if (!rc && chosen)
        rc = bake_find(s, o.appearance, image, e);
    if (!rc)
        rc = format == EXPORT_3DTILES ? export_3dtiles(s, &o, chosen, e)
             : format == EXPORT_3TZ   ? export_3tz(s, &o, chosen, e)
                                      : export_file(s, &o, format, chosen, e);
out:
    store_close(&s);
    arena_free(&arena);
    return rc;
}
