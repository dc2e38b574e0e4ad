/* 3D Tiles 1.1 and TileJSON 3.0.0 of a store, which map engines read first.
 *
 * Documents are explicit, use REPLACE and have one glb a tile. A large tileset is several
 * documents, each an external tileset of the one above (lod/store/tree.h says where they begin).
 * The root's transform is east-north-up at the scene's origin to ECEF, moved to the root tile's
 * centre. Below it there are only translations, because engines share one rotation, and one
 * rotation of SH, among all tiles of a tileset and its external ones. Boxes are in each tile's own
 * z-up frame. Both names of the splat extensions stand in the tileset's own extensions block,
 * because CesiumJS chooses its splat path by them. 3DTILES_content_gltf is never required in 1.1
 * (specification, section "glTF").
 *
 * The text is written without jansson: a city has 10^5 tiles, and only the root needs numbers with
 * 17 digits.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "lod/export/crop.h"
#include "lod/export/lowpass.h"
#include "lod/export/tileset.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

#define TILESET_TOP_ERROR 4.0 /* of the root's: from how far away the root itself is shown */

struct tileset {
    const struct store_tile *tiles;
    const struct tree *tree;
    const struct tileset_links *links;
    const struct crop_node *left; /* of each node; NULL: all of it */
    uint32_t start;               /* the node that the document begins with */
    bool lowpass;                 /* tiles are named in their low-pass form */
    struct buf *out;
};

const struct tileset_links tileset_of_entry = {.tile = "t/{z}/{x}/{y}.glb",
                                               .lowpass = "t/{z}/{x}/{y}.lowpass.glb",
                                               .part = "tileset/{z}/{x}/{y}.json"};
const struct tileset_links tileset_of_part = {.tile = "../../../t/{z}/{x}/{y}.glb",
                                              .lowpass = "../../../t/{z}/{x}/{y}.lowpass.glb",
                                              .part = "../../{z}/{x}/{y}.json"};

/* A JSON string with everything escaped that must be. */
static void tileset_text(struct buf *b, const char *text)
{
    json_t *j = json_string(text);
    char *s = j ? json_dumps(j, JSON_ENCODE_ANY | JSON_ENSURE_ASCII) : NULL;
    if (s)
        buf_printf(b, "%s", s);
    else
        buf_printf(b, "\"\""); /* not UTF-8, or out of memory */
    free(s);
    json_decref(j);
}

/* The template with {z}, {x}, {y} filled in. */
static void tileset_uri(struct buf *b, const char *template, struct key k)
{
    struct buf uri = {0};
    for (const char *p = template; *p; p++) {
        bool slot = p[0] == '{' && p[1] && p[2] == '}';
        if (slot && (p[1] == 'z' || p[1] == 'x' || p[1] == 'y')) {
            buf_printf(&uri, "%u", p[1] == 'z' ? k.z : p[1] == 'x' ? k.x : k.y);
            p += 2;
        } else {
            buf_u8(&uri, (unsigned char)*p);
        }
    }
    buf_u8(&uri, 0);
    if (uri.failed)
        b->failed = true;
    else
        tileset_text(b, (const char *)uri.data);
    buf_free(&uri);
}

static void tileset_center(const struct tileset *t, uint32_t node, double center[3])
{
    const struct store_shape x =
        node < t->tree->n_tiles ? index_bounds(t->tree->index, node) : (struct store_shape){0};
    memcpy(center, x.center_enu_m, sizeof x.center_enu_m);
}

static void tileset_matrix(struct buf *b, const double m[16])
{
    buf_printf(b, "\"transform\":[");
    for (size_t i = 0; i < 16; i++)
        buf_printf(b, "%s%.17g", i ? "," : "", m[i]);
    buf_printf(b, "],");
}

static void tileset_box(const struct tileset *t, uint32_t node)
{
    const struct tree_bounds b = tree_bounds(t->tree, node);
    double center[3];
    tileset_center(t, node, center);
    buf_printf(t->out, "\"boundingVolume\":{\"box\":[");
    for (size_t k = 0; k < 3; k++)
        buf_printf(t->out, "%.6f,", 0.5 * (b.min_enu_m[k] + b.max_enu_m[k]) - center[k]);
    for (size_t i = 0; i < 9; i++) {
        size_t k = i / 3;
        /* Half a micrometre up, so that rounding never cuts. */
        double half = i % 3 == k ? 0.5 * (b.max_enu_m[k] - b.min_enu_m[k]) + 1e-6 : 0.0;
        buf_printf(t->out, "%s%.6f", i ? "," : "", half);
    }
    buf_printf(t->out, "]}");
}

/* A box around `center`: least, then greatest. */
static void tileset_corners(struct buf *out, const char *name, const double min[3],
                            const double max[3], const double center[3])
{
    buf_printf(out, "\"%s\":[", name);
    for (size_t k = 0; k < 3; k++)
        buf_printf(out, "%s%.3f", k ? "," : "", min[k] - center[k]);
    for (size_t k = 0; k < 3; k++)
        buf_printf(out, ",%.3f", max[k] - center[k]);
    buf_printf(out, "]");
}

/* Where nearly all of the tile is, in its frame: the viewer measures distance to it, as pick.c. At
 * the root also where most of the scene is, which is not known of a part that is cut out. */
static void tileset_extras(const struct tileset *t, uint32_t node, const double center[3])
{
    const struct tree_node v = tree_node(t->tree, node);
    const bool core = v.tile != TREE_NONE && v.child_count > 0,
               root = node == t->tree->root && !t->left;
    if (!core && !root)
        return;
    buf_printf(t->out, ",\"extras\":{");
    if (core) {
        const struct tree_bounds b = tree_bounds(t->tree, node);
        tileset_corners(t->out, "core", b.core_min_enu_m, b.core_max_enu_m, center);
    }
    if (root) {
        double min[3], max[3];
        tree_extent(t->tree, min, max);
        buf_printf(t->out, "%s", core ? "," : "");
        tileset_corners(t->out, "extent", min, max, center);
    }
    buf_printf(t->out, "}");
}

static void tileset_content(const struct tileset *t, const char *template, struct key k)
{
    buf_printf(t->out, ",\"content\":{\"uri\":");
    tileset_uri(t->out, template, k);
    buf_printf(t->out, "}");
}

/* The child of a leaf in its low-pass form: the tile as it is, for those who are nearer. */
static void tileset_near(const struct tileset *t, uint32_t index)
{
    buf_printf(t->out, ",\"children\":[{");
    tileset_box(t, index);
    buf_printf(t->out, ",\"geometricError\":0");
    tileset_content(t, t->links->tile, t->tiles[tree_node(t->tree, index).tile].key);
    buf_printf(t->out, "}]");
}

/* A node and those below it, down to where other documents begin. m: NULL where the document that
 * leads here has moved to this frame already. */
static void tileset_node(const struct tileset *t, uint32_t index, const double *m)
{
    const struct tree_node v = tree_node(t->tree, index);
    const bool elsewhere = v.document && index != t->start;
    const bool shown = v.tile != TREE_NONE && (!t->left || t->left[index].count || elsewhere);
    const double pixel_m = shown && t->lowpass ? lowpass_pixel_m(t->tree, index) : 0.0;
    const bool two = pixel_m > 0.0 && !v.child_count;
    double center[3];
    tileset_center(t, index, center);
    buf_printf(t->out, "{");
    if (m)
        tileset_matrix(t->out, m);
    tileset_box(t, index);
    buf_printf(t->out, ",\"geometricError\":%.9g",
               two ? STORE_PX_PER_SIGMA * pixel_m : v.geometric_error_m);
    if (index == t->start)
        buf_printf(t->out, ",\"refine\":\"REPLACE\"");
    tileset_extras(t, index, center);
    if (shown)
        tileset_content(t,
                        elsewhere       ? t->links->part
                        : pixel_m > 0.0 ? t->links->lowpass
                                        : t->links->tile,
                        t->tiles[v.tile].key);
    if (two)
        tileset_near(t, index);
    uint32_t n = elsewhere ? 0 : v.child_count, n_written = 0;
    for (uint32_t i = 0; i < n; i++) {
        uint32_t c = t->tree->children[v.child_first + i];
        if (t->left && !t->left[c].any)
            continue;
        double at[3], move[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
        tileset_center(t, c, at);
        for (size_t k = 0; k < 3; k++)
            move[12 + k] = at[k] - center[k];
        buf_printf(t->out, "%s", n_written++ ? "," : ",\"children\":[");
        tileset_node(t, c, move); /* at most KEY_ZOOM_MAX + 1 deep */
    }
    buf_printf(t->out, "%s}", n_written ? "]" : "");
}

/* The root's frame: east-north-up at the scene's origin, moved to the root tile's centre. */
static enum err_code tileset_frame(const struct tileset *t, const struct store_meta *m,
                                   double ecef[16], struct err *e)
{
    double center[3];
    enum err_code rc = geo_enu_to_ecef(&m->origin, ecef, e);
    if (rc)
        return rc;
    tileset_center(t, t->tree->root, center);
    for (size_t r = 0; r < 3; r++)
        ecef[12 + r] += ecef[r] * center[0] + ecef[4 + r] * center[1] + ecef[8 + r] * center[2];
    return ERR_OK;
}

bool tileset_has_part(const struct store *s, struct key k)
{
    const struct store_tile *found = store_find(s, k);
    size_t n;
    return found && tree_node(store_tree(s), (size_t)(found - store_tiles(s, &n))).document;
}

enum err_code tileset_write(const struct store *s, const struct tileset_links *links,
                            const struct key *part, const struct crop_node *left, struct buf *out,
                            struct err *e)
{
    static const char names[] =
        "[\"KHR_gaussian_splatting\",\"KHR_gaussian_splatting_compression_spz_2\"]";
    const struct store_meta *m = store_info(s);
    struct tileset t = {.tree = store_tree(s),
                        .links = links,
                        .left = left,
                        .lowpass = links->lowpass && m->antialiased,
                        .out = out};
    double ecef[16];
    size_t n;
    t.tiles = store_tiles(s, &n);
    if (n == 0)
        return err_set(e, ERR_DATA, "tileset: the store has no tiles");
    if (part && !tileset_has_part(s, *part))
        return err_set(e, ERR_NOENT, "tileset: no document begins at tile %u/%u/%u", part->z,
                       part->x, part->y);
    t.start = part ? (uint32_t)(store_find(s, *part) - t.tiles) : t.tree->root;
    const struct tree_node first = tree_node(t.tree, t.start);
    double error_m = first.geometric_error_m;
    if (!part) {
        enum err_code rc = tileset_frame(&t, m, ecef, e);
        if (rc)
            return rc;
        error_m =
            TILESET_TOP_ERROR * fmax(error_m, index_shape(t.tree->index, 0).geometric_error_m);
    }
    buf_printf(out, "{\"asset\":{\"version\":\"1.1\",\"tilesetVersion\":\"%s\"", m->revision);
    if (!part && m->attribution[0]) {
        buf_printf(out, ",\"copyright\":");
        tileset_text(out, m->attribution);
    }
    if (!part) {
        char datum[HEIGHTS_WORDS_MAX];
        heights_datum(m->heights, datum);
        buf_printf(out, ",\"extras\":{\"verticalDatum\":\"%s\"", datum);
        if (m->attribution[0]) {
            buf_printf(out, ",\"cesium\":{\"credits\":[{\"html\":");
            tileset_text(out, m->attribution);
            buf_printf(out, ",\"showOnScreen\":true}]}");
        }
        buf_printf(out, "}");
    }
    buf_printf(
        out,
        "},\"extensionsUsed\":[\"3DTILES_content_gltf\"],\"extensions\":{\"3DTILES_content_gltf\":"
        "{\"extensionsUsed\":%s,\"extensionsRequired\":%s}},\"geometricError\":%.9g,\"root\":",
        names, names, error_m);
    tileset_node(&t, t.start, part ? NULL : ecef);
    buf_printf(out, "}\n");
    return buf_check(out, e);
}

/* ---- TileJSON ---- */

/* West, south, east, north of the finest tiles there are. */
static void tileset_bounds(const struct store *s, double out[4])
{
    const struct tree *t = store_tree(s);
    size_t n;
    const struct store_tile *tiles = store_tiles(s, &n);
    out[0] = out[1] = HUGE_VAL;
    out[2] = out[3] = -HUGE_VAL;
    for (size_t i = 0; i < n; i++) {
        if (!tree_leaf(t, i))
            continue;
        double w, so, ea, no;
        key_bounds(tiles[i].key, &w, &so, &ea, &no);
        out[0] = fmin(out[0], w);
        out[1] = fmin(out[1], so);
        out[2] = fmax(out[2], ea);
        out[3] = fmax(out[3], no);
    }
}

/* One row a tile, so that a client can select levels and keep a budget without asking again. */
static void tileset_rows(const struct store *s, struct buf *out)
{
    const struct tree *t = store_tree(s);
    size_t n;
    const struct store_tile *tiles = store_tiles(s, &n);
    buf_printf(out, "\"tile_fields\":[\"z\",\"x\",\"y\",\"level\",\"version\",\"count\",\"bytes\","
                    "\"geometric_error_m\",\"sigma_max_m\",\"center_e\",\"center_n\",\"center_u\","
                    "\"min_e\",\"min_n\",\"min_u\",\"max_e\",\"max_n\",\"max_u\"],\n\"tiles\":[");
    for (size_t i = 0; i < n; i++) {
        const struct store_tile *x = &tiles[i];
        const struct store_shape at = index_bounds(t->index, i);
        buf_printf(out, "%s\n[%u,%u,%u,%u,%u,%u,%llu,%.7g,%.7g", i ? "," : "", x->key.z, x->key.x,
                   x->key.y, x->level, x->version, x->count, (unsigned long long)x->bytes,
                   tree_node(t, i).geometric_error_m, at.sigma_max_m);
        for (size_t k = 0; k < 3; k++)
            buf_printf(out, ",%.17g", at.center_enu_m[k]);
        for (size_t k = 0; k < 3; k++)
            buf_printf(out, ",%.4f", at.min_enu_m[k] - 1e-4); /* outwards, whatever the rounding */
        for (size_t k = 0; k < 3; k++)
            buf_printf(out, ",%.4f", at.max_enu_m[k] + 1e-4);
        buf_printf(out, "]");
    }
    buf_printf(out, "]");
}

enum err_code tileset_tilejson(const struct store *s, const char *tiles_template, struct buf *out,
                               struct err *e)
{
    const struct store_meta *m = store_info(s);
    size_t n;
    const struct store_tile *tiles = store_tiles(s, &n);
    if (n == 0)
        return err_set(e, ERR_DATA, "tilejson: the store has no tiles");
    const struct tree_bounds root = tree_bounds(store_tree(s), store_tree(s)->root);
    double b[4];
    uint64_t total = 0, bytes = 0;
    uint8_t top = 0;
    for (size_t i = 0; i < n; i++) {
        total += tree_leaf(store_tree(s), i) ? tiles[i].count : 0;
        bytes += tiles[i].bytes;
        top = tiles[i].level > top ? tiles[i].level : top;
    }
    tileset_bounds(s, b);
    buf_printf(out,
               "{\"tilejson\":\"3.0.0\",\"name\":\"%s\",\"version\":\"1.0.0\",\"scheme\":\"xyz\","
               "\"tiles\":[",
               m->name);
    tileset_text(out, tiles_template);
    buf_printf(out,
               "],\"vector_layers\":[],\"minzoom\":%u,\"maxzoom\":%u,\"attribution\":", m->zoom_min,
               m->zoom_max);
    tileset_text(out, m->attribution);
    buf_printf(out, ",\n\"bounds\":[%.12g,%.12g,%.12g,%.12g],\"center\":[%.12g,%.12g,%u],\n", b[0],
               b[1], b[2], b[3], 0.5 * (b[0] + b[2]), 0.5 * (b[1] + b[3]), m->zoom_max);
    buf_printf(
        out,
        "\"splats\":{\"revision\":\"%s\",\"created\":\"%s\",\"origin\":[%.17g,%.17g,%.17g],"
        "\"frame\":\"enu\",\"levels\":%u,\"sh_degree\":%u,\"embed_len\":%u,\"antialiased\":%s,"
        "\"gaussians\":%llu,\"store_bytes\":%llu,\n\"box_enu_m\":[",
        m->revision, m->created, m->origin.lon_deg, m->origin.lat_deg, m->origin.h_m, top,
        m->sh_degree, m->embed_len, m->antialiased ? "true" : "false", (unsigned long long)total,
        (unsigned long long)bytes);
    for (size_t k = 0; k < 6; k++)
        buf_printf(out, "%s%.3f", k ? "," : "", k < 3 ? root.min_enu_m[k] : root.max_enu_m[k - 3]);
    buf_printf(out, "],\n");
    if (store_footprint(s))
        buf_printf(out, "\"footprint\":%s,\n", store_footprint(s));
    tileset_rows(s, out);
    buf_printf(out, "}}\n");
    return buf_check(out, e);
}
