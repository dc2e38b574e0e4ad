/* Residuals of single photographs, ranked by robust z-scores.
 *
 * Median and MAD replace mean and standard deviation, because a few bad photographs must not widen
 * the scale that measures them. There are two columns for two kinds of failure. A wrong pose ruins
 * structure (SSIM), also on ground with little contrast. A wrong exposure ruins colours (squared
 * error, as a logarithm, whose spread over photographs is nearly even).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/photographs/residual.h"
#include "core/math/sort.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "core/splat/camera.h"
#include "scene/cells/footprint.h"
#include "train/photographs/photo_loader.h"

#define RESIDUAL_NORMAL 0.6745 /* MAD of a normal distribution of deviation 1 */
#define RESIDUAL_MSE_MIN 1e-10 /* far below what 8 bits resolve: keeps the logarithm finite */
#define RESIDUAL_MAD_MIN 1e-3
enum {
    RESIDUAL_FIRST = 64,
    RESIDUAL_ALIKE_LEAST = 16, /* photographs of like coverage that one is compared with */
    RESIDUAL_ALIKE_MOST = 200,
    RESIDUAL_PLACES = 12 /* of a picture, a side */
};

enum err_code residual_add(struct residual_list *l, const char *name, double mse, double ssim,
                           double coverage, struct err *e)
{
    struct residual *rows = mem_room(l->rows, l->n, &l->cap, RESIDUAL_FIRST, sizeof *rows);
    if (!rows)
        return err_set(e, ERR_MEM, "residuals: out of memory for %zu photographs", l->n + 1);
    l->rows = rows;
    l->rows[l->n++] =
        (struct residual){.name = name, .mse = mse, .ssim = ssim, .coverage = coverage};
    return ERR_OK;
}

double residual_coverage(const struct footprint *ground, const struct camera *cam)
{
    double from[3], ray[3], sum = 0.0;
    if (!ground || !ground->nx)
        return 0.0;
    camera_center(cam, from);
    for (int k = 0; k < RESIDUAL_PLACES * RESIDUAL_PLACES; k++) {
        footprint_ray(cam, (k % RESIDUAL_PLACES + 0.5) / RESIDUAL_PLACES * cam->width_px,
                      (double)(k / RESIDUAL_PLACES) / RESIDUAL_PLACES * cam->height_px, ray);
        ptrdiff_t cell = footprint_meets(ground, from, ray);
        sum += cell < 0 ? 0.0 : log2(1.0 + ground->views[cell]);
    }
    return sum / (RESIDUAL_PLACES * RESIDUAL_PLACES);
}

/* Pixels for a used one. */
static double residual_share(const struct photo *p)
{
    size_t n = (size_t)p->cam.width_px * p->cam.height_px, used = 0;
    for (size_t i = 0; p->mask && i < n; i++)
        used += p->mask[i] != 0;
    return used ? (double)n / (double)used : 1.0;
}

double residual_ssim(const struct photo *p, double ssim)
{
    return 1.0 - (1.0 - ssim) * residual_share(p);
}

double residual_mse(const struct photo *p, double mse)
{
    return mse * residual_share(p);
}

void residual_clear(struct residual_list *l)
{
    l->n = l->n_suspicious = 0;
}

void residual_free(struct residual_list *l)
{
    mem_free(l->rows);
    *l = (struct residual_list){0};
}

/* ---- z-scores ---- */

void residual_z(const double *x, size_t n, double least, double *scratch, double *z)
{
    if (!n)
        return;
    memcpy(scratch, x, n * sizeof *x);
    double median = sort_median(scratch, n);
    for (size_t i = 0; i < n; i++)
        scratch[i] = fabs(x[i] - median);
    double mad = fmax(sort_median(scratch, n), least);
    for (size_t i = 0; i < n; i++)
        z[i] = RESIDUAL_NORMAL * (x[i] - median) / mad;
}

static int residual_by_z(const void *a, const void *b)
{
    const struct residual *x = a, *y = b;
    int order = (x->z < y->z) - (x->z > y->z);
    return order ? order : strcmp(x->name, y->name);
}

static int residual_by_coverage(const void *a, const void *b)
{
    const struct residual *x = a, *y = b;
    int order = (x->coverage > y->coverage) - (x->coverage < y->coverage);
    return order ? order : strcmp(x->name, y->name);
}

/* z of every x among those around it; x is in order of coverage. scratch: 2 n. */
static void residual_z_alike(const struct residual_list *l, const double *x, double *scratch,
                             double *z)
{
    size_t n = l->n, alike = n / 3;
    alike = alike > RESIDUAL_ALIKE_MOST ? RESIDUAL_ALIKE_MOST : alike;
    alike = alike < RESIDUAL_ALIKE_LEAST ? RESIDUAL_ALIKE_LEAST : alike;
    bool known = n > alike && l->rows[0].coverage < l->rows[n - 1].coverage;
    if (!known)
        residual_z(x, n, RESIDUAL_MAD_MIN, scratch, z);
    for (size_t i = 0; known && i < n; i++) {
        size_t from = i < alike / 2 ? 0 : i - alike / 2;
        from = from + alike > n ? n - alike : from;
        residual_z(x + from, alike, RESIDUAL_MAD_MIN, scratch, scratch + n);
        z[i] = scratch[n + i - from];
    }
}

enum err_code residual_rank(struct residual_list *l, struct err *e)
{
    size_t n = l->n;
    double *x = mem_array(4 * n, sizeof *x);
    if (!x)
        return err_set(e, ERR_MEM, "residuals: out of memory for %zu photographs", n);
    double *z = x + n, *scratch = z + n;
    if (n)
        qsort(l->rows, n, sizeof *l->rows, residual_by_coverage);
    for (size_t i = 0; i < n; i++)
        x[i] = log(fmax(l->rows[i].mse, RESIDUAL_MSE_MIN));
    residual_z_alike(l, x, scratch, z);
    for (size_t i = 0; i < n; i++) {
        l->rows[i].z_mse = z[i];
        x[i] = 1.0 - l->rows[i].ssim;
    }
    residual_z_alike(l, x, scratch, z);
    l->n_suspicious = 0;
    for (size_t i = 0; i < n; i++) {
        struct residual *r = &l->rows[i];
        r->z_ssim = z[i];
        r->z = fmax(r->z_mse, r->z_ssim);
        l->n_suspicious += r->z > RESIDUAL_LIMIT;
    }
    if (n)
        qsort(l->rows, n, sizeof *l->rows, residual_by_z);
    mem_free(x);
    return ERR_OK;
}

/* ---- the file ---- */

enum err_code residual_write(const struct residual_list *l, const char *path, const char *what,
                             struct err *e)
{
    json_t *rows = json_array();
    bool ok = rows != NULL;
    for (size_t i = 0; ok && i < l->n; i++) {
        const struct residual *r = &l->rows[i];
        ok = !json_array_append_new(
            rows, json_pack("{s:s, s:o, s:f, s:f, s:f, s:b}", "name", r->name, "psnr_db",
                            jsonc_real(-10.0 * log10(r->mse)), "ssim", r->ssim, "z_mse", r->z_mse,
                            "z_ssim", r->z_ssim, "suspicious", (int)(r->z > RESIDUAL_LIMIT)));
    }
    json_t *o = ok ? json_pack("{s:s, s:f, s:I, s:O}", "what", what, "limit", RESIDUAL_LIMIT,
                               "suspicious", (json_int_t)l->n_suspicious, "photographs", rows)
                   : NULL;
    enum err_code rc = o ? jsonc_write(path, o, e) : err_set(e, ERR_MEM, "%s: out of memory", path);
    json_decref(rows);
    json_decref(o);
    return rc;
}
