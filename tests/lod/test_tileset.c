/* 3D Tiles 1.1 and TileJSON 3.0.0 of a store, checked against the rules that engines rely on.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/lod/store_kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/splat/camera.h"
#include "lod/choose/pick.h"
#include "lod/export/tileset.h"
#include "lod/make/pyramid.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

#define PLACE_TOLERANCE_M                                                                          \
    1e-3 /* boxes are printed to micrometres; ECEF doubles hold nanometres                         \
          */

static void build(struct store_fixture *f, const struct geo_origin *origin, size_t n,
                  const char *attribution)
{
    struct err e = {0};
    struct gauss g;
    struct pyramid_config c = {.tile_edge_m = 60, .name = "rules"};
    snprintf(c.attribution, sizeof c.attribution, "%s", attribution);
    kit_gauss(1, n, 150, 0, 0, &g);
    store_fixture_level(f->path, origin, &g, &c, NULL);
    kit_ok(store_open(f->path, &f->s, &e), e);
    gauss_free(&g);
}

static json_t *document_of(const struct store *s, const struct key *part)
{
    struct err e = {0};
    struct buf b = {0};
    json_t *j;
    kit_ok(tileset_write(s, part ? &tileset_of_part : &tileset_of_entry, part, NULL, &b, &e), e);
    kit_ok(jsonc_parse((const char *)b.data, b.size, "tileset", &j, &e), e);
    buf_free(&b);
    return j;
}

static json_t *tileset_of(struct store_fixture *f)
{
    return document_of(f->s, NULL);
}

static void nums(const json_t *a, size_t n, double *out)
{
    assert_int_equal(json_array_size(a), n);
    for (size_t i = 0; i < n; i++) {
        assert_true(json_is_number(json_array_get(a, i)));
        out[i] = json_number_value(json_array_get(a, i));
    }
}

static void assert_names(const json_t *a, const char *one, const char *two)
{
    assert_int_equal(json_array_size(a), two ? 2 : 1);
    assert_string_equal(json_string_value(json_array_get(a, 0)), one);
    if (two)
        assert_string_equal(json_string_value(json_array_get(a, 1)), two);
}

static void heads_are_what_engines_look_for(void **state)
{
    struct store_fixture *f = *state;
    build(f, &(struct geo_origin){8.6821, 50.1109, 160}, 3000, "© Survey <2026> & \"Co\"");
    json_t *j = tileset_of(f);
    json_t *asset = json_object_get(j, "asset");
    assert_string_equal(json_string_value(json_object_get(asset, "version")), "1.1");
    assert_string_equal(json_string_value(json_object_get(asset, "tilesetVersion")),
                        store_info(f->s)->revision);
    json_t *credits =
        json_object_get(json_object_get(json_object_get(asset, "extras"), "cesium"), "credits");
    assert_string_equal(json_string_value(json_object_get(json_array_get(credits, 0), "html")),
                        "© Survey <2026> & \"Co\"");
    assert_true(json_is_true(json_object_get(json_array_get(credits, 0), "showOnScreen")));
    assert_string_equal(json_string_value(json_object_get(asset, "copyright")),
                        "© Survey <2026> & \"Co\"");
    assert_string_equal(
        json_string_value(json_object_get(json_object_get(asset, "extras"), "verticalDatum")),
        "WGS 84 ellipsoid");
    assert_names(json_object_get(j, "extensionsUsed"), "3DTILES_content_gltf", NULL);
    assert_null(json_object_get(j, "extensionsRequired")); /* never in 1.1 */
    json_t *block = json_object_get(json_object_get(j, "extensions"), "3DTILES_content_gltf");
    const char *base = "KHR_gaussian_splatting", *spz = "KHR_gaussian_splatting_compression_spz_2";
    assert_names(json_object_get(block, "extensionsUsed"), base, spz);
    assert_names(json_object_get(block, "extensionsRequired"), base, spz);
    json_t *root = json_object_get(j, "root");
    assert_string_equal(json_string_value(json_object_get(root, "refine")), "REPLACE");
    assert_true(json_number_value(json_object_get(j, "geometricError")) >
                json_number_value(json_object_get(root, "geometricError")));
    json_decref(j);
}

struct walk {
    const struct store *s;
    size_t n_tiles, n_documents, n_nodes, most; /* n_nodes: of the document under way */
    double rot[9];                              /* of the root */
};
enum begins { ENTRY, CHILD, PART };

/* False: the address of another document, of the template `links` has for it. */
static bool key_of_uri(const char *uri, bool part, struct key *out)
{
    const char *forms[] = {part ? "../../../t/%u/%u/%u.glb%n" : "t/%u/%u/%u.glb%n",
                           part ? "../../%u/%u/%u.json%n" : "tileset/%u/%u/%u.json%n"};
    unsigned z, x, y;
    for (int k = 0; k < 2; k++) {
        int end = 0;
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wformat-nonliteral"
        bool is = sscanf(uri, forms[k], &z, &x, &y, &end) == 3 && end && !uri[end];
#pragma GCC diagnostic pop
        *out = (struct key){(uint8_t)z, x, y};
        if (is)
            return k == 0;
    }
    fail_msg("%s: no address of a tile or of a document", uri);
    return false;
}

static void walk(struct walk *w, const json_t *node, const double at[3], double error_above,
                 enum begins how, bool part);

/* Another document: what it begins with is the node that led to it. */
static void walk_part(struct walk *w, struct key k, const json_t *node, const double at[3],
                      double error_above)
{
    json_t *j = document_of(w->s, &k), *root = json_object_get(j, "root");
    size_t n_nodes = w->n_nodes;
    w->n_nodes = 0;
    w->n_documents++;
    assert_true(tileset_has_part(w->s, k));
    assert_null(json_object_get(node, "children"));
    assert_true(json_equal(json_object_get(node, "boundingVolume"),
                           json_object_get(root, "boundingVolume")));
    assert_true(json_equal(json_object_get(node, "geometricError"),
                           json_object_get(root, "geometricError")));
    assert_true(
        json_equal(json_object_get(j, "geometricError"), json_object_get(root, "geometricError")));
    assert_string_equal(json_string_value(json_object_get(root, "refine")), "REPLACE");
    assert_non_null(json_object_get(json_object_get(j, "extensions"), "3DTILES_content_gltf"));
    walk(w, root, at, error_above, PART, true);
    w->most = w->n_nodes > w->most ? w->n_nodes : w->most;
    w->n_nodes = n_nodes;
    json_decref(j);
}

/* The root says where most of the scene is, by its own tile or by those that stand side by side:
 * sky and ground are drawn for it, by the viewer and by the server. */
static void walk_extent(const struct walk *w, const json_t *root)
{
    const struct tree *tree = store_tree(w->s);
    struct store_shape x = {0};
    double got[6], min[3], max[3];
    size_t n;
    if (tree->root < tree->n_tiles)
        x = store_shape(w->s, store_tiles(w->s, &n) + tree->root);
    nums(json_object_get(json_object_get(root, "extras"), "extent"), 6, got);
    tree_extent(tree, min, max);
    double low[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, high[3] = {-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
    const struct store_tile *tiles = store_tiles(w->s, &n);
    for (size_t i = 0; i < n; i++) {
        const struct store_shape top = store_shape(w->s, &tiles[i]);
        const uint32_t parent = tree_node(tree, i).parent;
        for (size_t k = 0; k < 3 && (parent == TREE_NONE || parent >= tree->n_tiles); k++) {
            low[k] = fmin(low[k], top.core_min_enu_m[k]);
            high[k] = fmax(high[k], top.core_max_enu_m[k]);
        }
    }
    for (size_t k = 0; k < 3; k++) {
        const double cut = 0.03125 * (high[k] - low[k]);
        assert_true(fabs(min[k] - low[k] - cut) < 1e-6 && fabs(high[k] - cut - max[k]) < 1e-6);
        assert_true(fabs(got[k] + x.center_enu_m[k] - min[k]) < 1e-3);
        assert_true(fabs(got[3 + k] + x.center_enu_m[k] - max[k]) < 1e-3);
    }
}

/* Tiles that may be replaced say where nearly all of them is: the viewer chooses by it. */
static void walk_core(const struct walk *w, const struct store_tile *t, const json_t *node)
{
    size_t n;
    const uint32_t at = (uint32_t)(t - store_tiles(w->s, &n));
    const struct tree_node v = tree_node(store_tree(w->s), at);
    const struct tree_bounds b = tree_bounds(store_tree(w->s), at);
    const struct store_shape x = store_shape(w->s, t);
    const json_t *core = json_object_get(json_object_get(node, "extras"), "core");
    double got[6];
    if (!v.child_count) {
        assert_null(core);
        return;
    }
    nums(core, 6, got);
    for (size_t k = 0; k < 3; k++) {
        assert_true(fabs(got[k] + x.center_enu_m[k] - b.core_min_enu_m[k]) < 1e-3);
        assert_true(fabs(got[3 + k] + x.center_enu_m[k] - b.core_max_enu_m[k]) < 1e-3);
    }
}

/* `at` is the ECEF place of the parent's frame, of a part's root its own. */
static void walk(struct walk *w, const json_t *node, const double at[3], double error_above,
                 enum begins how, bool part)
{
    struct err e = {0};
    double m[16], box[12], here[3];
    struct key k;
    if (how != PART)
        nums(json_object_get(node, "transform"), 16, m);
    nums(json_object_get(json_object_get(node, "boundingVolume"), "box"), 12, box);
    w->n_nodes++;
    if (how == PART) {
        memcpy(here, at, sizeof here);
        assert_null(json_object_get(node, "transform"));
    } else if (how == ENTRY) {
        for (size_t c = 0; c < 3; c++)
            for (size_t r = 0; r < 3; r++)
                w->rot[3 * r + c] = m[4 * c + r];
        memcpy(here, m + 12, sizeof here);
    } else { /* nothing but a translation, in the root's axes */
        for (size_t i = 0; i < 12; i++)
            assert_true(m[i] == (i % 5 == 0 ? 1.0 : 0.0));
        for (size_t r = 0; r < 3; r++)
            here[r] = at[r] + w->rot[3 * r] * m[12] + w->rot[3 * r + 1] * m[13] +
                      w->rot[3 * r + 2] * m[14];
        assert_null(json_object_get(node, "refine"));
    }
    assert_true(how == PART || (m[3] == 0 && m[7] == 0 && m[11] == 0 && m[15] == 1));
    double error = json_number_value(json_object_get(node, "geometricError"));
    assert_true(error < error_above);
    json_t *children = json_object_get(node, "children");
    json_t *content = json_object_get(node, "content");
    if (content && !key_of_uri(json_string_value(json_object_get(content, "uri")), part, &k)) {
        walk_part(w, k, node, here, error_above);
        return;
    }
    assert_true(json_array_size(children) > 0 ? error > 0 : error == 0);
    if (content) {
        const struct store_tile *t = store_find(w->s, k);
        assert_non_null(t);
        w->n_tiles++;
        walk_core(w, t, node);
        const struct store_shape x = store_shape(w->s, t);
        /* The frame stands at the payload's origin: ENU -> ECEF of it by geodesy alone. */
        double lon, lat, h, place[16];
        kit_ok(geo_from_enu(&store_info(w->s)->origin, x.center_enu_m, &lon, &lat, &h, &e), e);
        kit_ok(geo_enu_to_ecef(&(struct geo_origin){lon, lat, h}, place, &e), e);
        kit_near_d("frame", here, place + 12, 3, PLACE_TOLERANCE_M, 0);
        for (size_t k3 = 0; k3 < 3; k3++) { /* the box holds the tile's own bounds */
            double c = box[k3], half = box[3 + 4 * k3];
            assert_true(c - half <= x.min_enu_m[k3] - x.center_enu_m[k3] + 1e-6);
            assert_true(c + half >= x.max_enu_m[k3] - x.center_enu_m[k3] - 1e-6);
        }
    }
    for (size_t i = 0; i < 9; i++)
        assert_true(i % 4 == 0 ? box[3 + i] > 0 : box[3 + i] == 0);
    json_t *child;
    size_t i;
    json_array_foreach(children, i, child)
    {
        walk(w, child, here, error, CHILD, part);
        double cm[16], cb[12]; /* children's boxes lie within */
        nums(json_object_get(child, "transform"), 16, cm);
        nums(json_object_get(json_object_get(child, "boundingVolume"), "box"), 12, cb);
        for (size_t k3 = 0; k3 < 3; k3++)
            assert_true(fabs(cm[12 + k3] + cb[k3] - box[k3]) + cb[3 + 4 * k3] <=
                        box[3 + 4 * k3] + 1e-5);
    }
}

static struct walk walk_store(const struct store *s)
{
    struct err e = {0};
    struct walk w = {.s = s};
    const double none[3] = {0};
    double ecef[16];
    size_t n;
    json_t *j = document_of(s, NULL);
    walk(&w, json_object_get(j, "root"), none, HUGE_VAL, ENTRY, false);
    walk_extent(&w, json_object_get(j, "root"));
    w.most = w.n_nodes > w.most ? w.n_nodes : w.most;
    store_tiles(s, &n);
    assert_int_equal(w.n_tiles, n); /* every tile once */
    kit_ok(geo_enu_to_ecef(&store_info(s)->origin, ecef, &e), e);
    double got[9], want[9];
    for (size_t c = 0; c < 3; c++)
        for (size_t r = 0; r < 3; r++) {
            got[3 * r + c] = w.rot[3 * r + c];
            want[3 * r + c] = ecef[4 * c + r];
        }
    kit_near_d("rotation", got, want, 9, 0, 0); /* 17 digits: to the last bit */
    json_decref(j);
    return w;
}

static void walk_all(struct store_fixture *f)
{
    assert_int_equal(walk_store(f->s).n_documents, 0); /* small ones are one document */
}

/* ---- several documents ---- */

/* One Gaussian in each tile of `levels` levels below the tile at the origin, `keep` of 4 children
 * of each. */
static void put_below(struct store *s, struct key key, int levels, unsigned keep)
{
    static const struct geo_origin origin = {8.6821, 50.1109, 160};
    struct err e = {0};
    struct gauss g;
    double lon, lat;
    key_center(key, &lon, &lat);
    kit_gauss(1, 1, 0.01, 0, 0, &g);
    kit_ok(geo_to_enu(&origin, lon, lat, 160, g.origin_enu_m, &e), e);
    struct store_entry t = {.tile = {.key = key, .level = 1}};
    kit_ok(store_put(s, &t, &g, &e), e);
    gauss_free(&g);
    for (unsigned i = 0; levels && i < 4; i++)
        if (keep >> i & 1)
            put_below(s, (struct key){(uint8_t)(key.z + 1), 2 * key.x + i % 2, 2 * key.y + i / 2},
                      levels - 1, keep);
}

static void large_ones_are_several_documents(void **state)
{
    struct store_fixture *f = *state;
    /* Tiles, documents below the entry, most nodes of one. */
    static const struct {
        int levels;
        unsigned keep;
        size_t n, documents, most;
    } rows[] = {
        {4, 15, 341, 0, 341},   {5, 15, 1365, 4, 341}, /* of the four tiles of the second level */
        {6, 15, 5461, 16, 341},                        /* of the sixteen of the third */
        {9, 1, 10, 0, 10},                             /* a chain */
        {9, 3, 1023, 0, 1023},                         /* two children each */
        {10, 3, 2047, 2, 1023}, {6, 7, 1093, 3, 364},
    };
    const struct geo_origin origin = {8.6821, 50.1109, 160};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct err e = {0};
        struct store *s;
        struct buf b = {0};
        char path[FILE_PATH_MAX];
        snprintf(path, sizeof path, "%.3900s.%zu", f->path, i);
        const struct store_meta meta = {.name = "many", .origin = origin};
        kit_ok(store_create(path, &meta, &s, &e), e);
        put_below(s, key_at(origin.lon_deg, origin.lat_deg, 12), rows[i].levels, rows[i].keep);
        kit_ok(store_commit(&s, &e), e);
        kit_ok(store_open(path, &s, &e), e);
        struct walk w = walk_store(s);
        if (w.n_tiles != rows[i].n || w.n_documents != rows[i].documents || w.most != rows[i].most)
            fail_msg("row %zu: %zu tiles, %zu documents, at most %zu nodes", i, w.n_tiles,
                     w.n_documents, w.most);
        const struct key root = key_at(origin.lon_deg, origin.lat_deg, 12), none = {3, 1, 1};
        assert_false(tileset_has_part(s, root));
        assert_false(tileset_has_part(s, none));
        assert_int_equal(tileset_write(s, &tileset_of_part, &none, NULL, &b, &e), ERR_NOENT);
        buf_free(&b);
        store_close(&s);
    }
}

static void transforms_errors_and_boxes(void **state)
{
    struct store_fixture *f = *state;
    build(f, &(struct geo_origin){-122.4, 37.8, 30}, 4000, "");
    json_t *j = tileset_of(f);
    const json_t *asset = json_object_get(j, "asset");
    assert_null(json_object_get(asset, "copyright"));
    assert_null(json_object_get(json_object_get(asset, "extras"), "cesium"));
    json_decref(j);
    walk_all(f);
}

static void a_root_without_content(void **state)
{
    struct store_fixture *f = *state;
    build(f, &(struct geo_origin){0, 0, 0}, 500, "");
    json_t *j = tileset_of(f);
    assert_null(json_object_get(json_object_get(j, "root"), "content"));
    json_decref(j);
    walk_all(f);
}

static void tilejson(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct buf b = {0};
    json_t *j;
    double bounds[4], center[3];
    size_t n;
    build(f, &(struct geo_origin){8.6821, 50.1109, 160}, 3000, "A & B");
    kit_ok(tileset_tilejson(f->s, "r/abc/t/{z}/{x}/{y}.drc", &b, &e), e);
    kit_ok(jsonc_parse((const char *)b.data, b.size, "tilejson", &j, &e), e);
    assert_string_equal(json_string_value(json_object_get(j, "tilejson")), "3.0.0");
    assert_names(json_object_get(j, "tiles"), "r/abc/t/{z}/{x}/{y}.drc", NULL);
    assert_string_equal(json_string_value(json_object_get(j, "scheme")), "xyz");
    assert_string_equal(json_string_value(json_object_get(j, "attribution")), "A & B");
    assert_int_equal(json_integer_value(json_object_get(j, "minzoom")), store_info(f->s)->zoom_min);
    assert_int_equal(json_integer_value(json_object_get(j, "maxzoom")), store_info(f->s)->zoom_max);
    nums(json_object_get(j, "bounds"), 4, bounds);
    nums(json_object_get(j, "center"), 3, center);
    assert_true(bounds[0] < 8.6821 && bounds[2] > 8.6821 && bounds[1] < 50.1109 &&
                bounds[3] > 50.1109);
    assert_true(center[0] > bounds[0] && center[0] < bounds[2] && center[1] > bounds[1] &&
                center[1] < bounds[3]);
    json_t *s = json_object_get(j, "splats"), *fields = json_object_get(s, "tile_fields");
    assert_string_equal(json_string_value(json_object_get(s, "revision")),
                        store_info(f->s)->revision);
    assert_int_equal(json_integer_value(json_object_get(s, "gaussians")), 3000);
    const struct store_tile *t = store_tiles(f->s, &n);
    json_t *rows = json_object_get(s, "tiles");
    assert_int_equal(json_array_size(rows), n);
    assert_int_equal(json_array_size(fields), 18);
    for (size_t i = 0; i < n; i++) {
        double row[18];
        const struct store_shape x = store_shape(f->s, &t[i]);
        nums(json_array_get(rows, i), 18, row);
        assert_true(row[0] == t[i].key.z && row[1] == t[i].key.x && row[2] == t[i].key.y);
        assert_true(row[5] == t[i].count && row[6] == (double)t[i].bytes);
        for (size_t k = 0; k < 3; k++)
            assert_true(row[9 + k] == x.center_enu_m[k] && row[12 + k] <= x.min_enu_m[k] &&
                        row[15 + k] >= x.max_enu_m[k]);
    }
    json_decref(j);
    buf_free(&b);
}

/* 87,381 tiles, without their Gaussians. */
static void documents_of_a_large_city(void **state)
{
    struct err e = {0};
    struct tree tree;
    size_t n = 0, documents = 0;
    struct index index = {0};
    for (uint8_t z = 10; z <= 18; z++) /* in the order of key_compare */
        for (uint32_t y = 0; y < 1u << (z - 10); y++)
            for (uint32_t x = 0; x < 1u << (z - 10); x++) {
                const struct store_entry t = {.tile.key = {z, x, y},
                                              .shape.geometric_error_m = 1u << (18 - z)};
                kit_ok(index_add(&index, &t, 0, &e), e);
                n++;
            }
    assert_int_equal(n, 87381);
    kit_ok(tree_build(&index, &tree, &e), e);
    for (size_t i = 0; i < n; i++) {
        documents += tree_node(&tree, i).document;
        assert_int_equal(tree_node(&tree, i).document, index.tiles[i].key.z == 14);
        assert_true(!tree_node(&tree, i).document || tree_node(&tree, i).n_below == 341);
    }
    assert_int_equal(documents, 256);
    tree_free(&tree);
    index_free(&index);
}

/* ---- geometric errors: against their definition ---- */

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* 16 times the median over the tile of each Gaussian's largest sigma. */
static double defined_error(struct store *s, struct key k)
{
    struct err e = {0};
    struct gauss g;
    kit_ok(store_read_gauss(s, k, &g, &e), e);
    double *big = mem_array(g.n, sizeof *big);
    for (size_t i = 0; i < g.n; i++) {
        const float *x = &g.scale_log[3 * i];
        big[i] = exp(fmax(fmax((double)x[0], (double)x[1]), (double)x[2]));
    }
    qsort(big, g.n, sizeof *big, compare_doubles);
    double median = big[g.n / 2];
    mem_free(big);
    gauss_free(&g);
    return 16.0 * median;
}

struct errors_found {
    const struct tree *tree;
    struct store *s;
    size_t n;
};

/* Errors in the document are those of the tree. */
static void compare_errors(struct errors_found *f, const json_t *node)
{
    const json_t *content = json_object_get(node, "content");
    size_t i, n;
    json_t *child;
    if (content) {
        struct key k;
        assert_true(key_of_uri(json_string_value(json_object_get(content, "uri")), false, &k));
        const struct store_tile *first = store_tiles(f->s, &n);
        const struct tree_node v = tree_node(f->tree, (size_t)(store_find(f->s, k) - first));
        double got = json_number_value(json_object_get(node, "geometricError"));
        assert_true(fabs(got - v.geometric_error_m) <= 1e-8 * v.geometric_error_m);
        f->n++;
    }
    json_array_foreach(json_object_get(node, "children"), i, child) compare_errors(f, child);
}

/* Is the node's tile, or one above it, shown by a camera that looks down from so far over its core?
 */
static bool is_refined(struct store *s, uint32_t node, double distance_m)
{
    struct err e = {0};
    size_t n_out;
    const struct tree *tree = store_tree(s);
    uint32_t *out = mem_array(tree->n_tiles, sizeof *out);
    const struct tree_bounds b = tree_bounds(tree, node);
    const double eye[3] = {0.5 * (b.core_min_enu_m[0] + b.core_max_enu_m[0]),
                           0.5 * (b.core_min_enu_m[1] + b.core_max_enu_m[1]),
                           b.core_max_enu_m[2] + distance_m};
    const double down[3] = {eye[0], eye[1] + 1e-3, eye[2] - 1};
    struct camera cam = camera_look_at(eye, down, 2.8, 2000, 2000);
    bool shown = false;
    kit_ok(pick_select(tree, &cam, NULL, out, &n_out, &e), e);
    for (size_t i = 0; i < n_out; i++)
        for (uint32_t up = node; up != TREE_NONE; up = tree_node(tree, up).parent)
            shown = shown || out[i] == up;
    mem_free(out);
    return !shown;
}

static void errors_are_what_is_documented(void **state)
{
    struct store_fixture *f = *state;
    struct err e = {0};
    struct gauss g;
    const struct geo_origin origin = {8.6821, 50.1109, 160};
    const struct pyramid_config c = {.tile_edge_m = 60, .name = "errors", .lossless = true};
    kit_gauss(2, 3000, 100, 0, 0, &g);
    for (size_t i = 0; i < g.n; i++) /* one corner is far coarser than the rest */
        for (size_t k = 0; k < 3; k++)
            g.scale_log[3 * i + k] += g.mean_m[3 * i] + g.mean_m[3 * i + 1] > 120 ? 1.5f : -1.0f;
    const struct pyramid_level level = {.g = &g, .level = 3};
    kit_ok(pyramid_build(&origin, &level, 1, &c, NULL, 0, f->path, NULL, &e), e);
    kit_ok(store_open(f->path, &f->s, &e), e);
    gauss_free(&g);
    size_t n, cut = 0;
    const struct store_tile *t = store_tiles(f->s, &n);
    const struct tree *tree = store_tree(f->s);
    assert_true(tree_node(tree, tree->root).tile != TREE_NONE && n > 10);
    for (size_t i = 0; i < n; i++) {
        const struct tree_node v = tree_node(tree, i);
        const struct store_shape x = store_shape(f->s, &t[i]);
        double own = defined_error(f->s, t[i].key), want = own;
        /* In the store: of the rows alone. */
        assert_true(fabs(x.geometric_error_m - own) <= 1e-6 * own);
        assert_true(fabs(x.sigma_median_m - own / 16) <= 1e-6 * own);
        /* In the tree: 0 at the near end, elsewhere the tile's own, cut to less than the parent's.
         */
        if (v.parent != TREE_NONE)
            want = fmin(own, tree_node(tree, v.parent).geometric_error_m / 1.01);
        want = v.child_count ? want : 0.0;
        cut += v.child_count > 0 && want < own;
        assert_true(fabs(v.geometric_error_m - want) <= 1e-6 * want);
        if (v.parent != TREE_NONE)
            assert_true(tree_node(tree, v.parent).geometric_error_m > v.geometric_error_m);
        if (!v.child_count)
            continue;
        /* Selection switches where error f / d is 16 px: 1 px of sigma. */
        struct camera cam =
            camera_look_at((double[3]){0, 0, 1}, (double[3]){0, 1e-3, 0}, 2.8, 2000, 2000);
        double at = v.geometric_error_m * cam.fy_px / 16;
        assert_true(is_refined(f->s, (uint32_t)i, 0.999 * at));
        assert_false(is_refined(f->s, (uint32_t)i, 1.001 * at));
    }
    assert_true(cut > 0); /* or nothing would have tested that */
    double root_own = defined_error(f->s, t[tree_node(tree, tree->root).tile].key);
    assert_true(fabs(tree_node(tree, tree->root).geometric_error_m - root_own) <= 1e-6 * root_own);
    /* The far end: the error above all of them is beyond the root's. */
    json_t *j = tileset_of(f);
    struct errors_found found = {.tree = tree, .s = f->s};
    compare_errors(&found, json_object_get(j, "root"));
    assert_int_equal(found.n, n);
    assert_true(json_number_value(json_object_get(j, "geometricError")) >=
                2 * tree_node(tree, tree->root).geometric_error_m);
    json_decref(j);
}

/* The footprint travels as it was stored; what is no JSON never reaches a document. */
static void footprint(void **state)
{
    static const char good[] =
        "{\"type\":\"Feature\",\"properties\":{},\"geometry\":{\"type\":"
        "\"MultiPolygon\",\"coordinates\":[[[[8,50],[9,50],[9,51],[8,50]]]]}}",
                      bad[] = "{\"type\":\"Feature\"}, \"evil\": 1";
    struct store_fixture *f = *state;
    struct err e = {0};
    const struct geo_origin origin = {8.6821, 50.1109, 160};
    build(f, &origin, 3000, "A");
    assert_null(store_footprint(f->s));
    for (int k = 0; k < 2; k++) {
        char path[FILE_PATH_MAX];
        struct store *s;
        struct buf b = {0};
        json_t *j;
        size_t n;
        snprintf(path, sizeof path, "%.3900s.ground", f->path);
        struct store_meta meta = *store_info(f->s);
        const struct store_tile *t = store_tiles(f->s, &n);
        kit_ok(store_create(path, &meta, &s, &e), e);
        for (size_t i = 0; i < n; i++) {
            struct gauss g;
            struct store_entry copy = {.tile = {.key = t[i].key, .level = t[i].level}};
            kit_ok(store_read_gauss(f->s, t[i].key, &g, &e), e);
            kit_ok(store_put(s, &copy, &g, &e), e);
            gauss_free(&g);
        }
        kit_ok(store_put_blob(s, STORE_FOOTPRINT, k ? bad : good, strlen(k ? bad : good), &e), e);
        kit_ok(store_commit(&s, &e), e);
        log_set_level(LOG_ERROR); /* it warns of the bad one */
        kit_ok(store_open(path, &s, &e), e);
        log_set_level(LOG_WARN);
        kit_ok(tileset_tilejson(s, "t/{z}/{x}/{y}.drc", &b, &e), e);
        kit_ok(jsonc_parse((const char *)b.data, b.size, "tilejson", &j, &e), e);
        const json_t *ground = json_object_get(json_object_get(j, "splats"), "footprint");
        json_t *want = NULL;
        kit_ok(jsonc_parse(good, strlen(good), "stored", &want, &e), e);
        assert_true(k ? !ground : json_equal(ground, want));
        json_decref(want);
        json_decref(j);
        buf_free(&b);
        store_close(&s);
    }
}

int main(void)
{
#define CASE(name)                                                                                 \
    cmocka_unit_test_setup_teardown(name, store_fixture_setup, store_fixture_teardown)
    progress_quiet(true);
    const struct CMUnitTest tests[] = {
        CASE(heads_are_what_engines_look_for),
        CASE(transforms_errors_and_boxes),
        CASE(a_root_without_content),
        CASE(large_ones_are_several_documents),
        CASE(documents_of_a_large_city),
        CASE(errors_are_what_is_documented),
        CASE(tilejson),
        CASE(footprint),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
