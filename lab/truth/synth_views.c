/* Map views: the city at poses that are usual in maps, with depth and a mask of the surface that
 * the training photographs support.
 *
 * Test photographs lie between training photographs and look similar. A map's camera goes lower,
 * higher, farther out, and down into the streets. Kinds of views follow each other in a fixed
 * order, so any first N are a fair mix. For each view, poses are drawn at random until one is in
 * free air and sees its target.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "core/outdir.h"
#include "core/pool.h"
#include "lab/lab.h"
#include "lab/truth/synth_views.h"
#include "lab/truth/truth_config.h"

enum view_kind { ORBIT, NEAR, FAR, OVERVIEW, STREET, NADIR };
static const char *const kind_names[] = {"orbit", "near", "far", "overview", "street", "nadir"};
static const enum view_kind kind_order[] = {ORBIT, NEAR, NADIR, STREET, FAR, ORBIT, OVERVIEW, NEAR};

enum {
    VIEW_TRIES = 400,     /* poses drawn for a view before giving up */
    VIEW_SUPERSAMPLE = 3, /* rays per pixel and axis at least: far views have fine detail */
    MASK_PHOTOGRAPHS = 3, /* that must see a surface, */
    MASK_SEEN_MAX = 64,   /* of at most as many that are looked at */
    MASK_SUPPORTED = 255,
    MASK_SEEN = 128,
    MASK_HIDDEN = 64,
};
static const double view_fov_y_deg = 50, /* vertical, a map's usual one */
    mask_parallax_deg = 5;               /* between any two of those photographs */
static const double near_height = 0.45, far_height = 2.1,
                    aslant_pitch_deg = -45; /* flight heights */
static const double clear_m = 1;            /* of the eye from any solid */
static const uint64_t light_dice = 1 << 27; /* random numbers from here on are not those of poses */

struct pose { /* city frame; heading clockwise from +y */
    double eye_m[3], target_m[3], heading_deg, pitch_deg;
    bool aimed; /* must see the target */
};

struct views {
    const struct synth_config *cfg;
    const struct synth_views_options *o;
    const struct synth_city *city;
    const struct synth_photo *photos;
    const char *dir;
    struct lens photo_lens;
    struct synth_draw draw;
    struct camera *cams; /* [n] */
    enum view_kind *kinds;
    const struct synth_photo **lights; /* [n] whose light it is; NULL: the city's one */
    size_t n;
    struct progress progress;
    atomic_flag progress_busy;
    atomic_size_t done;
};

/* ---- poses ---- */

struct views_dice { /* random numbers of one try at one view */
    uint64_t seed, next;
};

static double views_roll(struct views_dice *d, double lo, double hi)
{
    return lo + (hi - lo) * rng_unit(d->seed, SYNTH_STREAM_VIEWS, d->next++);
}

static double views_height_at(const struct synth_city *c, double x, double y)
{
    const double eye[3] = {x, y, 1e4}, down[3] = {0, 0, -1};
    struct synth_hit hit;
    synth_trace_ray(c, NULL, eye, down, &hit);
    return hit.pos[2];
}

/* Free air around the eye? Boxes about the solids are close enough. */
static bool views_eye_is_clear(const struct synth_city *c, const double p[3])
{
    if (p[2] < clear_m)
        return false;
    for (size_t i = 0; i < c->n_solids; i++) {
        const struct synth_solid *s = &c->solids[i];
        double rx = p[0] - s->center_m[0], ry = p[1] - s->center_m[1];
        double x = s->cos_yaw * rx + s->sin_yaw * ry, y = -s->sin_yaw * rx + s->cos_yaw * ry;
        if (fabs(x) < s->half_m[0] + clear_m && fabs(y) < s->half_m[1] + clear_m &&
            p[2] > s->z0_m - clear_m && p[2] < s->ridge_m + clear_m)
            return false;
    }
    return true;
}

static bool views_target_is_seen(const struct synth_city *c, const struct pose *p)
{
    double d[3], len = 0;
    for (int i = 0; i < 3; i++) {
        d[i] = p->target_m[i] - p->eye_m[i];
        len += d[i] * d[i];
    }
    len = sqrt(len);
    for (int i = 0; i < 3; i++)
        d[i] /= len;
    struct synth_hit hit;
    synth_trace_ray(c, NULL, p->eye_m, d, &hit);
    return hit.t_m > len - 0.05;
}

/* Look at a place of the city from `height` above the ground, at p->pitch_deg. */
static bool views_aim(const struct synth_city *c, struct views_dice *d, double height,
                      double range_max, struct pose *p)
{
    double side = 0.8 * c->half_m, h, range;
    p->target_m[0] = views_roll(d, -side, side);
    p->target_m[1] = views_roll(d, -side, side);
    p->target_m[2] = views_height_at(c, p->target_m[0], p->target_m[1]);
    p->heading_deg = views_roll(d, 0, 360);
    h = p->heading_deg * M_PI / 180;
    range = (height - p->target_m[2]) / tan(-p->pitch_deg * M_PI / 180); /* on the ground */
    p->eye_m[0] = p->target_m[0] - range * sin(h);
    p->eye_m[1] = p->target_m[1] - range * cos(h);
    p->eye_m[2] = height;
    return height > p->target_m[2] + 2 && range < range_max;
}

static void views_overview(const struct synth_city *c, struct views_dice *d, struct pose *p)
{
    double away = views_roll(d, 1.8, 3) * c->half_m;
    p->heading_deg = views_roll(d, 0, 360);
    double h = p->heading_deg * M_PI / 180;
    p->eye_m[0] = -away * sin(h);
    p->eye_m[1] = -away * cos(h);
    p->eye_m[2] = fmax(15, views_roll(d, 0.6, 1.6) * c->half_m);
    p->pitch_deg = -atan2(p->eye_m[2] - 5, away) * 180 / M_PI;
}

static void views_street(const struct synth_city *c, struct views_dice *d, struct pose *p)
{
    int axis = views_roll(d, 0, 1) < 0.5;
    size_t i = (size_t)views_roll(d, 0, (double)c->n_streets[axis] - 0.001);
    double across = c->street_m[axis][i] + views_roll(d, -0.4, 0.4) * c->street_half_m[axis][i];
    double along = views_roll(d, -0.8, 0.8) * c->half_m;
    p->eye_m[0] = axis ? along : across;
    p->eye_m[1] = axis ? across : along;
    p->eye_m[2] = views_roll(d, 1.7, 3);
    /* Towards the longer half of the street. */
    p->heading_deg = (axis ? 90 : 0) + (along > 0 ? 180 : 0) + views_roll(d, -20, 20);
    p->pitch_deg = views_roll(d, -6, 2);
}

static bool views_pose(const struct views *v, enum view_kind kind, struct views_dice *d,
                       struct pose *p)
{
    const struct synth_city *c = v->city;
    double height = synth_flight_height(v->cfg), reach = 4 * height + c->half_m;
    *p = (struct pose){.pitch_deg = aslant_pitch_deg};
    switch (kind) {
    case ORBIT:
        p->pitch_deg = views_roll(d, -60, -20);
        p->aimed = true;
        return views_aim(c, d, height * 0.3 * pow(10, views_roll(d, 0, 1)), reach, p);
    case NEAR:
        return views_aim(c, d, near_height * height, reach, p);
    case FAR:
        return views_aim(c, d, far_height * height, reach, p);
    case OVERVIEW:
        views_overview(c, d, p);
        return true;
    case STREET:
        views_street(c, d, p);
        return true;
    case NADIR:
        p->heading_deg = views_roll(d, 0, 360);
        p->pitch_deg = -90;
        p->eye_m[0] = views_roll(d, -0.8, 0.8) * c->half_m;
        p->eye_m[1] = views_roll(d, -0.8, 0.8) * c->half_m;
        p->eye_m[2] = height * 0.3 * pow(10, views_roll(d, 0, 1));
        return true;
    }
    return false;
}

static struct camera views_camera(const struct views *v, const struct pose *p)
{
    double yaw = v->city->yaw_rad, cs = cos(yaw), sn = sin(yaw);
    const double eye[3] = {cs * p->eye_m[0] - sn * p->eye_m[1], sn * p->eye_m[0] + cs * p->eye_m[1],
                           p->eye_m[2]};
    return camera_heading(eye, p->heading_deg - yaw * 180 / M_PI, p->pitch_deg,
                          view_fov_y_deg * M_PI / 180, (uint32_t)v->cfg->width_px,
                          (uint32_t)v->cfg->height_px);
}

static enum err_code views_place(struct views *v, size_t i, struct err *e)
{
    enum view_kind kind = kind_order[i % (sizeof kind_order / sizeof *kind_order)];
    struct pose p;
    for (uint64_t k = 0; k < VIEW_TRIES; k++) {
        struct views_dice d = {(uint64_t)v->cfg->seed,
                               ((uint64_t)v->o->seed << 28) + ((uint64_t)i * VIEW_TRIES + k) * 16};
        if (!views_pose(v, kind, &d, &p) || !views_eye_is_clear(v->city, p.eye_m) ||
            (p.aimed && !views_target_is_seen(v->city, &p)))
            continue;
        v->kinds[i] = kind;
        v->cams[i] = views_camera(v, &p);
        return ERR_OK;
    }
    return err_set(e, ERR_DATA,
                   "synth: map view %zu (%s): no free place for its camera in %d tries; use a "
                   "larger --extent-m or --altitude-m",
                   i + 1, kind_names[kind], VIEW_TRIES);
}

/* One of the photographs that train and are what they seem. */
static enum err_code views_light(struct views *v, size_t i, struct err *e)
{
    const struct synth_config *cfg = v->cfg;
    struct views_dice d = {(uint64_t)cfg->seed,
                           ((uint64_t)v->o->seed << 28) + light_dice + (uint64_t)i * VIEW_TRIES};
    for (int k = 0; k < VIEW_TRIES; k++) {
        size_t j = (size_t)views_roll(&d, 0, (double)cfg->photos - 0.001);
        const struct synth_photo *p = &v->photos[j];
        if (j % (size_t)cfg->test_every == 0 || p->pose_error || p->gps_outlier)
            continue;
        v->lights[i] = p;
        return ERR_OK;
    }
    return err_set(e, ERR_DATA,
                   "synth: map view %zu: no training photograph whose light it could have", i + 1);
}

/* ---- the mask ---- */

/* What training has of a photograph: the picture without the lens' distortion, which leaves out the
 * corners that a barrel pushes in. */
static struct lens views_photo_lens(const struct synth_config *cfg)
{
    struct lens full = synth_flight_lens(cfg), l = full;
    l.model = LENS_PINHOLE;
    l.params[0] = l.params[1] = full.params[0];
    l.params[2] = 0.5 * (double)cfg->width_px;
    l.params[3] = 0.5 * (double)cfg->height_px;
    return l;
}

/* Are three of these unit vectors pairwise farther apart than that angle? The last one is new. */
static bool views_parallax(const double (*dir)[3], size_t n, double cos_max)
{
    const double *a = dir[n - 1];
    for (size_t i = 0; i + 1 < n; i++) {
        const double *b = dir[i];
        if (a[0] * b[0] + a[1] * b[1] + a[2] * b[2] > cos_max)
            continue;
        for (size_t j = i + 1; j + 1 < n; j++) {
            const double *c = dir[j];
            if (a[0] * c[0] + a[1] * c[1] + a[2] * c[2] <= cos_max &&
                b[0] * c[0] + b[1] * c[1] + b[2] * c[2] <= cos_max)
                return true;
        }
    }
    return false;
}

static uint8_t views_mask_at(const struct views *v, const double place[3])
{
    const struct synth_config *cfg = v->cfg;
    double dir[MASK_SEEN_MAX][3], cos_max = cos(mask_parallax_deg * M_PI / 180);
    size_t n = 0, framed = 0;
    for (size_t i = 0; i < (size_t)cfg->photos && n < MASK_SEEN_MAX; i++) {
        const struct synth_photo *p = &v->photos[i];
        double eye[3], len = 0;
        if (i % (size_t)cfg->test_every == 0 || p->pose_error || p->gps_outlier ||
            !synth_model_frames(&v->photo_lens, &p->cam, place))
            continue;
        framed++;
        if (!synth_model_sees(v->city, &v->photo_lens, &p->cam, place))
            continue;
        camera_center(&p->cam, eye);
        for (int k = 0; k < 3; k++) {
            dir[n][k] = eye[k] - place[k];
            len += dir[n][k] * dir[n][k];
        }
        for (int k = 0; k < 3; k++)
            dir[n][k] /= sqrt(len);
        n++;
        if (n >= MASK_PHOTOGRAPHS && views_parallax((const double(*)[3])dir, n, cos_max))
            return MASK_SUPPORTED;
    }
    return n ? MASK_SEEN : framed ? MASK_HIDDEN : 0;
}

/* ---- one view ---- */

static enum err_code views_path(const struct views *v, size_t i, const char *tail, char *out,
                                struct err *e)
{
    char name[64];
    snprintf(name, sizeof name, "%03zu-%s%s", i + 1, kind_names[v->kinds[i]], tail);
    return file_join(out, v->dir, name, e);
}

static json_t *views_nums(const double *v, size_t n)
{
    json_t *a = json_array();
    for (size_t i = 0; i < n; i++)
        json_array_append_new(a, json_real(v[i]));
    return a;
}

static enum err_code views_write_camera(const struct views *v, size_t i, struct err *e)
{
    char path[FILE_PATH_MAX];
    const struct camera *c = &v->cams[i];
    double m[16] = {[15] = 1};
    for (int r = 0; r < 3; r++) {
        memcpy(m + 4 * r, c->rot + 3 * r, 3 * sizeof *m);
        m[4 * r + 3] = c->trans[r];
    }
    json_t *o = json_pack("{s:i, s:i, s:f, s:f, s:f, s:f, s:o}", "width", (int)c->width_px,
                          "height", (int)c->height_px, "fx", c->fx_px, "fy", c->fy_px, "cx",
                          c->cx_px, "cy", c->cy_px, "world_to_camera", views_nums(m, 16));
    enum err_code rc = o ? views_path(v, i, ".json", path, e)
                         : err_set(e, ERR_MEM, "synth: out of memory for a camera");
    if (!rc)
        rc = jsonc_write(path, o, e);
    json_decref(o);
    return rc;
}

/* Depth, and what is known of the surface behind each pixel. */
static void views_surface(const struct views *v, const struct camera *cam, float *depth,
                          uint8_t *mask, uint8_t *square)
{
    const struct synth_city *c = v->city;
    double cs = cos(c->yaw_rad), sn = sin(c->yaw_rad);
    for (size_t i = 0; i < (size_t)cam->width_px * cam->height_px; i++) {
        struct synth_hit hit;
        depth[i] = (float)synth_draw_hit(&v->draw, cam, (double)(i % cam->width_px) + 0.5,
                                         (double)(i / cam->width_px) + 0.5, &hit);
        if (!isfinite(hit.t_m))
            continue; /* sky: both stay 0 */
        const double place[3] = {cs * hit.pos[0] - sn * hit.pos[1],
                                 sn * hit.pos[0] + cs * hit.pos[1], hit.pos[2]};
        mask[i] = views_mask_at(v, place);
        square[i] = fabs(hit.pos[0]) <= c->half_m && fabs(hit.pos[1]) <= c->half_m ? 255 : 0;
    }
}

static enum err_code views_write_one(const struct views *v, size_t i, struct err *e)
{
    char path[FILE_PATH_MAX];
    const struct camera *cam = &v->cams[i];
    struct synth_light light = v->lights[i] ? v->lights[i]->light : synth_shade_light();
    struct image img = {0}, mask = {0}, square = {0};
    size_t shape[2] = {cam->height_px, cam->width_px};
    float *depth = mem_array(shape[0] * shape[1], sizeof *depth);
    enum err_code rc = depth ? image_alloc(cam->width_px, cam->height_px, 1, &mask, e)
                             : err_set(e, ERR_MEM, "synth: out of memory for a depth map");
    if (!rc)
        rc = image_alloc(cam->width_px, cam->height_px, 1, &square, e);
    if (rc)
        goto out;
    views_surface(v, cam, depth, mask.px, square.px);
    rc = synth_draw_picture(&v->draw, cam, &light, NULL, &img, e);
    const struct {
        const char *tail;
        const struct image *img;
    } pictures[] = {{".png", &img}, {"_mask.png", &mask}, {"_square.png", &square}};
    for (size_t k = 0; !rc && k < sizeof pictures / sizeof *pictures; k++) {
        rc = views_path(v, i, pictures[k].tail, path, e);
        if (!rc)
            rc = image_write(path, pictures[k].img, 0, NULL, e);
    }
    if (!rc)
        rc = views_path(v, i, ".npy", path, e);
    if (!rc)
        rc = npy_write(path, depth, 2, shape, e);
    if (!rc)
        rc = views_write_camera(v, i, e);
out:
    mem_free(depth);
    image_free(&img);
    image_free(&mask);
    image_free(&square);
    return rc;
}

static enum err_code views_task(void *user, size_t i, struct err *e)
{
    struct views *v = user;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    enum err_code rc = views_write_one(v, i, e);
    size_t done = atomic_fetch_add(&v->done, 1) + 1;
    if (!atomic_flag_test_and_set(&v->progress_busy)) {
        progress_step(&v->progress, done, NULL);
        atomic_flag_clear(&v->progress_busy);
    }
    return rc;
}

/* ---- all of them ---- */

static enum err_code views_write_manifest(const struct views *v, struct err *e)
{
    char path[FILE_PATH_MAX], name[64];
    struct synth_similarity f = synth_model_frame(v->cfg);
    json_t *views = json_array();
    for (size_t i = 0; i < v->n; i++) {
        double eye[3];
        camera_center(&v->cams[i], eye);
        snprintf(name, sizeof name, "%03zu-%s", i + 1, kind_names[v->kinds[i]]);
        json_array_append_new(views,
                              json_pack("{s:s, s:s, s:f, s:s*}", "name", name, "kind",
                                        kind_names[v->kinds[i]], "height_m", eye[2], "photograph",
                                        v->lights[i] ? v->lights[i]->name : NULL));
    }
    json_t *root =
        json_pack("{s:s, s:I, s:I, s:f, s:{s:f, s:o, s:o}, s:o}", "format", "citysplat-views",
                  "seed", (json_int_t)v->cfg->seed, "map_seed", (json_int_t)v->o->seed,
                  "flight_height_m", synth_flight_height(v->cfg), "colmap_to_enu", "scale", f.scale,
                  "rot", views_nums(f.rot, 9), "trans", views_nums(f.trans, 3), "views", views);
    enum err_code rc = root ? file_join(path, v->dir, "views.json", e)
                            : err_set(e, ERR_MEM, "synth: out of memory for views.json");
    if (!rc)
        rc = jsonc_write(path, root, e);
    json_decref(root);
    return rc;
}

static enum err_code views_write(const struct synth_config *cfg,
                                 const struct synth_views_options *o, const struct synth_city *city,
                                 const struct synth_photo *photos, const char *dir, struct err *e)
{
    struct views v = {.cfg = cfg,
                      .o = o,
                      .city = city,
                      .photos = photos,
                      .dir = dir,
                      .photo_lens = views_photo_lens(cfg),
                      .n = (size_t)o->count,
                      .progress_busy = ATOMIC_FLAG_INIT};
    enum err_code rc = ERR_OK;
    v.cams = mem_array(v.n, sizeof *v.cams);
    v.kinds = mem_array(v.n, sizeof *v.kinds);
    v.lights = mem_array(v.n, sizeof *v.lights);
    if (!v.cams || !v.kinds || !v.lights)
        rc = err_set(e, ERR_MEM, "synth: out of memory for %zu views", v.n);
    for (size_t i = 0; !rc && i < v.n; i++)
        rc = views_place(&v, i, e);
    for (size_t i = 0; !rc && i < v.n && o->light; i++)
        rc = views_light(&v, i, e);
    if (!rc) {
        struct lens l = {
            .model = LENS_PINHOLE,
            .width_px = v.cams[0].width_px,
            .height_px = v.cams[0].height_px,
            .params = {v.cams[0].fx_px, v.cams[0].fy_px, v.cams[0].cx_px, v.cams[0].cy_px}};
        int rays = cfg->supersample > VIEW_SUPERSAMPLE ? (int)cfg->supersample : VIEW_SUPERSAMPLE;
        rc = synth_draw_open(city, &l, rays, o->blur_px, &v.draw, e);
    }
    if (!rc) {
        progress_start(&v.progress, "draw map views", (uint64_t)v.n);
        rc = pool_for(v.n, 0, views_task, &v, e);
        progress_end(&v.progress, NULL);
    }
    if (!rc)
        rc = views_write_manifest(&v, e);
    synth_draw_close(&v.draw);
    mem_free(v.cams);
    mem_free(v.kinds);
    mem_free(v.lights);
    return rc;
}

static enum err_code views_folder(const char *path, char out[FILE_PATH_MAX], struct err *e)
{
    int n = snprintf(out, FILE_PATH_MAX, "%s", path);
    return n < FILE_PATH_MAX ? ERR_OK : err_set(e, ERR_LIMIT, "%.100s...: path too long", path);
}

enum err_code synth_views_run(const char *city_dir, const struct synth_views_options *o,
                              char out_dir[FILE_PATH_MAX], struct err *e)
{
    struct synth_config of = {0};
    struct synth_city city = {0};
    struct synth_photo *photos = NULL;
    struct outdir dir = {0};
    struct arena arena = {0};
    enum err_code rc = truth_config(city_dir, &of, &arena, e);
    if (!rc)
        rc = o->output ? views_folder(o->output, out_dir, e)
                       : file_join(out_dir, city_dir, "map-views", e);
    if (!rc)
        rc = outdir_begin(out_dir, "views.json", o->overwrite, &dir, e);
    if (rc)
        goto out;
    photos = mem_array((size_t)of.photos, sizeof *photos);
    rc = photos ? synth_city_make(&of, &city, e)
                : err_set(e, ERR_MEM, "map-views: out of memory for %lld photographs",
                          (long long)of.photos);
    if (rc)
        goto out;
    synth_flight_make(&of, photos);
    rc = views_write(&of, o, &city, photos, dir.part, e);
    if (!rc)
        rc = outdir_commit(&dir, e);
out:
    outdir_abort(&dir);
    mem_free(photos);
    synth_city_free(&city);
    arena_free(&arena);
    return rc;
}

static const struct options_def views_defs[] = {
#define OPT(...) OPTIONS_ROW(struct synth_views_options, __VA_ARGS__)
#include "lab/truth/synth_views.def"
};

enum err_code lab_synth_views(int argc, char **argv, struct err *e)
{
    const struct options_spec spec = {
        .command = "map-views",
        .usage = "citysplat-lab map-views CITY [options]",
        .about = "Draws ground truth of the procedural city that `citysplat-lab synth` made in the "
                 "folder CITY, at poses that people take in maps: pictures, depth, and a mask of "
                 "what the training photographs see.",
        .example = "citysplat-lab map-views city --count 24",
        .defs = views_defs,
        .n_defs = sizeof views_defs / sizeof *views_defs,
        .min_args = 1,
        .max_args = 1};
    struct arena a = {0};
    struct synth_views_options o;
    struct options_args args;
    char dir[FILE_PATH_MAX];
    enum err_code rc = options_parse(&spec, argc, argv, &o, &args, &a, e);
    if (rc || args.done)
        goto out;
    signals_catch();
    double start = clock_s();
    rc = synth_views_run(args.arg[0], &o, dir, e);
    if (!rc)
        printf("%s: %lld map views of %s in %.1f s\n", dir, (long long)o.count, args.arg[0],
               clock_s() - start);
out:
    arena_free(&a);
    return rc;
}
