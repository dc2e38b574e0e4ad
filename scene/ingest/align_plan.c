/* Looking at a folder before alignment: see align_plan.h.
 *
 * Blur is told by the variance of the Laplacian over that of the picture (Pech-Pacheco 2000), in
 * pictures shrunk to 800 px, against the median of the folder: what is shown is alike, so that a
 * photograph with a fifth of the median is blurred rather than of something smooth. Flights lie
 * apart where no chain of photographs leads from one to the other with steps of ten times the
 * usual distance. Overlap comes from the distance of neighbours and from the ground that a
 * photograph covers.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/align_plan.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "codec/image/exif_camera.h"
#include "codec/image/image.h"
#include "codec/limits.h"
#include "core/geo/geo.h"
#include "core/math/sort.h"
#include "core/pool.h"
#include "scene/ingest/ingest_internal.h"

enum { PLAN_EDGE_PX = 800, PLAN_ALL_PAIRS = 80, PLAN_FEW = 3, PLAN_NO_GPS = 3 };
static const double blur_share = 0.2, cluster_steps = 10, cluster_least_m = 100;
static const double film_mm = 36; /* width of the film that focal lengths are told for */

struct plan_read {
    struct align_plan *p;
    const char *dir;
    atomic_size_t done;
};

void align_plan_free(struct align_plan *p)
{
    for (size_t i = 0; i < p->n; i++)
        mem_free(p->photos[i].fault);
    mem_free(p->pairs);
    arena_free(&p->arena);
    *p = (struct align_plan){0};
}

static enum err_code plan_no_memory(struct err *e)
{
    return err_set(e, ERR_MEM, "align: out of memory");
}

bool align_plan_usable(const struct align_photo *p)
{
    return !p->fault && p->copy_of == SIZE_MAX;
}

/* ---- one photograph ---- */

static double plan_sharpness(const struct image *in)
{
    double sum = 0, square = 0, fine = 0, n = 0;
    size_t w = in->width_px, h = in->height_px;
    for (size_t y = 1; y + 1 < h; y++)
        for (size_t x = 1; x + 1 < w; x++) {
            const uint8_t *g = in->px + 3 * (y * w + x) + 1; /* green is most of what is seen */
            double l = 4.0 * g[0] - g[3] - *(g - 3) - g[3 * w] - *(g - 3 * w);
            sum += g[0];
            square += (double)g[0] * g[0];
            fine += l * l;
            n++;
        }
    double contrast = n > 0 ? square / n - sum * sum / (n * n) : 0;
    return contrast > 0 ? fine / n / contrast : 0;
}

static enum err_code plan_pixels(const char *path, struct align_photo *p, struct err *e)
{
    struct codec_limits lim = {0};
    struct image full = {0}, small = {0};
    enum err_code rc = image_read(path, &lim, &full, e);
    double shrink = rc ? 1 : fmin(1, (double)PLAN_EDGE_PX / fmax(full.width_px, full.height_px));
    if (!rc)
        rc = image_resize(&full, (uint32_t)fmax(1, full.width_px * shrink + 0.5),
                          (uint32_t)fmax(1, full.height_px * shrink + 0.5), &small, e);
    if (!rc)
        p->sharp = plan_sharpness(&small);
    image_free(&full);
    image_free(&small);
    return rc;
}

static enum err_code plan_photo(const char *path, struct align_photo *p, struct image_gps *gps,
                                struct err *e)
{
    struct drone_meta drone;
    struct exif_camera camera;
    struct buf b = {0};
    enum err_code rc = image_read_info(path, &p->width_px, &p->height_px, gps, &drone, e);
    if (!rc)
        rc = exif_camera_read(path, &camera, e);
    if (!rc)
        rc = file_read(path, 0, &b, e);
    if (!rc) {
        p->hash = hash_bytes(b.data, b.size);
        snprintf(p->camera, sizeof p->camera, "%s", camera.model);
        p->focal_mm = camera.focal_mm;
        p->focal_px = camera.focal_35mm / film_mm * fmax(p->width_px, p->height_px);
        p->height_m = drone.has_relative ? drone.relative_m : (double)NAN;
        rc = plan_pixels(path, p, e);
    }
    buf_free(&b);
    return rc;
}

static enum err_code plan_photo_task(void *user, size_t i, struct err *e)
{
    struct plan_read *r = user;
    struct align_photo *p = &r->p->photos[i];
    struct image_gps gps = {0};
    char path[FILE_PATH_MAX];
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    enum err_code rc = file_join(path, r->dir, p->name, e);
    if (!rc)
        rc = plan_photo(path, p, &gps, e);
    /* Also one that is too large to decode, that we may not read, or whose link leads nowhere. */
    if (rc == ERR_FORMAT || rc == ERR_LIMIT || rc == ERR_NOENT || rc == ERR_IO) {
        p->fault = mem_text(e ? e->msg : "cannot be read");
        if (e)
            *e = (struct err){0};
        return p->fault ? ERR_OK : plan_no_memory(e);
    }
    p->time_s = positions_time(gps.time);
    p->has_gps = !rc && gps.has_position && (gps.lat_deg != 0 || gps.lon_deg != 0);
    p->at_m[0] = gps.lon_deg;
    p->at_m[1] = gps.lat_deg;
    return rc;
}

/* ---- the folder ---- */

static int plan_hash_compare(const void *a, const void *b)
{
    const struct align_photo *const *p = a, *const *q = b;
    if ((*p)->hash.hi != (*q)->hash.hi)
        return (*p)->hash.hi < (*q)->hash.hi ? -1 : 1;
    if ((*p)->hash.lo != (*q)->hash.lo)
        return (*p)->hash.lo < (*q)->hash.lo ? -1 : 1;
    return (*p > *q) - (*p < *q);
}

static void plan_copies(struct align_plan *p, struct align_photo **sorted)
{
    size_t n = 0;
    for (size_t i = 0; i < p->n; i++) {
        p->photos[i].copy_of = SIZE_MAX;
        if (!p->photos[i].fault)
            sorted[n++] = &p->photos[i];
    }
    qsort(sorted, n, sizeof *sorted, plan_hash_compare);
    for (size_t k = 1; k < n; k++) {
        const struct align_photo *before = sorted[k - 1];
        if (sorted[k]->hash.hi != before->hash.hi || sorted[k]->hash.lo != before->hash.lo)
            continue;
        sorted[k]->copy_of =
            before->copy_of == SIZE_MAX ? (size_t)(before - p->photos) : before->copy_of;
        p->n_copies++;
    }
}

/* Degrees to metres about the first photograph: a plane will do over a survey. */
static void plan_places(struct align_plan *p)
{
    const struct align_photo *first = NULL;
    double lon0 = 0, lat0 = 0;
    for (size_t i = 0; i < p->n; i++) {
        struct align_photo *f = &p->photos[i];
        if (!f->has_gps)
            continue;
        if (!first) {
            first = f;
            lon0 = f->at_m[0];
            lat0 = f->at_m[1];
        }
        f->at_m[0] = remainder(f->at_m[0] - lon0, 360) * 111320 * cos(lat0 / 57.29577951308232);
        f->at_m[1] = (f->at_m[1] - lat0) * 111320;
        p->n_gps += align_plan_usable(f);
    }
}

/* One camera, lens, focal length and size; what says nothing of it is one group a size. */
static void plan_groups(struct align_plan *p)
{
    for (size_t i = 0; i < p->n; i++) {
        struct align_photo *f = &p->photos[i];
        f->group = SIZE_MAX;
        for (size_t k = 0; k < i && f->group == SIZE_MAX && align_plan_usable(f); k++) {
            const struct align_photo *g = &p->photos[k];
            if (g->group != SIZE_MAX && g->width_px == f->width_px &&
                g->height_px == f->height_px && !strcmp(g->camera, f->camera) &&
                fabs(g->focal_mm - f->focal_mm) < 0.01)
                f->group = g->group;
        }
        if (f->group == SIZE_MAX && align_plan_usable(f))
            f->group = p->n_groups++;
    }
}

static double plan_apart(const struct align_photo *a, const struct align_photo *b)
{
    return hypot(a->at_m[0] - b->at_m[0], a->at_m[1] - b->at_m[1]);
}

static bool plan_has_place(const struct align_photo *f)
{
    return f->has_gps && align_plan_usable(f);
}

/* Median distance of a photograph from the nearest other. */
static double plan_step(const struct align_plan *p, double *scratch)
{
    size_t n = 0;
    for (size_t i = 0; i < p->n; i++) {
        double least = HUGE_VAL;
        for (size_t k = 0; k < p->n && plan_has_place(&p->photos[i]); k++)
            if (k != i && plan_has_place(&p->photos[k]))
                least = fmin(least, plan_apart(&p->photos[i], &p->photos[k]));
        if (isfinite(least))
            scratch[n++] = least;
    }
    return sort_median(scratch, n);
}

/* Number those that a chain of steps joins, the largest first. */
static void plan_clusters(struct align_plan *p, double step_m, size_t *stack, size_t *size)
{
    double most = fmax(cluster_least_m, cluster_steps * step_m);
    for (size_t i = 0; i < p->n; i++)
        p->photos[i].cluster = SIZE_MAX;
    for (size_t i = 0; i < p->n; i++) {
        size_t n = 0;
        if (!plan_has_place(&p->photos[i]) || p->photos[i].cluster != SIZE_MAX)
            continue;
        size[p->n_clusters] = 0;
        p->photos[i].cluster = p->n_clusters;
        for (stack[n++] = i; n;) {
            const struct align_photo *at = &p->photos[stack[--n]];
            size[p->n_clusters]++;
            for (size_t k = 0; k < p->n; k++) {
                struct align_photo *f = &p->photos[k];
                if (!plan_has_place(f) || f->cluster != SIZE_MAX || plan_apart(at, f) > most)
                    continue;
                f->cluster = p->n_clusters;
                stack[n++] = k;
            }
        }
        p->n_clusters++;
    }
    size_t first = 0;
    for (size_t c = 1; c < p->n_clusters; c++)
        first = size[c] > size[first] ? c : first;
    p->apart_m = p->n_clusters > 1 ? HUGE_VAL : 0;
    for (size_t i = 0; i < p->n; i++) {
        struct align_photo *f = &p->photos[i];
        f->cluster = f->cluster == first ? 0 : f->cluster == 0 ? first : f->cluster;
    }
    for (size_t i = 0; i < p->n; i++) /* how far the nearest other one is */
        for (size_t k = 0; k < p->n && p->photos[i].cluster == 0; k++)
            if (p->photos[k].cluster != 0 && p->photos[k].cluster != SIZE_MAX)
                p->apart_m = fmin(p->apart_m, plan_apart(&p->photos[i], &p->photos[k]));
}

/* Of a photograph's shorter side on the ground, what its neighbour shows as well. */
static void plan_overlap(struct align_plan *p, double step_m, double *scratch)
{
    size_t n = 0;
    for (size_t i = 0; i < p->n; i++) {
        const struct align_photo *f = &p->photos[i];
        if (plan_has_place(f) && f->focal_px > 0 && f->height_m > 1)
            scratch[n++] = f->height_m * fmin(f->width_px, f->height_px) / f->focal_px;
    }
    p->overlap =
        2 * n > p->n_usable && step_m > 0 ? 1 - step_m / sort_median(scratch, n) : (double)NAN;
}

static void plan_blur(struct align_plan *p, double *scratch)
{
    size_t n = 0;
    for (size_t i = 0; i < p->n; i++)
        if (align_plan_usable(&p->photos[i]))
            scratch[n++] = p->photos[i].sharp;
    double limit = blur_share * sort_median(scratch, n);
    for (size_t i = 0; i < p->n; i++) {
        p->photos[i].blurred = align_plan_usable(&p->photos[i]) && p->photos[i].sharp < limit;
        p->n_blurred += p->photos[i].blurred;
    }
}

static enum err_code plan_judge(struct align_plan *p, struct err *e)
{
    struct align_photo **sorted = mem_array(p->n, sizeof *sorted);
    double *scratch = mem_array(p->n, sizeof *scratch), pixels = 0;
    size_t *stack = mem_array(p->n, sizeof *stack), *size = mem_array(p->n, sizeof *size);
    bool room = sorted && scratch && stack && size;
    if (room) {
        plan_copies(p, sorted);
        for (size_t i = 0; i < p->n; i++) {
            const struct align_photo *f = &p->photos[i];
            p->n_broken += f->fault != NULL;
            p->n_usable += align_plan_usable(f);
            pixels += align_plan_usable(f) ? (double)f->width_px * f->height_px : 0;
        }
        p->megapixels = p->n_usable ? 1e-6 * pixels / (double)p->n_usable : 0;
        plan_places(p);
        plan_groups(p);
        double step_m = plan_step(p, scratch);
        plan_clusters(p, step_m, stack, size);
        plan_overlap(p, step_m, scratch);
        plan_blur(p, scratch);
    }
    mem_free(sorted);
    mem_free(scratch);
    mem_free(stack);
    mem_free(size);
    return room ? ERR_OK : plan_no_memory(e);
}

static int plan_order_compare(const void *a, const void *b)
{
    const struct align_photo *p = a, *q = b;
    const char *x = strrchr(p->name, '/'), *y = strrchr(q->name, '/');
    size_t n = x ? (size_t)(x - p->name) : 0, m = y ? (size_t)(y - q->name) : 0;
    int order = n != m ? strcmp(p->name, q->name) : strncmp(p->name, q->name, n);
    if (!order && isfinite(p->time_s) && isfinite(q->time_s) && p->time_s != q->time_s)
        order = p->time_s < q->time_s ? -1 : 1;
    return order ? order : strcmp(p->name, q->name);
}

static enum err_code plan_list(const char *dir, struct align_plan *p, struct err *e)
{
    struct ingest_files files;
    if (!file_is_dir(dir))
        return err_set(e, ERR_NOENT, "%s: no such folder of photographs", dir);
    enum err_code rc = ingest_files_list(dir, &files, e);
    if (!rc && !files.n)
        rc = err_set(e, ERR_NOENT, "%s: no photographs (.jpg, .png, .tif, .webp)", dir);
    if (!rc && !(p->photos = arena_get(&p->arena, files.n, sizeof *p->photos)))
        rc = plan_no_memory(e);
    for (size_t i = 0; !rc && i < files.n; i++) {
        p->photos[i] = (struct align_photo){.name = arena_text(&p->arena, files.names[i]),
                                            .height_m = (double)NAN,
                                            .time_s = (double)NAN,
                                            .copy_of = SIZE_MAX};
        p->n = i + 1;
        if (!p->photos[i].name)
            rc = plan_no_memory(e);
    }
    ingest_files_free(&files);
    return rc;
}

enum err_code align_plan_read(const char *dir, struct align_plan *out, struct err *e)
{
    struct align_plan p = {0};
    struct plan_read r = {.p = &p, .dir = dir};
    enum err_code rc = plan_list(dir, &p, e);
    if (!rc)
        rc = pool_for(p.n, 0, plan_photo_task, &r, e);
    if (!rc) {
        qsort(p.photos, p.n, sizeof *p.photos, plan_order_compare);
        for (size_t i = 0; i < p.n; i++) {
            const char *dot = strrchr(p.photos[i].name, '.');
            snprintf(p.photos[i].link, sizeof p.photos[i].link, "%06zu%.8s", i, dot ? dot : "");
        }
        rc = plan_judge(&p, e);
    }
    if (!rc && p.n_usable < PLAN_FEW)
        rc = err_set(e, ERR_DATA,
                     "%s: %zu of %zu photographs can be used (%zu cannot be read, %zu are copies): "
                     "three are needed at least",
                     dir, p.n_usable, p.n, p.n_broken, p.n_copies);
    if (rc)
        align_plan_free(&p);
    *out = p;
    return rc;
}

size_t align_plan_find(const struct align_plan *p, const char *link)
{
    size_t i = (size_t)strtoul(link, NULL, 10);
    return i < p->n && !strcmp(p->photos[i].link, link) ? i : SIZE_MAX;
}

/* ---- pairs ---- */

struct plan_pairs {
    struct align_pair *list;
    size_t n, cap;
};

static bool plan_add(struct plan_pairs *l, size_t a, size_t b)
{
    struct align_pair *list = mem_room(l->list, l->n, &l->cap, 1024, sizeof *list);
    if (!list)
        return false;
    l->list = list;
    l->list[l->n++] = (struct align_pair){(uint32_t)(a < b ? a : b), (uint32_t)(a < b ? b : a)};
    return true;
}

static int plan_pair_compare(const void *a, const void *b)
{
    const struct align_pair *p = a, *q = b;
    return p->a != q->a ? (p->a < q->a ? -1 : 1) : (p->b > q->b) - (p->b < q->b);
}

/* The nearest `most` by GPS. */
static bool plan_near(const struct align_plan *p, size_t i, size_t most, struct sort_item *scratch,
                      struct sort_item *spare, struct plan_pairs *l)
{
    size_t n = 0;
    for (size_t k = 0; k < p->n; k++)
        if (k != i && plan_has_place(&p->photos[k]))
            scratch[n++] = (struct sort_item){
                sort_key_float((float)plan_apart(&p->photos[i], &p->photos[k])), (uint32_t)k};
    sort_items(scratch, spare, n);
    for (size_t k = 0; k < n && k < most; k++)
        if (!plan_add(l, i, scratch[k].row))
            return false;
    return true;
}

enum err_code align_plan_pairs(struct align_plan *p, size_t neighbours, size_t next, struct err *e)
{
    struct plan_pairs l = {0};
    struct sort_item *scratch = mem_array(p->n, sizeof *scratch),
                     *spare = mem_array(p->n, sizeof *spare);
    uint32_t *order = mem_array(p->n, sizeof *order);
    size_t n = 0, left = 0;
    bool room = scratch && spare && order;
    for (size_t i = 0; room && i < p->n; i++)
        if (align_plan_usable(&p->photos[i]))
            order[n++] = (uint32_t)i;
    bool few_gps = 2 * p->n_gps < p->n_usable, all = few_gps && n <= PLAN_ALL_PAIRS;
    size_t far = all ? n : few_gps ? PLAN_NO_GPS * next : next;
    for (size_t i = 0; room && i < n; i++) {
        const struct align_photo *f = &p->photos[order[i]];
        for (size_t k = i + 1; room && k < n && k <= i + far; k++)
            room = plan_add(&l, order[i], order[k]);
        /* Without GPS also some far ahead, doubling, for flight lines side by side. */
        for (size_t d = 2 * far; room && few_gps && !all && i + d < n; d *= 2)
            room = plan_add(&l, order[i], order[i + d]);
        if (room && f->has_gps)
            room = plan_near(p, order[i], neighbours, scratch, spare, &l);
    }
    if (room && l.n)
        qsort(l.list, l.n, sizeof *l.list, plan_pair_compare);
    for (size_t k = 0; room && k < l.n; k++)
        if (!k || plan_pair_compare(&l.list[k], &l.list[k - 1]))
            l.list[left++] = l.list[k];
    mem_free(scratch);
    mem_free(spare);
    mem_free(order);
    mem_free(p->pairs);
    p->pairs = l.list;
    p->n_pairs = left;
    return room ? ERR_OK : plan_no_memory(e);
}

/* ---- a forecast ---- */

/* Core seconds of COLMAP 3.8 on a core of about 2.5 GHz: a megapixel of a photograph to read; one
 * of SIFT, and a feature; two pictures that are compared, by the square of thousands of features; a
 * photograph in the mapper, by thousands of features. */
static const double read_s = 0.1, megapixel_s = 0.35, feature_s = 0.0003, pair_s = 0.15,
                    pair_square_s = 0.055, model_s = 0.9, model_cores = 1.5, look_pairs = 0.4;
static const double pace_other = 4;
enum { FEATURES_A_MEGAPIXEL = 6000 };

struct align_forecast align_plan_forecast(const struct align_plan *p, uint32_t edge_px,
                                          uint32_t features, double slow)
{
    double longest = 1;
    for (size_t i = 0; i < p->n; i++)
        if (align_plan_usable(&p->photos[i]))
            longest = fmax(longest, fmax(p->photos[i].width_px, p->photos[i].height_px));
    double shrink = fmin(1, edge_px / longest), mp = p->megapixels * shrink * shrink,
           n = (double)p->n_usable, f = fmin(features, mp * FEATURES_A_MEGAPIXEL), k = f / 1000;
    return (struct align_forecast){
        .edge_px = edge_px,
        .features = features,
        .features_s = n * (p->megapixels * read_s + mp * megapixel_s + f * feature_s) * slow,
        .matches_s = (double)p->n_pairs * (pair_s + k * k * pair_square_s) * slow,
        .model_s = n * (0.2 + k) * model_s * slow};
}

double align_plan_look_s(const struct align_plan *p, double slow)
{
    struct align_forecast f = align_plan_forecast(p, 400, 1024, slow);
    return f.features_s + look_pairs * f.matches_s;
}

double align_plan_cpu_s(const struct align_forecast *f)
{
    return f->features_s + f->matches_s + f->model_s;
}

double align_plan_clock_s(const struct align_forecast *f, const struct align_pace *pace)
{
    double cores = (double)(pace->cores ? pace->cores : 1);
    return pace->load *
           ((f->features_s + f->matches_s) / cores + f->model_s / fmin(cores, model_cores));
}

struct align_pace align_plan_pace(const struct align_pace *measured)
{
    bool usual = measured->slow < pace_other && measured->slow > 1 / pace_other;
    return (struct align_pace){measured->cores, usual ? 1 : measured->slow, 1};
}

struct align_forecast align_plan_afford(const struct align_plan *p, uint32_t edge_px,
                                        uint32_t features, const struct align_pace *pace,
                                        double seconds)
{
    static const uint32_t choices[][2] = {{3200, ALIGN_PLAN_FEATURES_MOST},
                                          {3200, 6000},
                                          {2400, 4096},
                                          {2000, 4096},
                                          {1600, 4096},
                                          {1600, 3072},
                                          {1600, 2048},
                                          {1280, 1536},
                                          {1000, 1024}};
    const struct align_pace fixed = align_plan_pace(pace);
    struct align_forecast f = {0};
    for (size_t k = 0; k < sizeof choices / sizeof *choices; k++) {
        f = align_plan_forecast(p, edge_px ? edge_px : choices[k][0],
                                features ? features : choices[k][1], fixed.slow);
        if (align_plan_clock_s(&f, &fixed) <= seconds)
            break;
    }
    return align_plan_forecast(p, f.edge_px, f.features, pace->slow);
}
