/* Writes the procedural city: photographs, COLMAP model, truth.
 *
 * Photographs are independent and rendered on all cores. Each is a function of the seed and its
 * number. The folder appears when it is complete.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/synth/synth.h"

#include <jansson.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "codec/scene/colmap.h"
#include "core/geo/geo.h"
#include "core/outdir.h"
#include "core/pool.h"

struct job {
    const struct synth_config *cfg;
    const struct synth_city *city;
    const struct synth_photo *photos;
    const char *dir;
    struct synth_draw draw;
    struct progress progress;
    atomic_flag progress_busy; /* whoever holds it may touch `progress` */
    atomic_size_t done;
};

static enum err_code synth_render(const struct job *j, const struct synth_photo *p,
                                  const struct synth_light *light, const struct synth_grid *moving,
                                  struct image *out, struct err *e)
{
    return synth_draw_picture(&j->draw, &p->cam, light, moving, out, e);
}

static enum err_code synth_write_depth(const struct job *j, const struct synth_photo *p,
                                       const char *path, struct err *e)
{
    size_t w = p->cam.width_px, h = p->cam.height_px;
    float *depth = mem_array(w * h, sizeof *depth);
    if (!depth)
        return err_set(e, ERR_MEM, "synth: out of memory for a depth map");
    synth_draw_depth(&j->draw, &p->cam, depth);
    enum err_code rc = npy_write(path, depth, 2, (const size_t[2]){h, w}, e);
    mem_free(depth);
    return rc;
}

/* "DIR/sub/STEM.ext" of a photograph. */
static enum err_code synth_photo_path(const struct job *j, const char *sub,
                                      const struct synth_photo *p, const char *ext, char *out,
                                      struct err *e)
{
    char name[96];
    snprintf(name, sizeof name, "%s/%.*s%s", sub, (int)strcspn(p->name, "."), p->name, ext);
    return file_join(out, j->dir, name, e);
}

static enum err_code synth_photo_gps(const struct job *j, size_t i, struct image_gps *gps,
                                     struct err *e)
{
    const struct synth_config *cfg = j->cfg;
    struct geo_origin o = {cfg->lon_deg, cfg->lat_deg, cfg->ground_h_m};
    const struct synth_photo *p = &j->photos[i];
    size_t second = 36000 + 3 * i + (p->flight && cfg->flight_offset_m != 0 ? 14400 : 0);
    *gps = (struct image_gps){.has_position = true,
                              .has_altitude = true,
                              .iso = 100,
                              .exposure_s = 0.001 * exp2(p->exposure_ev)};
    snprintf(gps->time, sizeof gps->time, "2024:06:%02u %02u:%02u:%02u",
             1 + (unsigned)(second / 86400) % 28, (unsigned)(second / 3600 % 24),
             (unsigned)(second / 60 % 60), (unsigned)(second % 60));
    return geo_from_enu(&o, p->gps_enu_m, &gps->lon_deg, &gps->lat_deg, &gps->alt_m, e);
}

/* masks/NAME.jpg.png: 0 where the vehicles on the move changed the photograph in any way, by their
 * shadows and the blur of the lens too; found by drawing it without them. */
static enum err_code synth_write_mask(const struct job *j, const struct synth_photo *p,
                                      const struct image *with, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct image without = {0}, mask = {0};
    enum err_code rc = synth_render(j, p, &p->light, NULL, &without, e);
    if (!rc)
        rc = image_alloc(with->width_px, with->height_px, 1, &mask, e);
    for (size_t i = 0; !rc && i < (size_t)with->width_px * with->height_px; i++)
        mask.px[i] = memcmp(with->px + 3 * i, without.px + 3 * i, 3) ? 0 : 255;
    if (!rc)
        rc = file_join(path, j->dir, "masks", e);
    if (!rc)
        rc = file_mkdir(path, e);
    if (!rc)
        rc = synth_photo_path(j, "masks", p, ".jpg.png", path, e);
    if (!rc)
        rc = image_write(path, &mask, 0, NULL, e);
    image_free(&without);
    image_free(&mask);
    return rc;
}

static enum err_code synth_write_clean(const struct job *j, const struct synth_photo *p,
                                       struct err *e)
{
    char path[FILE_PATH_MAX];
    struct image img = {0};
    struct synth_light light = synth_shade_light();
    enum err_code rc = synth_render(j, p, &light, NULL, &img, e);
    if (!rc)
        rc = synth_photo_path(j, "truth/clean", p, ".png", path, e);
    if (!rc)
        rc = image_write(path, &img, 0, NULL, e);
    if (!rc)
        rc = synth_photo_path(j, "truth/depth", p, ".npy", path, e);
    if (!rc)
        rc = synth_write_depth(j, p, path, e);
    image_free(&img);
    return rc;
}

static enum err_code synth_photo_task(void *user, size_t i, struct err *e)
{
    struct job *j = user;
    const struct synth_photo *p = &j->photos[i];
    char path[FILE_PATH_MAX];
    struct image img = {0};
    struct image_gps gps;
    struct synth_grid moving = {0};
    size_t n = p->vehicles ? (size_t)j->cfg->vehicles : 0;
    struct synth_solid *cars = NULL;
    enum err_code rc = ERR_OK;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    if (n) {
        cars = mem_array(2 * n, sizeof *cars);
        if (!cars)
            return err_set(e, ERR_MEM, "synth: out of memory for %zu vehicles", n);
        synth_city_vehicles(j->city, i, n, cars);
        rc = synth_grid_make(cars, 2 * n, &moving, e);
    }
    if (!rc)
        rc = synth_render(j, p, &p->light, n ? &moving : NULL, &img, e);
    if (!rc)
        rc = synth_photo_gps(j, i, &gps, e);
    if (!rc)
        rc = synth_photo_path(j, "images", p, ".jpg", path, e);
    if (!rc)
        rc = image_write(path, &img, 95, &gps, e);
    if (!rc && n)
        rc = synth_write_mask(j, p, &img, e);
    if (!rc && i % (size_t)j->cfg->test_every == 0)
        rc = synth_write_clean(j, p, e);
    synth_grid_free(&moving);
    mem_free(cars);
    image_free(&img);
    size_t done = atomic_fetch_add(&j->done, 1) + 1;
    if (!atomic_flag_test_and_set(&j->progress_busy)) {
        progress_step(&j->progress, done, NULL);
        atomic_flag_clear(&j->progress_busy);
    }
    return rc;
}

/* ---- truth.json ---- */

static json_t *synth_nums(const double *v, size_t n)
{
    json_t *a = json_array();
    for (size_t i = 0; i < n; i++)
        json_array_append_new(a, json_real(v[i]));
    return a;
}

static json_t *synth_photo_to_json(const struct synth_photo *p, bool test)
{
    double m[16] = {0}, center[3];
    for (int i = 0; i < 3; i++) {
        memcpy(m + 4 * i, p->cam.rot + 3 * i, 3 * sizeof *m);
        m[4 * i + 3] = p->cam.trans[i];
    }
    m[15] = 1;
    camera_center(&p->cam, center);
    double gain[3] = {(double)p->light.gain[0], (double)p->light.gain[1], (double)p->light.gain[2]};
    return json_pack("{s:s, s:o, s:o, s:o, s:b, s:b, s:o, s:i, s:b, s:o, s:b}", "name", p->name,
                     "center_enu_m", synth_nums(center, 3), "world_to_camera", synth_nums(m, 16),
                     "gps_enu_m", synth_nums(p->gps_enu_m, 3), "gps_outlier", p->gps_outlier,
                     "pose_error", p->pose_error, "pose_shift_m", synth_nums(p->pose_shift_m, 3),
                     "flight", (int)p->flight, "vehicles", p->vehicles, "gain", synth_nums(gain, 3),
                     "test", test);
}

static enum err_code synth_write_truth(const struct job *j, const struct synth_similarity *f,
                                       struct err *e)
{
    const struct synth_config *cfg = j->cfg;
    char path[FILE_PATH_MAX];
    json_t *photos = json_array(), *config = NULL;
    enum err_code rc = file_join(path, j->dir, "truth/truth.json", e);
    if (!rc)
        rc = options_to_json(synth_options(), cfg, &config, e);
    for (size_t i = 0; i < (size_t)cfg->photos; i++)
        json_array_append_new(photos,
                              synth_photo_to_json(&j->photos[i], i % (size_t)cfg->test_every == 0));
    json_object_del(config, "output"); /* the same city has the same bytes wherever it is */
    json_object_del(config, "overwrite");
    if (cfg->paint == SYNTH_PAINT_RICH) /* cities had it before there was another */
        json_object_del(config, "paint");
    if (cfg->block_m3 == 0) /* likewise */
        json_object_del(config, "block_m3");
    json_t *root = json_pack(
        "{s:s, s:o, s:{s:f, s:f, s:f}, s:{s:f, s:o, s:o}, s:{s:s, s:i, s:i, s:o}, s:o}", "format",
        "citysplat-truth", "config", config ? config : json_object(), "origin", "lon_deg",
        cfg->lon_deg, "lat_deg", cfg->lat_deg, "h_m", cfg->ground_h_m, "colmap_to_enu", "scale",
        f->scale, "rot", synth_nums(f->rot, 9), "trans", synth_nums(f->trans, 3), "lens", "model",
        lens_name(j->draw.lens.model), "width", (int)cfg->width_px, "height", (int)cfg->height_px,
        "params", synth_nums(j->draw.lens.params, lens_param_count(j->draw.lens.model)),
        "photographs", photos);
    if (!rc && !root)
        rc = err_set(e, ERR_MEM, "synth: out of memory for truth.json");
    if (!rc)
        rc = jsonc_write(path, root, e);
    json_decref(root);
    return rc;
}

static enum err_code synth_make_folders(const char *dir, struct err *e)
{
    static const char *const subs[] = {"images", "truth/clean", "truth/depth"};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; i < sizeof subs / sizeof *subs && !rc; i++) {
        char path[FILE_PATH_MAX];
        rc = file_join(path, dir, subs[i], e);
        if (!rc)
            rc = file_mkdir(path, e);
    }
    return rc;
}

static enum err_code synth_write_all(struct job *j, struct synth_photo *photos,
                                     const struct synth_city *city, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct colmap_model model = {0};
    struct synth_similarity frame = synth_model_frame(j->cfg);
    struct lens lens = synth_flight_lens(j->cfg);
    synth_flight_make(j->cfg, photos);
    enum err_code rc = synth_make_folders(j->dir, e);
    if (!rc)
        rc = synth_draw_open(city, &lens, (int)j->cfg->supersample, j->cfg->lens_blur_px, &j->draw,
                             e);
    if (!rc)
        rc = synth_model_make(j->cfg, city, photos, &frame, &model, e);
    if (!rc)
        rc = file_join(path, j->dir, "sparse/0", e);
    if (!rc)
        rc = colmap_write_bin(path, &model, e);
    if (!rc) {
        log_info("synth", "city solids=%zu points=%zu observations=%zu", city->n_solids,
                 model.n_points, model.n_tracks);
        progress_start(&j->progress, "photograph the city", (uint64_t)j->cfg->photos);
        rc = pool_for((size_t)j->cfg->photos, 0, synth_photo_task, j, e);
        progress_end(&j->progress, NULL);
    }
    if (!rc)
        rc = synth_write_truth(j, &frame, e);
    colmap_free(&model);
    return rc;
}

enum err_code synth_run(const struct synth_config *cfg, struct err *e)
{
    struct outdir dir = {0};
    struct synth_city city = {0};
    struct synth_photo *photos = NULL;
    struct job j = {.cfg = cfg, .city = &city, .progress_busy = ATOMIC_FLAG_INIT};
    if (!cfg->output)
        return err_set(e, ERR_ARG, "synth: no output folder: give -o DIR");
    enum err_code rc = outdir_begin(cfg->output, "truth/truth.json", cfg->overwrite, &dir, e);
    if (rc)
        return rc;
    photos = mem_array((size_t)cfg->photos, sizeof *photos);
    if (!photos) {
        rc = err_set(e, ERR_MEM, "synth: out of memory for %lld photographs",
                     (long long)cfg->photos);
        goto out;
    }
    rc = synth_city_make(cfg, &city, e);
    if (rc)
        goto out;
    j.photos = photos;
    j.dir = dir.part;
    rc = synth_write_all(&j, photos, &city, e);
    if (!rc)
        rc = outdir_commit(&dir, e);
out:
    outdir_abort(&dir);
    synth_draw_close(&j.draw);
    mem_free(photos);
    synth_city_free(&city);
    return rc;
}
