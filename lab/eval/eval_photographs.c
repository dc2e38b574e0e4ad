/* citysplat-lab eval-photographs: what `citysplat eval` scores, with what studies vary, and with
 * rows of half images (half_image.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include <jansson.h>

#include "cli/train/eval_score.h"
#include "lab/eval/eval_lab.h"
#include "lab/eval/half_image.h"
#include "lab/eval/lpips.h"
#include "lab/lab.h"
#include "train/loss/photometric.h"
#include "train/photographs/photo_loader.h"

struct eval_photographs_options {
#define OPT OPTIONS_MEMBER
#include "lab/eval/eval_photographs.def"
};

static const struct options_def eval_photographs_defs[] = {
#define OPT(...) OPTIONS_ROW(struct eval_photographs_options, __VA_ARGS__)
#include "lab/eval/eval_photographs.def"
};

struct eval_photographs {
    struct eval_lab lab;
    struct eval_photographs_options o;
    struct eval_score score;
    struct lpips *lpips;       /* NULL: no weights */
    struct evaluate_more more; /* its score */
};

enum { EVAL_HALF_IMAGE_AUTO, EVAL_HALF_IMAGE_ON, EVAL_HALF_IMAGE_OFF };

static enum err_code eval_half_run(struct eval_photographs *v, const struct eval_drawing *d,
                                   uint32_t steps, struct photo_loader *photos,
                                   struct evaluate_score *out, struct err *e)
{
    struct eval_city *c = &v->lab.city;
    struct photometric *loss = NULL;
    struct half_image *half = NULL;
    const struct half_image_source src = {d->prepare, d->prepare_user};
    enum err_code rc = photometric_open(&c->dev, &loss, e);
    const struct half_image_config f = {.dev = &c->dev,
                                        .render = c->render,
                                        .loss = loss,
                                        .appearance = d->appearance,
                                        .steps = steps,
                                        .lr = HALF_IMAGE_LR,
                                        .lr_end = HALF_IMAGE_LR_END,
                                        .exposure = d->exposure,
                                        .seed = 1};
    if (!rc)
        rc = half_image_open(&f, &half, e);
    if (!rc)
        rc = half_image_run(half, photos, c->n_images, &src, out, e);
    half_image_close(&half);
    photometric_close(&loss);
    return rc;
}

static enum err_code eval_half(struct eval_photographs *v, const struct eval_drawing *d,
                               struct photo_loader *photos, uint32_t edge_px, struct err *e)
{
    struct evaluate_score score;
    char name[64];
    size_t n = v->lab.city.n_images;
    uint32_t steps = (uint32_t)v->o.half_image_steps;
    if (v->o.half_image == EVAL_HALF_IMAGE_OFF ||
        (v->o.half_image == EVAL_HALF_IMAGE_AUTO && !d->appearance && !d->exposure))
        return ERR_OK;
    if (!steps)
        steps = half_image_steps(d->trained_steps, n);
    if (d->appearance && !v->o.half_image_steps)
        log_info("eval",
                 "%s: embeddings of %zu photographs learn for %u steps a half%s; "
                 "--half-image-steps N changes it",
                 d->what, n, steps,
                 steps < HALF_IMAGE_STEPS ? ", as long as the level was trained" : "");
    snprintf(name, sizeof name, "%s, half image", d->what);
    enum err_code rc = eval_half_run(v, d, steps, photos, &score, e);
    score.bytes = d->src.bytes;
    return rc ? rc : eval_score_row(&v->score, name, edge_px, &score, e);
}

static enum err_code eval_photographs_drawing(void *user, const struct eval_drawing *d,
                                              struct err *e)
{
    struct eval_photographs *v = user;
    struct photo_loader *photos = NULL;
    uint32_t edge_px;
    enum err_code rc = eval_score_load(&v->lab.city, d, &photos, &edge_px, e);
    if (!rc)
        rc = eval_score_drawing(&v->score, &v->lab.city, d, photos, edge_px, NULL, e);
    if (!rc)
        rc = eval_half(v, d, photos, edge_px, e);
    photo_loader_close(&photos);
    return rc;
}

static enum err_code eval_lpips(void *user, const struct photo *p, const float *rgb, double *out,
                                struct err *e)
{
    return lpips_run(user, rgb, p->px, p->mask, p->cam.width_px, p->cam.height_px, out, e);
}

static enum err_code eval_lpips_open(struct eval_photographs *v, struct err *e)
{
    if (!v->o.lpips)
        return ERR_OK;
    enum err_code rc =
        lpips_open(&v->lab.city.dev, v->o.lpips, (enum lpips_range)v->o.lpips_range, &v->lpips, e);
    if (rc)
        return rc;
    v->more = (struct evaluate_more){lpips_key(v->lpips), eval_lpips, v->lpips};
    v->score.more = &v->more;
    return ERR_OK;
}

enum err_code lab_eval_photographs(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "eval-photographs",
        .usage = "citysplat-lab eval-photographs SCENE [options]",
        .about = "Scores what `citysplat eval` scores, with what studies vary. Rows \"half image\" "
                 "learn exposure and appearance of a photograph from one half of it, and score the "
                 "other half.",
        .example = "citysplat-lab eval-photographs scene --full-size --half-image off\n"
                   "citysplat-lab eval-photographs scene --tiles city.tiles --metric distance",
        .defs = eval_photographs_defs,
        .n_defs = sizeof eval_photographs_defs / sizeof *eval_photographs_defs,
        .min_args = 1,
        .max_args = 1};
    struct eval_photographs v = {0};
    enum err_code rc = eval_lab_open(&v.lab, &spec, argc, argv, &v.o, sizeof v.o, e);
    if (rc || v.lab.args.done)
        goto out;
    v.lab.city.full_size = v.o.full_size;
    v.score.pictures = v.o.pictures;
    v.score.rows = v.lab.rows;
    rc = eval_score_open(&v.lab.city, &v.score, e);
    if (!rc)
        rc = eval_lpips_open(&v, e);
    if (rc)
        goto out;
    eval_score_print_head();
    rc = eval_city_each(&v.lab.city, EVAL_CITY_ALL, eval_photographs_drawing, &v, e);
    if (!rc)
        rc = eval_lab_write(&v.lab, e);
out:
    lpips_close(&v.lpips);
    eval_score_close(&v.score);
    eval_lab_close(&v.lab);
    return rc;
}
