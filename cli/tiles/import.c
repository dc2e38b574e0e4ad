/* citysplat import: Gaussians of another trainer -> a tile store. Coarser levels are made by
 * simplification.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/base/splats.h"
#include "cli/tiles/import_fit.h"
#include "codec/splat/axes.h"
#include "codec/splat/ply.h"
#include "core/math/sort.h"
#include "lod/make/pyramid.h"

enum { IMPORT_AXES_AUTO, IMPORT_AXES_ENU, IMPORT_AXES_YUP, IMPORT_AXES_YDOWN };

struct import_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/import.def"
};

static const struct options_def import_defs[] = {
#define OPT(...) OPTIONS_ROW(struct import_options, __VA_ARGS__)
#include "cli/tiles/import.def"
};

static const struct options_spec import_spec = {
    .command = "import",
    .usage = "citysplat import FILE --origin LON,LAT,H -o CITY.tiles [options]",
    .about =
        "Makes a tile store from Gaussians that were trained elsewhere. Reads .ply "
        "(INRIA's and SuperSplat's compressed), .spz, .glb, .drc, .sog, .splat or a checkpoint, "
        "cuts it into tiles and makes the coarser levels.",
    .example = "citysplat import bridge.ply --origin 8.6821,50.1109,160 -o bridge.tiles\n"
               "citysplat import garden.spz --origin 8.68,50.11,160 --scale 2.5 -o garden.tiles",
    .defs = import_defs,
    .n_defs = sizeof import_defs / sizeof *import_defs,
    .min_args = 1,
    .max_args = 1};

static int import_axes(const struct splats *s, int axes)
{
    bool gltf = s->kind == SPLATS_SPZ || s->kind == SPLATS_GLB || s->kind == SPLATS_DRC ||
                s->kind == SPLATS_SOG || (s->kind == SPLATS_PLY && s->info.axes == PLY_AXES_GLTF);
    return axes != IMPORT_AXES_AUTO ? axes : gltf ? IMPORT_AXES_YUP : IMPORT_AXES_ENU;
}

/* To ENU. y down (x right, y down, z forward, forward taken as north) is glTF's turn the other way
 * round. */
static void import_turn(int axes, struct gauss *g)
{
    if (axes == IMPORT_AXES_YUP)
        axes_gltf_to_enu(g);
    if (axes == IMPORT_AXES_YDOWN)
        axes_enu_to_gltf(g);
}

static void import_scale(struct gauss *g, double scale)
{
    if (scale == 1.0)
        return;
    for (size_t k = 0; k < 3; k++)
        g->origin_enu_m[k] *= scale;
    import_fit_scale(g, scale);
}

/* Fits places of the file, turned and scaled as its Gaussians are, to those of the ground. */
static enum err_code import_fit(int axes, double scale, struct import_fit *fit, struct err *e)
{
    double turned[IMPORT_FIT_MOST][3];
    for (size_t i = 0; i < fit->n; i++) {
        memcpy(turned[i], fit->file[i], sizeof turned[i]);
        if (axes == IMPORT_AXES_YUP)
            axes_point_to_enu(turned[i]);
        if (axes == IMPORT_AXES_YDOWN)
            axes_point_to_gltf(turned[i]);
        for (size_t k = 0; k < 3; k++)
            turned[i][k] *= scale;
    }
    return import_fit_make(fit, (const double(*)[3])turned, e);
}

struct import_place {
    int axes;
    double scale;
    struct geo_origin origin;
    const struct import_fit *fit; /* NULL: the file is upright and north is its y */
};

static void import_put(const struct import_place *p, struct gauss *g)
{
    import_turn(p->axes, g);
    import_scale(g, p->scale);
    if (p->fit)
        import_fit_apply(p->fit, g);
}

/* --origin where no file has its name. */
static enum err_code import_origin(const char *text, struct geo_origin *out, struct err *e)
{
    const char *comma = strchr(text, ',');
    if (!comma || !strchr(comma + 1, ','))
        return err_set(e, ERR_ARG,
                       "--origin: '%s': longitude, latitude and height are expected, e.g. "
                       "8.6821,50.1109,160, or a file of places, and there is no file of this name",
                       text);
    return splats_place("--origin", text, out, e);
}

/* Where the file lies: by --origin, three places of it, or its own word. */
static enum err_code import_find_place(const char *path, const struct import_options *o,
                                       const struct splats *s, struct import_fit *fit,
                                       struct import_place *out, struct err *e)
{
    *out = (struct import_place){
        .axes = import_axes(s, o->axes), .scale = o->scale, .origin = s->info.origin};
    if (!o->origin && !s->info.has_origin)
        return err_set(e, ERR_ARG,
                       "%s does not say where on Earth it is: give --origin LON,LAT,H, or a file "
                       "of three places",
                       path);
    if (!o->origin)
        return ERR_OK;
    if (!file_exists(o->origin))
        return import_origin(o->origin, &out->origin, e);
    enum err_code rc = import_fit_read(o->origin, fit, e);
    if (!rc)
        rc = import_fit(out->axes, o->scale, fit, e);
    out->origin = fit->origin;
    out->fit = fit;
    return rc;
}

/* ---- outliers ---- */

/* A Gaussian so many times as far from the middle as half of them, and at least so far, is no part
 * of the city, nor is one whose standard deviation is so large. One whose distance in median sigmas
 * has more bits than a tile's positions makes tiles that cannot be read. */
#define IMPORT_FAR_TIMES 100.0
#define IMPORT_FAR_LEAST_M 1000.0
#define IMPORT_REACH_SIGMAS (double)(1 << 22)
/* So far away the plane of a city lies 780 m above the round Earth. */
#define IMPORT_WIDE_M 1e5
#define IMPORT_REACH_MOST_M 1e8 /* as stores have it */
enum { IMPORT_NAMED = 5, IMPORT_SAMPLES = 16 };

struct import_far {
    bool drop;
    double middle[3], limit_m, reach_m; /* in ENU */
    atomic_size_t n;
    _Atomic double farthest_m; /* up to 6e38: more than an integer holds */
};

static double import_far_m(const struct import_far *f, const struct gauss *g, size_t i)
{
    double d[3];
    for (size_t k = 0; k < 3; k++)
        d[k] = (double)g->mean_m[3 * i + k] + g->origin_enu_m[k] - f->middle[k];
    return hypot(hypot(d[0], d[1]), d[2]);
}

/* The largest standard deviation, in metres. */
static double import_size_m(const struct gauss *g, size_t i)
{
    const float *s = g->scale_log + 3 * i;
    return exp((double)fmaxf(s[0], fmaxf(s[1], s[2])));
}

/* The middle, and what is far from it, by a part or all of the Gaussians. */
static enum err_code import_far_find(const struct gauss *g, struct import_far *f, struct err *e)
{
    double *v = mem_array(3 * g->n, sizeof *v);
    size_t n = 0;
    if (!v)
        return err_set(e, ERR_MEM, "import: out of memory for %zu Gaussians", g->n);
    for (size_t k = 0; k < 3; k++) {
        for (size_t i = n = 0; i < g->n; i++)
            if (isfinite(g->mean_m[3 * i + k]))
                v[n++] = (double)g->mean_m[3 * i + k] + g->origin_enu_m[k];
        f->middle[k] = sort_median(v, n);
    }
    for (size_t i = n = 0; i < g->n; i++) {
        v[n] = import_far_m(f, g, i);
        n += isfinite(v[n]);
    }
    const double half_m = n ? sort_median(v, n) : 0.0;
    if (half_m > IMPORT_WIDE_M) {
        mem_free(v);
        return err_set(e, ERR_DATA,
                       "half of the Gaussians lie more than %.0f km from their middle, and tiles "
                       "are for cities: --scale is metres per unit of the file; is it right?",
                       1e-3 * half_m);
    }
    const double off_m = hypot(f->middle[0], f->middle[1]);
    if (off_m > IMPORT_WIDE_M) {
        mem_free(v);
        return err_set(e, ERR_DATA,
                       "the middle of the Gaussians, %.0f %.0f %.0f, lies %.0f km from the origin: "
                       "are these coordinates of a map, as UTM? Subtract those of one place and "
                       "give that as --origin, or give a file of three places",
                       f->middle[0], f->middle[1], f->middle[2], 1e-3 * off_m);
    }
    f->limit_m = fmax(IMPORT_FAR_LEAST_M, IMPORT_FAR_TIMES * half_m);
    for (size_t i = n = 0; i < 3 * g->n; i++)
        if (isfinite(g->scale_log[i]))
            v[n++] = (double)g->scale_log[i];
    f->reach_m =
        fmin(IMPORT_REACH_MOST_M, fmax(f->limit_m, IMPORT_REACH_SIGMAS * exp(sort_median(v, n))));
    mem_free(v);
    return ERR_OK;
}

/* Leaves outliers out, or counts them; `first` is the row of the file. Any thread. */
static enum err_code import_far_check(struct import_far *f, size_t first, struct gauss *g,
                                      struct err *e)
{
    size_t kept = 0;
    for (size_t i = 0; i < g->n; i++) {
        const double m = fmax(import_far_m(f, g, i), import_size_m(g, i));
        const bool far = isfinite(m) && m > f->limit_m;
        if (far && m > f->reach_m && !f->drop)
            return err_set(
                e, ERR_DATA,
                "row %zu lies %.0f km from the middle, or is so large, where half of the "
                "Gaussians lie within %.0f m: no tiles can hold both; leave such rows out by "
                "--drop-outliers",
                first + i, 1e-3 * m, f->limit_m / IMPORT_FAR_TIMES);
        if (far) {
            double most = atomic_load(&f->farthest_m);
            while (m > most && !atomic_compare_exchange_weak(&f->farthest_m, &most, m))
                ;
            if (atomic_fetch_add(&f->n, 1) < IMPORT_NAMED)
                log_info("import", "outlier row=%zu distance_m=%.0f", first + i, m);
        }
        if (!far || !f->drop) {
            if (kept < i)
                gauss_copy_row(g, kept, g, i);
            kept++;
        }
    }
    g->n = kept;
    return ERR_OK;
}

static void import_far_tell(const struct import_far *f)
{
    if (f->n)
        log_warn("import",
                 "%zu Gaussians lie more than %.0f m from the middle, or are so large, up to %.6g "
                 "km: %s",
                 (size_t)f->n, f->limit_m, 1e-3 * f->farthest_m,
                 f->drop ? "left out" : "--drop-outliers leaves them out");
}

static void import_print(const char *path, const struct pyramid_report *r)
{
    if (r->n_bad)
        printf("%s: %zu rows are left out: not finite, or no rotation\n", path, r->n_bad);
    printf("%s: %zu tiles, zoom %u to %u, at most %zu Gaussians in one, revision %s, %.1f s\n",
           path, r->n_tiles, r->zoom_min, r->zoom_max, r->max_in_tile, r->revision, r->seconds);
    log_info("tile", "seconds=%.2f read_s=%.2f plan_s=%.2f write_s=%.2f cpu_s=%.2f peak_bytes=%zu",
             r->seconds, r->read_s, r->plan_s, r->seconds - r->read_s - r->plan_s, clock_cpu_s(),
             mem_peak_bytes());
}

/* ---- a .ply in parts, so that memory does not grow with it ---- */

enum { IMPORT_PART_ROWS = 131072 };

struct import_stream {
    struct ply_stream *ply;
    const struct import_place *place;
    size_t n;
    struct import_far *far;
};

static enum err_code import_load(void *user, size_t part, struct gauss *out, struct err *e)
{
    const struct import_stream *s = user;
    size_t first = part * IMPORT_PART_ROWS, left = s->n - first;
    enum err_code rc =
        ply_stream_read(s->ply, first, left < IMPORT_PART_ROWS ? left : IMPORT_PART_ROWS, out, e);
    if (!rc)
        import_put(s->place, out);
    if (!rc && s->far->limit_m > 0)
        rc = import_far_check(s->far, first, out, e);
    return rc;
}

/* By some parts of the file. */
static enum err_code import_far_sample(const struct import_stream *s, size_t n_parts, struct err *e)
{
    const size_t step = (n_parts + IMPORT_SAMPLES - 1) / IMPORT_SAMPLES;
    struct gauss all = {0};
    enum err_code rc = ERR_OK;
    for (size_t k = 0; !rc && k < n_parts; k += step) {
        struct gauss part = {0};
        rc = import_load((void *)(uintptr_t)s, k, &part, e);
        if (!rc && !all.block)
            rc = gauss_alloc(&all, part.n, 0, 0, e);
        if (!rc)
            rc = gauss_append(&all, &part, NULL, part.n, e);
        gauss_free(&part);
    }
    if (!rc)
        rc = import_far_find(&all, s->far, e);
    gauss_free(&all);
    return rc;
}

/* Rows between the passes, and the store with its overviews: a third more rows than the finest
 * level has. */
static uint64_t import_room(const struct ply_rows *r, bool lossless)
{
    uint64_t values = 11 + 3 * (uint64_t)gauss_sh_count(r->sh_degree);
    uint64_t row = lossless ? 4 * values : 12 + 2 * (values - 3);
    return r->n * row * 7 / 3;
}

static enum err_code import_run(const char *path, const struct import_options *o, struct err *e)
{
    struct splats s = {0};
    struct import_fit fit;
    struct import_place place;
    struct pyramid_report report;
    struct import_far far = {.drop = o->drop_outliers};
    struct import_stream stream = {.place = &place, .far = &far};
    struct pyramid_level level = {.level = (uint8_t)o->level_count};
    struct pyramid_config cfg = {.tile_edge_m = o->tile_edge_m, .lossless = o->lossless};
    enum err_code rc =
        o->origin && !file_exists(o->origin) ? import_origin(o->origin, &place.origin, e) : ERR_OK;
    if (!rc && o->attribution && strlen(o->attribution) >= sizeof cfg.attribution)
        rc = err_set(e, ERR_ARG, "--attribution: at most %zu bytes", sizeof cfg.attribution - 1);
    if (!rc)
        rc = splats_name(o->name, o->output, cfg.name, e);
    if (!rc)
        rc = splats_kind(path, &s.kind, e);
    if (!rc && s.kind == SPLATS_PLY)
        rc = ply_stream_open(path, &stream.ply, &s.info, e);
    if (!rc && !stream.ply)
        rc = splats_read(path, NULL, &s, e);
    if (!rc)
        rc = import_find_place(path, o, &s, &fit, &place, e);
    if (rc)
        goto out;
    if (stream.ply) {
        const struct ply_rows rows = ply_stream_rows(stream.ply);
        stream.n = rows.n;
        level.load = import_load;
        level.user = &stream;
        level.n_parts = (rows.n + IMPORT_PART_ROWS - 1) / IMPORT_PART_ROWS;
        rc = file_room(o->output, import_room(&rows, o->lossless), e);
        if (!rc)
            rc = import_far_sample(&stream, level.n_parts, e);
    } else {
        import_put(&place, &s.g);
        level.g = &s.g;
        rc = import_far_find(&s.g, &far, e);
        if (!rc)
            rc = import_far_check(&far, 0, &s.g, e);
    }
    if (rc)
        goto out;
    snprintf(cfg.attribution, sizeof cfg.attribution, "%s", o->attribution ? o->attribution : "");
    if (!o->origin) /* --origin is above the ellipsoid */
        snprintf(cfg.heights, sizeof cfg.heights, "%s", s.info.heights);
    rc = pyramid_build(&place.origin, &level, 1, &cfg, NULL, 0, o->output, &report, e);
    import_far_tell(&far);
    if (!rc)
        import_print(o->output, &report);
    else if (rc != ERR_ARG && !stream.ply)
        err_add(e, "%s", path);
out:
    ply_stream_close(&stream.ply);
    splats_free(&s);
    return rc;
}

enum err_code cli_import(int argc, char **argv, struct err *e)
{
    struct import_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&import_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done)
        rc = output_needed(o.output, o.overwrite, e);
    if (!rc && !args.done)
        rc = output_apart(o.output, args.arg[0], e);
    if (!rc && !args.done)
        rc = output_apart(o.output, o.origin, e); /* it may be a file */
    if (!rc && !args.done) {
        signals_catch();
        rc = import_run(args.arg[0], &o, e);
    }
    arena_free(&arena);
    return rc;
}
