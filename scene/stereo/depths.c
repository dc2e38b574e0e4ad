/* Depth maps of all photographs of a scene: pictures, sweeps, agreement, files.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/stereo/depths.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/image/image.h"
#include "codec/scene/scene.h"
#include "core/base.h"
#include "core/outdir.h"
#include "core/pool.h"
#include "scene/stereo/fuse.h"
#include "scene/stereo/pairs.h"
#include "scene/stereo/sweep.h"

/* Measured: docs/decisions/007-stereo.md. */
#define DEPTHS_AGREE 2        /* neighbours that must have the same height, */
#define DEPTHS_TOLERANCE 1.5  /* within so many planes */
#define DEPTHS_MOVE_PX 0.75   /* most that a step of one plane may move a neighbour's pixel */
#define DEPTHS_SPACING_PX 2.0 /* edge of the cubes of fused points, in footprints of a pixel */
#define DEPTHS_JUMP 5.0       /* footprints of a pixel from one to the next: an edge */

enum { DEPTHS_SAMPLES_MAX = 16 << 20 };

struct depths_view { /* of a photograph of the scene */
    struct camera cam;
    struct image rgb;
    uint8_t *grey, *sure;   /* [h][w], as height_m; sure: correlation there, 1 is 255 */
    float *height_m, *kept; /* kept: what is written */
    double step_m;
};
struct depths {
    const struct scene *scene;
    const struct depths_config *cfg;
    struct pairs pairs;
    struct depths_view *views; /* [n_images] */
    uint8_t *use;
    const struct outdir *dir;
    uint64_t *known; /* [n_images] pixels that are kept */
};

static void depths_close(struct depths *d)
{
    for (size_t i = 0; d->views && i < d->scene->n_images; i++) {
        mem_free(d->views[i].grey);
        mem_free(d->views[i].sure);
        image_free(&d->views[i].rgb);
        mem_free(d->views[i].height_m);
        mem_free(d->views[i].kept);
    }
    mem_free(d->views);
    mem_free(d->use);
    mem_free(d->known);
    pairs_free(&d->pairs);
}

/* ---- pictures ---- */

static enum err_code depths_grey(const struct image *img, uint8_t **out, struct err *e)
{
    size_t n = (size_t)img->width_px * img->height_px;
    uint8_t *grey = mem_array(n, sizeof *grey);
    *out = grey;
    if (!grey)
        return err_set(e, ERR_MEM, "stereo: out of memory for %u x %u px", img->width_px,
                       img->height_px);
    for (size_t i = 0; i < n; i++) {
        const uint8_t *p = img->px + 3 * i;
        grey[i] = (uint8_t)(0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2] + 0.5);
    }
    return ERR_OK;
}

static enum err_code depths_read(void *user, size_t i, struct err *e)
{
    struct depths *d = user;
    const struct scene_image *im = &d->scene->images[i];
    struct depths_view *v = &d->views[i];
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct image full = {0};
    if (!d->use[i])
        return ERR_OK;
    enum err_code rc = file_join(dir, d->scene->dir, "images", e);
    if (!rc)
        rc = file_join(path, dir, im->name, e);
    if (!rc)
        rc = image_read(path, NULL, &full, e);
    if (!rc && (full.width_px != im->cam.width_px || full.height_px != im->cam.height_px))
        rc = err_set(e, ERR_DATA,
                     "%s: %u x %u pixels, the scene says %u x %u: ingest the scene again", path,
                     full.width_px, full.height_px, im->cam.width_px, im->cam.height_px);
    if (!rc)
        rc = image_resize(&full, v->cam.width_px, v->cam.height_px, &v->rgb, e);
    if (!rc)
        rc = depths_grey(&v->rgb, &v->grey, e);
    image_free(&full);
    return rc;
}

/* ---- a sweep ---- */

/* Point at which the ray through (x, y) px has the height, and its depth. False: it does not look
 * down enough. */
static bool depths_point(const struct camera *c, double x, double y, double z_m, double out[3],
                         double *depth_m)
{
    double eye[3], ray[3];
    camera_center(c, eye);
    camera_ray(c, x, y, ray);
    if (!(ray[2] < -SWEEP_DOWN))
        return false;
    *depth_m = (z_m - eye[2]) / ray[2];
    for (int k = 0; k < 3; k++)
        out[k] = eye[k] + *depth_m * ray[k];
    return *depth_m > 0.0;
}

/* What is swept for view i; false: it has no neighbours, or does not look down. */
static bool depths_input(const struct depths *d, size_t i, struct sweep_input *in)
{
    const struct depths_view *v = &d->views[i];
    *in = (struct sweep_input){.ref = {v->cam, v->grey}, .walls = true};
    for (size_t k = 0; k < d->pairs.n_swept[i]; k++) {
        const struct depths_view *other = &d->views[d->pairs.near[i][k]];
        in->near[in->n_near++] = (struct sweep_view){other->cam, other->grey};
    }
    return in->n_near && pairs_planes(&d->pairs, DEPTHS_MOVE_PX, in);
}

static enum err_code depths_sweep(struct depths *d, struct sweep *s, size_t i, float *score,
                                  struct err *e)
{
    struct depths_view *v = &d->views[i];
    struct sweep_input in;
    size_t n = (size_t)v->cam.width_px * v->cam.height_px;
    if (!depths_input(d, i, &in))
        return ERR_OK;
    v->height_m = mem_array(n, sizeof *v->height_m);
    v->sure = mem_array(n, 1);
    if (!v->height_m || !v->sure)
        return err_set(e, ERR_MEM, "stereo: out of memory for %zu px", n);
    v->step_m = in.step_m;
    enum err_code rc = sweep_run(s, &in, v->height_m, score, e);
    for (size_t p = 0; !rc && p < n; p++) {
        v->height_m[p] = (float)(in.low_m + in.step_m * (double)v->height_m[p]);
        v->sure[p] = (uint8_t)(255.0F * score[p]);
    }
    return rc;
}

/* ---- agreement ---- */

/* Height at which the others agree with the height of pixel p of view i; NaN: too few do. A map
 * with another surface in front says nothing. One that sees lower ground through the place speaks
 * against it (Merrell et al. 2007). */
static double depths_agreed(const struct depths *d, size_t i, size_t p)
{
    const struct depths_view *v = &d->views[i];
    double x = (double)(p % v->cam.width_px) + 0.5, y = (double)(p / v->cam.width_px) + 0.5;
    double z = (double)v->height_m[p], at[3], depth, sum = z;
    size_t n = 0, through = 0;
    if (!depths_point(&v->cam, x, y, z, at, &depth))
        return (double)NAN;
    for (size_t k = 0; k < d->pairs.n_near[i]; k++) {
        const struct depths_view *o = &d->views[d->pairs.near[i][k]];
        double px[2];
        if (!o->height_m || !camera_project(&o->cam, at, 0.0, px, NULL) || px[0] < 0.0 ||
            px[1] < 0.0 || px[0] >= o->cam.width_px || px[1] >= o->cam.height_px)
            continue;
        double other = (double)o->height_m[(size_t)px[1] * o->cam.width_px + (size_t)px[0]];
        double most = DEPTHS_TOLERANCE * fmax(v->step_m, o->step_m);
        if (fabs(other - z) <= most) {
            sum += other;
            n++;
        } else
            through += other < z;
    }
    bool one = n && !through && v->sure[p] >= 255.0 * d->cfg->sure;
    return n >= DEPTHS_AGREE || one ? sum / (double)(n + 1) : (double)NAN;
}

/* Writes 1 for the pixels behind an edge: deeper than one beside them by DEPTHS_JUMP footprints. */
static void depths_behind(const struct depths_view *v, uint8_t *out)
{
    size_t w = v->cam.width_px, h = v->cam.height_px;
    const ptrdiff_t beside[4] = {-1, 1, -(ptrdiff_t)w, (ptrdiff_t)w};
    for (size_t at = 0; at < w * h; at++) {
        size_t x = at % w, y = at / w;
        const bool is_there[4] = {x > 0, x + 1 < w, y > 0, y + 1 < h};
        double own, other, point[3];
        if (!depths_point(&v->cam, (double)x + 0.5, (double)y + 0.5, (double)v->height_m[at], point,
                          &own))
            continue;
        for (int k = 0; k < 4; k++) {
            size_t to = at + (size_t)beside[k];
            if (is_there[k] && depths_point(&v->cam, (double)(to % w) + 0.5, (double)(to / w) + 0.5,
                                            (double)v->height_m[to], point, &other))
                out[at] |= own - other > DEPTHS_JUMP * own / v->cam.fx_px;
        }
    }
}

/* Whether the window of a pixel reaches over an edge to lower ground. Windows make what stands in
 * front wider by their radius, in all views alike, so that views agree on it. Down a wall heights
 * fall without an edge. */
static bool depths_overhangs(const struct depths *d, size_t i, size_t at, const uint8_t *behind)
{
    const struct depths_view *v = &d->views[i];
    int w = (int)v->cam.width_px, h = (int)v->cam.height_px, x = (int)(at % (size_t)w),
        y = (int)(at / (size_t)w);
    float least = v->height_m[at] - (float)(d->cfg->edge * v->step_m);
    for (int j = y - SWEEP_RADIUS; j <= y + SWEEP_RADIUS; j++)
        for (int k = x - SWEEP_RADIUS; k <= x + SWEEP_RADIUS; k++)
            if (j >= 0 && k >= 0 && j < h && k < w && behind[j * w + k] &&
                v->height_m[j * w + k] < least)
                return true;
    return false;
}

static enum err_code depths_write(void *user, size_t i, struct err *e)
{
    struct depths *d = user;
    struct depths_view *v = &d->views[i];
    size_t shape[2] = {v->cam.height_px, v->cam.width_px}, n = shape[0] * shape[1];
    char path[FILE_PATH_MAX], name[FILE_PATH_MAX];
    if (!v->height_m)
        return ERR_OK;
    float *inverse = mem_array(n, sizeof *inverse);
    uint8_t *behind = mem_array(n, 1);
    if (!inverse || !behind) {
        mem_free(inverse);
        mem_free(behind);
        return err_set(e, ERR_MEM, "stereo: out of memory for %zu px", n);
    }
    depths_behind(v, behind);
    for (size_t p = 0; p < n; p++) {
        double x = (double)(p % shape[1]) + 0.5, y = (double)(p / shape[1]) + 0.5, at[3], depth;
        double z = depths_agreed(d, i, p);
        bool good = isfinite(z) && !depths_overhangs(d, i, p, behind) &&
                    depths_point(&v->cam, x, y, z, at, &depth);
        inverse[p] = good ? (float)(1.0 / depth) : NAN;
        d->known[i] += good;
    }
    mem_free(behind);
    mem_free(v->kept);
    v->kept = inverse;
    int k = snprintf(name, sizeof name, "%s.npy", d->scene->images[i].name);
    enum err_code rc = k > 0 && (size_t)k < sizeof name
                           ? file_join(path, d->dir->part, name, e)
                           : err_set(e, ERR_LIMIT, "stereo: a name is too long");
    return rc ? rc : npy_write(path, inverse, 2, shape, e);
}

/* ---- points ---- */

/* Every step-th pixel of every step-th row that is known. out NULL: counts. */
static size_t depths_samples(const struct depths *d, size_t step, struct fuse_sample *out,
                             double *footprint_m)
{
    size_t n = 0;
    double sum = 0.0;
    for (size_t i = 0; i < d->scene->n_images; i++) {
        const struct depths_view *v = &d->views[i];
        const struct camera *c = &v->cam;
        for (size_t y = 0; v->kept && y < c->height_px; y += step)
            for (size_t x = 0; x < c->width_px; x += step) {
                size_t at = y * c->width_px + x;
                double depth = 1.0 / (double)v->kept[at], eye[3];
                if (!isfinite(depth))
                    continue;
                double a = depth * ((double)x + 0.5 - c->cx_px) / c->fx_px,
                       b = depth * ((double)y + 0.5 - c->cy_px) / c->fy_px;
                camera_center(c, eye);
                sum += depth / c->fx_px;
                for (int k = 0; out && k < 3; k++) {
                    out[n].enu_m[k] =
                        (float)(eye[k] + c->rot[k] * a + c->rot[3 + k] * b + c->rot[6 + k] * depth);
                    out[n].rgb[k] = v->rgb.px[3 * at + (size_t)k];
                }
                n++;
            }
    }
    *footprint_m = n ? sum / (double)n : 0.0;
    return n;
}

static enum err_code depths_points(const struct depths *d, struct depths_result *out, struct err *e)
{
    double footprint_m;
    size_t step = 2, n = depths_samples(d, step, NULL, &footprint_m);
    while (n > DEPTHS_SAMPLES_MAX)
        n = depths_samples(d, ++step, NULL, &footprint_m);
    struct fuse_sample *samples = mem_array(n + 1, sizeof *samples);
    float *points = NULL;
    char path[FILE_PATH_MAX];
    if (!samples)
        return err_set(e, ERR_MEM, "stereo: out of memory for %zu samples", n);
    (void)depths_samples(d, step, samples, &footprint_m);
    enum err_code rc = fuse_samples(samples, n, fmax(DEPTHS_SPACING_PX * footprint_m, 1e-6),
                                    &points, &out->points, e);
    const size_t shape[2] = {out->points, FUSE_COLUMNS};
    if (!rc)
        rc = file_join(path, d->dir->part, "points.npy", e);
    if (!rc)
        rc = npy_write(path, points, 2, shape, e);
    mem_free(points);
    mem_free(samples);
    return rc;
}

/* ---- all ---- */

static struct camera depths_camera(const struct depths *d, size_t i)
{
    const struct camera *c = &d->scene->images[i].cam;
    const double f = fmin(1.0, d->cfg->max_edge_px / fmax(c->width_px, c->height_px));
    return camera_resize(c, (uint32_t)fmax(floor(c->width_px * f + 0.5), 1.0),
                         (uint32_t)fmax(floor(c->height_px * f + 0.5), 1.0));
}

/* Who is compared with whom. */
static enum err_code depths_open(struct depths *d, struct err *e)
{
    const struct scene *s = d->scene;
    d->views = mem_array(s->n_images, sizeof *d->views);
    d->use = mem_array(s->n_images, 1);
    d->known = mem_array(s->n_images, sizeof *d->known);
    if (!d->views || !d->use || !d->known)
        return err_set(e, ERR_MEM, "stereo: out of memory for %zu photographs", s->n_images);
    for (size_t i = 0; i < s->n_images; i++) {
        d->use[i] = !d->cfg->test_split || s->images[i].split == SCENE_TRAIN;
        d->views[i].cam = depths_camera(d, i);
    }
    return pairs_find(s, d->use, DEPTHS_NEAR, &d->pairs, e);
}

enum err_code depths_possible(const struct scene *s, bool *out, struct err *e)
{
    const struct depths_config cfg = {.max_edge_px = UINT32_MAX, .test_split = true};
    struct depths d = {.scene = s, .cfg = &cfg};
    struct sweep_input in;
    *out = false;
    enum err_code rc = s->n_points && s->n_tracks ? depths_open(&d, e) : ERR_OK;
    for (size_t i = 0; !rc && d.pairs.n_near && !*out && i < s->n_images; i++)
        *out = d.use[i] && depths_input(&d, i, &in);
    depths_close(&d);
    return rc;
}

static enum err_code depths_sweeps(struct depths *d, struct dev *dev, struct depths_result *out,
                                   struct err *e)
{
    struct sweep *s = NULL;
    struct progress progress;
    struct sweep_input in;
    size_t most = 0;
    uint32_t planes = 2;
    for (size_t i = 0; i < d->scene->n_images; i++) {
        size_t n = (size_t)d->views[i].cam.width_px * d->views[i].cam.height_px;
        most = n > most ? n : most;
        if (depths_input(d, i, &in) && in.planes > planes)
            planes = in.planes;
    }
    float *score = mem_array(most, sizeof *score);
    enum err_code rc =
        score ? ERR_OK : err_set(e, ERR_MEM, "stereo: out of memory for %zu px", most);
    if (!rc)
        rc = sweep_open(dev, planes, &s, e);
    progress_start(&progress, "stereo", d->scene->n_images);
    for (size_t i = 0; !rc && i < d->scene->n_images; i++) {
        if (signals_stopping())
            rc = err_set(e, ERR_CANCEL, "stereo: stopped; nothing was written");
        else if (d->use[i])
            rc = depths_sweep(d, s, i, score, e);
        out->photographs += d->use[i];
        out->maps += d->views[i].height_m != NULL;
        progress_step(&progress, i + 1, "");
    }
    progress_end(&progress, NULL);
    sweep_close(&s);
    mem_free(score);
    if (!rc && !out->photographs)
        rc = err_set(e, ERR_DATA,
                     "%s: all photographs are kept for scores: --no-test-split takes them too",
                     d->scene->dir);
    if (!rc && !out->maps)
        rc = err_set(e, ERR_DATA, "%s: no photograph has a neighbour that shares %d points",
                     d->scene->dir, PAIRS_SHARED_MIN);
    return rc;
}

static enum err_code depths_tell(const struct depths *d, struct depths_result *out, struct err *e)
{
    char path[FILE_PATH_MAX];
    for (size_t i = 0; i < d->scene->n_images; i++) {
        const struct depths_view *v = &d->views[i];
        out->pixels += v->height_m ? (uint64_t)v->cam.width_px * v->cam.height_px : 0;
        out->known += d->known[i];
    }
    enum err_code rc = file_join(path, d->dir->part, "depths.json", e);
    if (rc)
        return rc;
    json_t *j =
        json_pack("{s:s, s:I, s:I, s:I, s:I, s:i, s:i, s:i, s:f, s:f}", "depth", "inverse, 1/m",
                  "photographs", (json_int_t)out->photographs, "maps", (json_int_t)out->maps,
                  "pixels", (json_int_t)out->pixels, "known", (json_int_t)out->known, "max_edge_px",
                  (int)d->cfg->max_edge_px, "neighbours", DEPTHS_NEAR, "agree", DEPTHS_AGREE,
                  "tolerance", DEPTHS_TOLERANCE, "sure", d->cfg->sure);
    rc = j ? jsonc_write(path, j, e) : err_set(e, ERR_MEM, "%s: out of memory", path);
    json_decref(j);
    return rc;
}

enum err_code depths_make(struct dev *dev, const struct scene *s, const struct depths_config *cfg,
                          const char *dir, struct depths_result *out, struct err *e)
{
    struct outdir part = {0};
    struct depths d = {.scene = s, .cfg = cfg, .dir = &part};
    double start_s = clock_s();
    *out = (struct depths_result){0};
    enum err_code rc = outdir_begin(dir, "depths.json", cfg->overwrite, &part, e);
    if (!rc)
        rc = depths_open(&d, e);
    if (!rc)
        rc = pool_for(s->n_images, 0, depths_read, &d, e);
    if (!rc)
        rc = depths_sweeps(&d, dev, out, e);
    if (!rc)
        rc = pool_for(s->n_images, 0, depths_write, &d, e);
    if (!rc)
        rc = depths_points(&d, out, e);
    if (!rc)
        rc = depths_tell(&d, out, e);
    if (!rc)
        rc = outdir_commit(&part, e);
    outdir_abort(&part);
    depths_close(&d);
    out->seconds = clock_s() - start_s;
    return rc;
}
