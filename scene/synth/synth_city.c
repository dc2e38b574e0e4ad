/* The objects of the city: streets on a jittered grid, blocks cut into lots, and on the lots houses
 * with flat or gabled roofs, parks and car parks; trees along streets and in fields, parked cars.
 *
 * A lot is cut in two across its longer edge until it has the size of a house, as real parcels are.
 * Every number comes from rng_unit(seed, stream, counter), so a city is a function of its seed and
 * extent alone.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "scene/synth/synth.h"

struct dice { /* a walk through one random stream */
    uint64_t seed, stream, next;
};

static double city_roll(struct dice *d, double lo, double hi)
{
    return lo + (hi - lo) * rng_unit(d->seed, d->stream, d->next++);
}

static bool city_chance(struct dice *d, double p)
{
    return city_roll(d, 0, 1) < p;
}

struct builder {
    struct synth_city *city;
    struct dice lots, trees, cars;
    struct err *e;
    enum err_code rc;
};

struct rect {
    double x0, y0, x1, y1;
};

static const double street_half_m = 4.6, avenue_half_m = 6.4, sidewalk_m = 2.4, block_m = 46;
static const double block_slope = 0.4;   /* height of a block by its edge */
static const double block_clear_m = 0.5; /* open ground around it */
static const double lane_m = 2.1;        /* from the centre line to the middle of a lane */

static void city_add(struct builder *b, const struct synth_solid *s)
{
    struct synth_city *c = b->city;
    if (b->rc != ERR_OK)
        return;
    struct synth_solid *grown =
        mem_room(c->solids, c->n_solids, &c->cap_solids, 1024, sizeof *grown);
    if (!grown) {
        b->rc = err_set(b->e, ERR_MEM, "synth: out of memory for %zu solids", c->n_solids + 1);
        return;
    }
    c->solids = grown;
    c->solids[c->n_solids] = *s;
    c->solids[c->n_solids].seed =
        (uint32_t)rng_u64(c->seed, SYNTH_STREAM_LOTS, 0x10000000u + c->n_solids);
    if (s->kind != SYNTH_GABLE)
        c->solids[c->n_solids].ridge_m = s->z1_m;
    c->n_solids++;
}

static void city_set_color(struct synth_solid *s, const float rgb[3], double gain)
{
    for (int i = 0; i < 3; i++)
        s->color[i] = rgb[i] * (float)gain;
}

/* ---- vegetation and cars ---- */

static void city_add_tree(struct builder *b, double x, double y, double size)
{
    static const float greens[][3] = {{.10f, .22f, .05f},
                                      {.16f, .28f, .06f},
                                      {.07f, .16f, .05f},
                                      {.24f, .26f, .07f},
                                      {.30f, .17f, .05f}};
    struct dice *d = &b->trees;
    double height = size * city_roll(d, 3.6, 5.6), radius = size * city_roll(d, 1.5, 2.4);
    const float *green = greens[(int)city_roll(d, 0, 4.15)]; /* the last, autumn, is rare */
    struct synth_solid trunk = {.kind = SYNTH_BOX,
                                .material = SYNTH_TRUNK,
                                .center_m = {x, y},
                                .cos_yaw = 1,
                                .half_m = {0.16 * size, 0.16 * size},
                                .z1_m = 0.5 * height,
                                .color = {.13f, .09f, .06f}};
    city_add(b, &trunk);
    int lobes = 1 + (int)city_roll(d, 0, 2.99);
    for (int i = 0; i < lobes; i++) {
        double shift = i ? 0.55 * radius : 0, turn = city_roll(d, 0, 2 * M_PI),
               r = radius * (i ? 0.72 : 1);
        double top = height * (i ? city_roll(d, 0.75, 0.95) : 1);
        struct synth_solid crown = {.kind = SYNTH_ELLIPSOID,
                                    .material = SYNTH_TREE,
                                    .cos_yaw = 1,
                                    .center_m = {x + shift * cos(turn), y + shift * sin(turn)},
                                    .half_m = {r, r},
                                    .z0_m = 0.28 * height,
                                    .z1_m = top};
        city_set_color(&crown, green, city_roll(d, 0.85, 1.2));
        city_add(b, &crown);
    }
}

static const float car_colors[][3] = {{.62f, .62f, .64f}, {.30f, .31f, .33f}, {.04f, .04f, .05f},
                                      {.45f, .05f, .04f}, {.06f, .12f, .34f}, {.70f, .68f, .62f},
                                      {.55f, .42f, .08f}, {.08f, .22f, .13f}};

/* Body and cabin of a car whose long axis is turned by yaw from x. */
static void city_make_car(double x, double y, double yaw, double u, struct synth_solid out[2])
{
    size_t n = sizeof car_colors / sizeof *car_colors;
    const float *rgb = car_colors[(size_t)(u * (double)n) % n];
    bool van = u > 0.86;
    struct synth_solid body = {.kind = SYNTH_BOX,
                               .material = SYNTH_CAR,
                               .center_m = {x, y},
                               .cos_yaw = cos(yaw),
                               .sin_yaw = sin(yaw),
                               .half_m = {van ? 2.7 : 2.2, van ? 1.05 : 0.92},
                               .z0_m = 0.25,
                               .z1_m = van ? 2.3 : 0.95,
                               .ridge_m = van ? 2.3 : 0.95};
    struct synth_solid cabin = body;
    cabin.material = SYNTH_CABIN;
    cabin.half_m[0] = van ? 0.6 : 1.15;
    cabin.half_m[1] = van ? 0.95 : 0.8;
    cabin.z0_m = body.z1_m;
    cabin.z1_m = cabin.ridge_m = van ? 2.5 : 1.5;
    city_set_color(&body, rgb, 1);
    city_set_color(&cabin, rgb, 0.9);
    body.seed = cabin.seed = (uint32_t)(u * 4e9);
    out[0] = body;
    out[1] = cabin;
}

static void city_add_car(struct builder *b, double x, double y, double yaw)
{
    struct synth_solid car[2];
    city_make_car(x, y, yaw, city_roll(&b->cars, 0, 1), car);
    city_add(b, &car[0]);
    city_add(b, &car[1]);
}

/* ---- lots ---- */

static const float wall_colors[][3] = {{.42f, .20f, .14f}, {.55f, .46f, .33f}, {.60f, .57f, .52f},
                                       {.36f, .30f, .26f}, {.63f, .53f, .30f}, {.30f, .36f, .42f},
                                       {.52f, .32f, .22f}, {.68f, .66f, .62f}, {.40f, .44f, .36f},
                                       {.58f, .40f, .36f}};

static void city_add_roof_machines(struct builder *b, const struct synth_solid *house)
{
    struct dice *d = &b->lots;
    int n = (int)city_roll(d, 0, 3.99);
    for (int i = 0; i < n; i++) {
        double hx = city_roll(d, 0.5, 1.7), hy = city_roll(d, 0.5, 1.4);
        double u = city_roll(d, -0.7, 0.7) * (house->half_m[0] - hx),
               v = city_roll(d, -0.7, 0.7) * (house->half_m[1] - hy);
        struct synth_solid m = {.kind = SYNTH_BOX,
                                .material = SYNTH_SHED,
                                .cos_yaw = house->cos_yaw,
                                .sin_yaw = house->sin_yaw,
                                .half_m = {hx, hy},
                                .z0_m = house->z1_m,
                                .z1_m = house->z1_m + city_roll(d, 0.7, 2.2)};
        m.center_m[0] = house->center_m[0] + u * house->cos_yaw - v * house->sin_yaw;
        m.center_m[1] = house->center_m[1] + u * house->sin_yaw + v * house->cos_yaw;
        float grey = (float)city_roll(d, 0.3, 0.62);
        city_set_color(&m, (const float[3]){1, 1, 1.03f}, (double)grey);
        city_add(b, &m);
    }
}

static void city_add_house(struct builder *b, struct rect r)
{
    struct dice *d = &b->lots;
    double inset = city_roll(d, 0.9, 2.2), hx = 0.5 * (r.x1 - r.x0) - inset,
           hy = 0.5 * (r.y1 - r.y0) - inset;
    if (hx < 2 || hy < 2)
        return;
    double x = 0.5 * (r.x0 + r.x1), y = 0.5 * (r.y0 + r.y1), half = b->city->half_m;
    double center = exp(-(x * x + y * y) / (0.25 * half * half)); /* taller towards the middle */
    double floors = floor(city_roll(d, 2, 4.5) + center * city_roll(d, 0, 4.5));
    struct synth_solid h = {.kind = SYNTH_BOX,
                            .material = SYNTH_HOUSE,
                            .center_m = {x, y},
                            .half_m = {hx, hy},
                            .z1_m = 3.1 * floors + 0.6};
    double yaw = city_chance(d, 0.12) ? city_roll(d, -0.12, 0.12) : 0;
    if (yaw != 0 && hx > 3 && hy > 3)
        h.half_m[0] -= 0.8, h.half_m[1] -= 0.8;
    bool gable = floors <= 3 && hx < 9 && hy < 9 && city_chance(d, 0.7);
    if (gable && hy > hx) { /* the ridge runs along the longer side, which is local x */
        yaw += M_PI / 2;
        double t = h.half_m[0];
        h.half_m[0] = h.half_m[1];
        h.half_m[1] = t;
    }
    h.cos_yaw = cos(yaw);
    h.sin_yaw = sin(yaw);
    size_t n = sizeof wall_colors / sizeof *wall_colors;
    city_set_color(&h, wall_colors[(size_t)city_roll(d, 0, (double)n - 0.01)],
                   city_roll(d, 0.85, 1.1));
    if (gable) {
        h.kind = SYNTH_GABLE;
        h.ridge_m = h.z1_m + h.half_m[1] * city_roll(d, 0.55, 0.95);
        city_add(b, &h);
        return;
    }
    city_add(b, &h);
    if (floors >= 4 && hx > 5 && hy > 5 && city_chance(d, 0.45)) { /* a set-back top */
        struct synth_solid top = h;
        top.half_m[0] *= city_roll(d, 0.45, 0.75);
        top.half_m[1] *= city_roll(d, 0.45, 0.75);
        top.z0_m = h.z1_m;
        top.z1_m = h.z1_m + 3.1 * floor(city_roll(d, 1, 3.2));
        city_add(b, &top);
    } else
        city_add_roof_machines(b, &h);
}

static void city_add_park(struct builder *b, struct rect r)
{
    double area = (r.x1 - r.x0) * (r.y1 - r.y0);
    int n = 2 + (int)(area / 28);
    for (int i = 0; i < n; i++)
        city_add_tree(b, city_roll(&b->trees, r.x0 + 1.5, r.x1 - 1.5),
                      city_roll(&b->trees, r.y0 + 1.5, r.y1 - 1.5), city_roll(&b->trees, 0.6, 1.5));
}

static void city_add_car_park(struct builder *b, struct rect r)
{
    for (double y = r.y0 + 3.2; y < r.y1 - 2.5; y += 7.2)
        for (double x = r.x0 + 2; x < r.x1 - 1.5; x += 2.7)
            if (city_chance(&b->cars, 0.62))
                city_add_car(b, x, y, M_PI / 2 + city_roll(&b->cars, -0.03, 0.03));
}

static void city_fill_lot(struct builder *b, struct rect r)
{
    struct dice *d = &b->lots;
    double w = r.x1 - r.x0, h = r.y1 - r.y0, limit = city_roll(d, 13, 22);
    if (fmax(w, h) > limit && fmax(w, h) > 12) {
        double cut = city_roll(d, 0.4, 0.6);
        struct rect p = r, q = r;
        if (w > h)
            p.x1 = q.x0 = r.x0 + cut * w;
        else
            p.y1 = q.y0 = r.y0 + cut * h;
        city_fill_lot(b, p);
        city_fill_lot(b, q);
        return;
    }
    double kind = city_roll(d, 0, 1);
    if (kind < 0.76)
        city_add_house(b, r);
    else if (kind < 0.9)
        city_add_park(b, r);
    else
        city_add_car_park(b, r);
    if (kind < 0.76 && city_chance(d, 0.5)) /* a tree in a corner of the yard */
        city_add_tree(b, r.x0 + 0.8, r.y0 + 0.8, city_roll(&b->trees, 0.4, 0.7));
}

/* ---- streets ---- */

static void city_lay_streets(struct synth_city *c, double extent_m)
{
    struct dice d = {c->seed, SYNTH_STREAM_STREETS, 0};
    size_t n = (size_t)fmax(1, floor(extent_m / block_m + 0.5));
    if (n > SYNTH_STREETS_MAX - 1)
        n = SYNTH_STREETS_MAX - 1;
    double pitch = extent_m / (double)n;
    for (int axis = 0; axis < 2; axis++) {
        c->n_streets[axis] = n + 1;
        for (size_t i = 0; i <= n; i++) {
            double jitter = i > 0 && i < n ? city_roll(&d, -0.12, 0.12) * pitch : 0;
            c->street_m[axis][i] = -0.5 * extent_m + (double)i * pitch + jitter;
            c->street_half_m[axis][i] = i % 3 == 1 ? avenue_half_m : street_half_m;
        }
    }
}

/* Parked cars and trees along both sides of a street. `axis` 0: the street runs along y at x = at.
 */
static void city_line_street(struct builder *b, int axis, size_t i)
{
    struct synth_city *c = b->city;
    double at = c->street_m[axis][i], half = c->street_half_m[axis][i];
    for (int side = -1; side <= 1; side += 2)
        for (double s = -c->half_m + 6; s < c->half_m - 6; s += 6.2) {
            bool crossing = false;
            for (size_t k = 0; k < c->n_streets[1 - axis]; k++)
                crossing = crossing ||
                           fabs(s - c->street_m[1 - axis][k]) < c->street_half_m[1 - axis][k] + 5.5;
            if (crossing)
                continue;
            double car = at + side * (half - 1.05), tree = at + side * (half + 1.1);
            if (city_chance(&b->cars, 0.34))
                city_add_car(b, axis ? s : car, axis ? car : s,
                             (axis ? 0 : M_PI / 2) + city_roll(&b->cars, -0.04, 0.04));
            if (city_chance(&b->trees, 0.22))
                city_add_tree(b, axis ? s : tree, axis ? tree : s, city_roll(&b->trees, 0.55, 1.0));
        }
}

static void city_plant_fields(struct builder *b, double extent_m)
{
    double reach = 0.5 * extent_m + fmin(120, extent_m);
    int n = (int)fmin(60000, (4 * reach * reach - extent_m * extent_m) / 260);
    for (int i = 0; i < n; i++) {
        double x = city_roll(&b->trees, -reach, reach), y = city_roll(&b->trees, -reach, reach);
        double size = city_roll(&b->trees, 0.6, 1.7);
        if (fmax(fabs(x), fabs(y)) > 0.5 * extent_m + 9)
            city_add_tree(b, x, y, size);
    }
}

/* Whether no solid reaches into the square. Yaw is covered by the solid's circle. */
static bool city_is_open(const struct synth_city *c, const double at[2], double half_m)
{
    for (size_t i = 0; i < c->n_solids; i++) {
        const struct synth_solid *s = &c->solids[i];
        double reach = half_m + hypot(s->half_m[0], s->half_m[1]);
        if (fmax(fabs(s->center_m[0] - at[0]), fabs(s->center_m[1] - at[1])) < reach)
            return false;
    }
    return true;
}

/* The open place nearest to the middle, on rings of a raster. It depends on the solids alone, so
 * a block of another size changes nothing else of the city. */
static void city_add_block(struct builder *b, double volume_m3)
{
    const struct synth_city *c = b->city;
    const double step = 0.5, edge = cbrt(volume_m3 / block_slope), half = 0.5 * edge;
    const int rings = (int)((c->half_m - half) / step);
    struct synth_solid block = {.kind = SYNTH_BOX,
                                .material = SYNTH_SHED,
                                .cos_yaw = 1,
                                .half_m = {half, half},
                                .z1_m = block_slope * edge,
                                .color = {.46f, .40f, .34f}};
    for (int r = 0; r <= rings; r++)
        for (int y = -r; y <= r; y++)
            for (int x = -r; x <= r; x += abs(y) == r || r == 0 ? 1 : 2 * r) {
                block.center_m[0] = step * x;
                block.center_m[1] = step * y;
                if (city_is_open(c, block.center_m, half + block_clear_m)) {
                    city_add(b, &block);
                    return;
                }
            }
    if (b->rc == ERR_OK)
        b->rc = err_set(b->e, ERR_ARG,
                        "synth: no open ground of %.1f m x %.1f m for a block of %g m3; choose a "
                        "smaller --block-m3, a larger --extent-m or another --seed",
                        edge, edge, volume_m3);
}

/* Axes and sun: those of a seed. */
static void city_orient(struct synth_city *c, uint32_t seed)
{
    c->yaw_rad = (rng_unit(seed, SYNTH_STREAM_YAW, 0) - 0.5) * 0.9;
    double azimuth = 2 * M_PI * rng_unit(seed, SYNTH_STREAM_YAW, 1);
    double rise = 0.75 + 0.25 * rng_unit(seed, SYNTH_STREAM_YAW, 2); /* 43 to 57 degrees */
    c->sun[0] = cos(rise) * cos(azimuth);
    c->sun[1] = cos(rise) * sin(azimuth);
    c->sun[2] = sin(rise);
}

static struct builder city_builder(struct synth_city *c, struct err *e)
{
    return (struct builder){.city = c,
                            .lots = {c->seed, SYNTH_STREAM_LOTS, 0},
                            .e = e,
                            .trees = {c->seed, SYNTH_STREAM_TREES, 0},
                            .cars = {c->seed, SYNTH_STREAM_CARS, 0}};
}

/* Blocks and streets; only the fields are missing. */
static void city_build(struct builder *b)
{
    const struct synth_city *c = b->city;
    for (size_t i = 0; i + 1 < c->n_streets[0]; i++)
        for (size_t j = 0; j + 1 < c->n_streets[1]; j++) {
            struct rect r = {c->street_m[0][i] + c->street_half_m[0][i] + sidewalk_m,
                             c->street_m[1][j] + c->street_half_m[1][j] + sidewalk_m,
                             c->street_m[0][i + 1] - c->street_half_m[0][i + 1] - sidewalk_m,
                             c->street_m[1][j + 1] - c->street_half_m[1][j + 1] - sidewalk_m};
            if (r.x1 - r.x0 > 4 && r.y1 - r.y0 > 4)
                city_fill_lot(b, r);
        }
    for (int axis = 0; axis < 2; axis++)
        for (size_t i = 0; i < c->n_streets[axis]; i++)
            city_line_street(b, axis, i);
}

/* The grid of what was built; after an error nothing is left. */
static enum err_code city_finish(struct builder *b, struct synth_city *out)
{
    struct synth_city *c = b->city;
    if (b->rc == ERR_OK)
        b->rc = synth_grid_make(c->solids, c->n_solids, &c->grid, b->e);
    if (b->rc == ERR_OK)
        *out = *c;
    else
        synth_city_free(c);
    return b->rc;
}

enum err_code synth_city_make(const struct synth_config *cfg, struct synth_city *out, struct err *e)
{
    struct synth_city c = {.seed = (uint32_t)cfg->seed, .half_m = 0.5 * cfg->extent_m};
    struct builder b = city_builder(&c, e);
    city_orient(&c, c.seed);
    c.gloss = cfg->gloss;
    c.tricky = cfg->paint == SYNTH_PAINT_TRICKY;
    city_lay_streets(&c, cfg->extent_m);
    city_build(&b);
    city_plant_fields(&b, cfg->extent_m);
    if (cfg->block_m3 > 0)
        city_add_block(&b, cfg->block_m3);
    return city_finish(&b, out);
}

/* Streets of a district. A street of the whole city has one number, so it goes on next door. */
static void city_lay_district(struct synth_city *c, uint32_t seed, const int64_t at[2])
{
    const double pitch = SYNTH_DISTRICT_M / SYNTH_DISTRICT_BLOCKS;
    for (int axis = 0; axis < 2; axis++) {
        c->n_streets[axis] = SYNTH_DISTRICT_BLOCKS + 1;
        for (size_t i = 0; i <= SYNTH_DISTRICT_BLOCKS; i++) {
            uint64_t number = (uint64_t)(at[axis] * SYNTH_DISTRICT_BLOCKS + (int64_t)i);
            double jitter = rng_unit(seed, SYNTH_STREAM_STREETS, 2 * number + (uint64_t)axis);
            bool inner = i > 0 && i < SYNTH_DISTRICT_BLOCKS;
            c->street_m[axis][i] =
                -c->half_m + (double)i * pitch + (inner ? 0.24 * (jitter - 0.5) * pitch : 0.0);
            c->street_half_m[axis][i] = i % 3 == 1 ? avenue_half_m : street_half_m;
        }
    }
}

enum err_code synth_city_district(uint32_t seed, int64_t column, int64_t row,
                                  struct synth_city *out, struct err *e)
{
    const int64_t at[2] = {column, row};
    uint64_t place = (uint64_t)column << 32 ^ ((uint64_t)row & 0xffffffffu);
    struct synth_city c = {.seed = (uint32_t)rng_u64(seed, SYNTH_STREAM_DISTRICTS, place),
                           .half_m = 0.5 * SYNTH_DISTRICT_M};
    struct builder b = city_builder(&c, e);
    size_t n = 0;
    city_orient(&c, seed);
    city_lay_district(&c, seed, at);
    city_build(&b);
    for (size_t i = 0; i < c.n_solids; i++) /* what stands beyond the border is the neighbour's */
        if (fmax(fabs(c.solids[i].center_m[0]), fabs(c.solids[i].center_m[1])) < c.half_m)
            c.solids[n++] = c.solids[i];
    c.n_solids = n;
    return city_finish(&b, out);
}

void synth_city_free(struct synth_city *c)
{
    synth_grid_free(&c->grid);
    mem_free(c->solids);
    *c = (struct synth_city){0};
}

void synth_city_vehicles(const struct synth_city *c, uint64_t photo, size_t n,
                         struct synth_solid *out)
{
    struct dice d = {c->seed, SYNTH_STREAM_MOVING, photo << 16};
    for (size_t i = 0; i < n; i++) {
        int axis = city_roll(&d, 0, 1) < 0.5;
        size_t k = (size_t)city_roll(&d, 0, (double)c->n_streets[axis] - 0.001);
        double side = city_roll(&d, 0, 1) < 0.5 ? -1 : 1, s = city_roll(&d, -c->half_m, c->half_m);
        double at = c->street_m[axis][k] + side * lane_m * 0.75;
        city_make_car(axis ? s : at, axis ? at : s, (axis ? 0 : M_PI / 2), city_roll(&d, 0, 1),
                      out + 2 * i);
    }
}
