/* citysplat tile: the checkpoints of a trained scene -> one tile store.
 *
 * Each level is combined from all trained cells, a slice of rows at a time. A cell's checkpoint
 * also has background outside its own ground, so each Gaussian is taken only from the cell that
 * owns its place. A cell without a level gives its next coarser one, so that no level has holes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/base/results.h"
#include "cli/base/splats.h"
#include "cli/tiles/photographs.h"
#include "codec/container/ckpt.h"
#include "codec/container/seen.h"
#include "codec/scene/scene.h"
#include "core/splat/appearance.h"
#include "lod/make/pyramid.h"
#include "lod/make/update.h"
#include "lod/store/bake.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/footprint.h"
#include "scene/cells/partition.h"
#include "scene/cells/support.h"
#include "scene/cells/trim.h"
#include "train/base/config.h"

enum { TILE_LEVELS_MAX = 7, TILE_PART_ROWS = 131072 };

struct tile_options {
#define OPT OPTIONS_MEMBER
#include "cli/tiles/tile.def"
};

static const struct options_def tile_defs[] = {
#define OPT(...) OPTIONS_ROW(struct tile_options, __VA_ARGS__)
#include "cli/tiles/tile.def"
};

static const struct options_spec tile_spec = {
    .command = "tile",
    .usage = "citysplat tile SCENE -o CITY.tiles [options]\n"
             "       citysplat tile SCENE --update CITY.tiles --cell ID",
    .about = "Cuts the trained levels of a scene into tiles z/x/y of the Web Mercator grid. "
             "Makes overviews until one tile holds the scene. Writes everything into one file "
             "for `citysplat serve`.",
    .example = "citysplat tile scene -o city.tiles --attribution '© Survey 2026'",
    .defs = tile_defs,
    .n_defs = sizeof tile_defs / sizeof *tile_defs,
    .min_args = 1,
    .max_args = 1};

struct tile_cell {
    char id[64];
    size_t owner; /* index into the plan's cells of those present; unused without a plan */
    bool has[TILE_LEVELS_MAX + 1];
};

struct tile_scene {
    const char *dir, *trained; /* scene.json and plan.json; cells/ */
    const struct scene *of;
    struct tile_cell *cells; /* sorted by id */
    size_t n_cells;
    struct footprint footprint; /* empty: nothing is left out */
    struct trim trim;           /* empty: nothing is cut at the edge */
    atomic_size_t *cropped;     /* rows of all levels that --crop left out; tile_load has threads */
    struct partition plan;      /* only cells with checkpoints; n_cells 0 = no plan */
    uint8_t n_levels;
    struct buf appearance; /* appearance model of all checkpoints, as they hold it; empty: none */
    bool look_known;
    struct arena arena;
};

struct tile_file { /* an opened checkpoint and the cell whose ground is taken from it */
    struct ckpt_rows *rows;
    size_t cell;
};
struct tile_level { /* what load() needs */
    const struct tile_scene *scene;
    uint8_t level;
    struct tile_file *file; /* one a cell that is not empty */
    size_t n_files;
    size_t *first;  /* [n_files + 1] number of the first part of each file */
    double pixel_m; /* pyramid_level.pixel_m */
};

static enum err_code tile_path(char path[FILE_PATH_MAX], const struct tile_scene *s, const char *id,
                               uint8_t level, struct err *e)
{
    int n = snprintf(path, FILE_PATH_MAX, "%s/cells/%s/level%u.ckpt", s->trained, id, level);
    return n > 0 && n < FILE_PATH_MAX ? ERR_OK : err_set(e, ERR_LIMIT, "%s: path too long", s->dir);
}

static int tile_cell_compare(const void *a, const void *b)
{
    return strcmp(((const struct tile_cell *)a)->id, ((const struct tile_cell *)b)->id);
}

/* The folders below cells/ that hold a checkpoint. */
static enum err_code tile_find_cells(struct tile_scene *s, struct err *e)
{
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    enum err_code rc = file_join(dir, s->trained, "cells", e);
    DIR *d = rc ? NULL : opendir(dir);
    if (!rc && !d)
        return err_set(e, ERR_NOENT,
                       "%s: no trained cells in there; run `citysplat train %s` first", dir,
                       s->dir);
    size_t cap = 0;
    for (struct dirent *ent; !rc && (ent = readdir(d));) {
        struct tile_cell c = {0};
        bool any = false;
        if (ent->d_name[0] == '.' || strlen(ent->d_name) >= sizeof c.id ||
            !strcmp(ent->d_name, TRAIN_COARSE_ID)) /* what all cells began from */
            continue;
        memcpy(c.id, ent->d_name, strlen(ent->d_name));
        for (uint8_t l = 1; !rc && l <= TILE_LEVELS_MAX; l++) {
            rc = tile_path(path, s, c.id, l, e);
            c.has[l] = !rc && file_exists(path);
            any = any || c.has[l];
            if (c.has[l] && s->n_levels < l)
                s->n_levels = l;
        }
        if (!any)
            continue;
        struct tile_cell *p = mem_room(s->cells, s->n_cells, &cap, 16, sizeof *p);
        if (!p) {
            rc = err_set(e, ERR_MEM, "%s: out of memory", dir);
            break;
        }
        s->cells = p;
        s->cells[s->n_cells++] = c;
    }
    if (d)
        closedir(d);
    if (!rc && !s->n_cells)
        rc = err_set(e, ERR_NOENT,
                     "%s: no level<n>.ckpt in any cell; run `citysplat train %s` first", dir,
                     s->dir);
    if (!rc)
        qsort(s->cells, s->n_cells, sizeof *s->cells, tile_cell_compare);
    return rc;
}

/* Leave out of the plan what is not trained, and number the rest anew: keep[i] says whether cell i
 * stays. A background cell stays with its parent, whose ground it is. */
static void tile_thin_plan(struct partition *p, const bool *keep, size_t *number)
{
    size_t n = 0;
    for (size_t i = 0; i < p->n_cells; i++)
        number[i] = keep[i] ? n++ : SIZE_MAX;
    for (size_t i = 0; i < p->n_cells; i++) {
        if (!keep[i])
            continue;
        struct partition_cell c = p->cells[i];
        if (c.parent >= 0)
            c.parent = (ptrdiff_t)number[c.parent];
        p->cells[number[i]] = c; /* number[i] <= i */
    }
    p->n_cells = n;
}

/* The trained cell of this id; NULL when there is none. */
static struct tile_cell *tile_find(struct tile_scene *s, const char *id)
{
    struct tile_cell want = {0};
    snprintf(want.id, sizeof want.id, "%s", id);
    return bsearch(&want, s->cells, s->n_cells, sizeof want, tile_cell_compare);
}

/* Which cells of the plan are trained, or background of one that is? number: scratch of n_cells. */
static enum err_code tile_keep(struct tile_scene *s, bool *keep, size_t *number, struct err *e)
{
    const struct partition *p = &s->plan;
    size_t trained = 0;
    for (size_t i = 0; i < p->n_cells; i++) {
        const struct partition_cell *c = &p->cells[i];
        keep[i] = c->parent < 0 && tile_find(s, c->id);
        trained += keep[i];
        if (c->parent < 0 && !keep[i])
            log_warn("tile",
                     "cell %s of the plan is not trained: its ground is left to its neighbours",
                     c->id);
    }
    if (trained != s->n_cells)
        return err_set(e, ERR_DATA,
                       "%s: %zu cells are trained, the plan knows %zu of them; remove those of an "
                       "older plan from cells/",
                       s->dir, s->n_cells, trained);
    for (size_t i = 0; i < p->n_cells; i++) {
        size_t up = i;
        while (p->cells[up].parent >= 0)
            up = (size_t)p->cells[up].parent;
        number[i] = up;
    }
    for (size_t i = 0; i < p->n_cells; i++)
        if (number[i] != i)
            keep[i] = keep[number[i]];
    return ERR_OK;
}

/* Match cells to the plan and keep in the plan those that are trained: they share all the ground.
 */
static enum err_code tile_match_plan(struct tile_scene *s, const struct scene *scene, struct err *e)
{
    char path[FILE_PATH_MAX];
    enum err_code rc = file_join(path, s->dir, "plan.json", e);
    if (rc || s->n_cells == 1)
        return rc;
    if (!file_exists(path))
        return err_set(e, ERR_DATA,
                       "%s: %zu cells are trained and plan.json is missing, so nothing says which "
                       "owns which ground",
                       s->dir, s->n_cells);
    rc = cell_plan_read(path, scene, &s->plan, e);
    if (rc)
        return rc;
    bool *keep = mem_array(s->plan.n_cells, sizeof *keep);
    size_t *number = mem_array(s->plan.n_cells, sizeof *number);
    if (!keep || !number)
        rc = err_set(e, ERR_MEM, "%s: out of memory for %zu cells", path, s->plan.n_cells);
    if (!rc)
        rc = tile_keep(s, keep, number, e);
    if (!rc)
        tile_thin_plan(&s->plan, keep, number);
    for (size_t i = 0; !rc && i < s->plan.n_cells; i++)
        if (s->plan.cells[i].parent < 0)
            tile_find(s, s->plan.cells[i].id)->owner = i;
    mem_free(keep);
    mem_free(number);
    return rc;
}

enum { TILE_SURE = 3 };                /* photographs that know how far away a thing is */
#define TILE_FREE_SPACE 0.05           /* flight heights above the points around, as in training */
#define TILE_OPACITY_MIN (1.0 / 255.0) /* what is fainter than that is never drawn */

/* Fade a row by the footprint; false: nothing is left of it. */
static bool tile_fade(const struct footprint *f, struct gauss *g, size_t i)
{
    double mean[3], quat[4], rot[9], cov[9] = {0};
    if (!f->nx)
        return true;
    for (int a = 0; a < 4; a++)
        quat[a] = (double)g->quat_wxyz[4 * i + a];
    camera_quat_to_rot(quat, rot);
    for (int a = 0; a < 3; a++)
        mean[a] = (double)g->mean_m[3 * i + a] + g->origin_enu_m[a];
    for (int a = 0; a < 3; a++) /* the diagonal is all that is looked at */
        for (int k = 0; k < 3; k++) {
            double sigma = exp((double)g->scale_log[3 * i + k]) * rot[3 * a + k];
            cov[4 * a] += sigma * sigma;
        }
    double w = footprint_weight(f, mean, cov);
    if (w >= 1.0)
        return true;
    double opacity = w / (1.0 + exp(-(double)g->opacity_logit[i]));
    if (!(opacity >= TILE_OPACITY_MIN))
        return false;
    g->opacity_logit[i] = (float)log(opacity / (1.0 - opacity));
    return true;
}

/* The rows of a slice that its cell owns, within the crop. ERR_MEM. */
static enum err_code tile_own(const struct tile_scene *s, const struct tile_cell *c,
                              struct gauss *g, struct err *e)
{
    size_t n = 0, gone = 0;
    if (!s->plan.n_cells && !s->footprint.nx)
        return ERR_OK;
    for (size_t i = 0; i < g->n; i++) {
        double x = (double)g->mean_m[3 * i] + g->origin_enu_m[0],
               y = (double)g->mean_m[3 * i + 1] + g->origin_enu_m[1];
        if (s->plan.n_cells && partition_owner(&s->plan, x, y) != c->owner)
            continue;
        if (!tile_fade(&s->footprint, g, i)) {
            atomic_fetch_add(s->cropped, 1);
            continue;
        }
        if (n != i)
            gauss_copy_row(g, n, g, i);
        n++;
    }
    g->n = n;
    enum err_code rc = trim_rows(&s->trim, g, &gone, e);
    atomic_fetch_add(s->cropped, gone);
    return rc;
}

static enum err_code tile_load(void *user, size_t part, struct gauss *out, struct err *e)
{
    const struct tile_level *l = user;
    size_t f = 0;
    while (part >= l->first[f + 1])
        f++;
    const struct tile_file *file = &l->file[f];
    size_t from = (part - l->first[f]) * TILE_PART_ROWS, n = ckpt_rows_count(file->rows) - from;
    enum err_code rc =
        ckpt_rows_read(file->rows, from, n < TILE_PART_ROWS ? n : TILE_PART_ROWS, out, e);
    if (!rc)
        rc = tile_own(l->scene, &l->scene->cells[file->cell], out, e);
    return rc;
}

/* The nearest level that a cell has: coarser ones first. */
static uint8_t tile_nearest(const struct tile_cell *c, uint8_t level)
{
    uint8_t l = level;
    while (l > 0 && !c->has[l])
        l--;
    for (uint8_t up = level; l == 0 && up <= TILE_LEVELS_MAX; up++)
        l = c->has[up] ? up : 0;
    return l;
}

/* One network reads the embeddings of all tiles: cells and levels must have been trained with it.
 */
static enum err_code tile_check_blob(struct tile_scene *s, const struct ckpt_blob *blob,
                                     const char *path, struct err *e)
{
    static const struct ckpt_blob none = {0};
    blob = blob ? blob : &none;
    if (!s->look_known) {
        s->look_known = true;
        buf_add(&s->appearance, blob->data, blob->size_bytes);
        return buf_check(&s->appearance, e);
    }
    if (blob->size_bytes == s->appearance.size &&
        (!s->appearance.size || !memcmp(blob->data, s->appearance.data, s->appearance.size)))
        return ERR_OK;
    return err_set(e, ERR_DATA,
                   "%s: its appearance model is not that of the checkpoints before: tiles share "
                   "one; train all cells in one run, with --appearance-shared",
                   path);
}

static enum err_code tile_check_look(struct tile_scene *s, const struct ckpt_rows *rows,
                                     const char *path, struct err *e)
{
    struct buf b = {0};
    enum err_code rc = ckpt_rows_blob(rows, "appearance", &b, e);
    const struct ckpt_blob blob = {"appearance", b.data, b.size};
    if (!rc)
        rc = tile_check_blob(s, &blob, path, e);
    buf_free(&b);
    return rc;
}

/* Is it of this scene, and the largest pixel of all cells: none is shown from nearer than its own
 * allows. Checkpoints of before have none. */
static enum err_code tile_read_head(const struct ckpt_rows *rows, const char *path,
                                    struct tile_level *l, struct err *e)
{
    struct json_t *meta = NULL;
    enum err_code rc = ckpt_rows_meta(rows, &meta, e);
    if (!rc)
        rc = results_check_origin(l->scene->of, path, meta, e);
    const double pixel_m = json_number_value(json_object_get(meta, "pixel_m"));
    json_decref(meta);
    if (!rc && pixel_m > 0.0 && isfinite(pixel_m))
        l->pixel_m = fmax(l->pixel_m, pixel_m);
    return rc;
}

static enum err_code tile_open_level(struct tile_scene *s, uint8_t level, struct tile_level *l,
                                     struct err *e)
{
    enum err_code rc = ERR_OK;
    *l = (struct tile_level){.scene = s, .level = level};
    l->file = mem_array(s->n_cells, sizeof *l->file);
    l->first = mem_array(s->n_cells + 1, sizeof *l->first);
    if (!l->file || !l->first)
        return err_set(e, ERR_MEM, "out of memory for %zu cells", s->n_cells);
    for (size_t i = 0; !rc && i < s->n_cells; i++) {
        char path[FILE_PATH_MAX];
        struct tile_file *f = &l->file[l->n_files];
        f->cell = i;
        rc = tile_path(path, s, s->cells[i].id, tile_nearest(&s->cells[i], level), e);
        if (!rc)
            rc = ckpt_rows_open(path, &f->rows, e);
        if (rc)
            break;
        rc = tile_check_look(s, f->rows, path, e);
        if (!rc)
            rc = tile_read_head(f->rows, path, l, e);
        size_t parts = (ckpt_rows_count(f->rows) + TILE_PART_ROWS - 1) / TILE_PART_ROWS;
        l->first[l->n_files + 1] = l->first[l->n_files] + parts;
        l->n_files++;
    }
    return rc;
}

static void tile_close_level(struct tile_level *l)
{
    for (size_t i = 0; i < l->n_files; i++)
        ckpt_rows_close(&l->file[i].rows);
    mem_free(l->file);
    mem_free(l->first);
}

static void tile_warn_missing(const struct tile_scene *s)
{
    for (size_t i = 0; i < s->n_cells; i++)
        for (uint8_t l = 1; l <= s->n_levels; l++)
            if (!s->cells[i].has[l])
                log_warn("tile", "cell %s has no level %u yet: its nearest other level stands in",
                         s->cells[i].id, l);
}

/* The appearance model as the store keeps it: with the default appearance, fitted to the first
 * Gaussians of the finest level. Stays empty where there is none. */
static enum err_code tile_make_appearance(const struct tile_scene *s,
                                          const struct tile_level *finest, struct buf *out,
                                          struct err *e)
{
    struct appearance a = {0}, full = {0};
    struct gauss g = {0};
    if (!s->appearance.size || !finest->n_files)
        return ERR_OK;
    const struct ckpt_rows *rows = finest->file[finest->n_files / 2].rows;
    size_t n = ckpt_rows_count(rows);
    enum err_code rc = appearance_read(s->appearance.data, s->appearance.size, &a, e);
    if (!rc)
        rc = ckpt_rows_read(rows, 0, n < TILE_PART_ROWS ? n : TILE_PART_ROWS, &g, e);
    if (!rc)
        rc = bake_with_default(&a, &g, &full, e);
    if (!rc)
        rc = appearance_write(&full, out, e);
    gauss_free(&g);
    appearance_free(&a);
    appearance_free(&full);
    return rc;
}

/* What people choose an appearance by: the photographs that the model knows. */
static enum err_code tile_photographs(const struct scene *scene, const struct buf *appearance,
                                      bool thumbnails, struct photographs *out, struct err *e)
{
    struct appearance a = {0};
    enum err_code rc = appearance_read(appearance->data, appearance->size, &a, e);
    if (!rc)
        rc = photographs_of(scene, &a, thumbnails, out, e);
    appearance_free(&a);
    return rc;
}

static void tile_print(const char *path, const struct pyramid_report *r)
{
    printf("%s: %zu tiles, zoom %u to %u, at most %zu Gaussians in one, revision %s, %.1f s\n",
           path, r->n_tiles, r->zoom_min, r->zoom_max, r->max_in_tile, r->revision, r->seconds);
    for (size_t l = 7; l > 0; l--)
        if (r->n_gaussians[l])
            printf("level %zu    %10zu Gaussians\n", l, r->n_gaussians[l]);
    if (r->n_gaussians[0])
        printf("overviews  %10zu Gaussians\n", r->n_gaussians[0]);
}

/* ---- one cell into a store that exists ---- */

struct tile_ground { /* of one cell, for lod/make/update_build.c */
    const struct partition *plan;
    size_t cell;
};

static bool tile_owns(void *user, double x_m, double y_m)
{
    const struct tile_ground *t = user;
    return partition_owner(t->plan, x_m, y_m) == t->cell;
}

/* Not when the box lies within another cell. */
static bool tile_may_own(void *user, const double min_m[3], const double max_m[3])
{
    const struct tile_ground *t = user;
    for (size_t i = 0; i < t->plan->n_cells; i++) {
        size_t owner = i;
        while (t->plan->cells[owner].parent >= 0)
            owner = (size_t)t->plan->cells[owner].parent;
        if (owner != t->cell && partition_covers(t->plan, i, min_m, max_m))
            return false;
    }
    return true;
}

static enum err_code tile_update(struct tile_scene *s, const struct tile_options *o, struct err *e)
{
    struct tile_ground ground = {.plan = &s->plan};
    struct update_config cfg = {.owns = tile_owns, .may_own = tile_may_own, .user = &ground};
    struct update_report r;
    struct ckpt level[TILE_LEVELS_MAX + 1] = {{0}};
    const struct tile_cell *cell = NULL;
    struct appearance appearance = {0};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < s->n_cells; i++)
        if (!strcmp(s->cells[i].id, o->cell))
            cell = &s->cells[i];
    if (!s->plan.n_cells)
        return err_set(e, ERR_ARG,
                       "%s has one cell: there is nothing to keep, so tile it anew "
                       "with -o instead of --update",
                       s->dir);
    if (!cell)
        return err_set(e, ERR_ARG, "--cell %s: no trained cell of this name in %s/cells", o->cell,
                       s->trained);
    ground.cell = cell->owner;
    for (uint8_t l = 1; !rc && l <= s->n_levels; l++) {
        char path[FILE_PATH_MAX];
        rc = tile_path(path, s, cell->id, tile_nearest(cell, l), e);
        if (!rc)
            rc = ckpt_read(path, &level[l], e);
        if (!rc)
            rc = results_check_origin(s->of, path, level[l].meta, e);
        if (!rc)
            rc = tile_own(s, cell, &level[l].g, e);
        if (!rc)
            rc = tile_check_blob(s, ckpt_find(&level[l], "appearance"), path, e);
        cfg.level[l] = &level[l].g;
    }
    if (!rc && s->appearance.size) {
        rc = appearance_read(s->appearance.data, s->appearance.size, &appearance, e);
        cfg.appearance = &appearance;
    }
    if (!rc)
        rc = update_build(o->update, &cfg, o->output ? o->output : o->update, &r, e);
    if (!rc)
        printf("%s: cell %s: %zu tiles written, %zu kept, %zu removed, revision %s\n",
               o->output ? o->output : o->update, cell->id, r.n_written, r.n_copied, r.n_removed,
               r.revision);
    for (uint8_t l = 1; l <= TILE_LEVELS_MAX; l++)
        ckpt_free(&level[l]);
    appearance_free(&appearance);
    return rc;
}

/* --crop: what the scene's photographs support, the polygons of a file, or everything. */
static enum err_code tile_crop(struct tile_scene *s, const struct scene *scene, const char *crop,
                               struct err *e)
{
    enum err_code rc = ERR_OK;
    bool own = !strcmp(crop, "footprint");
    if (!strcmp(crop, "none"))
        return ERR_OK;
    if (!own && !file_exists(crop))
        return err_set(e, ERR_NOENT,
                       "--crop %s: no such file; give footprint, none or a GeoJSON file", crop);
    rc = footprint_of(scene, &s->footprint, e);
    if (rc)
        return rc;
    return own ? trim_open(scene, &s->footprint, TILE_SURE, TILE_FREE_SPACE * s->footprint.height_m,
                           &s->trim, e)
               : footprint_read(&s->footprint, crop, &scene->origin, e);
}

/* Name and attribution of the store. */
static enum err_code tile_describe(const struct tile_options *o, const struct scene *scene,
                                   struct pyramid_config *cfg, struct err *e)
{
    const char *attribution = o->attribution ? o->attribution : scene->attribution;
    if (strlen(attribution ? attribution : "") >= sizeof cfg->attribution)
        return err_set(e, ERR_ARG, "--attribution: at most %zu bytes", sizeof cfg->attribution - 1);
    snprintf(cfg->attribution, sizeof cfg->attribution, "%s", attribution ? attribution : "");
    memcpy(cfg->heights, scene->heights, sizeof cfg->heights);
    return splats_name(o->name, o->output, cfg->name, e);
}

/* What the store keeps besides tiles; empty ones are left out. The blobs borrow the bytes; *out:
 * caller frees with mem_free. */
static enum err_code tile_blobs(const struct photographs *photographs, const struct buf *appearance,
                                const struct buf *ground, const struct buf *seen,
                                struct store_blob **out, size_t *n, struct err *e)
{
    struct store_blob *blobs = mem_array(photographs->n_blobs + 3, sizeof *blobs);
    if (!blobs)
        return err_set(e, ERR_MEM, "out of memory for %zu blobs", photographs->n_blobs);
    *n = 0;
    for (size_t i = 0; i < photographs->n_blobs; i++)
        blobs[(*n)++] = photographs->blobs[i];
    if (appearance->size)
        blobs[(*n)++] = (struct store_blob){BAKE_BLOB, appearance->data, appearance->size};
    if (ground->size)
        blobs[(*n)++] = (struct store_blob){STORE_FOOTPRINT, ground->data, ground->size};
    if (seen->size)
        blobs[(*n)++] = (struct store_blob){SEEN_BLOB, seen->data, seen->size};
    *out = blobs;
    return ERR_OK;
}

/* Counts the photographs that see each place of the finest level. */
static enum err_code tile_count_views(struct tile_scene *s, const struct scene *scene,
                                      const struct pyramid_level *finest, struct buf *out,
                                      struct err *e)
{
    struct support support;
    enum err_code rc = support_open(&s->footprint, &support, e);
    for (size_t part = 0; !rc && support.nx && part < finest->n_parts; part++) {
        struct gauss g = {0};
        rc = finest->load(finest->user, part, &g, e);
        for (size_t i = 0; !rc && i < g.n; i++) {
            const double mean[3] = {(double)g.mean_m[3 * i] + g.origin_enu_m[0],
                                    (double)g.mean_m[3 * i + 1] + g.origin_enu_m[1],
                                    (double)g.mean_m[3 * i + 2] + g.origin_enu_m[2]};
            support_add(&support, mean, 1.0 / (1.0 + exp(-(double)g.opacity_logit[i])));
        }
        gauss_free(&g);
    }
    atomic_store(s->cropped, 0); /* the store loads these rows once more */
    if (!rc && support.nx)
        rc = support_count(&support, scene, e);
    if (!rc && support.nx)
        rc = support_write(&support, out, e);
    support_free(&support);
    return rc;
}

/* Levels, blobs and the store of a scene that was looked at. */
static enum err_code tile_build(struct tile_scene *s, const struct scene *scene,
                                const struct tile_options *o, struct err *e)
{
    struct tile_level level[TILE_LEVELS_MAX] = {{0}};
    struct pyramid_level levels[TILE_LEVELS_MAX] = {{0}};
    struct pyramid_config cfg = {.tile_edge_m = o->tile_edge_m, .lossless = o->lossless};
    struct pyramid_report report;
    struct photographs photographs = {0};
    struct buf appearance = {0}, ground = {0}, seen = {0};
    struct store_blob *blobs = NULL;
    size_t n_blobs = 0;
    enum err_code rc = tile_describe(o, scene, &cfg, e);
    for (uint8_t i = 0; !rc && i < s->n_levels; i++) {
        rc = tile_open_level(s, (uint8_t)(i + 1), &level[i], e);
        levels[i] = (struct pyramid_level){
            .level = level[i].level,
            .pixel_m = i + 1 < s->n_levels ? level[i].pixel_m : 0.0,
            .load = tile_load,
            .user = &level[i],
            .n_parts = level[i].first ? level[i].first[level[i].n_files] : 0};
    }
    if (!rc)
        rc = tile_make_appearance(s, &level[s->n_levels - 1], &appearance, e);
    if (!rc && s->footprint.nx)
        rc = footprint_write(&s->footprint, &scene->origin, &ground, e);
    if (!rc && s->footprint.nx)
        rc = tile_count_views(s, scene, &levels[s->n_levels - 1], &seen, e);
    if (!rc && appearance.size)
        rc = tile_photographs(scene, &appearance, o->thumbnails, &photographs, e);
    if (!rc)
        rc = tile_blobs(&photographs, &appearance, &ground, &seen, &blobs, &n_blobs, e);
    if (!rc)
        rc = pyramid_build(&scene->origin, levels, s->n_levels, &cfg, blobs, n_blobs, o->output,
                           &report, e);
    if (!rc)
        tile_print(o->output, &report);
    if (!rc && photographs.thumbnail_bytes)
        printf("thumbnails %10zu photographs, %zu kB\n", photographs.n,
               photographs.thumbnail_bytes / 1000);
    mem_free(blobs);
    for (uint8_t i = 0; i < TILE_LEVELS_MAX; i++)
        tile_close_level(&level[i]);
    photographs_free(&photographs);
    buf_free(&appearance);
    buf_free(&ground);
    buf_free(&seen);
    return rc;
}

static enum err_code tile_run(const char *dir, const struct tile_options *o, struct err *e)
{
    atomic_size_t cropped = 0;
    struct tile_scene s = {
        .dir = dir, .trained = o->trained ? o->trained : dir, .cropped = &cropped};
    struct scene scene = {0};
    s.of = &scene;
    enum err_code rc = scene_read(dir, &scene, e);
    if (!rc)
        rc = tile_crop(&s, &scene, o->crop, e);
    if (!rc)
        rc = tile_find_cells(&s, e);
    if (!rc)
        rc = tile_match_plan(&s, &scene, e);
    for (size_t i = 0; !rc && i < s.n_cells; i++)
        if (!o->cell || !strcmp(o->cell, s.cells[i].id))
            results_warn_unfinished("tile", &scene, s.trained, s.cells[i].id);
    if (!rc && o->update) {
        rc = tile_update(&s, o, e);
    } else if (!rc) {
        tile_warn_missing(&s);
        rc = tile_build(&s, &scene, o, e);
        if (!rc && s.footprint.nx)
            printf(
                "cropped    %10zu Gaussians of all levels, outside of what the photographs support "
                "(--crop)\n",
                atomic_load(&cropped));
    }
    buf_free(&s.appearance);
    trim_free(&s.trim);
    footprint_free(&s.footprint);
    partition_free(&s.plan);
    mem_free(s.cells);
    scene_free(&scene);
    return rc;
}

enum err_code cli_tile(int argc, char **argv, struct err *e)
{
    struct tile_options o = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&tile_spec, argc, argv, &o, &args, &arena, e);
    if (!rc && !args.done && (!o.update != !o.cell))
        rc = err_set(e, ERR_ARG, "--update FILE and --cell ID belong together");
    if (!rc && !args.done && !o.output && !o.update)
        rc = err_set(e, ERR_ARG, "-o FILE is missing: where to write the tiles");
    if (!rc && !args.done && !(o.update && o.output && !strcmp(o.update, o.output)))
        rc = output_check(o.output, o.overwrite, e);
    if (!rc && !args.done)
        rc = output_apart(o.output, o.crop, e);
    if (!rc && !args.done) {
        signals_catch();
        rc = tile_run(args.arg[0], &o, e);
    }
    arena_free(&arena);
    return rc;
}
