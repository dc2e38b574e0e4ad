/* Size of .drc files by choices that do not change pictures: the order of rows, the division of
 * integers into attributes, the colour transform, prediction; and by SH degree and appearance
 * embedding.
 *
 * The leaves of a store (--tiles) are quantised by the presets `spz` and `balanced`. Every variant
 * has the same integers, so only sizes are compared. A variant changes the layout of
 * codec/splat/draco_layout.c in one point; its ratio is to the unchanged layout.
 *
 * Rows are lines of a recorded study, as in bench_rd.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

#include "codec/splat/axes.h"
#include "codec/splat/draco.h"
#include "codec/splat/quant.h"
#include "codec/splat/spz.h"
#include "core/math/sort.h"
#include "lab/bench/bench.h"
#include "lab/bench/layout.h"
#include "lab/bench/leaves.h"

enum { NAME_MAX_BYTES = 64, CELL_BITS = 20, BLOCK = 64 };

static const enum quant_preset presets[] = {QUANT_SPZ, QUANT_BALANCED};
enum { PRESETS = sizeof presets / sizeof *presets };

/* ---- orders of rows ---- */

enum order {
    ORDER_STORED,
    ORDER_CUBES,
    ORDER_BOX,
    ORDER_BRIGHT,
    ORDER_SIZE,
    ORDER_COLOR,
    ORDER_NONE
};
static const struct {
    const char *name;
    enum order order;
} orders[] = {{"Hilbert curve", ORDER_STORED},
              {"Morton curve of cubes", ORDER_CUBES},
              {"Morton curve of the box", ORDER_BOX},
              {"Hilbert curve, runs of 64 by brightness", ORDER_BRIGHT},
              {"by size, then the Hilbert curve", ORDER_SIZE},
              {"Morton curve in colour, not in space", ORDER_COLOR},
              {"shuffled", ORDER_NONE}};

/* Morton code of v[3] of row i over the range of all rows. */
static uint64_t layout_cell_key(const float *v, const float lo[3], const float span[3])
{
    uint64_t key = 0;
    for (size_t c = 0; c < 3; c++) {
        float t = span[c] > 0 ? (v[c] - lo[c]) / span[c] : 0;
        key |= sort_spread3((uint64_t)(t * (float)((1 << CELL_BITS) - 1))) << c;
    }
    return key;
}

static void layout_range_of(const float *v, size_t stride, size_t n, bool cube, float lo[3],
                            float span[3])
{
    float most = 0;
    for (size_t c = 0; c < 3; c++) {
        float hi = lo[c] = v[c];
        for (size_t i = 0; i < n; i++) {
            lo[c] = fminf(lo[c], v[stride * i + c]);
            hi = fmaxf(hi, v[stride * i + c]);
        }
        span[c] = hi - lo[c];
        most = fmaxf(most, span[c]);
    }
    for (size_t c = 0; cube && c < 3; c++)
        span[c] = most;
}

static uint64_t layout_order_key(const struct gauss *g, enum order o, size_t i, const float lo[3],
                                 const float span[3])
{
    const float *s = g->scale_log + 3 * i, *dc = g->sh + 3 * gauss_sh_count(g->sh_degree) * i;
    switch (o) {
    case ORDER_CUBES:
    case ORDER_BOX:
        return layout_cell_key(g->mean_m + 3 * i, lo, span);
    case ORDER_BRIGHT:
        return (uint64_t)(i / BLOCK) << 32 | sort_key_float(dc[0] + dc[1] + dc[2]);
    case ORDER_SIZE: /* steps of a factor of two */
        return sort_key_float(floorf((s[0] + s[1] + s[2]) / 3 / 0.69f));
    case ORDER_COLOR:
        return layout_cell_key(dc, lo, span);
    case ORDER_NONE:
        return rng_u64(1, 2, i);
    default:
        return i;
    }
}

/* A copy of the tile (as it comes, along a Hilbert curve) in another order, with `embed_len`
 * numbers of its embedding. */
static enum err_code layout_reorder(const struct gauss *g, enum order o, uint32_t embed_len,
                                    struct gauss *out, struct err *e)
{
    struct sort_item *item = mem_array(g->n, sizeof *item), *spare = mem_array(g->n, sizeof *item);
    float lo[3] = {0}, span[3] = {0};
    enum err_code rc = item && spare ? gauss_alloc(out, g->n, g->sh_degree, embed_len, e)
                                     : err_set(e, ERR_MEM, "out of memory");
    if (o == ORDER_COLOR)
        layout_range_of(g->sh, 3 * gauss_sh_count(g->sh_degree), g->n, true, lo, span);
    else
        layout_range_of(g->mean_m, 3, g->n, o == ORDER_CUBES, lo, span);
    for (size_t i = 0; !rc && i < g->n; i++)
        item[i] = (struct sort_item){layout_order_key(g, o, i, lo, span), (uint32_t)i};
    if (!rc)
        sort_items(item, spare, g->n);
    memcpy(out->origin_enu_m, g->origin_enu_m, sizeof g->origin_enu_m);
    out->antialiased = g->antialiased;
    out->n = rc ? 0 : g->n;
    for (size_t i = 0; i < out->n; i++)
        gauss_copy_row(out, i, g, item[i].row);
    mem_free(item);
    mem_free(spare);
    return rc;
}

/* ---- sums over tiles ---- */

struct lay {
    struct bench *b;
    struct leaves leaves; /* glTF axes */
};

enum file_kind { FILE_SPZ3, FILE_DRC, FILE_COLUMNS };

/* Bytes a Gaussian of all tiles. */
static enum err_code layout_bytes(const struct lay *l, enum file_kind kind, enum order o,
                                  const struct quant_grid *grid, uint32_t embed_len,
                                  const struct layout *layout, double *out, struct err *e)
{
    size_t bytes = 0;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < l->leaves.n_tiles; i++) {
        struct gauss g = {0};
        struct quant q = {0};
        struct buf file = {0};
        rc = layout_reorder(&l->leaves.tile[i], o, embed_len, &g, e);
        if (!rc)
            rc = quant_from_gauss(&g, g.sh_degree, grid, &q, e);
        if (!rc)
            rc = kind == FILE_SPZ3  ? spz_encode(&q, 3, &file, e)
                 : kind == FILE_DRC ? draco_encode(&q, "18/0/0", &file, e)
                                    : layout_encode(&q, layout, &file, e);
        bytes += file.size;
        gauss_free(&g);
        quant_free(&q);
        buf_free(&file);
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    *out = (double)bytes / (double)l->leaves.n;
    return rc;
}

static enum err_code layout_note(const struct lay *l, const char *row, const char *what,
                                 double bytes, double ratio, struct err *e)
{
    char name[3 * NAME_MAX_BYTES];
    snprintf(name, sizeof name, "%s, %s", row, what);
    bench_report(l->b, name, bytes, "bytes", ratio, "the first");
    return bench_record(l->b, row, what,
                        json_pack("{s:f, s:f, s:I}", "bytes_per_gaussian", bytes, "ratio", ratio,
                                  "gaussians", (json_int_t)l->leaves.n),
                        e);
}

static enum err_code layout_orders(const struct lay *l, struct err *e)
{
    char row[2 * NAME_MAX_BYTES], what[NAME_MAX_BYTES];
    enum err_code rc = ERR_OK;
    for (size_t p = 0; p < PRESETS; p++)
        for (int spz = 0; spz < 2; spz++) {
            double first = 0, bytes = 0;
            snprintf(what, sizeof what, "%s %s", spz ? "spz 3" : "drc",
                     quant_preset_name(presets[p]));
            for (size_t i = 0; !rc && i < sizeof orders / sizeof *orders; i++) {
                rc = layout_bytes(l, spz ? FILE_SPZ3 : FILE_DRC, orders[i].order,
                                  quant_preset_grid(presets[p]), 0, NULL, &bytes, e);
                first = i ? first : bytes;
                snprintf(row, sizeof row, "order: %s", orders[i].name);
                if (!rc)
                    rc = layout_note(l, row, what, bytes, bytes / first, e);
            }
        }
    return rc;
}

static enum err_code layout_layouts(const struct lay *l, struct err *e)
{
    static const struct {
        const char *name;
        struct layout layout;
    } variants[] = {
        {"as it is", {0}},
        {"red, green, blue", {.channels = LAYOUT_RGB}},
        {"YCoCg", {.channels = LAYOUT_YCOCG}},
        {"scale of one component", {.split_scale = true}},
        {"differences of scales", {.scale_differences = true}},
        {"rotation of one component", {.split_rotation = true}},
        {"colour and harmonics of one component", {.split_color = true}},
        {"all of one component",
         {.split_scale = true, .split_rotation = true, .split_color = true}},
        {"all of one component, positions too",
         {.split_scale = true,
          .split_rotation = true,
          .split_color = true,
          .split_position = true}},
        {"a band of channels together", {.join_channels = true}},
        {"predicted: position alone", {.predict = LAYOUT_PREDICT_POSITION}},
        {"predicted: all", {.predict = LAYOUT_PREDICT_ALL}},
    };
    char row[2 * NAME_MAX_BYTES], what[NAME_MAX_BYTES];
    enum err_code rc = ERR_OK;
    for (size_t p = 0; p < PRESETS; p++) {
        double first = 0, bytes = 0;
        snprintf(what, sizeof what, "drc %s", quant_preset_name(presets[p]));
        for (size_t i = 0; !rc && i < sizeof variants / sizeof *variants; i++) {
            rc = layout_bytes(l, FILE_COLUMNS, ORDER_STORED, quant_preset_grid(presets[p]), 0,
                              &variants[i].layout, &bytes, e);
            first = i ? first : bytes;
            snprintf(row, sizeof row, "layout: %s", variants[i].name);
            if (!rc)
                rc = layout_note(l, row, what, bytes, bytes / first, e);
        }
    }
    return rc;
}

/* All formats and presets at SH degrees 0 to 3, without and with the embedding. */
static enum err_code layout_sizes(const struct lay *l, struct err *e)
{
    static const char *const keys[] = {"sh0", "sh1", "sh2", "sh3"};
    const struct gauss *first = &l->leaves.tile[0];
    char row[NAME_MAX_BYTES], what[NAME_MAX_BYTES];
    enum err_code rc = ERR_OK;
    for (int p = 0; !rc && p < QUANT_PRESETS; p++)
        for (int k = 0; !rc && k < 2 + (first->embed_len > 0); k++) {
            uint32_t embed = k == 2 ? first->embed_len : 0;
            json_t *numbers = json_pack("{s:i}", "embed_len", (int)embed);
            snprintf(row, sizeof row, "bytes: %s", quant_preset_name((enum quant_preset)p));
            snprintf(what, sizeof what,
                     embed ? "drc, embedding of %u"
                     : k   ? "drc"
                           : "spz 3",
                     embed);
            for (uint32_t d = 0; !rc && d <= first->sh_degree; d++) {
                struct quant_grid grid = *quant_preset_grid((enum quant_preset)p);
                double bytes = 0;
                grid.sh_degree = (uint8_t)d;
                rc = layout_bytes(l, k ? FILE_DRC : FILE_SPZ3, ORDER_STORED, &grid, embed, NULL,
                                  &bytes, e);
                if (!rc && json_object_set_new(numbers, keys[d], json_real(bytes)))
                    rc = err_set(e, ERR_MEM, "out of memory");
                char name[3 * NAME_MAX_BYTES];
                snprintf(name, sizeof name, "%s, %s, SH %u", row, what, d);
                bench_report(l->b, name, bytes, "bytes", 0, NULL);
            }
            if (rc)
                json_decref(numbers);
            else
                rc = bench_record(l->b, row, what, numbers, e);
        }
    return rc;
}

enum err_code bench_layout(struct bench *b, struct err *e)
{
    struct lay l = {.b = b};
    if (!b->tiles) {
        log_info("bench", "layout skipped: it takes --tiles FILE");
        return ERR_OK;
    }
    enum err_code rc = leaves_read(b->tiles, &l.leaves, e);
    for (size_t i = 0; i < l.leaves.n_tiles; i++)
        axes_enu_to_gltf(&l.leaves.tile[i]);
    if (!rc)
        rc = layout_sizes(&l, e);
    if (!rc)
        rc = layout_orders(&l, e);
    if (!rc)
        rc = layout_layouts(&l, e);
    if (!rc)
        rc = bench_record_write(b, e);
    leaves_free(&l.leaves);
    return rc;
}
