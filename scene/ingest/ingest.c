/* All steps from photographs and a COLMAP model to a scene folder.
 *
 * Photographs are judged by three questions. Does their pose agree with the points that they see?
 * (A wrong pose has a large reprojection error, whatever GPS says.) Do these points fix the pose
 * (pose_error.c)? Does their place agree with their GPS position (georef.c)? Photographs that fail
 * are dropped with their observations, and the report names them. The split into training and test
 * photographs uses the rank among all photographs of the model, so it does not depend on what was
 * dropped. The scene appears when it is complete.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/ingest.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include <jansson.h>

#include "codec/image/image.h"
#include "codec/limits.h"
#include "codec/scene/colmap.h"
#include "codec/scene/mask.h"
#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "core/outdir.h"
#include "core/pool.h"
#include "scene/control/table.h"
#include "scene/ingest/ingest_internal.h"

static enum err_code ingest_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "ingest: out of memory");
}

static void ingest_step_done(struct ingest *g)
{
    size_t done = atomic_fetch_add(&g->done, 1) + 1;
    if (!atomic_flag_test_and_set(&g->progress_busy)) {
        progress_step(&g->progress, done, NULL);
        atomic_flag_clear(&g->progress_busy);
    }
}

/* pool_for over the photographs with a progress bar. */
static enum err_code ingest_for_photos(struct ingest *g, const char *what,
                                       enum err_code (*fn)(void *user, size_t i, struct err *e),
                                       struct err *e)
{
    atomic_store(&g->done, 0);
    progress_start(&g->progress, what, g->n);
    enum err_code rc = pool_for(g->n, 0, fn, g, e);
    progress_end(&g->progress, NULL);
    return rc;
}

/* ---- the photographs ---- */

/* Also by a drive's letter or a share, as in models that were made on Windows. */
static bool ingest_name_is_absolute(const char *s)
{
    return s[0] == '/' || !strncmp(s, "\\\\", 2) ||
           (s[0] && s[1] == ':' && (s[2] == '/' || s[2] == '\\'));
}

/* A relative path that stays below its folder. */
static bool ingest_name_is_safe(const char *s)
{
    if (ingest_name_is_absolute(s))
        return false;
    for (const char *p = s; *p; p += strcspn(p, "/"), p += *p == '/')
        if (!strncmp(p, "..", 2) && (p[2] == '/' || !p[2]))
            return false;
    return true;
}

static int ingest_photo_compare(const void *a, const void *b)
{
    const struct ingest_photo *p = a, *q = b;
    return strcmp(p->image->name, q->image->name);
}

static int ingest_text_compare(const void *a, const void *b)
{
    char *const *p = a, *const *q = b;
    return strcmp(*p, *q);
}

/* "flight 1/DSC_1.JPG" -> "flight 1_DSC_1.JPG", and "DSC_1.PNG" -> "DSC_1.PNG.jpg". */
static char *ingest_out_name_make(struct ingest *g, const char *name)
{
    const char *dot = strrchr(name, '.');
    bool fits = dot && (!strcasecmp(dot, ".jpg") || !strcasecmp(dot, ".jpeg"));
    char *out = arena_printf(&g->scene.arena, "%s%s", name, fits ? "" : ".jpg");
    for (char *p = out; p && *p; p++)
        if (*p == '/' || *p == '\\')
            *p = '_';
    return out;
}

static enum err_code ingest_out_names_check(const struct ingest *g, struct err *e)
{
    char **names = mem_array(g->n, sizeof *names);
    enum err_code rc = names ? ERR_OK : ingest_no_memory(e);
    for (size_t i = 0; names && i < g->n; i++)
        names[i] = g->photos[i].out_name;
    if (names)
        qsort(names, g->n, sizeof *names, ingest_text_compare);
    for (size_t i = 1; !rc && i < g->n; i++)
        if (!strcmp(names[i], names[i - 1]))
            rc = err_set(e, ERR_DATA,
                         "two photographs would both be called %.200s in the scene; rename one",
                         names[i]);
    mem_free(names);
    return rc;
}

/* scene.json takes nothing else, and is written last. */
static bool ingest_is_utf8(const char *text)
{
    json_t *o = json_string(text);
    json_decref(o);
    return o != NULL;
}

/* i: its rank by name. */
static enum err_code ingest_check_name(const struct ingest *g, const char *name, size_t i,
                                       struct err *e)
{
    if (!ingest_name_is_safe(name))
        return err_set(e, ERR_DATA,
                       "%.300s: image '%.100s' %s: names of images are relative to the folder of "
                       "photographs: convert the model to text (colmap model_converter "
                       "--output_type TXT), shorten the names in images.txt, and give that folder",
                       g->model.dir, name,
                       ingest_name_is_absolute(name) ? "has an absolute name"
                                                     : "leads out of the folder of photographs");
    if (!ingest_is_utf8(name))
        return err_set(e, ERR_DATA,
                       "images: '%.200s', the %zu. by name, is not written in UTF-8, which the "
                       "scene is: rename it",
                       name, i + 1);
    return ERR_OK;
}

static enum err_code ingest_list_photos(struct ingest *g, struct err *e)
{
    g->n = g->model.n_images;
    if (!g->n)
        return err_set(e, ERR_DATA, "the COLMAP model holds no images");
    if (!file_is_dir(g->images_dir))
        return err_set(e, ERR_NOENT, "%s: no such folder of photographs", g->images_dir);
    g->photos = arena_get(&g->scene.arena, g->n, sizeof *g->photos);
    g->kept = arena_get(&g->scene.arena, g->n, sizeof *g->kept);
    if (!g->photos || !g->kept)
        return ingest_no_memory(e);
    size_t missing = 0;
    const char *first = NULL;
    struct table_renamed renamed = {0};
    enum err_code listed = ingest_files_list(g->images_dir, &g->files, e);
    if (listed)
        return listed;
    for (size_t i = 0; i < g->n; i++)
        g->photos[i].image = &g->model.images[i];
    qsort(g->photos, g->n, sizeof *g->photos, ingest_photo_compare);
    for (size_t i = 0; i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        char path[FILE_PATH_MAX];
        p->residual_m = (double)NAN;
        enum err_code rc = ingest_check_name(g, p->image->name, i, e);
        if (rc)
            return rc;
        p->out_name = ingest_out_name_make(g, p->image->name);
        if (!p->out_name)
            return ingest_no_memory(e);
        p->file = p->image->name;
        rc = file_join(path, g->images_dir, p->file, e);
        if (rc)
            return rc;
        if (!file_exists(path) && !(p->file = ingest_files_find(&g->files, p->image->name))) {
            p->file = p->image->name;
            p->verdict = INGEST_MISSING;
            first = missing++ ? first : p->image->name;
        }
        table_rename(&renamed, p->file, p->image->name);
    }
    table_tell_renamed(&renamed, "the COLMAP model");
    if (missing == g->n || (missing && !g->cfg->skip_missing))
        return err_set(
            e, ERR_NOENT,
            "%s: %zu of the %zu photographs of the COLMAP model are not in there, '%.200s' first; "
            "give the folder that COLMAP was run on%s",
            g->images_dir, missing, g->n, first,
            missing == g->n ? "" : ", or drop them with --skip-missing");
    return ingest_out_names_check(g, e);
}

/* ---- EXIF and sizes ---- */

/* A file that cannot be read is set aside and named; the others are worth a scene. Any thread. */
static enum err_code ingest_set_aside(struct ingest *g, struct ingest_photo *p, enum err_code rc,
                                      struct err *e)
{
    if (rc != ERR_FORMAT || p->fault)
        return rc;
    p->fault = mem_text(e ? e->msg : "cannot be read");
    if (!p->fault)
        return ingest_no_memory(e);
    p->verdict = INGEST_BROKEN;
    atomic_fetch_add(&g->n_broken, 1);
    log_warn("ingest", "set aside: %s", p->fault);
    if (e)
        *e = (struct err){0};
    return ERR_OK;
}

static enum err_code ingest_read_info_task(void *user, size_t i, struct err *e)
{
    struct ingest *g = user;
    struct ingest_photo *p = &g->photos[i];
    char path[FILE_PATH_MAX];
    if (p->verdict == INGEST_MISSING)
        return ERR_OK;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    enum err_code rc = file_join(path, g->images_dir, p->file, e);
    if (!rc)
        rc = image_read_info(path, &p->width_px, &p->height_px, &p->gps, &p->drone, e);
    if (rc) {
        rc = ingest_set_aside(g, p, rc, e);
        p->gps = (struct image_gps){0};
        p->drone = (struct drone_meta){0};
        ingest_step_done(g);
        return rc;
    }
    const struct lens *l = &g->model.cameras[p->image->camera].lens;
    if (fabs((double)p->width_px * l->height_px / l->width_px - p->height_px) > 1.001)
        return err_set(e, ERR_DATA,
                       "%s: is %u x %u px, its COLMAP camera %u x %u px: not the photographs the "
                       "model was made "
                       "from, or turned by a viewer",
                       path, p->width_px, p->height_px, l->width_px, l->height_px);
    ingest_step_done(g);
    return ERR_OK;
}

struct moment {
    double s;
    size_t photo;
};

static int ingest_moment_compare(const void *a, const void *b)
{
    const struct moment *p = a, *q = b;
    if (p->s != q->s)
        return p->s < q->s ? -1 : 1;
    return (p->photo > q->photo) - (p->photo < q->photo);
}

#define INGEST_FLIGHT_GAP_MIN 20.0 /* minutes: a pause of this length begins another flight */

/* Flights: a pause begins another. Without times, every folder is one. */
static enum err_code ingest_find_flights(struct ingest *g, struct err *e)
{
    struct moment *m = mem_array(g->n, sizeof *m);
    if (!m)
        return ingest_no_memory(e);
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++) {
        double s = positions_time(g->photos[i].gps.time);
        if (isfinite(s))
            m[n++] = (struct moment){s, i};
    }
    qsort(m, n, sizeof *m, ingest_moment_compare);
    uint32_t flight = 0;
    for (size_t k = 0; k < n; k++) {
        flight += k && m[k].s - m[k - 1].s > 60 * INGEST_FLIGHT_GAP_MIN;
        g->photos[m[k].photo].geo.flight_hint = flight;
    }
    for (size_t i = 1; n == 0 && i < g->n; i++) {
        const char *a = g->photos[i - 1].image->name, *b = g->photos[i].image->name;
        size_t folder = (size_t)(strrchr(b, '/') ? strrchr(b, '/') - b : 0);
        flight += strncmp(a, b, folder) ||
                  (strrchr(a, '/') ? strrchr(a, '/') - a : 0) != (ptrdiff_t)folder;
        g->photos[i].geo.flight_hint = flight;
    }
    mem_free(m);
    return ERR_OK;
}

/* ---- poses against points ---- */

static enum err_code ingest_judge_poses(struct ingest *g, struct err *e)
{
    struct pose_error *known = mem_array(g->model.n_images, sizeof *known);
    enum err_code rc = known ? pose_error_find(&g->model, known, e) : ingest_no_memory(e);
    if (!rc && !g->model.n_tracks)
        log_warn("ingest", "the COLMAP model does not say which photographs see which points: "
                           "its poses are taken as they are, unchecked");
    for (size_t i = 0; !rc && i < g->n; i++) {
        struct ingest_photo *p = &g->photos[i];
        camera_quat_to_rot(p->image->quat_wxyz, p->geo.rot);
        for (int a = 0; a < 3; a++)
            p->geo.center[a] =
                -(p->geo.rot[a] * p->image->trans[0] + p->geo.rot[3 + a] * p->image->trans[1] +
                  p->geo.rot[6 + a] * p->image->trans[2]);
        p->pose = known[p->image - g->model.images];
        if (p->verdict != INGEST_KEPT || !g->model.n_tracks)
            continue;
        if (p->pose.reprojection_px > g->cfg->max_reprojection_px)
            p->verdict = INGEST_POSE;
        else if (!pose_error_known(&p->pose, &g->model.cameras[p->image->camera].lens))
            p->verdict = INGEST_LOOSE;
    }
    mem_free(known);
    return rc;
}

static size_t ingest_count_verdict(const struct ingest *g, enum ingest_verdict v)
{
    size_t n = 0;
    for (size_t i = 0; i < g->n; i++)
        n += g->photos[i].verdict == v;
    return n;
}

static enum err_code ingest_check_some_left(const struct ingest *g, struct err *e)
{
    size_t broken = ingest_count_verdict(g, INGEST_BROKEN),
           loose = ingest_count_verdict(g, INGEST_LOOSE),
           pose = ingest_count_verdict(g, INGEST_POSE), most = 0;
    if (ingest_count_verdict(g, INGEST_KEPT) >= 3)
        return ERR_OK;
    for (size_t i = 0; i < g->n; i++)
        most = g->photos[i].pose.n_points > most ? g->photos[i].pose.n_points : most;
    return err_set(
        e, ERR_DATA,
        "no scene is left: the points that %zu of %zu photographs see do not fix their poses (the "
        "best one sees %zu: align with more --minutes or --features), %zu disagree with the points "
        "they see (--max-reprojection-px), the files of %zu are broken",
        loose, g->n, most, pose, broken);
}

/* The mask of a photograph: of --mask-dir, or what its alpha calls transparent; and of the sky. */
static enum err_code ingest_convert_mask(struct ingest *g, const struct ingest_photo *p,
                                         const char *photo, struct err *e)
{
    const struct camera *cam = &g->scene.images[g->kept[p->image - g->model.images]].cam;
    char from[FILE_PATH_MAX] = "", to[FILE_PATH_MAX], folder[FILE_PATH_MAX];
    enum ingest_mask made = INGEST_MASK_NONE;
    enum err_code rc =
        g->cfg->mask_dir ? mask_path(g->cfg->mask_dir, p->image->name, from, e) : ERR_OK;
    if (!rc && from[0] && !file_exists(from)) /* the model may write the name otherwise */
        rc = mask_path(g->cfg->mask_dir, p->file, from, e);
    const bool alpha = !rc && !(from[0] && file_exists(from));
    bool sky = false;
    const char *dot = strrchr(photo, '.');
    const bool opaque = alpha && dot && (!strcasecmp(dot, ".jpg") || !strcasecmp(dot, ".jpeg"));
    if (!rc && opaque && !ingest_sky_looks_up(cam))
        return ERR_OK;
    if (!rc)
        rc = file_join(folder, g->dir.part, "masks", e);
    if (!rc)
        rc = mask_path(folder, p->out_name, to, e);
    if (!rc)
        rc = file_mkdir(folder, e);
    if (!rc && !opaque)
        rc = ingest_mask_convert(&g->views[p->view], alpha ? photo : from, alpha, to, &made, e);
    if (!rc)
        rc = ingest_sky_mask(&g->scene, cam, to, made >= INGEST_MASK_MADE, &sky, e);
    if (made == INGEST_MASK_BLANK)
        atomic_fetch_add(&g->blanks, 1);
    if (made >= INGEST_MASK_MADE)
        atomic_fetch_add(alpha ? &g->alphas : &g->masks, 1);
    atomic_fetch_add(&g->wholes, made == INGEST_MASK_WHOLE);
    atomic_fetch_add(&g->skies, sky);
    return rc;
}

static enum err_code ingest_convert_task(void *user, size_t i, struct err *e)
{
    struct ingest *g = user;
    struct ingest_photo *p = &g->photos[i];
    char from[FILE_PATH_MAX], to[FILE_PATH_MAX], folder[FILE_PATH_MAX];
    struct codec_limits lim = {0};
    enum ingest_light light = INGEST_LIGHT_USUAL;
    enum err_code rc = ERR_OK;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    if (p->verdict == INGEST_KEPT) {
        rc = file_join(from, g->images_dir, p->file, e);
        if (!rc)
            rc = file_join(folder, g->dir.part, "images", e);
        if (!rc)
            rc = file_join(to, folder, p->out_name, e);
        if (!rc)
            rc = ingest_photo_convert(&g->views[p->view], from, to, &lim, &light, e);
        atomic_fetch_add(&g->darks, !rc && light == INGEST_LIGHT_DARK);
        atomic_fetch_add(&g->whites, !rc && light == INGEST_LIGHT_WHITE);
        if (rc == ERR_FORMAT)
            rc = ingest_set_aside(g, p, rc, e);
        else if (!rc)
            rc = ingest_convert_mask(g, p, from, e);
    }
    ingest_step_done(g);
    return rc;
}

/* Photographs whose pixels turned out to be broken leave the scene again. */
static enum err_code ingest_convert(struct ingest *g, struct err *e)
{
    size_t before = atomic_load(&g->n_broken);
    enum err_code rc = ingest_for_photos(g, "undistort and shrink", ingest_convert_task, e);
    if (rc || atomic_load(&g->n_broken) == before)
        return rc;
    g->scene.n_images = g->scene.n_points = g->scene.n_tracks = 0;
    g->n_views = 0;
    rc = ingest_check_some_left(g, e);
    if (!rc)
        rc = ingest_scene_fill(g, e);
    return rc ? rc : ingest_points_filter(g->cfg, &g->scene, g->points, e);
}

/* A folder in which no name fits was named wrongly, or its files were. */
static enum err_code ingest_check_masks(struct ingest *g, struct err *e)
{
    size_t found = atomic_load(&g->masks);
    if (!found)
        return err_set(e, ERR_NOENT,
                       "--mask-dir %s: no mask of any photograph is in there; the one of %s would "
                       "be %s.png",
                       g->cfg->mask_dir, g->photos[0].image->name, g->photos[0].image->name);
    log_info("ingest", "%zu of %zu photographs have a mask", found, g->scene.n_images);
    return ERR_OK;
}

static int ingest_file_compare(const void *a, const void *b)
{
    const char *const *p = a, *const *q = b;
    return strcmp(*p, *q);
}

/* Photographs in the folder that the model does not have: COLMAP did not place them. */
static enum err_code ingest_find_unplaced(struct ingest *g, struct err *e)
{
    const char **placed = mem_array(g->n, sizeof *placed);
    g->unplaced = arena_get(&g->scene.arena, g->files.n, sizeof *g->unplaced);
    if (!placed || !g->unplaced) {
        mem_free(placed);
        return ingest_no_memory(e);
    }
    for (size_t i = 0; i < g->n; i++)
        placed[i] = g->photos[i].file;
    qsort(placed, g->n, sizeof *placed, ingest_file_compare);
    for (size_t k = 0; k < g->files.n; k++) {
        const char *name = g->files.names[k];
        if (!bsearch(&name, placed, g->n, sizeof *placed, ingest_file_compare))
            g->unplaced[g->n_unplaced++] = g->files.names[k];
    }
    mem_free(placed);
    return ERR_OK;
}

static enum err_code ingest_write_scene(struct ingest *g, double start_s, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct ingest_result r = {.cfg = g->cfg,
                              .photos = g->photos,
                              .n_photos = g->n,
                              .n_kept = g->scene.n_images,
                              .scene = &g->scene,
                              .points = g->points,
                              .georef = g->fitted ? &g->georef : NULL,
                              .gcp = g->gcps ? &g->gcp : NULL,
                              .unplaced = g->unplaced,
                              .n_unplaced = g->n_unplaced,
                              .images_dir = g->images_dir,
                              .model_dir = g->model.dir,
                              .n_models = g->model.n_models,
                              .n_second = g->model.n_second,
                              .gimbal = &g->gimbal,
                              .positions = g->positions,
                              .n_positioned = g->n_positioned};
    for (size_t i = 0; i < g->scene.n_images; i++)
        *(g->scene.images[i].split == SCENE_TEST ? &r.n_test : &r.n_train) += 1;
    if (!r.n_train)
        log_warn("ingest",
                 "all %zu photographs are for testing, and none is left to train on: give a larger "
                 "--test-every or a smaller --test-block, or train with --no-test-split",
                 r.n_test);
    for (size_t i = 0; i < g->n; i++)
        r.n_gps += g->photos[i].geo.has_gps;
    enum err_code rc = scene_write(g->dir.part, &g->scene, e);
    if (!rc)
        rc = file_join(path, g->dir.part, "report.json", e);
    r.seconds = clock_s() - start_s;
    if (!rc)
        rc = ingest_report_write(&r, path, e);
    if (!rc)
        rc = outdir_commit(&g->dir, e);
    if (!rc)
        ingest_report_print(&r);
    return rc;
}

/* Up to the photographs' verdicts: what they are, and how good their poses. */
static enum err_code ingest_read_survey(struct ingest *g, const char *sparse_dir, struct err *e)
{
    enum err_code rc = colmap_read(sparse_dir, &g->model, e);
    if (!rc)
        rc = ingest_list_photos(g, e);
    if (!rc)
        rc = ingest_find_unplaced(g, e);
    if (!rc)
        rc = ingest_for_photos(g, "read EXIF", ingest_read_info_task, e);
    if (!rc)
        rc = ingest_find_flights(g, e);
    if (!rc)
        rc = ingest_drone_heights(g, e);
    if (!rc)
        rc = ingest_positions_apply(g, e);
    if (!rc)
        rc = ingest_heights_check(g, e);
    if (!rc)
        rc = ingest_judge_poses(g, e);
    return !rc ? ingest_check_some_left(g, e) : rc;
}

/* What the pixels of all photographs are like. */
static void ingest_tell_pixels(struct ingest *g)
{
    const size_t blanks = atomic_load(&g->blanks), wholes = atomic_load(&g->wholes),
                 alphas = atomic_load(&g->alphas), skies = atomic_load(&g->skies);
    if (atomic_load(&g->darks) == g->scene.n_images)
        log_warn(
            "ingest",
            "all photographs are dark: no sample is larger than %d of 255. If they have 10, 12 "
            "or 14 bits in samples of 16, multiply them by 64, 16 or 4, e.g. by oiiotool "
            "a.tif --mulc 16 -o b.tif",
            INGEST_DARK_MOST);
    if (atomic_load(&g->whites) == g->scene.n_images)
        log_warn("ingest",
                 "all photographs are white: nearly all samples are 255. Floats count to 1: if "
                 "these count to 255 or 65535, divide them, e.g. by oiiotool a.tif --divc 255 -d "
                 "uint8 -o b.tif");
    if (blanks)
        log_warn("ingest", "%zu photographs have the alpha 0 everywhere: it does not count",
                 blanks);
    if (wholes)
        log_warn("ingest", "%zu photographs are masked whole: nothing of them trains or is scored",
                 wholes);
    if (alphas)
        log_info("ingest", "%zu photographs have transparent pixels: these are masked", alphas);
    if (skies)
        log_info("ingest",
                 "%zu photographs show the sky: what is above the horizon and above all points is "
                 "masked",
                 skies);
}

static enum err_code ingest_run_steps(struct ingest *g, const char *sparse_dir, double start_s,
                                      struct err *e)
{
    char folder[FILE_PATH_MAX];
    enum err_code rc = ingest_read_survey(g, sparse_dir, e);
    if (!rc)
        rc = ingest_frame_find(g, e);
    if (!rc)
        rc = ingest_scene_fill(g, e);
    if (!rc)
        rc = ingest_points_filter(g->cfg, &g->scene, g->points, e);
    if (!rc)
        rc = file_join(folder, g->dir.part, "images", e);
    if (!rc)
        rc = file_mkdir(folder, e);
    if (!rc)
        rc = ingest_convert(g, e);
    if (!rc)
        ingest_tell_pixels(g);
    if (!rc && !atomic_load(&g->alphas) && !atomic_load(&g->masks) && !atomic_load(&g->skies) &&
        !file_join(folder, g->dir.part, "masks", e))
        (void)remove(folder); /* made for photographs that turned out to be opaque */
    if (!rc && g->cfg->mask_dir)
        rc = ingest_check_masks(g, e);
    if (!rc && g->cfg->exposure)
        rc = ingest_exposure_find(g, e);
    if (!rc)
        rc = ingest_write_scene(g, start_s, e);
    return rc;
}

static void ingest_close(struct ingest *g)
{
    outdir_abort(&g->dir);
    georef_free(&g->georef);
    for (size_t i = 0; i < g->n && g->photos; i++)
        mem_free(g->photos[i].fault);
    ingest_files_free(&g->files);
    gcp_fit_free(&g->gcp);
    geoid_close(&g->geoid);
    colmap_free(&g->model);
    scene_free(&g->scene);
}

/* ---- a look, without a scene ---- */

/* The photographs whose poses count with ground control points, by name. */
static enum err_code ingest_look_photos(const struct ingest *g, struct ingest_survey *out,
                                        struct err *e)
{
    out->photos = mem_array(g->n, sizeof *out->photos);
    if (!out->photos)
        return ingest_no_memory(e);
    for (size_t i = 0; i < g->n; i++) {
        const struct ingest_photo *p = &g->photos[i];
        if (p->verdict != INGEST_KEPT && p->verdict != INGEST_GPS)
            continue;
        struct ingest_survey_photo *q = &out->photos[out->n++];
        *q = (struct ingest_survey_photo){
            .file = mem_text(p->file),
            .width_px = p->width_px,
            .height_px = p->height_px,
            .view = {.image = p->image, .lens = &g->model.cameras[p->image->camera].lens}};
        memcpy(q->view.center, p->geo.center, sizeof q->view.center);
        memcpy(q->view.rot, p->geo.rot, sizeof q->view.rot);
        if (!q->file)
            return ingest_no_memory(e);
    }
    return ERR_OK;
}

enum err_code ingest_look(const char *images_dir, const char *sparse_dir,
                          const struct ingest_config *cfg, struct ingest_survey *out, struct err *e)
{
    struct ingest g = {.cfg = cfg, .images_dir = images_dir, .progress_busy = ATOMIC_FLAG_INIT};
    struct err why = {0};
    *out = (struct ingest_survey){0};
    enum err_code rc = ingest_heights_open(&g, e);
    if (!rc)
        rc = ingest_read_survey(&g, sparse_dir, e);
    if (!rc) {
        enum err_code placed = ingest_frame_find(&g, &why);
        out->placed = !placed;
        out->origin = g.scene.origin;
        out->sim.scale = g.scene.scale;
        memcpy(out->sim.rot, g.scene.rot, sizeof out->sim.rot);
        memcpy(out->sim.trans, g.scene.trans, sizeof out->sim.trans);
        if (placed && placed != ERR_DATA)
            rc = err_set(e, placed, "%s", why.msg);
    }
    if (!rc)
        rc = ingest_look_photos(&g, out, e);
    out->model = g.model; /* the photographs point into it */
    g.model = (struct colmap_model){0};
    ingest_close(&g);
    if (rc)
        ingest_survey_free(out);
    return rc;
}

void ingest_survey_free(struct ingest_survey *s)
{
    for (size_t i = 0; i < s->n && s->photos; i++)
        mem_free(s->photos[i].file);
    mem_free(s->photos);
    colmap_free(&s->model);
    *s = (struct ingest_survey){0};
}

/* ---- a scene ---- */

enum err_code ingest_run(const char *images_dir, const char *sparse_dir,
                         const struct ingest_config *cfg, struct err *e)
{
    return ingest_run_with(images_dir, sparse_dir, cfg, NULL, NULL, e);
}

enum err_code ingest_run_gcp(const char *images_dir, const char *sparse_dir,
                             const struct ingest_config *cfg, const struct gcp_list *gcps,
                             struct err *e)
{
    return ingest_run_with(images_dir, sparse_dir, cfg, gcps, NULL, e);
}

enum err_code ingest_run_with(const char *images_dir, const char *sparse_dir,
                              const struct ingest_config *cfg, const struct gcp_list *gcps,
                              const struct positions *positions, struct err *e)
{
    struct ingest g = {.cfg = cfg,
                       .images_dir = images_dir,
                       .gcps = gcps,
                       .positions = positions,
                       .progress_busy = ATOMIC_FLAG_INIT};
    struct geo_origin ignored;
    double start_s = clock_s();
    if (!cfg->output)
        return err_set(e, ERR_ARG, "ingest: no output folder: give -o SCENE");
    enum err_code rc = cfg->origin ? ingest_frame_parse(cfg->origin, &ignored, e) : ERR_OK;
    if (!rc && cfg->attribution && !ingest_is_utf8(cfg->attribution))
        rc = err_set(e, ERR_ARG, "--attribution: is not written in UTF-8");
    if (!rc)
        rc = ingest_heights_open(&g, e);
    if (!rc)
        rc = outdir_begin(cfg->output, "scene.json", cfg->overwrite, &g.dir, e);
    if (rc) {
        geoid_close(&g.geoid);
        return rc;
    }
    if (cfg->attribution && !(g.scene.attribution = arena_text(&g.scene.arena, cfg->attribution)))
        rc = ingest_no_memory(e);
    if (!rc)
        rc = ingest_run_steps(&g, sparse_dir, start_s, e);
    ingest_close(&g);
    return rc;
}
