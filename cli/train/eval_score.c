/* See eval_score.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/train/eval_score.h"

#include <jansson.h>
#include <stdio.h>

#include "train/photographs/photo_loader.h"

enum err_code eval_score_open(struct eval_city *c, struct eval_score *out, struct err *e)
{
    return footprint_of(&c->scene, &out->ground, e);
}

void eval_score_close(struct eval_score *s)
{
    footprint_free(&s->ground);
}

void eval_score_print_head(void)
{
    printf("%-14s %6s %9s %9s %9s %8s %10s %8s %12s %12s %9s %9s\n", "what", "photos", "edge px",
           "PSNR dB", "seen dB", "SSIM", "SSIM valid", "GMSD", "Gaussians", "in view", "ms/frame",
           "MB");
}

enum err_code eval_score_row(struct eval_score *s, const char *what, uint32_t edge_px,
                             const struct evaluate_score *score, struct err *e)
{
    char visible[32] = "", seen[32] = "";
    const bool more = s->more && score->more > 0.0; /* rows of half images have none */
    if (score->n_seen)
        snprintf(seen, sizeof seen, "%.3f", score->seen_psnr_db);
    if (score->visible > 0.0)
        snprintf(visible, sizeof visible, "%.0f", score->visible);
    printf("%-14s %6zu %9u %9.3f %9s %8.4f %10.4f %8.5f %12.0f %12s %9.2f %9.2f\n", what,
           score->n_photos, edge_px, score->psnr_db, seen, score->ssim, score->ssim_valid,
           score->gmsd, score->gaussians, visible, score->ms_frame, score->bytes / 1e6);
    if (more)
        printf("%-14s %s %.4f\n", "", s->more->key, score->more);
    fflush(stdout);
    json_t *row =
        json_pack("{s:s, s:I, s:i, s:o, s:o, s:o, s:f, s:f, s:f, s:f, s:f}", "what", what,
                  "photographs", (json_int_t)score->n_photos, "edge_px", (int)edge_px, "psnr_db",
                  jsonc_real(score->psnr_db), "ssim", jsonc_real(score->ssim), "ssim_valid",
                  jsonc_real(score->ssim_valid), "l1", score->l1, "gmsd", score->gmsd, "gaussians",
                  score->gaussians, "ms_frame", score->ms_frame, "bytes", score->bytes);
    bool ok = row != NULL;
    if (ok && more)
        ok = !json_object_set_new(row, s->more->key, json_real(score->more));
    if (ok && score->n_seen)
        ok = !json_object_set_new(row, "seen_psnr_db", jsonc_real(score->seen_psnr_db));
    if (ok && score->visible > 0.0)
        ok = !json_object_set_new(row, "visible", json_real(score->visible));
    if (ok)
        ok = !json_array_append(s->rows, row);
    json_decref(row);
    return ok ? ERR_OK : err_set(e, ERR_MEM, "eval: out of memory");
}

enum err_code eval_score_load(const struct eval_city *c, const struct eval_drawing *d,
                              struct photo_loader **out, uint32_t *edge_px, struct err *e)
{
    const struct photo_loader_config f = {.scene = &c->scene,
                                          .images = c->images,
                                          .n_images = c->n_images,
                                          .max_edge_px = d->max_edge_px,
                                          .downsample = d->downsample,
                                          .cache_bytes = (size_t)64 << 20,
                                          .exposure = d->exposure ? PHOTO_LOADER_TOLD
                                                                  : PHOTO_LOADER_AS_TAKEN};
    struct camera cam =
        photo_loader_camera(&c->scene.images[c->images[0]].cam, d->max_edge_px, d->downsample);
    *edge_px = cam.width_px > cam.height_px ? cam.width_px : cam.height_px;
    return photo_loader_open(&f, out, e);
}

enum err_code eval_score_drawing(struct eval_score *s, const struct eval_city *c,
                                 const struct eval_drawing *d, struct photo_loader *photos,
                                 uint32_t edge_px, struct residual_list *residuals, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct evaluate_score score;
    struct evaluate_source src = d->src;
    src.ground = s->ground.nx ? &s->ground : NULL;
    src.more = s->more;
    src.residuals = residuals;
    if (d->all_photographs)
        log_warn("eval",
                 "%s trained on with the photographs that score it (--final-all): the scores that "
                 "`train` printed are of before",
                 d->what);
    enum err_code rc = eval_score_folder(s->pictures, d->what, path, &src.pictures, e);
    if (!rc)
        rc = evaluate_run(photos, c->n_images, &src, &score, e);
    if (!rc && !score.n_photos)
        rc = err_set(e, ERR_DATA,
                     "%s: masks leave nothing of the test photographs, so there is no score; "
                     "`citysplat ingest` without --mask-dir, or with other masks, gives some",
                     d->what);
    return rc ? rc : eval_score_row(s, d->what, edge_px, &score, e);
}

enum err_code eval_score_folder(const char *pictures, const char *what, char path[FILE_PATH_MAX],
                                const char **out, struct err *e)
{
    char folder[64];
    *out = NULL;
    if (!pictures)
        return ERR_OK;
    snprintf(folder, sizeof folder, "%s", what);
    for (char *c = folder; *c; c++)
        *c = *c == ' ' || *c == ',' ? '_' : *c;
    *out = path;
    return file_join(path, pictures, folder, e);
}

enum err_code eval_score_write(const struct eval_city *c, const struct json_t *rows,
                               const char *path, struct err *e)
{
    if (!path)
        return ERR_OK;
    json_t *o = json_pack("{s:s, s:s, s:s, s:O}", "scene", c->scene.dir, "device", c->dev.name,
                          "version", CITYSPLAT_VERSION, "scores", rows);
    if (!o)
        return err_set(e, ERR_MEM, "eval: out of memory");
    enum err_code rc = jsonc_write(path, o, e);
    json_decref(o);
    return rc;
}
