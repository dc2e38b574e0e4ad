/* Rows of statistics of surfaces; see surface_table.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/surface_table.h"

#include <jansson.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>

#include "core/base.h"

static const struct surface_column {
    const char *head, *key;
    size_t at; /* of a double in struct surface_figures */
    int width, digits;
    double times;
    bool truth; /* needs to know where the surface should be */
} surface_columns[] = {
#define AT(field) offsetof(struct surface_figures, field)
    {"thick m", "thickness_m", AT(thickness_m), 8, 3, 1, false},
    {"90 % m", "thickness_90_m", AT(thickness_90_m), 7, 3, 1, false},
    {"never%", "never_opaque", AT(never), 7, 2, 100, false},
    {"light%", "light_through", AT(left), 7, 2, 100, false},
    {"90 % %", "light_through_90", AT(left_90), 7, 2, 100, false},
    {"met", "gaussians_met", AT(met), 6, 1, 1, false},
    {"none %", "missing", AT(missing), 7, 2, 100, false},
    {"median m", "median_m", AT(median_m), 9, 3, 1, true},
    {"signed m", "off_m", AT(off_m), 9, 3, 1, true},
    {"RMSE m", "rmse_m", AT(rmse_m), 7, 3, 1, true},
    {"NMAD m", "nmad_m", AT(nmad_m), 7, 3, 1, true},
    {"LE90 m", "le90_m", AT(le90_m), 7, 3, 1, true},
    {"LE95 m", "le95_m", AT(le95_m), 7, 3, 1, true},
    {">1 GSD%", "above_1_gsd", AT(above[0]), 8, 2, 100, true},
    {">2 GSD%", "above_2_gsd", AT(above[1]), 8, 2, 100, true},
    {">5 GSD%", "above_5_gsd", AT(above[2]), 8, 2, 100, true},
    {">0.5 m%", "above_half_m", AT(above[3]), 8, 2, 100, true},
    {">1 m %", "above_1_m", AT(above[4]), 7, 2, 100, true},
    {"bright", "follows_brightness", AT(follows_brightness), 7, 2, 1, true},
#undef AT
};
enum { SURFACE_COLUMNS = sizeof surface_columns / sizeof *surface_columns };

#define SURFACE_ANY SURFACE_CLASSES
static const struct surface_group {
    const char *name; /* NULL: the class's */
    enum surface_class kind;
    bool level, edge;
    float bright_from, bright_to;
} surface_groups[] = {
    {"level", SURFACE_ANY, true, false, 0, 0},
    {"edges", SURFACE_ANY, false, true, 0, 0},
    {"all", SURFACE_ANY, false, false, 0, 0},
    {"level ground", SURFACE_GROUND, true, false, 0, 0},
    {NULL, SURFACE_GROUND, false, false, 0, 0},
    {NULL, SURFACE_ROOF, false, false, 0, 0},
    {NULL, SURFACE_WALL, false, false, 0, 0},
    {NULL, SURFACE_TREE, false, false, 0, 0},
    {NULL, SURFACE_CAR, false, false, 0, 0},
    {NULL, SURFACE_ASPHALT, false, false, 0, 0},
    {NULL, SURFACE_MARK, false, false, 0, 0},
    {NULL, SURFACE_LAWN, false, false, 0, 0},
    {NULL, SURFACE_BLACK, false, false, 0, 0},
    {NULL, SURFACE_GLASS, false, false, 0, 0},
    {"bright to 0.2", SURFACE_ANY, false, false, 0, 0.2f},
    {"bright 0.2 to 0.4", SURFACE_ANY, false, false, 0.2f, 0.4f},
    {"bright 0.4 to 0.6", SURFACE_ANY, false, false, 0.4f, 0.6f},
    {"bright from 0.6", SURFACE_ANY, false, false, 0.6f, 2.0f},
};

/* What a group picks among these rays; false: they do not know it. */
static bool surface_group_pick(const struct surface_table *t, const struct surface_group *g,
                               struct surface_pick *out)
{
    bool any = g->kind == SURFACE_ANY;
    *out = (struct surface_pick){.kinds = any                       ? 0
                                          : g->kind < SURFACE_BASES ? surface_class_bits(g->kind)
                                                                    : UINT32_C(1) << g->kind,
                                 .level = g->level || g->bright_to > 0.0f,
                                 .edge = g->edge,
                                 .bright_from = g->bright_from,
                                 .bright_to = g->bright_to};
    return (t->edges || !(g->level || g->edge)) && (t->kinds || any);
}

void surface_table_cell(int width, int digits, double v)
{
    if (isfinite(v))
        printf(" %*.*f", width - 1, digits, v);
    else
        printf(" %*s", width - 1, "-");
}

static double surface_value(const struct surface_figures *f, const struct surface_column *c)
{
    return *(const double *)(const void *)((const char *)f + c->at);
}

static bool surface_shown(const struct surface_table *t, const struct surface_column *c)
{
    return t->truth || !c->truth;
}

enum err_code surface_table_row(json_t *rows, const char *what, const char *of, json_t *figures,
                                struct err *e)
{
    json_t *row = json_pack("{s:s, s:s}", "what", what, "views_of", of);
    bool added =
        row && figures && !json_object_update(row, figures) && !json_array_append(rows, row);
    json_decref(row);
    json_decref(figures);
    return added ? ERR_OK : err_set(e, ERR_MEM, "eval: out of memory");
}

static enum err_code surface_group_print(const struct surface_table *t, const char *name,
                                         const struct surface_figures *f, struct err *e)
{
    char of[96];
    json_t *figures = json_pack("{s:I}", "rays", (json_int_t)f->n);
    printf("%-18s %8zu", name, f->n);
    for (size_t i = 0; i < SURFACE_COLUMNS; i++) {
        const struct surface_column *c = &surface_columns[i];
        if (!surface_shown(t, c))
            continue;
        surface_table_cell(c->width, c->digits, c->times * surface_value(f, c));
        if (figures && json_object_set_new(figures, c->key, jsonc_real(surface_value(f, c)))) {
            json_decref(figures);
            figures = NULL;
        }
    }
    putchar('\n');
    snprintf(of, sizeof of, "%s: %s", t->rays, name);
    return surface_table_row(t->rows, t->what, of, figures, e);
}

void surface_table_head(const struct eval_drawing *d, double gsd_m)
{
    printf("%s: GSD %.3f m", d->what, gsd_m);
    if (isfinite(d->gaussians))
        printf("; %.0f Gaussians, %.1f %% of them of opacity below 0.5", d->gaussians,
               100.0 * d->faint);
    putchar('\n');
}

enum err_code surface_table_print(const struct surface_table *t, const struct surface_rays *s,
                                  struct err *e)
{
    enum err_code rc = ERR_OK;
    if (!s->n)
        return ERR_OK;
    printf("%-18s %8s", t->rays, "rays");
    for (size_t i = 0; i < SURFACE_COLUMNS; i++)
        if (surface_shown(t, &surface_columns[i]))
            printf(" %*s", surface_columns[i].width - 1, surface_columns[i].head);
    putchar('\n');
    for (size_t i = 0; !rc && i < sizeof surface_groups / sizeof *surface_groups; i++) {
        const struct surface_group *g = &surface_groups[i];
        struct surface_pick pick;
        struct surface_figures f;
        if (!surface_group_pick(t, g, &pick))
            continue;
        rc = surface_rays_tell(s, &pick, t->gsd_m, &f, e);
        if (!rc && f.n)
            rc = surface_group_print(t, g->name ? g->name : surface_class_name(g->kind), &f, e);
    }
    return rc;
}
