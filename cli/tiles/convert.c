/* citysplat convert: one file of Gaussians into another format.
 *
 * Between .spz, .drc and .glb with SPZ, integers are copied unchanged if nothing else was asked
 * for. All other conversions use struct gauss. Axes are turned only if those of both files are
 * known.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>
#include <strings.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/base/splats.h"
#include "codec/limits.h"
#include "codec/splat/axes.h"
#include "codec/splat/draco.h"
#include "codec/splat/glb.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "codec/splat/sog.h"
#include "codec/splat/splat.h"
#include "codec/splat/spz.h"

struct convert_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/convert.def"
};

static const struct options_def convert_defs[] = {
#define OPT(...) OPTIONS_ROW(struct convert_options, __VA_ARGS__)
#include "cli/tiles/convert.def"
};

enum convert_format {
    CONVERT_PLY_PACKED, /* SuperSplat's compressed one; read as any other .ply */
    CONVERT_PLY,
    CONVERT_SPZ,
    CONVERT_DRC,
    CONVERT_GLB,
    CONVERT_SOG,
    CONVERT_SPLAT,
    CONVERT_FORMATS
};
enum convert_axes {
    AXES_AUTO,
    AXES_ENU,
    AXES_GLTF,
    AXES_YDOWN
}; /* as in the options; AUTO is also "unknown" */

struct converted {
    struct gauss g;
    struct quant q; /* the integers, when IN has them */
    struct ply_info info;
    enum convert_axes axes;
};

static enum err_code convert_format_of(const char *path, enum convert_format *out, struct err *e)
{
    static const char *const names[CONVERT_FORMATS] = {
        ".compressed.ply", ".ply", ".spz", ".drc", ".glb", ".sog", ".splat"};
    const size_t n = strlen(path);
    for (int f = 0; f < CONVERT_FORMATS; f++) {
        size_t n_name = strlen(names[f]);
        if (n >= n_name && !strcasecmp(path + n - n_name, names[f])) {
            *out = (enum convert_format)f;
            return ERR_OK;
        }
    }
    if (splats_is_sog_meta(path)) {
        *out = CONVERT_SOG;
        return ERR_OK;
    }
    return err_set(e, ERR_ARG,
                   "%s: its name must end in .ply, .compressed.ply, .spz, .drc, .glb or .sog "
                   "(to read also .splat, and the meta.json of a SOG's folder)",
                   path);
}

static enum err_code convert_decode_glb(const struct buf *b, struct converted *c, struct err *e)
{
    const void *spz;
    size_t n;
    enum err_code rc = glb_find_spz(b->data, b->size, &spz, &n, e);
    if (!rc)
        return spz_decode(spz, n, NULL, &c->q, e);
    return rc == ERR_NOENT ? glb_decode(b->data, b->size, NULL, &c->g, e) : rc;
}

static enum err_code convert_read(const char *path, struct converted *c, struct err *e)
{
    static const enum convert_axes of_ply[] = {AXES_AUTO, AXES_ENU, AXES_GLTF};
    enum convert_format format;
    struct buf b = {0};
    enum err_code rc = convert_format_of(path, &format, e);
    if (!rc)
        rc = file_read(path, CODEC_MAX_BYTES, &b, e);
    if (rc)
        return rc;
    c->axes = AXES_GLTF;
    if (format == CONVERT_PLY || format == CONVERT_PLY_PACKED) {
        rc = ply_decode(b.data, b.size, NULL, &c->g, &c->info, e);
        c->axes = of_ply[c->info.axes];
    } else if (format == CONVERT_SPLAT) {
        rc = splat_decode(b.data, b.size, NULL, &c->g, e);
        c->axes = AXES_AUTO;
    } else if (format == CONVERT_SOG && splats_is_sog_meta(path)) {
        rc = sog_read(path, NULL, &c->g, e);
    } else if (format == CONVERT_SOG) {
        rc = sog_decode(b.data, b.size, NULL, &c->g, e);
    } else if (format == CONVERT_SPZ) {
        rc = spz_decode(b.data, b.size, NULL, &c->q, e);
    } else if (format == CONVERT_DRC) {
        rc = draco_decode(b.data, b.size, NULL, &c->q, e);
    } else {
        rc = convert_decode_glb(&b, c, e);
    }
    if (!rc && c->q.block)
        rc = quant_to_gauss(&c->q, &c->g, e);
    if (rc)
        err_add(e, "%s", path);
    buf_free(&b);
    return rc;
}

/* Rows of another degree: bands that are missing are 0, surplus ones go. */
static enum err_code convert_set_degree(struct gauss *g, uint32_t degree, struct err *e)
{
    struct gauss other = {0};
    enum err_code rc = gauss_alloc(&other, g->n, degree, g->embed_len, e);
    if (rc)
        return rc;
    other.antialiased = g->antialiased;
    memcpy(other.origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
    rc = gauss_append(&other, g, NULL, g->n, e);
    gauss_free(!rc ? g : &other);
    if (!rc)
        *g = other;
    return rc;
}

/* Turns from what is known of IN to what OUT is to be; returns what it then is. ENU is a quarter
 * turn of glTF's axes, and y down another one on. */
static enum convert_axes convert_turn(struct converted *c, enum convert_axes want, const char *path)
{
    if (c->axes == AXES_AUTO && want != AXES_AUTO)
        log_warn("convert",
                 "axes of %s are not known: its numbers are kept as they are; say --axes ydown (as "
                 "most trainers write), enu or gltf",
                 path);
    if (c->axes == AXES_AUTO || want == AXES_AUTO || c->axes == want)
        return c->axes;
    if (c->axes == AXES_GLTF)
        axes_gltf_to_enu(&c->g);
    if (c->axes == AXES_YDOWN)
        axes_enu_to_gltf(&c->g);
    if (want == AXES_GLTF)
        axes_enu_to_gltf(&c->g);
    if (want == AXES_YDOWN)
        axes_gltf_to_enu(&c->g);
    return want;
}

/* .sog has y down, as trainers' .ply have it: of unknown axes, its numbers stay what they are. */
static void convert_turn_for_sog(struct converted *c, const char *path)
{
    if (c->axes == AXES_AUTO) {
        log_warn("convert",
                 "axes of %s are not known: its numbers are kept as they are, which .sog has y "
                 "down (as most trainers write); say --axes enu or gltf if that is wrong",
                 path);
        c->axes = AXES_YDOWN;
    }
    convert_turn(c, AXES_GLTF, path);
}

/* A compressed one is always sorted: 256 rows share a box. */
static enum err_code convert_write_ply(struct converted *c, enum convert_format format,
                                       const struct convert_options *o, const char *in,
                                       struct buf *out, struct err *e)
{
    enum convert_axes want = o->ply_axes            ? (enum convert_axes)o->ply_axes
                             : c->axes == AXES_AUTO ? AXES_AUTO
                                                    : AXES_ENU;
    static const enum ply_axes said[] = {PLY_AXES_UNKNOWN, PLY_AXES_ENU, PLY_AXES_GLTF,
                                         PLY_AXES_UNKNOWN};
    c->info.axes = said[convert_turn(c, want, in)];
    if (format == CONVERT_PLY)
        return ply_encode(&c->g, &c->info, out, e);
    enum err_code rc = gauss_sort(&c->g, e);
    return !rc ? ply_packed_encode(&c->g, c->g.sh_degree, &c->info, out, e) : rc;
}

static enum err_code convert_write_integers(struct converted *c, enum convert_format format,
                                            const struct convert_options *o, struct buf *out,
                                            struct err *e)
{
    if (format == CONVERT_SPZ)
        return spz_encode(&c->q, o->spz_version ? 4 : 3, out, e);
    if (format == CONVERT_DRC)
        return draco_encode(&c->q, NULL, out, e);
    return glb_encode_spz(&c->q, o->copyright, out, e);
}

static void convert_center(struct gauss *g)
{
    double lo[3], hi[3], middle[3];
    gauss_bounds(g, 0, lo, hi);
    for (int k = 0; k < 3; k++)
        middle[k] = (lo[k] + hi[k]) / 2;
    gauss_recenter(g, middle);
    log_info("convert", "center origin_m=%.3f,%.3f,%.3f", middle[0], middle[1], middle[2]);
    memset(g->origin_enu_m, 0, sizeof g->origin_enu_m);
}

static const struct quant_grid *convert_grid(const struct convert_options *o)
{
    return quant_preset_grid(o->preset ? (enum quant_preset)(o->preset - 1) : QUANT_NEAR_LOSSLESS);
}

static enum err_code convert_write(struct converted *c, enum convert_format format,
                                   const struct convert_options *o, const char *in, struct buf *out,
                                   struct err *e)
{
    bool as_is = c->q.block && o->sh_degree < 0 && !o->center && !o->preset && c->axes == AXES_GLTF;
    bool integers = format == CONVERT_SPZ || format == CONVERT_DRC ||
                    (format == CONVERT_GLB && !o->glb_payload);
    if (as_is && integers)
        return convert_write_integers(c, format, o, out, e);
    enum err_code rc = ERR_OK;
    if (o->sh_degree >= 0)
        rc = convert_set_degree(&c->g, (uint32_t)o->sh_degree, e);
    if (!rc && o->center)
        convert_center(&c->g);
    if (rc)
        return rc;
    if (format == CONVERT_PLY || format == CONVERT_PLY_PACKED)
        return convert_write_ply(c, format, o, in, out, e);
    if (c->g.origin_enu_m[0] != 0 || c->g.origin_enu_m[1] != 0 || c->g.origin_enu_m[2] != 0)
        return err_set(
            e, ERR_LIMIT,
            "convert: %s: coordinates are about %.0f %.0f %.0f m: such numbers do not fit the "
            "format ; use --center",
            in, c->g.origin_enu_m[0], c->g.origin_enu_m[1], c->g.origin_enu_m[2]);
    if (format == CONVERT_SOG)
        convert_turn_for_sog(c, in);
    else
        convert_turn(c, AXES_GLTF, in);
    if (o->sort)
        rc = gauss_sort(&c->g, e);
    if (!rc && format == CONVERT_SOG)
        return sog_encode(&c->g, c->g.sh_degree, out, e);
    if (!rc && !integers)
        return glb_encode_plain(&c->g, o->copyright, out, e);
    quant_free(&c->q);
    if (!rc)
        rc = quant_from_gauss(&c->g, c->g.sh_degree, convert_grid(o), &c->q, e);
    return !rc ? convert_write_integers(c, format, o, out, e) : rc;
}

enum err_code cli_convert(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "convert",
        .usage = "citysplat convert IN OUT [options]",
        .about =
            "Converts a file of Gaussians. Reads .ply (of any trainer, or SuperSplat's "
            "compressed one), .spz, .drc, .glb, .sog and .splat. Writes .ply, .compressed.ply, "
            ".spz, .drc, .glb and .sog.",
        .example = "citysplat convert point_cloud.ply scene.spz --axes enu\n"
                   "citysplat convert tile.drc tile.glb --glb-payload plain",
        .defs = convert_defs,
        .n_defs = sizeof convert_defs / sizeof convert_defs[0],
        .min_args = 2,
        .max_args = 2};
    struct convert_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    struct converted c = {0};
    struct buf out = {0};
    enum convert_format format;
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &arena, e);
    if (rc || args.done)
        goto out;
    rc = convert_format_of(args.arg[1], &format, e);
    if (!rc && format == CONVERT_SPLAT)
        rc = err_set(e, ERR_ARG, "%s: .splat is read, not written", args.arg[1]);
    if (!rc && format == CONVERT_SOG && splats_is_sog_meta(args.arg[1]))
        rc = err_set(e, ERR_ARG, "%s: a SOG of files in a folder is read, not written: name a .sog",
                     args.arg[1]);
    if (!rc)
        rc = output_check(args.arg[1], o.overwrite, e);
    if (!rc)
        rc = output_apart(args.arg[1], args.arg[0], e);
    if (rc || (rc = convert_read(args.arg[0], &c, e)) != ERR_OK)
        goto out;
    if (o.axes)
        c.axes = (enum convert_axes)o.axes;
    rc = convert_write(&c, format, &o, args.arg[0], &out, e);
    if (!rc)
        rc = file_write(args.arg[1], out.data, out.size, e);
    if (!rc)
        log_info("convert",
                 "write file=%s gaussians=%zu sh_degree=%u bytes=%zu bytes_per_gaussian=%.2f",
                 args.arg[1], c.g.n, c.g.sh_degree, out.size,
                 (double)out.size / (double)(c.g.n ? c.g.n : 1));
out:
    quant_free(&c.q);
    gauss_free(&c.g);
    buf_free(&out);
    arena_free(&arena);
    return rc;
}
