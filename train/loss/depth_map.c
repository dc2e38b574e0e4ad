/* Known depths of a photograph. Maps are read again when they are needed. It owns one target
 * picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "train/loss/depth_map.h"

enum { DEPTH_MEDIAN_SAMPLE = 16384, DEPTH_EDGE_MAX = 16384 };

struct depth_map {
    struct depth_map_config cfg;
    bool *has; /* by image of the scene */
    float *target;
    size_t pixels; /* room in target */
};

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

/* ---- all photographs ---- */

static enum err_code depth_find_all(struct depth_map *d, struct err *e)
{
    char path[FILE_PATH_MAX];
    size_t used = 0, n = d->cfg.n_images;
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < n; i++) {
        const uint32_t image = d->cfg.images[i];
        rc = depth_map_find(d->cfg.dir, d->cfg.scene->images[image].name, &d->has[image], path, e);
        used += d->has[image];
    }
    if (rc)
        return rc;
    if (used < n)
        log_warn("train", "depth maps: %zu of %zu photographs have no map", n - used, n);
    log_info("train", "depth maps used=%zu of=%zu", used, n);
    return used ? ERR_OK
                : err_set(e, ERR_DATA,
                          "%s: no depth map can be used: %zu of %zu photographs have no map",
                          d->cfg.dir, n, n);
}

enum err_code depth_map_open(const struct depth_map_config *cfg, struct depth_map **out,
                             struct err *e)
{
    struct depth_map *d = mem_array(1, sizeof *d);
    *out = NULL;
    if (!d || !(d->has = mem_array(cfg->scene->n_images, sizeof *d->has))) {
        mem_free(d);
        return err_set(e, ERR_MEM, "depth maps: out of memory");
    }
    d->cfg = *cfg;
    enum err_code rc = depth_find_all(d, e);
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
    mem_free(d->has);
    mem_free(d->target);
    mem_free(d);
    *p = NULL;
}

/* ---- targets ---- */

static enum err_code depth_fill_map(struct depth_map *d, uint32_t image, const struct camera *cam,
                                    size_t *n_known, struct err *e)
{
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
            double t = isfinite(v) ? fmax(v, 0.0) : -1.0;
            d->target[(size_t)y * cam->width_px + x] = (float)t;
            *n_known += t >= 0.0;
        }
    mem_free(f.px);
    return rc;
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
    if (!d->has[image])
        return ERR_OK;
    if (pixels > d->pixels) {
        mem_free(d->target);
        d->target = mem_array(pixels, sizeof *d->target);
        d->pixels = d->target ? pixels : 0;
        if (!d->target)
            return err_set(e, ERR_MEM, "depth maps: out of memory for %zu pixels", pixels);
    }
    rc = depth_fill_map(d, image, cam, &out->n_known, e);
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
