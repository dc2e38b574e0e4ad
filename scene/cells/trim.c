/* Finds exactly where the photographs end. For each cell of the footprint's grid it is known
 * whether all, none or a part of it is in a picture, and for parts in which pictures. Few cells are
 * shown in part and few photographs reach there, so a query of a place is fast.
 *
 * Two halves that keep the mean and covariance of a Gaussian have its axis shortened to 0.6, and
 * lie 0.8 sigma to either side. Together they are 1.2 times as long. Their opacity is therefore 1 -
 * (1 - opacity)^(1 / 1.2), by the law of Beer and Lambert. What is opaque stays opaque.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/cells/trim.h"

#include <math.h>
#include <string.h>

#include "codec/scene/scene.h"
#include "core/pool.h"
#include "core/splat/camera.h"
#include "core/splat/gauss.h"
#include "scene/cells/footprint.h"

enum {
    TRIM_PLACES = 5,  /* of a cell: its corners and its middle, */
    TRIM_HEIGHTS = 3, /* at its lowest, its ground and its highest */
    TRIM_DEEP = 255,
    TRIM_DEPTH = 24, /* halvings of one Gaussian, at most */
};
#define TRIM_ROUNDING_M 1e-6
#define TRIM_REACH 2.0   /* sigmas that must not stick out */
#define TRIM_UNSURE 0.25 /* of the free height, where one photograph looks */
#define TRIM_OFFSET 0.8
#define TRIM_SHRINK 0.6
#define TRIM_HALVE 3.0 /* of the least sigma: what is larger is halved, what is not is squeezed */
enum { TRIM_BISECTIONS = 6 };
#define TRIM_LEAST_PX 2.0      /* sigmas as fine as that on the ground are left alone, */
#define TRIM_LEAST_SHARE 0.005 /* and those below this share of the flight height */

void trim_free(struct trim *t)
{
    mem_free(t->deep);
    mem_free(t->first);
    mem_free(t->cams);
    *t = (struct trim){0};
}

/* ---- which cells are shown ---- */

enum trim_class { TRIM_NONE, TRIM_PART, TRIM_WHOLE };

/* The sides of what a camera frames, as half spaces in the world: n . x + n[3] metres inside. What
 * lies within all four is in front of it. */
struct trim_sides {
    double n[4][4];
};

struct trim_work {
    const struct scene *s;
    const struct footprint *f;
    uint32_t sure;
    struct trim_sides *sides; /* [photographs] */
    uint8_t *class;           /* [cells]: shown as a whole, as a part, not at all */
    uint32_t **cams;          /* [cells] of parts; */
    uint32_t *n;              /* how many */
};

/* The places of a cell that stand for it. */
static void trim_places(const struct footprint *f, size_t cell,
                        double out[TRIM_PLACES * TRIM_HEIGHTS][3])
{
    static const double at[TRIM_PLACES][2] = {{0, 0}, {1, 0}, {0, 1}, {1, 1}, {0.5, 0.5}};
    const double z[TRIM_HEIGHTS] = {(double)f->low_m[cell] + f->margin_m, (double)f->ground_m[cell],
                                    (double)f->high_m[cell] - f->margin_m};
    for (size_t p = 0; p < TRIM_PLACES; p++)
        for (size_t h = 0; h < TRIM_HEIGHTS; h++) {
            double *x = out[TRIM_HEIGHTS * p + h];
            x[0] = f->corner_m[0] + ((double)(cell % f->nx) + at[p][0]) * f->cell_m;
            x[1] = f->corner_m[1] + ((double)(cell / f->nx) + at[p][1]) * f->cell_m;
            x[2] = z[h];
        }
}

static struct trim_sides trim_sides_of(const struct camera *c)
{
    const double in[4][3] = {{c->fx_px, 0.0, c->cx_px},
                             {-c->fx_px, 0.0, c->width_px - c->cx_px},
                             {0.0, c->fy_px, c->cy_px},
                             {0.0, -c->fy_px, c->height_px - c->cy_px}};
    struct trim_sides out;
    for (int k = 0; k < 4; k++) {
        double len = sqrt(in[k][0] * in[k][0] + in[k][1] * in[k][1] + in[k][2] * in[k][2]);
        for (int a = 0; a < 3; a++)
            out.n[k][a] =
                (in[k][0] * c->rot[a] + in[k][1] * c->rot[3 + a] + in[k][2] * c->rot[6 + a]) / len;
        out.n[k][3] =
            (in[k][0] * c->trans[0] + in[k][1] * c->trans[1] + in[k][2] * c->trans[2]) / len;
    }
    return out;
}

/* The ball about a cell's places: middle, and radius with room for rounding. */
static void trim_ball(double x[TRIM_PLACES * TRIM_HEIGHTS][3], double out[4])
{
    double most = 0.0;
    for (int a = 0; a < 3; a++) {
        out[a] = 0.0;
        for (size_t k = 0; k < TRIM_PLACES * TRIM_HEIGHTS; k++)
            out[a] += x[k][a] / (TRIM_PLACES * TRIM_HEIGHTS);
    }
    for (size_t k = 0; k < TRIM_PLACES * TRIM_HEIGHTS; k++) {
        double d = 0.0;
        for (int a = 0; a < 3; a++)
            d += (x[k][a] - out[a]) * (x[k][a] - out[a]);
        most = fmax(most, d);
    }
    out[3] = 1.000001 * sqrt(most) + TRIM_ROUNDING_M;
}

/* Is a ball framed as a whole, in part or not at all? Part is always right. */
static enum trim_class trim_frames_ball(const struct trim_sides *s, const double ball[4])
{
    enum trim_class out = TRIM_WHOLE;
    for (int k = 0; k < 4; k++) {
        const double *n = s->n[k];
        double in = n[0] * ball[0] + n[1] * ball[1] + n[2] * ball[2] + n[3];
        if (in < -ball[3])
            return TRIM_NONE;
        if (!(in > ball[3]))
            out = TRIM_PART;
    }
    return out;
}

/* Cameras that frame one of the cell's places; *shown: places that one of them frames. */
static size_t trim_look(const struct trim_work *w, size_t cell, uint32_t *cams, size_t *shown)
{
    double x[TRIM_PLACES * TRIM_HEIGHTS][3], ball[4];
    bool seen[TRIM_PLACES * TRIM_HEIGHTS] = {0};
    size_t n = 0;
    trim_places(w->f, cell, x);
    trim_ball(x, ball);
    for (size_t i = 0; i < w->s->n_images; i++) {
        enum trim_class there =
            w->s->images[i].split == SCENE_TRAIN ? trim_frames_ball(&w->sides[i], ball) : TRIM_NONE;
        bool some = there == TRIM_WHOLE;
        for (size_t k = 0; there != TRIM_NONE && k < TRIM_PLACES * TRIM_HEIGHTS; k++)
            if (there == TRIM_WHOLE || camera_frames(&w->s->images[i].cam, x[k], 0.0, NULL))
                some = seen[k] = true;
        if (some)
            cams[n++] = (uint32_t)i;
    }
    *shown = 0;
    for (size_t k = 0; k < TRIM_PLACES * TRIM_HEIGHTS; k++)
        *shown += seen[k];
    return n;
}

static enum err_code trim_row_task(void *user, size_t row, struct err *e)
{
    struct trim_work *w = user;
    uint32_t *cams = mem_array(w->s->n_images, sizeof *cams);
    if (!cams)
        return err_set(e, ERR_MEM, "trim: out of memory for %zu photographs", w->s->n_images);
    enum err_code rc = ERR_OK;
    for (size_t i = row * w->f->nx; !rc && i < (row + 1) * w->f->nx; i++) {
        size_t shown, n = trim_look(w, i, cams, &shown);
        bool sure = shown == TRIM_PLACES * TRIM_HEIGHTS && w->f->views[i] >= w->sure;
        w->class[i] = !n ? TRIM_NONE : sure ? TRIM_WHOLE : TRIM_PART;
        if (w->class[i] != TRIM_PART)
            continue;
        w->cams[i] = mem_array(n, sizeof *cams);
        if (!w->cams[i])
            rc = err_set(e, ERR_MEM, "trim: out of memory for %zu photographs", n);
        else
            memcpy(w->cams[i], cams, n * sizeof *cams);
        w->n[i] = (uint32_t)n;
    }
    mem_free(cams);
    return rc;
}

/* Cells between each one that is shown as a whole and the nearest one that is not, at most
 * TRIM_DEEP, itself counted: two sweeps. */
static void trim_deepen(const struct footprint *f, const uint8_t *class, uint8_t *deep)
{
    ptrdiff_t nx = (ptrdiff_t)f->nx, ny = (ptrdiff_t)f->ny;
    for (int back = 0; back < 2; back++)
        for (ptrdiff_t k = 0; k < nx * ny; k++) {
            ptrdiff_t i = back ? nx * ny - 1 - k : k, x = i % nx, y = i / nx, s = back ? 1 : -1;
            const ptrdiff_t before[4][2] = {{x + s, y}, {x - 1, y + s}, {x, y + s}, {x + 1, y + s}};
            int least = back ? deep[i] : TRIM_DEEP;
            for (int b = 0; b < 4; b++) {
                bool in = before[b][0] >= 0 && before[b][0] < nx && before[b][1] >= 0 &&
                          before[b][1] < ny;
                int there = in ? deep[before[b][1] * nx + before[b][0]] + 1 : 1;
                least = there < least ? there : least;
            }
            deep[i] = class[i] == TRIM_WHOLE ? (uint8_t)least : 0;
        }
}

static enum err_code trim_collect(struct trim *t, const struct trim_work *w, struct err *e)
{
    size_t cells = w->f->nx * w->f->ny, n = 0;
    for (size_t i = 0; i < cells; i++)
        n += w->n[i];
    t->deep = mem_array(cells, 1);
    t->first = mem_array(cells + 1, sizeof *t->first);
    t->cams = mem_array(n, sizeof *t->cams);
    if (!t->deep || !t->first || !t->cams)
        return err_set(e, ERR_MEM, "trim: out of memory for %zu cells", cells);
    for (size_t i = 0; i < cells; i++) {
        if (w->n[i])
            memcpy(t->cams + t->first[i], w->cams[i], w->n[i] * sizeof *t->cams);
        t->first[i + 1] = t->first[i] + w->n[i];
    }
    trim_deepen(w->f, w->class, t->deep);
    return ERR_OK;
}

enum err_code trim_open(const struct scene *s, const struct footprint *at, uint32_t sure,
                        double free_m, struct trim *out, struct err *e)
{
    size_t cells = at->nx * at->ny;
    *out = (struct trim){0};
    if (!cells)
        return ERR_OK;
    *out = (struct trim){.scene = s,
                         .at = at,
                         .sure = sure,
                         .free_m = free_m,
                         .least_m =
                             fmax(TRIM_LEAST_PX / at->px_per_m, TRIM_LEAST_SHARE * at->height_m)};
    struct trim_work w = {.s = s,
                          .sure = sure,
                          .f = at,
                          .class = mem_array(cells, 1),
                          .cams = mem_array(cells, sizeof *w.cams),
                          .n = mem_array(cells, sizeof *w.n),
                          .sides = mem_array(s->n_images, sizeof *w.sides)};
    for (size_t i = 0; w.sides && i < s->n_images; i++)
        w.sides[i] = trim_sides_of(&s->images[i].cam);
    enum err_code rc = w.class && w.cams && w.n && w.sides
                           ? pool_for(at->ny, 0, trim_row_task, &w, e)
                           : err_set(e, ERR_MEM, "trim: out of memory for %zu cells", cells);
    if (!rc)
        rc = trim_collect(out, &w, e);
    for (size_t i = 0; w.cams && i < cells; i++)
        mem_free(w.cams[i]);
    mem_free(w.class);
    mem_free(w.cams);
    mem_free(w.n);
    mem_free(w.sides);
    if (rc)
        trim_free(out);
    return rc;
}

static ptrdiff_t trim_cell(const struct footprint *f, const double x_m[3])
{
    double x = floor((x_m[0] - f->corner_m[0]) / f->cell_m),
           y = floor((x_m[1] - f->corner_m[1]) / f->cell_m);
    if (!(x >= 0.0 && y >= 0.0 && x < (double)f->nx && y < (double)f->ny))
        return -1;
    return (ptrdiff_t)y * (ptrdiff_t)f->nx + (ptrdiff_t)x;
}

bool trim_shows(const struct trim *t, const double x_m[3])
{
    ptrdiff_t cell = t->at ? trim_cell(t->at, x_m) : -1;
    if (cell < 0)
        return !t->at;
    if (t->deep[cell])
        return true;
    for (size_t k = t->first[cell]; k < t->first[cell + 1]; k++)
        if (camera_frames(&t->scene->images[t->cams[k]].cam, x_m, 0.0, NULL))
            return true;
    return false;
}

bool trim_holds(const struct trim *t, const double x_m[3])
{
    ptrdiff_t cell = t->at ? trim_cell(t->at, x_m) : -1;
    if (cell < 0 || t->deep[cell])
        return !t->at || cell >= 0;
    double share = fmax(((double)t->at->views[cell] - 1.0) / ((double)t->sure - 1.0), TRIM_UNSURE);
    if (t->free_m > 0.0 && footprint_off(t->at, x_m) > t->free_m * fmin(share, 1.0))
        return false;
    return trim_shows(t, x_m);
}

/* ---- rows ---- */

struct trim_piece {
    size_t row;
    double mean_m[3]; /* ENU */
    double sigma_m[3];
    double thickness; /* optical: -ln(1 - opacity) */
};
struct trim_pieces {
    struct trim_piece *all;
    size_t n, cap;
};

static enum err_code trim_add(struct trim_pieces *p, const struct trim_piece *piece, struct err *e)
{
    struct trim_piece *grown = mem_room(p->all, p->n, &p->cap, 256, sizeof *grown);
    if (!grown)
        return err_set(e, ERR_MEM, "trim: out of memory for %zu pieces", p->n + 1);
    p->all = grown;
    p->all[p->n++] = *piece;
    return ERR_OK;
}

/* trim_shows or trim_holds */
typedef bool trim_test(const struct trim *t, const double x_m[3]);

/* Does the place pass that lies so many sigmas along an axis? */
static bool trim_end_passes(const struct trim *t, trim_test *test, const struct trim_piece *p,
                            const double rot[9], int k, double sigmas)
{
    double x[3];
    for (int a = 0; a < 3; a++)
        x[a] = p->mean_m[a] + sigmas * p->sigma_m[k] * rot[3 * a + k];
    return test(t, x);
}

/* The longest axis that sticks out, of those above the least size; -1: none. */
static int trim_axis(const struct trim *t, trim_test *test, const struct trim_piece *p,
                     const double rot[9])
{
    int axis = -1;
    for (int k = 0; k < 3; k++)
        if (p->sigma_m[k] > t->least_m && (axis < 0 || p->sigma_m[k] > p->sigma_m[axis]) &&
            !(trim_end_passes(t, test, p, rot, k, -TRIM_REACH) &&
              trim_end_passes(t, test, p, rot, k, TRIM_REACH)))
            axis = k;
    return axis;
}

/* Sigmas from the middle, which is held, to where the pictures end. */
static double trim_end(const struct trim *t, const struct trim_piece *p, const double rot[9], int k,
                       double side)
{
    double in = 0.0, out = TRIM_REACH;
    if (trim_end_passes(t, trim_holds, p, rot, k, side * out))
        return out;
    for (int i = 0; i < TRIM_BISECTIONS; i++) {
        double half = 0.5 * (in + out);
        if (trim_end_passes(t, trim_holds, p, rot, k, side * half))
            in = half;
        else
            out = half;
    }
    return in;
}

/* Shorten and move it along its axes until both ends of each lie inside. */
static void trim_squeeze(const struct trim *t, struct trim_piece *p, const double rot[9])
{
    for (int k = 0; k < 3; k++) {
        if (!(p->sigma_m[k] > t->least_m))
            continue;
        double low = trim_end(t, p, rot, k, -1.0), high = trim_end(t, p, rot, k, 1.0);
        double away = 0.5 * (high - low) * p->sigma_m[k];
        for (int a = 0; a < 3; a++)
            p->mean_m[a] += away * rot[3 * a + k];
        p->sigma_m[k] = fmax(p->sigma_m[k] * (low + high) / (2.0 * TRIM_REACH), 0.5 * t->least_m);
    }
}

/* The pieces of one Gaussian, depth first. */
static enum err_code trim_cut(const struct trim *t, const struct trim_piece *whole,
                              const double rot[9], struct trim_pieces *out, struct err *e)
{
    struct trim_piece stack[TRIM_DEPTH + 1];
    size_t n = 0;
    enum err_code rc = ERR_OK;
    stack[n++] = *whole;
    while (!rc && n) {
        struct trim_piece p = stack[n - 1];
        int k = n < TRIM_DEPTH ? trim_axis(t, trim_holds, &p, rot) : -1;
        n--;
        if (k < 0 || !(p.sigma_m[k] > TRIM_HALVE * t->least_m)) {
            if (!trim_holds(t, p.mean_m))
                continue;
            trim_squeeze(t, &p, rot);
            rc = trim_add(out, &p, e);
            continue;
        }
        double away = TRIM_OFFSET * p.sigma_m[k];
        p.sigma_m[k] *= TRIM_SHRINK;
        p.thickness *= 0.5 / TRIM_SHRINK;
        for (int side = 1; side >= -1; side -= 2) {
            stack[n] = p;
            for (int a = 0; a < 3; a++)
                stack[n].mean_m[a] += side * away * rot[3 * a + k];
            n++;
        }
    }
    return rc;
}

/* Is it far from all that is not shown? */
static bool trim_is_inside(const struct trim *t, const struct trim_piece *p)
{
    double largest = fmax(fmax(p->sigma_m[0], p->sigma_m[1]), p->sigma_m[2]);
    ptrdiff_t cell = trim_cell(t->at, p->mean_m);
    return cell >= 0 && TRIM_REACH * largest <= (t->deep[cell] - 1.0) * t->at->cell_m;
}

bool trim_is_far(const struct trim *t, const double mean_m[3], double largest_sigma_m)
{
    ptrdiff_t cell = t->at ? trim_cell(t->at, mean_m) : -1;
    return cell < 0 || TRIM_REACH * largest_sigma_m <= (t->deep[cell] - 1.0) * t->at->cell_m;
}

enum trim_verdict trim_judge(const struct trim *t, const double mean_m[3], const double sigma_m[3],
                             const double rot[9], double largest_m)
{
    struct trim_piece p = {0};
    memcpy(p.mean_m, mean_m, sizeof p.mean_m);
    memcpy(p.sigma_m, sigma_m, sizeof p.sigma_m);
    if (!t->at || trim_cell(t->at, mean_m) < 0 || trim_is_inside(t, &p))
        return TRIM_INSIDE; /* beyond the grid lie horizon and sky */
    int k = trim_axis(t, trim_shows, &p, rot);
    if (k >= 0 && p.sigma_m[k] > largest_m)
        return TRIM_STICKS_OUT;
    return trim_holds(t, p.mean_m) ? TRIM_INSIDE : TRIM_OUTSIDE;
}

static void trim_write(struct gauss *g, size_t row, const struct trim_piece *p)
{
    for (int a = 0; a < 3; a++) {
        g->mean_m[3 * row + a] = (float)(p->mean_m[a] - g->origin_enu_m[a]);
        g->scale_log[3 * row + a] = (float)log(p->sigma_m[a]);
    }
    g->opacity_logit[row] = (float)(p->thickness + log(-expm1(-p->thickness)));
}

static enum err_code trim_row(const struct trim *t, const struct gauss *g, size_t i,
                              struct trim_pieces *out, bool *whole, struct err *e)
{
    double logit = (double)g->opacity_logit[i]; /* -ln(1 - opacity) = ln(1 + exp(logit)) */
    struct trim_piece p = {.row = i, .thickness = fmax(logit, 0.0) + log1p(exp(-fabs(logit)))};
    double quat[4], rot[9];
    for (int a = 0; a < 3; a++) {
        p.mean_m[a] = (double)g->mean_m[3 * i + a] + g->origin_enu_m[a];
        p.sigma_m[a] = exp((double)g->scale_log[3 * i + a]);
    }
    *whole = trim_is_inside(t, &p);
    if (*whole)
        return ERR_OK;
    for (int a = 0; a < 4; a++)
        quat[a] = (double)g->quat_wxyz[4 * i + a];
    camera_quat_to_rot(quat, rot);
    *whole = trim_axis(t, trim_holds, &p, rot) < 0 && trim_holds(t, p.mean_m);
    return *whole ? ERR_OK : trim_cut(t, &p, rot, out, e);
}

enum err_code trim_rows(const struct trim *t, struct gauss *g, size_t *gone, struct err *e)
{
    struct trim_pieces pieces = {0};
    size_t n = g->n, left = 0;
    enum err_code rc = ERR_OK;
    *gone = 0;
    if (!t->at || !n)
        return ERR_OK;
    uint8_t *keep = mem_array(n, 1);
    if (!keep)
        return err_set(e, ERR_MEM, "trim: out of memory for %zu Gaussians", n);
    for (size_t i = 0; !rc && i < n; i++) {
        bool whole = false;
        size_t before = pieces.n;
        rc = trim_row(t, g, i, &pieces, &whole, e);
        keep[i] = whole;
        *gone += !whole && pieces.n == before;
    }
    if (!rc && pieces.n)
        rc = gauss_reserve(g, n + pieces.n, e);
    for (size_t k = 0; !rc && k < pieces.n; k++) {
        gauss_copy_row(g, n + k, g, pieces.all[k].row);
        trim_write(g, n + k, &pieces.all[k]);
    }
    for (size_t i = 0; !rc && i < n + pieces.n; i++)
        if (i >= n || keep[i]) {
            if (left != i)
                gauss_copy_row(g, left, g, i);
            left++;
        }
    if (!rc)
        g->n = left;
    mem_free(keep);
    mem_free(pieces.all);
    return rc;
}
