/* The surface of a store as a height field: see surface.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/surface/surface.h"

#include <math.h>
#include <string.h>

#include "codec/container/seen.h"
#include "core/base.h"
#include "core/pool.h"

/* Lengths are in sizes of the usual Gaussian, but not of less than half a pixel: coarser Gaussians
 * are drawn where pixels are larger. What they were chosen for: docs/decisions/028-surface.md.
 */
static const double surface_least_sigma_px = 0.5;
static const double surface_reach = 1.15;      /* of the window */
static const double surface_agree = 3;         /* heights that differ by less are of one surface */
static const double surface_slant_px = 0.6;    /* pixels of slanted rays, at most */
static const double surface_kernel_px2 = 0.03; /* of drawing: that of colours widens roofs */
static const double surface_floor = 0.045;     /* of the uncertainty */
static const double surface_common = 0.115;    /* what all views are off by alike */
static const double surface_scatter = 0.85;    /* of what the window spreads */
static const double surface_step = 1.5;        /* what differs by more around a pixel is an edge */
static const double surface_edge_share = 0.33; /* of its height, beyond that, is uncertain */
/* Of a pixel at which so many of the five agree. */
static const double surface_few[NADIR_WAYS + 2] = {0, 1, 0.36, 0.08, 0, 0};
/* Of a place that so many photographs see, 0 to SEEN_VIEWS_MAX: docs/decisions/028-surface.md. */
static const double surface_seen[SEEN_VIEWS_MAX + 1] = {1.5,  0.8,  0.47, 0.38, 0.2,
                                                        0.15, 0.08, 0.06, 0};
static const float surface_color = 0.15f; /* standard deviation of colours that weigh alike */
static const float surface_least_weight = 1e-6f;
static const float surface_normal = 1.4826f; /* median absolute difference to standard deviation */

enum { SURFACE_FAR_MAX_PX = 32, SURFACE_WINDOW = 25, SURFACE_SLANT_MAX = 8, SURFACE_ROWS = 8 };

struct surface_window surface_window(double sigma_px)
{
    double far = floor(surface_reach * fmax(sigma_px, surface_least_sigma_px) + 0.5);
    struct surface_window w = {.far_px = (uint32_t)fmin(fmax(far, 1), SURFACE_FAR_MAX_PX)};
    w.near_px = (w.far_px + 1) / 2;
    return w;
}

/* Offsets of the window along an axis; returns how many. */
static size_t surface_offsets(struct surface_window w, int out[5])
{
    size_t n = 0;
    for (int k = -2; k <= 2; k++) {
        int at = (k < 0 ? -1 : 1) * (int)(k == 0 ? 0 : k == 1 || k == -1 ? w.near_px : w.far_px);
        if (!n || at != out[n - 1])
            out[n++] = at;
    }
    return n;
}

/* ---- five views ---- */

struct surface_job {
    struct nadir_piece piece; /* with its margin */
    uint32_t margin;
    double sigma_m; /* of the Gaussians that are drawn */
    struct surface_window window;
    float *rgb, *height, *slant[NADIR_WAYS], *smooth, *spread;
    uint8_t *agree; /* how many of the five */
    float *seen;    /* of the piece without its margin: photographs */
    void *room;
};

static size_t surface_pixels(const struct surface_job *j)
{
    return (size_t)j->piece.width * j->piece.height;
}

static void surface_plan(const struct nadir *n, const struct nadir_piece *p, struct surface_job *j)
{
    double px_per_m = sqrt(p->px_per_m_x * p->px_per_m_y),
           sigma_px = fmax(nadir_area(n)->sigma_m * px_per_m, surface_least_sigma_px);
    j->window = surface_window(sigma_px);
    j->sigma_m = sigma_px / px_per_m;
    /* A multiple of what a slanted pixel may be, so that those of pieces side by side agree. */
    j->margin = (j->window.far_px + j->window.near_px + SURFACE_SLANT_MAX - 1) / SURFACE_SLANT_MAX *
                SURFACE_SLANT_MAX;
    j->piece = *p;
    j->piece.kernel_px2 = surface_kernel_px2;
    j->piece.width += 2 * j->margin;
    j->piece.height += 2 * j->margin;
}

static enum err_code surface_room(struct surface_job *j, struct err *e)
{
    size_t n = surface_pixels(j), planes = 3 + 1 + NADIR_WAYS + 2;
    float *at = j->room = mem_array(n, planes * sizeof *at);
    j->agree = mem_array(n, 1);
    j->seen = mem_array(n, sizeof *j->seen);
    if (!at || !j->agree || !j->seen)
        return err_set(e, ERR_MEM, "out of memory for a surface of %u x %u px", j->piece.width,
                       j->piece.height);
    j->rgb = at;
    j->height = at + 3 * n;
    for (size_t k = 0; k < NADIR_WAYS; k++)
        j->slant[k] = at + (4 + k) * n;
    j->smooth = at + (4 + NADIR_WAYS) * n;
    j->spread = at + (5 + NADIR_WAYS) * n;
    return ERR_OK;
}

/* The median of what the straight and the slanted rays say, as far as they mean one surface. */
static void surface_fuse(struct surface_job *j)
{
    float most = (float)(surface_agree * j->sigma_m);
    for (size_t i = 0; i < surface_pixels(j); i++) {
        float at[NADIR_WAYS + 1] = {j->height[i]};
        size_t n = isfinite(at[0]) ? 1 : 0;
        for (size_t k = 0; n && k < NADIR_WAYS; k++) {
            float h = j->slant[k][i];
            if (!(fabsf(h - j->height[i]) <= most))
                continue;
            size_t to = n++;
            for (; to > 0 && at[to - 1] > h; to--)
                at[to] = at[to - 1];
            at[to] = h;
        }
        j->agree[i] = (uint8_t)n;
        if (n)
            j->height[i] = 0.5f * (at[(n - 1) / 2] + at[n / 2]);
    }
}

static enum err_code surface_see(struct nadir *n, struct surface_job *j, struct err *e)
{
    double px_per_m = sqrt(j->piece.px_per_m_x * j->piece.px_per_m_y);
    uint32_t coarse = 1;
    while (coarse < SURFACE_SLANT_MAX && 2 * coarse <= surface_slant_px * j->sigma_m * px_per_m)
        coarse *= 2;
    enum err_code rc = nadir_draw(n, &j->piece, j->rgb, j->height, e);
    for (unsigned k = 0; !rc && k < NADIR_WAYS; k++)
        rc = nadir_slant(n, &j->piece, k, coarse, j->height, j->slant[k], e);
    if (!rc)
        surface_fuse(j);
    return rc;
}

/* ---- medians over a window ---- */

struct surface_sample {
    float height, weight;
};

/* Where half of the weight lies; sorts. */
static float surface_median(struct surface_sample *s, size_t n)
{
    double total = 0, sum = 0;
    for (size_t i = 0; i < n; i++) {
        struct surface_sample at = s[i];
        size_t to = i;
        total += (double)at.weight;
        for (; to > 0 && s[to - 1].height > at.height; to--)
            s[to] = s[to - 1];
        s[to] = at;
    }
    size_t k = 0;
    while (k + 1 < n && (sum += (double)s[k].weight) < 0.5 * total)
        k++;
    return s[k].height;
}

struct surface_filter {
    const float *height, *rgb;
    uint32_t w, h;
    struct surface_window window;
    float *out, *spread;
};

/* Pixels around (x, y) that have a height, weighed by colour. */
static size_t surface_around(const struct surface_filter *f, const int *offset, size_t n,
                             uint32_t x, uint32_t y, struct surface_sample *out)
{
    const float *own = f->rgb + 3 * ((size_t)y * f->w + x);
    size_t found = 0;
    for (size_t r = 0; r < n; r++)
        for (size_t c = 0; c < n; c++) {
            int64_t u = (int64_t)x + offset[c], v = (int64_t)y + offset[r];
            if (u < 0 || v < 0 || u >= f->w || v >= f->h)
                continue;
            size_t at = (size_t)v * f->w + (size_t)u;
            float d = 0;
            if (!isfinite(f->height[at]))
                continue;
            for (size_t k = 0; k < 3; k++)
                d += (f->rgb[3 * at + k] - own[k]) * (f->rgb[3 * at + k] - own[k]);
            float like = isfinite(d) ? expf(-d / (6 * surface_color * surface_color)) : 0;
            out[found++] = (struct surface_sample){f->height[at], like + surface_least_weight};
        }
    return found;
}

static enum err_code surface_rows(void *user, size_t part, struct err *e)
{
    const struct surface_filter *f = user;
    struct surface_sample s[SURFACE_WINDOW];
    int offset[5];
    size_t n = surface_offsets(f->window, offset);
    (void)e;
    for (uint32_t y = (uint32_t)part * SURFACE_ROWS;
         y < f->h && y < ((uint32_t)part + 1) * SURFACE_ROWS; y++)
        for (uint32_t x = 0; x < f->w; x++) {
            size_t i = (size_t)y * f->w + x;
            f->out[i] = f->spread[i] = NAN;
            if (!isfinite(f->height[i]))
                continue;
            size_t found = surface_around(f, offset, n, x, y, s);
            float median = surface_median(s, found);
            for (size_t k = 0; k < found; k++)
                s[k].height = fabsf(s[k].height - median);
            f->out[i] = median;
            f->spread[i] = surface_normal * surface_median(s, found);
        }
    return ERR_OK;
}

enum err_code surface_smooth(const float *height_m, const float *rgb, uint32_t w, uint32_t h,
                             struct surface_window win, float *out, float *spread_m, struct err *e)
{
    struct surface_filter f = {height_m, rgb, w, h, win, out, spread_m};
    return pool_for((h + SURFACE_ROWS - 1) / SURFACE_ROWS, 0, surface_rows, &f, e);
}

/* ---- the uncertainty ---- */

/* How far heights around a pixel of the padded piece are apart: the height of a step. */
static float surface_range(const struct surface_job *j, size_t x, size_t y)
{
    /* Half as far as the window: an edge is off by no more. */
    const struct surface_window half = {(j->window.near_px + 1) / 2, j->window.near_px};
    int offset[5];
    size_t n = surface_offsets(half, offset);
    float lo = INFINITY, hi = -INFINITY;
    for (size_t r = 0; r < n; r++)
        for (size_t c = 0; c < n; c++) {
            float h = j->smooth[(size_t)((int64_t)y + offset[r]) * j->piece.width +
                                (size_t)((int64_t)x + offset[c])];
            lo = fminf(lo, h); /* takes no notice of NAN */
            hi = fmaxf(hi, h);
        }
    return hi - lo;
}

/* Of a place that this many photographs see. */
static double surface_unseen(double views)
{
    size_t low = (size_t)fmin(fmax(views, 0), SEEN_VIEWS_MAX - 1);
    double part = views - (double)low;
    return (1 - part) * surface_seen[low] + part * surface_seen[low + 1];
}

static void surface_tell(const struct surface_job *j, const struct nadir_piece *p,
                         const struct surface_maps *out)
{
    for (size_t y = 0; y < p->height; y++)
        for (size_t x = 0; x < p->width; x++) {
            size_t to = y * p->width + x, i = (y + j->margin) * j->piece.width + x + j->margin;
            if (out->height_m)
                out->height_m[to] = j->smooth[i];
            if (!out->sigma_m && !out->noise_m && !out->repeat_m)
                continue;
            double spread = surface_scatter * (double)j->spread[i],
                   few = surface_few[j->agree[i]] * j->sigma_m, least = surface_floor * j->sigma_m,
                   step = (double)surface_range(j, x + j->margin, y + j->margin) -
                          surface_step * j->sigma_m,
                   edge = surface_edge_share * fmax(step, 0), common = surface_common * j->sigma_m,
                   unseen = surface_unseen((double)j->seen[to]) * j->sigma_m,
                   noise2 = least * least + spread * spread + few * few + unseen * unseen;
            if (out->noise_m)
                out->noise_m[to] = (float)sqrt(noise2); /* NAN where spread is */
            if (out->sigma_m)
                out->sigma_m[to] = (float)sqrt(noise2 + common * common + edge * edge);
            if (out->repeat_m)
                out->repeat_m[to] = (float)sqrt(noise2 + edge * edge);
        }
}

/* Colours with the kernel that they were trained with, where there is a height. At the rim of a
 * surface this kernel may find none: then those of the narrow one. */
static enum err_code surface_colors(struct nadir *n, const struct surface_job *j,
                                    const struct nadir_piece *p, float *rgb, struct err *e)
{
    enum err_code rc = nadir_draw(n, p, rgb, NULL, e);
    for (size_t y = 0; !rc && y < p->height; y++)
        for (size_t x = 0; x < p->width; x++) {
            size_t i = (y + j->margin) * j->piece.width + x + j->margin;
            float *to = rgb + 3 * (y * p->width + x);
            for (size_t k = 0; k < 3; k++)
                to[k] = !isfinite(j->smooth[i]) ? NAN : isfinite(to[k]) ? to[k] : j->rgb[3 * i + k];
        }
    return rc;
}

enum err_code surface_draw(struct nadir *n, const struct nadir_piece *p,
                           const struct surface_maps *out, struct err *e)
{
    struct surface_job j = {0};
    if (p->width < 1 || p->height < 1 || p->width > NADIR_SIZE_MAX || p->height > NADIR_SIZE_MAX ||
        !(p->px_per_m_x > 0) || !(p->px_per_m_y > 0))
        return err_set(e, ERR_ARG, "a surface of %u x %u px: 1 to %d, of positive size", p->width,
                       p->height, NADIR_SIZE_MAX);
    surface_plan(n, p, &j);
    enum err_code rc = surface_room(&j, e);
    if (!rc)
        rc = surface_see(n, &j, e);
    if (!rc)
        rc = surface_smooth(j.height, j.rgb, j.piece.width, j.piece.height, j.window, j.smooth,
                            j.spread, e);
    if (!rc)
        rc = nadir_seen(n, p, j.seen, e);
    if (!rc)
        surface_tell(&j, p, out);
    if (!rc && out->rgb)
        rc = surface_colors(n, &j, p, out->rgb, e);
    mem_free(j.room);
    mem_free(j.agree);
    mem_free(j.seen);
    return rc;
}
