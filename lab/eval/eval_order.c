/* citysplat-lab eval-order: what another order of refinement could gain.
 *
 * Level selection refines tiles in the order of their errors on the screen. Here each test
 * photograph is drawn with the finest level, and then once for each tile of the next coarser level,
 * with that tile in place of its children. That gives what the tile costs and saves: squared error
 * of the photograph, and Gaussians. Tiles are then made coarse until a share of the Gaussians is
 * left, in two orders: by error on the screen, as level selection does with a budget, and by cost
 * for each Gaussian saved. The second order knows the photograph, which no number that is stored
 * with a tile does. Costs are those of single tiles, so what tiles hide of each other is left out.
 * Only the finest level and the one above it take part.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lab/eval/eval_lab.h"
#include "lab/lab.h"
#include "lod/choose/view.h"
#include "lod/store/tree.h"
#include "train/photographs/photo_loader.h"

struct eval_order_options {
#define OPT OPTIONS_MEMBER
#include "lab/eval/eval_order.def"
};

static const struct options_def eval_order_defs[] = {
#define OPT(...) OPTIONS_ROW(struct eval_order_options, __VA_ARGS__)
#include "lab/eval/eval_order.def"
};

enum eval_order_way { EVAL_ORDER_ERROR, EVAL_ORDER_BEST, EVAL_ORDER_WAYS };
static const char *const eval_order_names[EVAL_ORDER_WAYS] = {"by error", "by photograph"};
enum { EVAL_ORDER_SHARES = 4, EVAL_ORDER_CACHE = 64 << 20 /* bytes of photographs */ };

struct eval_order_group { /* a tile that could stand for its children in a picture */
    uint32_t parent;
    double key[EVAL_ORDER_WAYS]; /* made coarse in ascending order */
    double saved;                /* Gaussians */
};
struct eval_order { /* {0} is empty; eval_order_clear */
    struct view *view;
    struct render_options ro;
    const struct tree *tree;
    uint32_t *cut, *mixed; /* [n_nodes] tiles of the finest picture, and of the one at hand */
    bool *coarse;          /* [n_nodes] stands for its children */
    size_t n_cut, n_mixed;
    struct eval_order_group *group; /* [n_nodes] */
    size_t n_groups;
    float *rgb; /* [h][w][3] of the photograph at hand */
    size_t n_photographs;
    double share[EVAL_ORDER_SHARES];
    double finest_db; /* sums over photographs, as are those below */
    double db[EVAL_ORDER_WAYS][EVAL_ORDER_SHARES], left[EVAL_ORDER_WAYS][EVAL_ORDER_SHARES];
};

static void eval_order_clear(struct eval_order *o)
{
    mem_free(o->cut);
    mem_free(o->mixed);
    mem_free(o->coarse);
    mem_free(o->group);
    mem_free(o->rgb);
    view_close(&o->view);
}

static enum err_code eval_order_prepare(struct eval_order *o, double least, struct err *e)
{
    for (size_t i = 0; i < EVAL_ORDER_SHARES; i++)
        o->share[i] = 1.0 - (1.0 - least) * (double)(i + 1) / EVAL_ORDER_SHARES;
    if (view_appearance(o->view))
        return err_set(e, ERR_ARG, "eval-order: not of tiles with appearance");
    o->tree = store_tree(view_store(o->view));
    const size_t n = o->tree->n_nodes;
    o->cut = mem_array(n + 1, sizeof *o->cut);
    o->mixed = mem_array(n + 1, sizeof *o->mixed);
    o->coarse = mem_array(n + 1, sizeof *o->coarse);
    o->group = mem_array(n + 1, sizeof *o->group);
    return o->cut && o->mixed && o->coarse && o->group
               ? ERR_OK
               : err_set(e, ERR_MEM, "eval: out of memory for %zu tiles", n);
}

/* Sum of squared differences over the pixels that count, and their number of values. */
static double eval_order_error(const struct photo *p, const float *rgb, size_t *n)
{
    const size_t pixels = (size_t)p->cam.width_px * p->cam.height_px;
    double sum = 0.0;
    *n = 0;
    for (size_t i = 0; i < pixels; i++) {
        if (p->mask && !p->mask[i])
            continue;
        *n += 3;
        for (size_t c = 3 * i; c < 3 * i + 3; c++) {
            const double d = fmin(fmax((double)rgb[c], 0.0), 1.0) - (double)p->px[c] / 255.0;
            sum += d * d;
        }
    }
    return sum;
}

static double eval_order_db(double sum, size_t n)
{
    return -10.0 * log10(fmax(sum, 1e-12) / (double)n);
}

/* The tiles of the picture where o->coarse stand for their children, ascending. */
static void eval_order_mix(struct eval_order *o)
{
    size_t at = 0;
    o->n_mixed = 0;
    for (uint32_t i = 0; i < o->tree->n_tiles; i++) {
        const bool fine = at < o->n_cut && o->cut[at] == i;
        at += fine;
        const uint32_t up = tree_node(o->tree, i).parent;
        if (o->coarse[i] || (fine && (up == TREE_NONE || !o->coarse[up])))
            o->mixed[o->n_mixed++] = i;
    }
}

static enum err_code eval_order_draw(struct eval_order *o, const struct photo *p, double *gaussians,
                                     double *sum, size_t *n, struct err *e)
{
    struct view_stats st = {0};
    eval_order_mix(o);
    const struct view_tiles tiles = {.tile = o->mixed, .n = o->n_mixed};
    enum err_code rc = view_render_tiles(o->view, &tiles, &p->cam, &o->ro, o->rgb, &st, e);
    *gaussians = (double)st.n_gaussians;
    *sum = rc ? 0.0 : eval_order_error(p, o->rgb, n);
    return rc;
}

/* As in lod/choose/pick.c: error over the distance to the core. */
static double eval_order_screen(const struct eval_order *o, uint32_t node, const double eye[3])
{
    const struct tree_bounds b = tree_bounds(o->tree, node);
    double d2 = 0.0;
    for (size_t k = 0; k < 3; k++) {
        const double d = fmax(fmax(b.core_min_enu_m[k] - eye[k], eye[k] - b.core_max_enu_m[k]), 0);
        d2 += d * d;
    }
    return tree_node(o->tree, node).geometric_error_m / sqrt(d2);
}

/* The parents of the tiles in the picture. */
static void eval_order_find(struct eval_order *o, const struct camera *cam)
{
    double eye[3];
    camera_center(cam, eye);
    o->n_groups = 0;
    for (size_t i = 0; i < o->n_cut; i++) {
        const uint32_t up = tree_node(o->tree, o->cut[i]).parent;
        if (up == TREE_NONE || tree_node(o->tree, up).tile == TREE_NONE || o->coarse[up])
            continue;
        o->coarse[up] = true;
        o->group[o->n_groups++] = (struct eval_order_group){
            .parent = up, .key[EVAL_ORDER_ERROR] = eval_order_screen(o, up, eye)};
    }
    for (size_t i = 0; i < o->n_groups; i++)
        o->coarse[o->group[i].parent] = false;
}

/* What each tile costs and saves alone. */
static enum err_code eval_order_price(struct eval_order *o, const struct photo *p, double gaussians,
                                      double sum, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < o->n_groups; i++) {
        struct eval_order_group *g = &o->group[i];
        double left, now;
        size_t n;
        o->coarse[g->parent] = true;
        rc = eval_order_draw(o, p, &left, &now, &n, e);
        o->coarse[g->parent] = false;
        g->saved = gaussians - left;
        g->key[EVAL_ORDER_BEST] = g->saved > 0.0 ? (now - sum) / g->saved
                                  : now < sum    ? -HUGE_VAL
                                                 : HUGE_VAL;
        if (!rc && signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stopped");
    }
    return rc;
}

static int eval_order_compare(const struct eval_order_group *a, const struct eval_order_group *b,
                              enum eval_order_way way)
{
    if (a->key[way] != b->key[way])
        return a->key[way] < b->key[way] ? -1 : 1;
    return a->parent < b->parent ? -1 : a->parent > b->parent;
}

static int eval_order_compare_error(const void *a, const void *b)
{
    return eval_order_compare(a, b, EVAL_ORDER_ERROR);
}

static int eval_order_compare_best(const void *a, const void *b)
{
    return eval_order_compare(a, b, EVAL_ORDER_BEST);
}

/* Makes tiles coarse in an order until the share is left. */
static enum err_code eval_order_spend(struct eval_order *o, const struct photo *p, double gaussians,
                                      enum eval_order_way way, size_t row, struct err *e)
{
    double left = gaussians, sum;
    size_t n;
    for (size_t i = 0; i < o->n_groups && left > o->share[row] * gaussians; i++) {
        o->coarse[o->group[i].parent] = true;
        left -= o->group[i].saved;
    }
    enum err_code rc = eval_order_draw(o, p, &left, &sum, &n, e);
    for (size_t i = 0; i < o->n_groups; i++)
        o->coarse[o->group[i].parent] = false;
    if (!rc) {
        o->db[way][row] += eval_order_db(sum, n);
        o->left[way][row] += left / gaussians;
    }
    return rc;
}

static enum err_code eval_order_photograph(struct eval_order *o, const struct photo *p,
                                           struct err *e)
{
    static int (*const compare[EVAL_ORDER_WAYS])(const void *, const void *) = {
        eval_order_compare_error, eval_order_compare_best};
    const struct pick_options finest = {.no_lod = true};
    double gaussians, sum;
    size_t n = 0;
    mem_free(o->rgb);
    o->rgb = mem_array((size_t)p->cam.width_px * p->cam.height_px, 3 * sizeof *o->rgb);
    enum err_code rc = o->rgb
                           ? pick_tiles(view_store(o->view), &p->cam, &finest, o->cut, &o->n_cut, e)
                           : err_set(e, ERR_MEM, "eval: out of memory for a picture");
    if (!rc)
        rc = eval_order_draw(o, p, &gaussians, &sum, &n, e);
    if (rc || !n || !(gaussians > 0.0))
        return rc;
    eval_order_find(o, &p->cam);
    rc = eval_order_price(o, p, gaussians, sum, e);
    for (size_t way = 0; !rc && way < EVAL_ORDER_WAYS; way++) {
        qsort(o->group, o->n_groups, sizeof *o->group, compare[way]);
        for (size_t row = 0; !rc && row < EVAL_ORDER_SHARES; row++)
            rc = eval_order_spend(o, p, gaussians, (enum eval_order_way)way, row, e);
    }
    o->finest_db += eval_order_db(sum, n);
    o->n_photographs++;
    return rc;
}

static enum err_code eval_order_row(const struct eval_order *o, size_t way, size_t row,
                                    struct json_t *rows, struct err *e)
{
    const double n = (double)o->n_photographs, db = o->db[way][row] / n,
                 left = o->left[way][row] / n, loss = o->finest_db / n - db;
    printf("%-14s %6.2f %6.3f %9.3f %8.3f\n", eval_order_names[way], o->share[row], left, db, loss);
    json_t *j = json_pack("{s:s, s:f, s:f, s:f, s:f}", "order", eval_order_names[way], "share",
                          o->share[row], "left", left, "psnr_db", db, "loss_db", loss);
    return !j || json_array_append_new(rows, j) ? err_set(e, ERR_MEM, "eval: out of memory")
                                                : ERR_OK;
}

static enum err_code eval_order_run(struct eval_lab *v, struct eval_order *o, struct err *e)
{
    const struct eval_city *c = &v->city;
    const struct photo_loader_config f = {.scene = &c->scene,
                                          .images = c->images,
                                          .n_images = c->n_images,
                                          .max_edge_px = (uint32_t)c->o.max_edge_px,
                                          .downsample = 1.0,
                                          .exposure = c->exposed ? PHOTO_LOADER_TO_MEAN
                                                                 : PHOTO_LOADER_AS_TAKEN,
                                          .cache_bytes = EVAL_ORDER_CACHE};
    struct photo_loader *photos = NULL;
    enum err_code rc = photo_loader_open(&f, &photos, e);
    for (size_t i = 0; !rc && i < c->n_images; i++) {
        struct photo p;
        rc = photo_loader_get_nth(photos, i, &p, e);
        if (!rc)
            rc = eval_order_photograph(o, &p, e);
    }
    photo_loader_close(&photos);
    if (!rc && !o->n_photographs)
        rc = err_set(e, ERR_DATA, "eval-order: no test photograph shows the tiles");
    if (rc)
        return rc;
    printf("finest level: %.3f dB of %zu photographs\n%-14s %6s %6s %9s %8s\n",
           o->finest_db / (double)o->n_photographs, o->n_photographs, "order", "share", "left",
           "PSNR dB", "loss dB");
    for (size_t way = 0; !rc && way < EVAL_ORDER_WAYS; way++)
        for (size_t row = 0; !rc && row < EVAL_ORDER_SHARES; row++)
            rc = eval_order_row(o, way, row, v->rows, e);
    return rc;
}

enum err_code lab_eval_order(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "eval-order",
        .usage = "citysplat-lab eval-order SCENE --tiles CITY.tiles [options]",
        .about = "Prints how much accuracy a share of the Gaussians costs when tiles become coarse "
                 "in the order of their errors, and in the best order that the test photographs "
                 "know.",
        .example = "citysplat-lab eval-order scene --tiles city.tiles --share 0.8",
        .defs = eval_order_defs,
        .n_defs = sizeof eval_order_defs / sizeof *eval_order_defs,
        .min_args = 1,
        .max_args = 1};
    struct eval_lab v = {0};
    struct eval_order_options own;
    struct eval_order o = {0};
    struct pick_options po;
    enum err_code rc = eval_lab_open(&v, &spec, argc, argv, &own, sizeof own, e);
    if (rc || v.args.done)
        goto out;
    rc = v.o.city.tiles
             ? eval_city_store(&v.city, &o.view, &o.ro, &po, e)
             : err_set(e, ERR_ARG, "levels change in tile stores: give one with --tiles FILE");
    if (!rc)
        rc = eval_order_prepare(&o, own.share, e);
    if (!rc)
        rc = eval_order_run(&v, &o, e);
    if (!rc)
        rc = eval_lab_write(&v, e);
out:
    eval_order_clear(&o);
    eval_lab_close(&v);
    return rc;
}
