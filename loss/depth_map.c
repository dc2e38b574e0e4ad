/* Known depths of a photograph: a map of relative inverse depth from a network, aligned to metres
 * by the sparse points that the photograph observes, or these points alone.
 *
 * A network's map is right up to a scale and an offset. So a y + b is fitted to the points' inverse
 * depths for each photograph. Maps that fit badly are left out and counted (the hierarchical 3D
 * Gaussian Splatting of Kerbl et al. 2024 aligns in the same way). Only alignments are kept; maps
 * are read again when needed. It owns the alignments and one target picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/image.h"
#include "codec/npy.h"
#include "codec/scene.h"
#include "core/sort.h"
#include "loss/depth_map.h"

#define DEPTH_ERROR_MAX_PX 1.5f /* reprojection error of points to align with */
#define DEPTH_RANGE_MIN 0.05    /* (largest - smallest) / median inverse depth */
#define DEPTH_LOG_RATIO_MAX 0.3
#define DEPTH_SCALE_MIN 0.2 /* against the median scale of all maps */
#define DEPTH_SCALE_MAX 5.0
enum { DEPTH_FEW = 10, DEPTH_MEDIAN_SAMPLE = 16384, DEPTH_EDGE_MAX = 16384 };

const char *const depth_verdict_text[DEPTH_VERDICTS] = {
    "used",
    "have no map",
    "observe 10 good points or fewer",
    "see points of too equal depth, or the map is constant there",
    "have a map that does not fit the points (is it depth, not inverse depth?)",
    "have a map of another scale than the rest",
};

struct depth_photo {
    double a, b;
    enum depth_verdict verdict;
    size_t first, last; /* its observations in scene->tracks */
};

struct depth_map {
    struct depth_map_config cfg;
    struct depth_photo *photos; /* by image of the scene */
    size_t count[DEPTH_VERDICTS];
    float *target;
    size_t pixels; /* room in target */
};

/* ---- alignment ---- */

static double depth_deviation(const double *v, size_t n, double about)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++)
        sum += fabs(v[i] - about);
    return sum / (double)n;
}

/* With scratch[n]. */
static enum depth_verdict depth_fit(const double *x, const double *y, size_t n, double *scratch,
                                    double *a, double *b)
{
    memcpy(scratch, x, n * sizeof *x);
    double mx = sort_median(scratch, n), range = scratch[n - 1] - scratch[0];
    memcpy(scratch, y, n * sizeof *y);
    double my = sort_median(scratch, n);
    double dx = depth_deviation(x, n, mx), dy = depth_deviation(y, n, my), together = 0.0;
    if (!(range > DEPTH_RANGE_MIN * mx) || !(dy > 0.0))
        return DEPTH_MAP_FLAT;
    *a = dx / dy;
    *b = mx - *a * my;
    for (size_t i = 0; i < n; i++) {
        double t = *a * y[i] + *b;
        together += (x[i] - mx) * (y[i] - my);
        scratch[i] = t > 0.0 ? fabs(log(t / x[i])) : (double)INFINITY;
    }
    if (!(together > 0.0) || !(sort_median(scratch, n) <= DEPTH_LOG_RATIO_MAX))
        return DEPTH_MAP_MISFIT;
    return DEPTH_MAP_OK;
}

enum depth_verdict depth_align(const double *x, const double *y, size_t n, double *a, double *b)
{
    *a = *b = 0.0;
    if (n <= DEPTH_FEW)
        return DEPTH_MAP_FEW;
    double *scratch = mem_array(n, sizeof *scratch);
    if (!scratch)
        return DEPTH_MAP_FEW; /* as good as none: the photograph goes without */
    enum depth_verdict v = depth_fit(x, y, n, scratch, a, b);
    mem_free(scratch);
    return v;
}

/* ---- files ---- */

struct depth_file { /* {0} is empty; mem_free(px) */
    uint32_t width, height;
    float *px;
};

enum err_code depth_map_find(const char *dir, const char *name, bool *found, char *path,
                             struct err *e)
{
    static const char *const endings[] = {".npy", ".png", ".pfm", ".tif", ".tiff", ".exr"};
    char stem[2][FILE_PATH_MAX], file[FILE_PATH_MAX];
    snprintf(stem[0], sizeof stem[0], "%s", name);
    snprintf(stem[1], sizeof stem[1], "%s", name);
    char *dot = strrchr(stem[1], '.');
    if (dot && !strchr(dot, '/'))
        *dot = '\0';
    *found = false;
    for (size_t s = 0; s < 2; s++)
        for (size_t k = 0; k < sizeof endings / sizeof endings[0]; k++) {
            int n = snprintf(file, sizeof file, "%s%s", stem[s], endings[k]);
            if (n < 0 || (size_t)n >= sizeof file)
                continue;
            enum err_code rc = file_join(path, dir, file, e);
            if (rc)
                return rc;
            if (file_exists(path)) {
                *found = true;
                return ERR_OK;
            }
        }
    return ERR_OK;
}

static enum err_code depth_read_file(const char *path, struct depth_file *out, struct err *e)
{
    size_t n = strlen(path), shape[2] = {0, 0};
    *out = (struct depth_file){0};
    if (n < 4 || strcmp(path + n - 4, ".npy"))
        return image_read_map(path, NULL, &out->width, &out->height, &out->px, e);
    enum err_code rc = npy_read(path, 2, shape, &out->px, e);
    if (!rc &&
        (shape[0] < 1 || shape[1] < 1 || shape[0] > DEPTH_EDGE_MAX || shape[1] > DEPTH_EDGE_MAX))
        rc =
            err_set(e, ERR_FORMAT, "%s: a depth map of shape (%zu, %zu)", path, shape[0], shape[1]);
    if (rc) {
        mem_free(out->px);
        out->px = NULL;
        return rc;
    }
    out->height = (uint32_t)shape[0];
    out->width = (uint32_t)shape[1];
    return ERR_OK;
}

/* Bilinear, pixel centres at + 0.5, at a place given in parts of the picture; NaN stays NaN. */
static double depth_sample(const struct depth_file *f, double x, double y)
{
    double u = fmin(fmax(x * f->width - 0.5, 0.0), f->width - 1.0),
           v = fmin(fmax(y * f->height - 0.5, 0.0), f->height - 1.0);
    uint32_t i = (uint32_t)u, j = (uint32_t)v, i1 = i + 1 < f->width ? i + 1 : i,
             j1 = j + 1 < f->height ? j + 1 : j;
    double fu = u - i, fv = v - j;
    const float *top = f->px + (size_t)j * f->width, *low = f->px + (size_t)j1 * f->width;
    return (1.0 - fv) * ((1.0 - fu) * (double)top[i] + fu * (double)top[i1]) +
           fv * ((1.0 - fu) * (double)low[i] + fu * (double)low[i1]);
}

/* Where a camera's picture lies in the whole photograph, in the camera's pixels. */
struct depth_frame {
    double left, top, width, height;
};

/* A camera may show a part of its photograph (camera_crop), at another size (camera_resize). */
static struct depth_frame depth_frame_of(const struct camera *full, const struct camera *cam)
{
    double sx = cam->fx_px / full->fx_px, sy = cam->fy_px / full->fy_px;
    return (struct depth_frame){round(full->cx_px * sx - cam->cx_px),
                                round(full->cy_px * sy - cam->cy_px), round(full->width_px * sx),
                                round(full->height_px * sy)};
}

/* ---- points ---- */

/* Inverse depth of observation t in its photograph; 0: behind it, outside, or a bad point. */
static double depth_of_track(const struct scene *s, const struct scene_track *t)
{
    const struct camera *c = &s->images[t->image].cam;
    const struct scene_point *p = &s->points[t->point];
    double z = c->trans[2];
    for (int k = 0; k < 3; k++)
        z += c->rot[6 + k] * p->enu_m[k];
    bool inside = t->x_px >= 0.0f && t->y_px >= 0.0f && t->x_px < (float)c->width_px &&
                  t->y_px < (float)c->height_px;
    return z > 0.0 && inside && p->error_px < DEPTH_ERROR_MAX_PX ? 1.0 / z : 0.0;
}

static enum err_code depth_align_photo(struct depth_map *d, uint32_t image, struct err *e)
{
    const struct scene *s = d->cfg.scene;
    struct depth_photo *p = &d->photos[image];
    const struct camera *c = &s->images[image].cam;
    struct depth_file f = {0};
    char path[FILE_PATH_MAX];
    bool found;
    size_t n = 0;
    p->verdict = DEPTH_MAP_MISSING;
    enum err_code rc = depth_map_find(d->cfg.dir, s->images[image].name, &found, path, e);
    if (rc || !found)
        return rc;
    if (d->cfg.metric) {
        p->a = 1.0;
        p->verdict = DEPTH_MAP_OK;
        return ERR_OK;
    }
    rc = depth_read_file(path, &f, e);
    double *x = mem_array(p->last - p->first, sizeof *x),
           *y = mem_array(p->last - p->first, sizeof *y);
    if (!rc && (!x || !y))
        rc = err_set(e, ERR_MEM, "%s: out of memory", path);
    for (size_t i = p->first; !rc && i < p->last; i++) {
        const struct scene_track *t = &s->tracks[i];
        x[n] = depth_of_track(s, t);
        y[n] = depth_sample(&f, (double)t->x_px / c->width_px, (double)t->y_px / c->height_px);
        n += x[n] > 0.0 && isfinite(y[n]);
    }
    if (!rc)
        p->verdict = depth_align(x, y, n, &p->a, &p->b);
    mem_free(x);
    mem_free(y);
    mem_free(f.px);
    return rc;
}

/* ---- all photographs ---- */

static void depth_find_tracks(struct depth_map *d)
{
    const struct scene *s = d->cfg.scene;
    for (size_t i = 0; i < s->n_tracks; i++) { /* sorted by image */
        struct depth_photo *p = &d->photos[s->tracks[i].image];
        if (p->first == p->last)
            p->first = i;
        p->last = i + 1;
    }
}

/* A map whose scale is far from that of the others was aligned to something else. */
static enum err_code depth_check_scales(struct depth_map *d, struct err *e)
{
    double *a = mem_array(d->cfg.n_images, sizeof *a);
    size_t n = 0;
    if (!a)
        return err_set(e, ERR_MEM, "depth maps: out of memory");
    for (size_t i = 0; i < d->cfg.n_images; i++)
        if (d->photos[d->cfg.images[i]].verdict == DEPTH_MAP_OK)
            a[n++] = d->photos[d->cfg.images[i]].a;
    double middle = sort_median(a, n);
    for (size_t i = 0; i < d->cfg.n_images; i++) {
        struct depth_photo *p = &d->photos[d->cfg.images[i]];
        if (p->verdict == DEPTH_MAP_OK &&
            !(p->a >= DEPTH_SCALE_MIN * middle && p->a <= DEPTH_SCALE_MAX * middle))
            p->verdict = DEPTH_MAP_SCALE;
        d->count[p->verdict]++;
    }
    mem_free(a);
    return ERR_OK;
}

static enum err_code depth_report(const struct depth_map *d, struct err *e)
{
    enum depth_verdict worst = DEPTH_MAP_MISSING;
    for (enum depth_verdict v = DEPTH_MAP_MISSING; v < DEPTH_VERDICTS; v++) {
        if (d->count[v])
            log_warn("train", "depth maps: %zu of %zu photographs %s", d->count[v], d->cfg.n_images,
                     depth_verdict_text[v]);
        worst = d->count[v] > d->count[worst] ? v : worst;
    }
    log_info("train", "depth maps used=%zu of=%zu", d->count[DEPTH_MAP_OK], d->cfg.n_images);
    if (d->count[DEPTH_MAP_OK])
        return ERR_OK;
    return err_set(e, ERR_DATA, "%s: no depth map can be used: %zu of %zu photographs %s",
                   d->cfg.dir, d->count[worst], d->cfg.n_images, depth_verdict_text[worst]);
}

enum err_code depth_map_open(const struct depth_map_config *cfg, struct depth_map **out,
                             struct err *e)
{
    struct depth_map *d = mem_array(1, sizeof *d);
    enum err_code rc = ERR_OK;
    *out = NULL;
    if (!d || !(d->photos = mem_array(cfg->scene->n_images, sizeof *d->photos))) {
        mem_free(d);
        return err_set(e, ERR_MEM, "depth maps: out of memory");
    }
    d->cfg = *cfg;
    for (size_t i = 0; i < cfg->scene->n_images; i++)
        d->photos[i].verdict = DEPTH_MAP_MISSING;
    depth_find_tracks(d);
    for (size_t i = 0; !rc && cfg->dir && i < cfg->n_images; i++)
        rc = depth_align_photo(d, cfg->images[i], e);
    if (!rc)
        rc = depth_check_scales(d, e);
    if (!rc && cfg->dir)
        rc = depth_report(d, e);
    if (!rc && !cfg->dir && !cfg->scene->n_tracks)
        rc = err_set(e, ERR_DATA,
                     "%s: the scene holds no observations of points: there is no sparse depth",
                     cfg->scene->dir);
    if (rc)
        depth_map_close(&d);
    *out = d;
    return rc;
}

void depth_map_close(struct depth_map **p)
{
    struct depth_map *d = *p;
    if (!d)
        return;
    mem_free(d->photos);
    mem_free(d->target);
    mem_free(d);
    *p = NULL;
}

size_t depth_map_count(const struct depth_map *d, enum depth_verdict v)
{
    return d->count[v];
}

/* ---- targets ---- */

static enum err_code depth_fill_map(struct depth_map *d, uint32_t image, const struct camera *cam,
                                    size_t *n_known, struct err *e)
{
    const struct depth_photo *p = &d->photos[image];
    struct depth_file f = {0};
    char path[FILE_PATH_MAX];
    bool found;
    enum err_code rc =
        depth_map_find(d->cfg.dir, d->cfg.scene->images[image].name, &found, path, e);
    if (!rc && !found)
        rc = err_set(e, ERR_NOENT, "%s: the depth map of %s has gone", d->cfg.dir,
                     d->cfg.scene->images[image].name);
    if (!rc)
        rc = depth_read_file(path, &f, e);
    const struct depth_frame in = depth_frame_of(&d->cfg.scene->images[image].cam, cam);
    for (uint32_t y = 0; !rc && y < cam->height_px; y++)
        for (uint32_t x = 0; x < cam->width_px; x++) {
            double v =
                depth_sample(&f, (x + 0.5 + in.left) / in.width, (y + 0.5 + in.top) / in.height);
            double t = isfinite(v) ? fmax(p->a * v + p->b, 0.0) : -1.0;
            d->target[(size_t)y * cam->width_px + x] = (float)t;
            *n_known += t >= 0.0;
        }
    mem_free(f.px);
    return rc;
}

/* Each observed point in its pixel, the nearest where there are several. */
static void depth_fill_points(struct depth_map *d, uint32_t image, const struct camera *cam,
                              size_t *n_known)
{
    const struct scene *s = d->cfg.scene;
    const struct camera *full = &s->images[image].cam;
    const struct depth_photo *p = &d->photos[image];
    const struct depth_frame in = depth_frame_of(full, cam);
    for (size_t i = 0; i < (size_t)cam->width_px * cam->height_px; i++)
        d->target[i] = -1.0f;
    for (size_t i = p->first; i < p->last; i++) {
        double t = depth_of_track(s, &s->tracks[i]);
        if (!(t > 0.0))
            continue;
        double x = floor((double)s->tracks[i].x_px / full->width_px * in.width) - in.left,
               y = floor((double)s->tracks[i].y_px / full->height_px * in.height) - in.top;
        if (!(x >= 0.0 && y >= 0.0 && x < cam->width_px && y < cam->height_px))
            continue; /* in another part of the photograph */
        float *to = &d->target[(size_t)y * cam->width_px + (size_t)x];
        *n_known += *to < 0.0f;
        *to = fmaxf(*to, (float)t);
    }
}

/* 1 / median of the known values, from an even sample of them; 0 when it is 0. */
static enum err_code depth_unit(const float *t, size_t pixels, double *unit, struct err *e)
{
    size_t known = 0, n = 0;
    double *v = mem_array(DEPTH_MEDIAN_SAMPLE + 1, sizeof *v);
    if (!v)
        return err_set(e, ERR_MEM, "depth maps: out of memory");
    for (size_t i = 0; i < pixels; i++)
        known += t[i] >= 0.0f;
    size_t every = known / DEPTH_MEDIAN_SAMPLE + 1, at = 0;
    for (size_t i = 0; i < pixels; i++)
        if (t[i] >= 0.0f && at++ % every == 0)
            v[n++] = (double)t[i];
    double middle = sort_median(v, n);
    *unit = middle > 0.0 ? 1.0 / middle : 0.0;
    mem_free(v);
    return ERR_OK;
}

enum err_code depth_map_target(struct depth_map *d, uint32_t image, const struct camera *cam,
                               const uint8_t *mask, struct depth_target *out, struct err *e)
{
    size_t pixels = (size_t)cam->width_px * cam->height_px;
    enum err_code rc = ERR_OK;
    *out = (struct depth_target){0};
    bool map = d->photos[image].verdict == DEPTH_MAP_OK;
    if (!map && !d->cfg.sparse)
        return ERR_OK;
    if (pixels > d->pixels) {
        mem_free(d->target);
        d->target = mem_array(pixels, sizeof *d->target);
        d->pixels = d->target ? pixels : 0;
        if (!d->target)
            return err_set(e, ERR_MEM, "depth maps: out of memory for %zu pixels", pixels);
    }
    if (map)
        rc = depth_fill_map(d, image, cam, &out->n_known, e);
    else
        depth_fill_points(d, image, cam, &out->n_known);
    for (size_t i = 0; !rc && mask && i < pixels; i++)
        if (!mask[i] && d->target[i] >= 0.0f) {
            d->target[i] = -1.0f;
            out->n_known--;
        }
    if (!rc && out->n_known)
        rc = depth_unit(d->target, pixels, &out->unit_m, e);
    if (rc || !(out->unit_m > 0.0)) {
        *out = (struct depth_target){0};
        return rc;
    }
    for (size_t i = 0; i < pixels; i++)
        d->target[i] = d->target[i] >= 0.0f ? (float)((double)d->target[i] * out->unit_m) : -1.0f;
    out->t = d->target;
    return ERR_OK;
}
