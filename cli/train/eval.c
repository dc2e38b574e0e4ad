/* citysplat eval: how close pictures of a trained scene, or of its tile store, come to photographs.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>

#include <jansson.h>

#include "cli/base/cli.h"
#include "cli/base/output.h"
#include "cli/train/eval_score.h"
#include "train/photographs/photo_loader.h"
#include "train/photographs/residual.h"

struct eval_options {
    struct eval_city_options city;
#define OPT OPTIONS_MEMBER
#include "cli/train/eval.def"
};

static const struct options_def eval_defs[] = {
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW_IN(struct eval_options, city, __VA_ARGS__)
#include "cli/train/eval_city.def"
#define GROUP(title) OPTIONS_GROUP_ROW(title)
#define OPT(...) OPTIONS_ROW(struct eval_options, __VA_ARGS__)
#include "cli/train/eval.def"
};

struct eval {
    struct eval_options o;
    struct eval_city city;
    struct eval_score score;
    struct residual_list residuals; /* of the last row that was scored */
    char residuals_of[64];          /* what that row is called */
};

enum { EVAL_SUSPICIOUS_MAX = 20 }; /* rows printed; the file has all */

static enum err_code eval_drawing(void *user, const struct eval_drawing *d, struct err *e)
{
    struct eval *v = user;
    struct photo_loader *photos = NULL;
    uint32_t edge_px;
    residual_clear(&v->residuals);
    snprintf(v->residuals_of, sizeof v->residuals_of, "%s", d->what);
    enum err_code rc = eval_score_load(&v->city, d, &photos, &edge_px, e);
    if (!rc)
        rc = eval_score_drawing(&v->score, &v->city, d, photos, edge_px, &v->residuals, e);
    photo_loader_close(&photos);
    return rc;
}

/* The photographs that fit worst, on paper and on the screen. */
static enum err_code eval_residuals(struct eval *v, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct residual_list *l = &v->residuals;
    const char *dir = v->o.city.results ? v->o.city.results : v->city.scene.dir;
    if (!v->o.split)
        return ERR_OK;
    enum err_code rc = residual_rank(l, e);
    if (!rc)
        rc = file_join(path, dir, "residuals.json", e);
    if (!rc)
        rc = residual_write(l, path, v->residuals_of, e);
    if (rc || !l->n)
        return rc;
    if (!l->n_suspicious) {
        printf("No photograph stands out: the worst of %zu, %s, has a robust z-score of %.1f "
               "(limit %.0f).\n",
               l->n, l->rows[0].name, l->rows[0].z, RESIDUAL_LIMIT);
        return ERR_OK;
    }
    printf("%zu of %zu photographs fit much worse than the others (wrong pose? another light?); "
           "all of them are in %s\n%-32s %9s %8s %8s %8s\n",
           l->n_suspicious, l->n, path, "photograph", "PSNR dB", "SSIM", "z MSE", "z SSIM");
    for (size_t i = 0; i < l->n_suspicious && i < EVAL_SUSPICIOUS_MAX; i++)
        printf("%-32s %9.3f %8.4f %8.1f %8.1f\n", l->rows[i].name, -10.0 * log10(l->rows[i].mse),
               l->rows[i].ssim, l->rows[i].z_mse, l->rows[i].z_ssim);
    return ERR_OK;
}

enum err_code cli_eval(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "eval",
        .usage = "citysplat eval SCENE [options]",
        .about = "Draws the scene's test photographs from the trained Gaussians, or from a tile "
                 "store with and without level of detail. Prints PSNR, SSIM (zero padded as in "
                 "training, and inner windows only), GMSD (perceptual, lower is better), Gaussians "
                 "and time a frame. If appearance was trained, a photograph is drawn in the "
                 "appearance of the nearest training photographs.",
        .example =
            "citysplat eval scene\ncitysplat eval scene --tiles city.tiles --max-edge-px 800",
        .defs = eval_defs,
        .n_defs = sizeof eval_defs / sizeof eval_defs[0],
        .min_args = 1,
        .max_args = 1};
    struct eval v = {0};
    struct options_args args;
    struct arena arena = {0};
    enum err_code rc = options_parse(&spec, argc, argv, &v.o, &args, &arena, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    v.city.o = v.o.city;
    v.score.pictures = v.o.pictures;
    v.score.rows = json_array();
    eval_city_defaults(&v.city);
    rc = v.score.rows ? output_check(v.o.output, v.o.overwrite, e)
                      : err_set(e, ERR_MEM, "eval: out of memory");
    if (!rc)
        rc = output_apart(v.o.output, v.o.city.tiles, e);
    if (!rc)
        rc = eval_city_open(&v.city, args.arg[0], v.o.split ? SCENE_TRAIN : SCENE_TEST, e);
    if (!rc)
        rc = eval_score_open(&v.city, &v.score, e);
    if (rc)
        goto out;
    eval_score_print_head();
    rc = eval_city_each(&v.city, EVAL_CITY_ALL, eval_drawing, &v, e);
    if (!rc)
        rc = eval_residuals(&v, e);
    if (!rc)
        rc = eval_score_write(&v.city, v.score.rows, v.o.output, e);
out:
    json_decref(v.score.rows);
    residual_free(&v.residuals);
    eval_score_close(&v.score);
    eval_city_close(&v.city);
    arena_free(&arena);
    return rc;
}
