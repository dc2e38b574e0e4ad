/* Gaussians on the surfaces of the city: see synth_splats.h.
 *
 * The surfaces of a district are faces with an area each: rectangles and triangles of solids,
 * ellipsoids, and squares of ground that no house covers. Row r of n lies (r + 0.5) / n along the
 * sum of all areas, which gives its face. Within a face rows follow the R2 sequence, the
 * two-dimensional relative of the golden ratio, whose points leave no gaps however many there are.
 * Source: M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/synth_splats.h"

#include <math.h>
#include <string.h>

#include "core/pool.h"

static const double splats_r2[2] = {0.7548776662466927, 0.5698402909980532};
static const double splats_ground_m = 4;     /* edge of a square of ground */
static const double splats_sigma = 0.6;      /* of a disc, of the distance between neighbours */
static const double splats_flat = 0.12;      /* thickness of a disc, of its sigma */
static const double splats_leaf = 0.5;       /* the same in trees */
static const double splats_harmonic = 0.04;  /* deviation of harmonics above degree 0 */
static const float splats_opacity_logit = 3; /* 0.95 */

struct face { /* a place on it: at + u a + v b in the solid's frame; of an ellipsoid: its surface */
    const struct synth_solid *solid; /* NULL: ground */
    bool triangle;
    float at[3], a[3], b[3], normal[3];
    double before_m2; /* area of the faces before it */
};
struct district {
    struct synth_city city;
    struct face *face;
    size_t n, cap;
    double area_m2;
    bool *covered; /* [side][side] squares of ground under houses */
    size_t side;
};

/* ---- the faces of a district ---- */

static enum err_code splats_add(struct district *d, struct face f, double area_m2, struct err *e)
{
    struct face *more = mem_room(d->face, d->n, &d->cap, 4096, sizeof *more);
    if (!more)
        return err_set(e, ERR_MEM, "synth: out of memory for %zu faces", d->n + 1);
    d->face = more;
    f.before_m2 = d->area_m2;
    d->area_m2 += area_m2;
    d->face[d->n++] = f;
    return ERR_OK;
}

/* A rectangle or a triangle: corner, and the two edges from it. The normal is a x b. */
static enum err_code splats_add_flat(struct district *d, const struct synth_solid *s, bool triangle,
                                     const double at[3], const double a[3], const double b[3],
                                     struct err *e)
{
    struct face f = {.solid = s, .triangle = triangle};
    double n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    double len = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int i = 0; i < 3; i++) {
        f.at[i] = (float)at[i];
        f.a[i] = (float)a[i];
        f.b[i] = (float)b[i];
        f.normal[i] = (float)(n[i] / len);
    }
    return len > 0 ? splats_add(d, f, triangle ? 0.5 * len : len, e) : ERR_OK;
}

/* Four walls, counted from +x against the clock. */
static enum err_code splats_add_walls(struct district *d, const struct synth_solid *s,
                                      struct err *e)
{
    double x = s->half_m[0], y = s->half_m[1];
    const double up[3] = {0, 0, s->z1_m - s->z0_m},
                 corner[4][3] = {{x, -y, 0}, {x, y, 0}, {-x, y, 0}, {-x, -y, 0}},
                 edge[4][3] = {{0, 2 * y, 0}, {-2 * x, 0, 0}, {0, -2 * y, 0}, {2 * x, 0, 0}};
    enum err_code rc = ERR_OK;
    for (int i = 0; !rc && i < 4; i++)
        rc = splats_add_flat(d, s, false, corner[i], edge[i], up, e);
    return rc;
}

static enum err_code splats_add_roof(struct district *d, const struct synth_solid *s, struct err *e)
{
    double x = s->half_m[0], y = s->half_m[1], h = s->z1_m - s->z0_m, up = s->ridge_m - s->z1_m;
    if (s->kind != SYNTH_GABLE)
        return splats_add_flat(d, s, false, (const double[3]){-x, -y, h},
                               (const double[3]){2 * x, 0, 0}, (const double[3]){0, 2 * y, 0}, e);
    enum err_code rc = ERR_OK;
    for (int side = -1; !rc && side <= 1; side += 2) {
        /* A slope, from its eaves to the ridge. */
        rc = splats_add_flat(d, s, false, (const double[3]){side * x, side * y, h},
                             (const double[3]){-side * 2 * x, 0, 0},
                             (const double[3]){0, -side * y, up}, e);
        if (!rc) /* the wall above the eaves: two triangles that meet below the ridge */
            rc = splats_add_flat(d, s, true, (const double[3]){side * x, 0, h},
                                 (const double[3]){0, side * y, 0}, (const double[3]){0, 0, up}, e);
        if (!rc)
            rc =
                splats_add_flat(d, s, true, (const double[3]){side * x, 0, h},
                                (const double[3]){0, 0, up}, (const double[3]){0, -side * y, 0}, e);
    }
    return rc;
}

static enum err_code splats_add_ellipsoid(struct district *d, const struct synth_solid *s,
                                          struct err *e)
{
    double r = s->half_m[0], h = 0.5 * (s->z1_m - s->z0_m), p = 1.6075;
    double mean = (pow(r, 2 * p) + 2 * pow(r * h, p)) / 3; /* Knud Thomsen's formula */
    return splats_add(d, (struct face){.solid = s}, 4 * M_PI * pow(mean, 1 / p), e);
}

/* Squares of ground whose four corners a house hides. */
static void splats_cover(struct district *d, const struct synth_solid *s)
{
    double reach = hypot(s->half_m[0], s->half_m[1]);
    size_t lo[2], hi[2];
    for (int k = 0; k < 2; k++) {
        double from = floor((s->center_m[k] - reach + d->city.half_m) / splats_ground_m),
               to = floor((s->center_m[k] + reach + d->city.half_m) / splats_ground_m);
        lo[k] = from > 0 ? (size_t)from : 0;
        hi[k] = to < (double)d->side - 1 ? (size_t)fmax(to, 0) : d->side - 1;
    }
    for (size_t j = lo[1]; j <= hi[1]; j++)
        for (size_t i = lo[0]; i <= hi[0]; i++) {
            bool inside = true;
            for (size_t c = 0; c < 4; c++) {
                double x = (double)(i + c % 2) * splats_ground_m - d->city.half_m - s->center_m[0],
                       y = (double)(j + c / 2) * splats_ground_m - d->city.half_m - s->center_m[1];
                inside = inside && fabs(s->cos_yaw * x + s->sin_yaw * y) < s->half_m[0] &&
                         fabs(s->cos_yaw * y - s->sin_yaw * x) < s->half_m[1];
            }
            d->covered[j * d->side + i] = d->covered[j * d->side + i] || inside;
        }
}

static enum err_code splats_add_ground(struct district *d, struct err *e)
{
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < d->side * d->side; i++)
        if (!d->covered[i])
            rc = splats_add_flat(
                d, NULL, false,
                (const double[3]){(double)(i % d->side) * splats_ground_m - d->city.half_m,
                                  (double)(i / d->side) * splats_ground_m - d->city.half_m, 0},
                (const double[3]){splats_ground_m, 0, 0}, (const double[3]){0, splats_ground_m, 0},
                e);
    return rc;
}

static void splats_close(struct district *d)
{
    synth_city_free(&d->city);
    mem_free(d->face);
    mem_free(d->covered);
    *d = (struct district){0};
}

static enum err_code splats_district(const struct synth_splats *s, size_t i, struct district *out,
                                     struct err *e)
{
    struct district d = {.side = (size_t)(SYNTH_DISTRICT_M / splats_ground_m)};
    enum err_code rc = synth_city_district(s->seed, (int64_t)(i % s->columns),
                                           (int64_t)(i / s->columns), &d.city, e);
    if (!rc && !(d.covered = mem_array(d.side * d.side, sizeof *d.covered)))
        rc = err_set(e, ERR_MEM, "synth: out of memory for a district");
    for (size_t k = 0; !rc && k < d.city.n_solids; k++) {
        const struct synth_solid *solid = &d.city.solids[k];
        if (solid->material == SYNTH_HOUSE && !(solid->z0_m > 0))
            splats_cover(&d, solid);
        if (solid->kind == SYNTH_ELLIPSOID) {
            rc = splats_add_ellipsoid(&d, solid, e);
            continue;
        }
        rc = splats_add_walls(&d, solid, e);
        if (!rc)
            rc = splats_add_roof(&d, solid, e);
    }
    if (!rc)
        rc = splats_add_ground(&d, e);
    if (rc)
        splats_close(&d);
    else
        *out = d;
    return rc;
}

/* ---- the plan ---- */

static enum err_code splats_measure(void *user, size_t i, struct err *e)
{
    struct synth_splats *s = user;
    struct district d;
    if (signals_stopping())
        return err_set(e, ERR_CANCEL, "stopped");
    enum err_code rc = splats_district(s, i, &d, e);
    if (!rc) {
        s->area_m2[i + 1] = d.area_m2;
        splats_close(&d);
    }
    return rc;
}

enum err_code synth_splats_open(uint32_t seed, uint32_t sh_degree, size_t n, double spacing_m,
                                struct synth_splats *out, struct err *e)
{
    struct synth_splats s = {.seed = seed, .sh_degree = sh_degree, .columns = 1};
    struct district d;
    enum err_code rc = splats_district(&s, 0, &d, e);
    if (rc)
        return rc;
    double many = (double)n * spacing_m * spacing_m / d.area_m2;
    splats_close(&d);
    s.n_districts = many > 1 ? (size_t)(many + 0.5) : 1;
    s.columns = (size_t)ceil(sqrt((double)s.n_districts));
    s.rows = (s.n_districts + s.columns - 1) / s.columns;
    s.reach_m = 0.5 * hypot((double)s.columns, (double)s.rows) * SYNTH_DISTRICT_M;
    s.area_m2 = mem_array(s.n_districts + 1, sizeof *s.area_m2);
    if (!s.area_m2)
        return err_set(e, ERR_MEM, "synth: out of memory for %zu districts", s.n_districts);
    rc = pool_for(s.n_districts, 0, splats_measure, &s, e);
    for (size_t i = 0; !rc && i < s.n_districts; i++)
        s.area_m2[i + 1] += s.area_m2[i];
    if (rc)
        synth_splats_free(&s);
    else
        *out = s;
    return rc;
}

void synth_splats_free(struct synth_splats *s)
{
    mem_free(s->area_m2);
    *s = (struct synth_splats){0};
}

double synth_splats_spacing(const struct synth_splats *s, size_t n)
{
    return sqrt(s->area_m2[s->n_districts] / (double)n);
}

/* ---- rows ---- */

struct splats_rows { /* of one district */
    const struct synth_splats *s;
    const struct district *d;
    struct synth_light light;
    size_t n; /* in the district */
    double spacing_m, cos_yaw, sin_yaw, middle_m[2];
    bool colour;
};

/* The number of the first row behind this much of the district's area. */
static size_t splats_first(const struct splats_rows *w, double before_m2)
{
    double r = ceil(before_m2 / w->d->area_m2 * (double)w->n - 0.5);
    return r > 0 ? (size_t)r : 0;
}

static const struct face *splats_face(const struct splats_rows *w, size_t row)
{
    size_t lo = 0, hi = w->d->n;
    while (lo + 1 < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (splats_first(w, w->d->face[mid].before_m2) <= row)
            lo = mid;
        else
            hi = mid;
    }
    return &w->d->face[lo];
}

/* Place `j` of the face: in the solid's frame, and the normal there. */
static void splats_place(const struct face *f, size_t j, double local[3], double normal[3])
{
    double u = fmod(0.5 + (double)j * splats_r2[0], 1), v = fmod(0.5 + (double)j * splats_r2[1], 1);
    if (f->solid && f->solid->kind == SYNTH_ELLIPSOID) {
        const struct synth_solid *s = f->solid;
        double half[3] = {s->half_m[0], s->half_m[1], 0.5 * (s->z1_m - s->z0_m)}, len = 0;
        double z = 1 - 2 * u, r = sqrt(1 - z * z);
        const double on[3] = {r * cos(2 * M_PI * v), r * sin(2 * M_PI * v), z};
        for (int i = 0; i < 3; i++) {
            local[i] = half[i] * on[i] + (i == 2 ? half[i] : 0);
            normal[i] = on[i] / half[i];
            len += normal[i] * normal[i];
        }
        for (int i = 0; i < 3; i++)
            normal[i] /= sqrt(len);
        return;
    }
    bool fold = f->triangle && u + v > 1;
    for (int i = 0; i < 3; i++) {
        local[i] = (double)f->at[i] + (fold ? 1 - u : u) * (double)f->a[i] +
                   (fold ? 1 - v : v) * (double)f->b[i];
        normal[i] = (double)f->normal[i];
    }
}

static struct synth_hit splats_hit(const struct face *f, size_t j)
{
    struct synth_hit h = {.t_m = 1, .solid = f->solid};
    splats_place(f, j, h.local, h.local_normal);
    if (!f->solid) {
        memcpy(h.pos, h.local, sizeof h.pos);
        memcpy(h.normal, h.local_normal, sizeof h.normal);
        return h;
    }
    double c = f->solid->cos_yaw, n = f->solid->sin_yaw;
    h.pos[0] = f->solid->center_m[0] + c * h.local[0] - n * h.local[1];
    h.pos[1] = f->solid->center_m[1] + n * h.local[0] + c * h.local[1];
    h.pos[2] = f->solid->z0_m + h.local[2];
    h.normal[0] = c * h.local_normal[0] - n * h.local_normal[1];
    h.normal[1] = n * h.local_normal[0] + c * h.local_normal[1];
    h.normal[2] = h.local_normal[2];
    return h;
}

static void splats_colour(const struct splats_rows *w, const struct synth_hit *h, uint64_t id,
                          float *sh)
{
    static const double down[3] = {0, 0, -1};
    float rgb[3];
    size_t n_sh = 3 * gauss_sh_count(w->s->sh_degree);
    synth_shade_hit(&w->d->city, NULL, &w->light, down, h, w->spacing_m, rgb);
    for (size_t k = 0; k < 3; k++)
        sh[k] = (float)((synth_shade_encode(rgb[k]) / 255.0 - 0.5) / GAUSS_SH_C0);
    for (size_t k = 3; k < n_sh; k++) { /* uniform, of this deviation */
        double u = rng_unit(w->s->seed, SYNTH_STREAM_SPLATS, id * 48 + k) - 0.5;
        sh[k] = (float)(splats_harmonic * sqrt(12.0) * u);
    }
}

/* Row `row` of the district to row i of g; `id` is its number in the city. */
static void splats_row(const struct splats_rows *w, size_t row, uint64_t id, struct gauss *g,
                       size_t i)
{
    const struct face *f = splats_face(w, row);
    struct synth_hit h = splats_hit(f, row - splats_first(w, f->before_m2));
    double c = w->cos_yaw, s = w->sin_yaw;
    float *m = g->mean_m + 3 * i, *q = g->quat_wxyz + 4 * i;
    bool leaf = f->solid && f->solid->material == SYNTH_TREE;
    double ln = log(splats_sigma * w->spacing_m) +
                0.3 * (rng_unit(w->s->seed, SYNTH_STREAM_SPLATS, id * 48) - 0.5);
    m[0] = (float)(w->middle_m[0] + c * h.pos[0] - s * h.pos[1]);
    m[1] = (float)(w->middle_m[1] + s * h.pos[0] + c * h.pos[1]);
    m[2] = (float)h.pos[2];
    const double n[3] = {c * h.normal[0] - s * h.normal[1], s * h.normal[0] + c * h.normal[1],
                         h.normal[2]};
    bool below = n[2] < -0.999; /* half a turn about x */
    q[0] = below ? 0 : (float)(1 + n[2]);
    q[1] = below ? 1 : (float)-n[1];
    q[2] = below ? 0 : (float)n[0];
    q[3] = 0;
    float len = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
    for (int k = 0; k < 3; k++) {
        q[k] /= len;
        g->scale_log[3 * i + (size_t)k] =
            (float)(ln + (k == 2 ? log(leaf ? splats_leaf : splats_flat) : 0.0));
    }
    g->opacity_logit[i] = splats_opacity_logit;
    if (w->colour)
        splats_colour(w, &h, id, g->sh + 3 * gauss_sh_count(g->sh_degree) * i);
}

/* The first row of a district among n. */
static size_t splats_begin(const struct synth_splats *s, size_t n, size_t district)
{
    return district == s->n_districts
               ? n
               : (size_t)(s->area_m2[district] / s->area_m2[s->n_districts] * (double)n);
}

static enum err_code splats_fill(const struct synth_splats *s, size_t n, size_t district,
                                 size_t first, bool colour, struct gauss *out, size_t end,
                                 struct err *e)
{
    struct district d;
    enum err_code rc = splats_district(s, district, &d, e);
    if (rc)
        return rc;
    size_t begin = splats_begin(s, n, district);
    struct splats_rows w = {.s = s,
                            .d = &d,
                            .light = synth_shade_light(),
                            .n = splats_begin(s, n, district + 1) - begin,
                            .spacing_m = synth_splats_spacing(s, n),
                            .cos_yaw = cos(d.city.yaw_rad),
                            .sin_yaw = sin(d.city.yaw_rad),
                            .colour = colour};
    double x = ((double)(district % s->columns) - 0.5 * (double)(s->columns - 1)) *
               SYNTH_DISTRICT_M,
           y = ((double)(district / s->columns) - 0.5 * (double)(s->rows - 1)) * SYNTH_DISTRICT_M;
    w.middle_m[0] = w.cos_yaw * x - w.sin_yaw * y;
    w.middle_m[1] = w.sin_yaw * x + w.cos_yaw * y;
    for (; out->n < end; out->n++)
        splats_row(&w, first + out->n - begin, first + out->n, out, out->n);
    splats_close(&d);
    return ERR_OK;
}

enum err_code synth_splats_make(const struct synth_splats *s, size_t n, size_t first, size_t count,
                                bool colour, struct gauss *out, struct err *e)
{
    enum err_code rc = gauss_alloc(out, count, s->sh_degree, 0, e);
    size_t district = 0;
    while (district + 1 < s->n_districts && splats_begin(s, n, district + 1) <= first)
        district++;
    for (; !rc && out->n < count; district++) {
        size_t end = splats_begin(s, n, district + 1);
        rc = splats_fill(s, n, district, first, colour, out,
                         end < first + count ? end - first : count, e);
    }
    if (rc)
        gauss_free(out);
    return rc;
}
