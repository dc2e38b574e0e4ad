/* citysplat info: the content of a file. It makes one JSON object and prints it as JSON or as text.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "cli/base/cli.h"
#include "cli/base/splats.h"
#include "cli/tiles/info_device.h"
#include "codec/scene/scene.h"
#include "core/splat/appearance.h"
#include "lod/store/bake.h"
#include "lod/store/photograph.h"
#include "lod/store/store.h"
#include "lod/store/tree.h"

struct info_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/info.def"
};

static const struct options_def info_defs[] = {
#define OPT(...) OPTIONS_ROW(struct info_options, __VA_ARGS__)
#include "cli/tiles/info.def"
};

static const struct options_spec info_spec = {
    .command = "info",
    .usage = "citysplat info FILE | --device NAME [--json]",
    .about =
        "Prints what a tile store, a scene, a checkpoint or a file of Gaussians (.ply .spz "
        ".glb .drc .splat) holds: counts, sizes, bounds, levels. With --device: what the OpenCL "
        "device is, and whether its driver compiles our kernels.",
    .example = "citysplat info city.tiles\ncitysplat info bridge.ply --json\n"
               "citysplat info --device auto",
    .defs = info_defs,
    .n_defs = sizeof info_defs / sizeof *info_defs,
    .min_args = 0,
    .max_args = 1};

/* Members that are NULL (out of memory) make the whole call fail. */
static enum err_code info_set(json_t *o, const char *key, json_t *value, struct err *e)
{
    return value && !json_object_set_new(o, key, value)
               ? ERR_OK
               : err_set(e, ERR_MEM, "info: out of memory");
}

static json_t *info_box(const double lo[3], const double hi[3])
{
    return json_pack("[f,f,f,f,f,f]", lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]);
}

static json_t *info_origin(const struct geo_origin *o)
{
    return json_pack("[f,f,f]", o->lon_deg, o->lat_deg, o->h_m);
}

/* ---- stores ---- */

struct info_zoom {
    size_t tiles;
    uint64_t gaussians, bytes;
    uint32_t most;
    uint8_t level_min, level_max;
    double sigma_sum;
};

static json_t *info_zooms(const struct store *s)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    struct info_zoom z[KEY_ZOOM_MAX + 1] = {{0}};
    json_t *list = json_array();
    for (size_t i = 0; i < n; i++) {
        struct info_zoom *x = &z[t[i].key.z];
        x->level_min = !x->tiles || t[i].level < x->level_min ? t[i].level : x->level_min;
        x->level_max = t[i].level > x->level_max ? t[i].level : x->level_max;
        x->tiles++;
        x->gaussians += t[i].count;
        x->bytes += t[i].bytes;
        x->most = t[i].count > x->most ? t[i].count : x->most;
        x->sigma_sum += store_shape(s, &t[i]).sigma_median_m * t[i].count;
    }
    for (int i = 0; i <= KEY_ZOOM_MAX; i++)
        if (z[i].tiles)
            json_array_append_new(
                list,
                json_pack("{s:i,s:i,s:I,s:I,s:I,s:I,s:f}", "zoom", i, "level", (int)z[i].level_max,
                          "tiles", (json_int_t)z[i].tiles, "gaussians", (json_int_t)z[i].gaussians,
                          "bytes", (json_int_t)z[i].bytes, "most_in_tile", (json_int_t)z[i].most,
                          "sigma_median_m", z[i].sigma_sum / (double)z[i].gaussians));
    return list;
}

static json_t *info_tiles(const struct store *s)
{
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    json_t *list = json_array();
    for (size_t i = 0; i < n; i++) {
        char hash[33], key[48];
        const struct store_shape x = store_shape(s, &t[i]);
        hash_text(t[i].hash, hash);
        snprintf(key, sizeof key, "%u/%u/%u", t[i].key.z, t[i].key.x, t[i].key.y);
        json_t *o = json_pack("{s:s,s:i,s:I,s:I,s:I,s:f,s:f,s:s}", "tile", key, "level",
                              (int)t[i].level, "gaussians", (json_int_t)t[i].count, "bytes",
                              (json_int_t)t[i].bytes, "version", (json_int_t)t[i].version,
                              "sigma_median_m", x.sigma_median_m, "geometric_error_m",
                              tree_node(store_tree(s), i).geometric_error_m, "hash", hash);
        json_object_set_new(o, "box_enu_m", info_box(x.min_enu_m, x.max_enu_m));
        json_array_append_new(list, o);
    }
    return list;
}

/* Photographs whose appearance can be had; false without appearance. */
static json_t *info_appearance(const struct appearance *a)
{
    return a ? json_pack("[{s:I,s:i,s:i,s:i}]", "photographs", (json_int_t)a->n_images - 1,
                         "embedding", (int)a->len_gauss, "image_embedding", (int)a->len_image,
                         "hidden", (int)a->hidden)
             : json_false();
}

struct info_blobs { /* of a store */
    json_t *others;
    size_t photographs, thumbnails;
};

static enum err_code info_count_blobs(struct store *s, struct info_blobs *out, struct err *e)
{
    struct arena a = {0};
    char **names = NULL;
    size_t n = 0;
    enum err_code rc = store_list_blobs(s, &a, &names, &n, e);
    *out = (struct info_blobs){.others = json_array()};
    for (size_t i = 0; !rc && i < n; i++) {
        if (!photograph_is_blob(names[i]))
            json_array_append_new(out->others, json_string(names[i]));
        else if (!strncmp(names[i], PHOTOGRAPH_BLOB, strlen(PHOTOGRAPH_BLOB)))
            out->photographs++;
        else
            out->thumbnails++;
    }
    arena_free(&a);
    return rc;
}

static enum err_code info_store(const char *path, bool tiles, json_t *o, struct err *e)
{
    struct store *s;
    enum err_code rc = store_open(path, &s, e);
    if (rc)
        return rc;
    const struct store_meta *m = store_info(s);
    size_t n;
    const struct store_tile *t = store_tiles(s, &n);
    uint64_t bytes = 0, leaves = 0;
    for (size_t i = 0; i < n; i++) {
        bytes += t[i].bytes;
        leaves += tree_leaf(store_tree(s), i) ? t[i].count : 0;
    }
    const struct appearance *appearance = NULL;
    rc = bake_of(s, &appearance, e);
    struct info_blobs blobs = {0};
    if (!rc)
        rc = info_count_blobs(s, &blobs, e);
    const struct {
        const char *key;
        json_t *value;
    } members[] = {
        {"name", json_string(m->name)},
        {"revision", json_string(m->revision)},
        {"created", json_string(m->created)},
        {"origin_lon_lat_h", info_origin(&m->origin)},
        {"attribution", json_string(m->attribution)},
        {"heights", json_string(heights_name(m->heights))},
        {"sh_degree", json_integer(m->sh_degree)},
        {"embed_len", json_integer(m->embed_len)},
        {"antialiased", json_boolean(m->antialiased)},
        {"lossless", json_boolean(m->lossless)},
        {"zoom_min", json_integer(m->zoom_min)},
        {"zoom_max", json_integer(m->zoom_max)},
        {"tiles_count", json_integer((json_int_t)n)},
        {"gaussians", json_integer((json_int_t)leaves)},
        {"payload_bytes", json_integer((json_int_t)bytes)},
        {"zooms", info_zooms(s)},
        {"blobs", blobs.others},
        {"photographs", json_integer((json_int_t)blobs.photographs)},
        {"thumbnails", json_integer((json_int_t)blobs.thumbnails)},
        {"appearance", info_appearance(appearance)},
    };
    for (size_t i = 0; i < sizeof members / sizeof *members; i++) {
        if (rc)
            json_decref(members[i].value);
        else
            rc = info_set(o, members[i].key, members[i].value, e);
    }
    if (!rc && n) {
        const struct tree_bounds root = tree_bounds(store_tree(s), store_tree(s)->root);
        rc = info_set(o, "box_enu_m", info_box(root.min_enu_m, root.max_enu_m), e);
    }
    if (!rc && tiles)
        rc = info_set(o, "tiles", info_tiles(s), e);
    store_close(&s);
    return rc;
}

/* ---- scenes and files ---- */

static enum err_code info_scene(const char *path, json_t *o, struct err *e)
{
    struct scene s;
    size_t n_test = 0, n_gps = 0;
    enum err_code rc = scene_read(path, &s, e);
    if (rc)
        return rc;
    double lo[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, hi[3] = {-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
    for (size_t i = 0; i < s.n_images; i++) {
        double c[3];
        camera_center(&s.images[i].cam, c);
        n_test += s.images[i].split == SCENE_TEST;
        n_gps += isfinite(s.images[i].gps_enu_m[0]);
        for (size_t k = 0; k < 3; k++) {
            lo[k] = fmin(lo[k], c[k]);
            hi[k] = fmax(hi[k], c[k]);
        }
    }
    rc = info_set(o, "origin_lon_lat_h", info_origin(&s.origin), e);
    if (!rc)
        rc = info_set(o, "photographs", json_integer((json_int_t)s.n_images), e);
    if (!rc)
        rc = info_set(o, "test_photographs", json_integer((json_int_t)n_test), e);
    if (!rc)
        rc = info_set(o, "photographs_with_gps", json_integer((json_int_t)n_gps), e);
    if (!rc)
        rc = info_set(o, "points", json_integer((json_int_t)s.n_points), e);
    if (!rc && s.n_images)
        rc = info_set(o, "cameras_enu_m", info_box(lo, hi), e);
    if (!rc && s.heights[0])
        rc = info_set(o, "heights", json_string(s.heights), e);
    if (!rc && s.attribution)
        rc = info_set(o, "attribution", json_string(s.attribution), e);
    scene_free(&s);
    return rc;
}

static enum err_code info_splats(const char *path, json_t *o, struct err *e)
{
    struct splats s;
    enum err_code rc = splats_read(path, NULL, &s, e);
    if (rc)
        return rc;
    double lo[3], hi[3];
    gauss_bounds(&s.g, 0, lo, hi);
    rc = info_set(o, "gaussians", json_integer((json_int_t)s.g.n), e);
    if (!rc)
        rc = info_set(o, "sh_degree", json_integer(s.g.sh_degree), e);
    if (!rc)
        rc = info_set(o, "embed_len", json_integer(s.g.embed_len), e);
    if (!rc)
        rc = info_set(o, "antialiased", json_boolean(s.g.antialiased), e);
    if (!rc)
        rc = info_set(o, "unusable", json_integer((json_int_t)s.g.n_left_out), e);
    if (!rc && isfinite(lo[0] + lo[1] + lo[2] + hi[0] + hi[1] + hi[2]))
        rc = info_set(o, "box", info_box(lo, hi), e);
    if (!rc && s.info.has_origin)
        rc = info_set(o, "origin_lon_lat_h", info_origin(&s.info.origin), e);
    if (!rc && s.info.heights[0])
        rc = info_set(o, "heights", json_string(s.info.heights), e);
    splats_free(&s);
    return rc;
}

/* ---- text ---- */

static void info_print_table(const json_t *rows)
{
    size_t i;
    const json_t *row;
    const char *key;
    json_t *value;
    json_array_foreach(rows, i, row)
    {
        json_t *object = json_array_get(rows, i);
        if (i == 0) {
            printf(" ");
            json_object_foreach(object, key, value) printf(" %15s", key);
            printf("\n");
        }
        printf(" ");
        json_object_foreach(object, key, value)
        {
            if (json_is_integer(value))
                printf(" %15lld", (long long)json_integer_value(value));
            else if (json_is_real(value))
                printf(" %15.4g", json_real_value(value));
            else
                printf(" %15s", json_is_string(value) ? json_string_value(value) : "");
        }
        printf("\n");
    }
}

static void info_print(json_t *o)
{
    const char *key;
    json_t *value;
    json_object_foreach(o, key, value)
    {
        printf("%-22s", key);
        if (json_is_array(value) && json_is_object(json_array_get(value, 0))) {
            printf("\n");
            info_print_table(value);
            continue;
        }
        if (json_is_string(value))
            printf("%s", json_string_value(value));
        else if (json_is_integer(value))
            printf("%lld", (long long)json_integer_value(value));
        else if (json_is_boolean(value))
            printf("%s", json_is_true(value) ? "yes" : "no");
        else if (json_is_real(value))
            printf("%.3g", json_real_value(value));
        for (size_t i = 0; i < json_array_size(value); i++) {
            const json_t *x = json_array_get(value, i);
            if (json_is_string(x))
                printf("%s%s", i ? ", " : "", json_string_value(x));
            else
                printf("%s%.10g", i ? ", " : "", json_number_value(x));
        }
        printf("\n");
    }
}

static enum err_code info_file(const char *path, bool tiles, json_t *j, struct err *e)
{
    enum splats_kind kind = SPLATS_UNKNOWN;
    enum err_code rc = splats_kind(path, &kind, e);
    if (!rc)
        rc = info_set(j, "file", json_string(path), e);
    if (!rc)
        rc = info_set(j, "kind", json_string(splats_kind_name(kind)), e);
    if (rc)
        return rc;
    return kind == SPLATS_STORE   ? info_store(path, tiles, j, e)
           : kind == SPLATS_SCENE ? info_scene(path, j, e)
                                  : info_splats(path, j, e);
}

enum err_code cli_info(int argc, char **argv, struct err *e)
{
    struct info_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    json_t *j = json_object();
    enum err_code rc = j ? options_parse(&info_spec, argc, argv, &o, &args, &arena, e)
                         : err_set(e, ERR_MEM, "info: out of memory");
    if (rc || args.done)
        goto out;
    if ((args.n > 0) == (o.device != NULL))
        rc = err_set(e, ERR_ARG, "info: expected a file, or --device NAME (auto, cpu, gpu)");
    else
        rc = o.device ? info_device(o.device, j, e) : info_file(args.arg[0], o.tiles, j, e);
    if (rc)
        goto out;
    if (o.json) {
        json_dumpf(j, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(12));
        printf("\n");
    } else {
        info_print(j);
    }
out:
    json_decref(j);
    arena_free(&arena);
    return rc;
}
