/* Cells: grid, assignment, rebalancing, ownership, the plan file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/scene/scene.h"
#include "scene/cells/cell.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"
#include "scene/cells/share.h"
#include "scene/cells/window.h"
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include <jansson.h>

/* A flight of nx x ny nadir photographs, `step` metres apart, over flat ground with a point every 2
 * m; each photograph sees a square of 2 * reach metres. Tracks are exact. */
static void flight_make(size_t nx, size_t ny, double step, double reach, struct scene *s)
{
    *s = (struct scene){.scale = 1.0};
    const double height = 50.0;
    const uint32_t px = 200;
    s->n_images = nx * ny;
    s->images = arena_get(&s->arena, s->n_images, sizeof *s->images);
    const double wide = (double)(nx - 1) * step + 2.0 * reach,
                 deep = (double)(ny - 1) * step + 2.0 * reach;
    size_t px_n = (size_t)(wide / 2.0) + 1, py_n = (size_t)(deep / 2.0) + 1;
    s->n_points = px_n * py_n;
    s->points = arena_get(&s->arena, s->n_points, sizeof *s->points);
    s->tracks = arena_get(&s->arena, s->n_points * s->n_images, sizeof *s->tracks);
    for (size_t i = 0; i < s->n_points; i++)
        s->points[i] = (struct scene_point){
            .enu_m = {2.0 * (double)(i % px_n) - reach, 2.0 * (double)(i / px_n) - reach, 0.0},
            .track_length = 3};
    for (size_t i = 0; i < s->n_images; i++) {
        double eye[3] = {step * (double)(i % nx), step * (double)(i / nx), height};
        s->images[i].cam = camera_heading(eye, 0.0, -90.0, 2.0 * atan(reach / height), px, px);
        s->images[i].name = arena_printf(&s->arena, "img%04zu.jpg", i);
        assert_non_null(s->images[i].name);
        for (size_t k = 0; k < s->n_points; k++) {
            double dx = s->points[k].enu_m[0] - eye[0], dy = s->points[k].enu_m[1] - eye[1];
            if (fabs(dx) < reach && fabs(dy) < reach)
                s->tracks[s->n_tracks++] =
                    (struct scene_track){.point = (uint32_t)k,
                                         .image = (uint32_t)i,
                                         .x_px = (float)(100.0 + 100.0 * dx / reach),
                                         .y_px = (float)(100.0 - 100.0 * dy / reach)};
        }
    }
}

/* Squares of this edge; none is merged with a neighbour for few photographs. */
static struct partition_config cells_of(double edge_m)
{
    struct partition_config cfg = partition_defaults();
    cfg.edge_m = edge_m;
    cfg.images_few = 0;
    cfg.images_least = 1;
    return cfg;
}

static void a_grid_covers_every_camera_and_cells_tile_the_plane(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p;
    flight_make(10, 10, 10.0, 15.0, &s);
    struct partition_config cfg = cells_of(30.0);
    kit_ok(partition_make(&s, &cfg, &p, &e), e);
    assert_int_equal(p.n_cells, 9);
    size_t covered = 0;
    for (size_t i = 0; i < s.n_images; i++) {
        double c[3];
        camera_center(&s.images[i].cam, c);
        bool found = false;
        for (size_t j = 0; j < p.n_cells; j++)
            for (size_t k = 0; k < p.cells[j].n_location; k++)
                found |= p.cells[j].images[k] == i;
        covered += found;
        /* Exactly one owner, and it is the half-open box that holds the place. */
        const struct partition_cell *o = &p.cells[partition_owner(&p, c[0], c[1])];
        assert_true(partition_distance(o, c[0], c[1]) == 0.0);
    }
    assert_int_equal(covered, s.n_images);
    /* On a shared border the upper cell owns; outside, the nearest. */
    double border = p.cells[0].max_m[0], y = 0.5 * (p.cells[0].min_m[1] + p.cells[0].max_m[1]);
    assert_int_equal(partition_owner(&p, border, y), 1);
    assert_int_equal(partition_owner(&p, nextafter(border, -1.0), y), 0);
    assert_int_equal(partition_owner(&p, -1e6, y), 0);
    assert_int_equal(partition_owner(&p, 1e6, 1e6), 8);
    partition_free(&p);
    scene_free(&s);
}

static void visibility_adds_photographs_that_look_in(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition with, without;
    flight_make(10, 4, 10.0, 20.0, &s);
    struct partition_config cfg = cells_of(45.0);
    kit_ok(partition_make(&s, &cfg, &with, &e), e);
    cfg.use_visibility = false;
    kit_ok(partition_make(&s, &cfg, &without, &e), e);
    assert_int_equal(with.n_cells, 2);
    for (size_t j = 0; j < 2; j++) {
        const struct partition_cell *c = &with.cells[j];
        assert_int_equal(c->n_location, without.cells[j].n_images);
        /* A photograph at d metres beyond the cell sees 20 - d of its 40 m inside: with threshold
         * 1/6 those up to 13.3 m beyond belong. Location alone takes 4.5 m, and columns are 10 m
         * apart: one more column of 4. */
        assert_int_equal(c->n_images - c->n_location, 4);
        for (size_t k = c->n_location; k < c->n_images; k++) {
            double at[3];
            camera_center(&s.images[c->images[k]].cam, at);
            double d = partition_distance(c, at[0], at[1]);
            assert_true(d > 4.5 && d < 13.4);
        }
    }
    partition_free(&with);
    partition_free(&without);
    scene_free(&s);
}

/* Photographs that look 45 degrees down, north, east, south and west in turn; tracks are exact. */
static void oblique_make(size_t nx, size_t ny, double step, struct scene *s)
{
    const uint32_t px = 200;
    const double height = 30.0;
    *s = (struct scene){.scale = 1.0, .n_images = nx * ny};
    size_t wide = (size_t)((double)(nx - 1) * step / 2.0) + 1,
           deep = (size_t)((double)(ny - 1) * step / 2.0) + 1;
    s->n_points = wide * deep;
    s->images = arena_get(&s->arena, s->n_images, sizeof *s->images);
    s->points = arena_get(&s->arena, s->n_points, sizeof *s->points);
    s->tracks = arena_get(&s->arena, s->n_points * s->n_images, sizeof *s->tracks);
    for (size_t i = 0; i < s->n_points; i++)
        s->points[i] = (struct scene_point){
            .enu_m = {2.0 * (double)(i % wide), 2.0 * (double)(i / wide), 0.0}, .track_length = 3};
    for (size_t i = 0; i < s->n_images; i++) {
        double eye[3] = {step * (double)(i % nx), step * (double)(i / nx), height};
        const struct camera *c = &s->images[i].cam;
        s->images[i].cam = camera_heading(eye, 90.0 * (double)(i % 4), -45.0, 0.9, px, px);
        s->images[i].name = arena_printf(&s->arena, "img%04zu.jpg", i);
        for (size_t k = 0; k < s->n_points; k++) {
            double v[3];
            for (size_t r = 0; r < 3; r++)
                v[r] = c->rot[3 * r] * s->points[k].enu_m[0] +
                       c->rot[3 * r + 1] * s->points[k].enu_m[1] +
                       c->rot[3 * r + 2] * s->points[k].enu_m[2] + c->trans[r];
            double x = c->cx_px + c->fx_px * v[0] / v[2], y = c->cy_px + c->fy_px * v[1] / v[2];
            if (v[2] > 1.0 && x >= 0.0 && x < px && y >= 0.0 && y < px)
                s->tracks[s->n_tracks++] = (struct scene_track){
                    .point = (uint32_t)k, .image = (uint32_t)i, .x_px = (float)x, .y_px = (float)y};
        }
    }
}

/* F14: the photographs of a cell see all of it, though most of them were taken elsewhere. */
static void every_point_of_a_cell_is_seen_by_three_of_its_photographs(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p;
    oblique_make(14, 14, 8.0, &s);
    struct partition_config cfg = cells_of(35.0);
    kit_ok(partition_make(&s, &cfg, &p, &e), e);
    uint32_t *all = mem_array(s.n_points, sizeof *all), *own = mem_array(s.n_points, sizeof *own);
    uint8_t *has = mem_array(s.n_images, 1);
    assert_true(all && own && has && p.n_cells >= 9);
    size_t points = 0, few = 0, selected = 0;
    for (size_t k = 0; k < s.n_tracks; k++)
        all[s.tracks[k].point]++;
    for (size_t j = 0; j < p.n_cells; j++) {
        memset(has, 0, s.n_images);
        memset(own, 0, s.n_points * sizeof *own);
        for (size_t k = 0; k < p.cells[j].n_images; k++)
            has[p.cells[j].images[k]] = 1;
        selected += p.cells[j].n_images;
        for (size_t k = 0; k < s.n_tracks; k++)
            own[s.tracks[k].point] += has[s.tracks[k].image];
        for (size_t k = 0; k < s.n_points; k++) {
            const double *at = s.points[k].enu_m;
            if (all[k] < 3 || partition_distance(&p.cells[j], at[0], at[1]) > 0.0)
                continue; /* at the rim of the flight nobody sees it three times */
            points++;
            few += own[k] < 3;
        }
    }
    kit_figure(
        "F14",
        "points=%zu seen_by_fewer_than_3=%zu limit=0 cells=%zu photographs_a_cell=%zu of=%zu",
        points, few, p.n_cells, selected / p.n_cells, s.n_images);
    assert_true(points > s.n_points / 2 && selected < p.n_cells * s.n_images);
    assert_int_equal(few, 0);
    mem_free(all);
    mem_free(own);
    mem_free(has);
    partition_free(&p);
    scene_free(&s);
}

static void poor_cells_merge_into_rectangles_and_rich_ones_divide(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p;
    flight_make(12, 12, 10.0, 15.0, &s);
    struct partition_config cfg =
        cells_of(20.0); /* 6 x 6 cells of about 9 photographs by location */
    cfg.use_visibility = false;
    cfg.images_few = 12;
    kit_ok(partition_make(&s, &cfg, &p, &e), e);
    assert_true(p.n_merged > 0);
    double area = 0.0;
    for (size_t i = 0; i < p.n_cells; i++) {
        double w = p.cells[i].max_m[0] - p.cells[i].min_m[0],
               h = p.cells[i].max_m[1] - p.cells[i].min_m[1];
        assert_true(fmax(w / h, h / w) <= 2.0 + 1e-9);
        area += w * h;
        for (size_t j = 0; j < i; j++)
            assert_string_not_equal(p.cells[i].id, p.cells[j].id);
    }
    assert_true(fabs(area - 120.0 * 120.0) < 1e-6);
    partition_free(&p);

    cfg.edge_m = 110.0;
    cfg.images_few = 0;
    cfg.images_many = 100;
    kit_ok(partition_make(&s, &cfg, &p, &e), e);
    assert_int_equal(
        p.n_divided,
        1); /* one cell of 144: two halves of 72 and up to two columns of 12 in the overlap */
    assert_int_equal(p.n_cells, 2);
    assert_true(p.cells[0].max_m[0] == p.cells[1].min_m[0] ||
                p.cells[0].max_m[1] == p.cells[1].min_m[1]);
    partition_free(&p);
    scene_free(&s);
}

static void empty_and_tiny_cells_become_background(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p;
    flight_make(10, 10, 10.0, 15.0, &s);
    /* Keep the left half and one photograph at the far right corner. */
    for (size_t i = 0; i < s.n_images; i++)
        if (i % 10 >= 5 && i != 99)
            s.images[i].split = SCENE_TEST;
    struct partition_config cfg = cells_of(18.0);
    cfg.use_visibility = false;
    cfg.images_least = 4;
    kit_ok(partition_make(&s, &cfg, &p, &e), e);
    size_t trained = 0, empty = 0;
    for (size_t i = 0; i < p.n_cells; i++) {
        trained += p.cells[i].parent < 0;
        empty += p.cells[i].n_images == 0;
        if (p.cells[i].n_images < 4)
            assert_true(p.cells[i].parent >= 0);
        if (p.cells[i].parent >= 0)
            assert_true(p.cells[p.cells[i].parent].parent < 0);
    }
    assert_true(trained > 0 && empty > 0);
    for (double x = -50.0; x < 150.0; x += 7.0)
        assert_true(p.cells[partition_owner(&p, x, 40.0)].parent < 0);
    partition_free(&p);
    s.n_images = 0;
    kit_fails(partition_make(&s, &cfg, &p, &e), ERR_DATA, e, "no photographs");
    scene_free(&s);
}

static void the_plan_file_reads_back_and_refuses_another_scene(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p, q;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    kit_tmpdir(dir);
    flight_make(8, 8, 10.0, 15.0, &s);
    struct partition_config cfg = cells_of(30.0);
    cfg.images_few = 10;
    cfg.images_least = 5;
    kit_ok(partition_make(&s, &cfg, &p, &e), e);
    kit_ok(file_join(path, dir, "plan.json", &e), e);
    kit_ok(cell_plan_write(path, &s, &p, &e), e);
    kit_ok(cell_plan_read(path, &s, &q, &e), e);
    assert_int_equal(q.n_cells, p.n_cells);
    for (size_t i = 0; i < p.n_cells; i++) {
        assert_string_equal(q.cells[i].id, p.cells[i].id);
        assert_int_equal(q.cells[i].n_images, p.cells[i].n_images);
        assert_int_equal(q.cells[i].n_location, p.cells[i].n_location);
        assert_int_equal(q.cells[i].parent, p.cells[i].parent);
        assert_memory_equal(q.cells[i].images, p.cells[i].images,
                            p.cells[i].n_images * sizeof(uint32_t));
        assert_memory_equal(q.cells[i].min_m, p.cells[i].min_m, sizeof p.cells[i].min_m);
        assert_memory_equal(q.cells[i].azimuth, p.cells[i].azimuth, sizeof p.cells[i].azimuth);
    }
    partition_free(&q);
    /* Two cells of one id would share a folder. */
    memcpy(p.cells[1].id, p.cells[0].id, sizeof p.cells[0].id);
    kit_ok(cell_plan_write(path, &s, &p, &e), e);
    kit_fails(cell_plan_read(path, &s, &q, &e), ERR_FORMAT, e, "is taken by cell 0");
    snprintf(p.cells[1].id, sizeof p.cells[1].id, "other");
    kit_ok(cell_plan_write(path, &s, &p, &e), e);
    json_t *root; /* more points than there are whole numbers */
    kit_ok(jsonc_read(path, &root, &e), e);
    json_object_set_new(json_array_get(json_object_get(root, "cells"), 0), "points",
                        json_real(1e300));
    kit_ok(jsonc_write(path, root, &e), e);
    json_decref(root);
    kit_fails(cell_plan_read(path, &s, &q, &e), ERR_FORMAT, e, "1e+300");
    kit_ok(cell_plan_write(path, &s, &p, &e), e);
    s.images[3].name = arena_text(&s.arena, "other.jpg");
    kit_fails(cell_plan_read(path, &s, &q, &e), ERR_FORMAT, e, "img0003.jpg");
    kit_ok(file_join(path, dir, "plan.svg", &e), e);
    kit_ok(cell_plan_svg(path, &s, &p, &e), e);
    struct buf b = {0};
    kit_ok(file_read(path, 0, &b, &e), e);
    buf_u8(&b, 0);
    assert_non_null(strstr((char *)b.data, p.cells[0].id));
    buf_free(&b);
    partition_free(&p);
    scene_free(&s);
    kit_rmdir(dir);
}

/* Everything of a scene turned about a place, so that photographs show what they did. */
static void flight_turn(struct scene *s, double yaw_rad, const double o[2])
{
    const double c = cos(yaw_rad), n = sin(yaw_rad);
    for (size_t i = 0; i < s->n_points; i++) {
        double *p = s->points[i].enu_m, x = p[0] - o[0], y = p[1] - o[1];
        p[0] = o[0] + c * x - n * y;
        p[1] = o[1] + n * x + c * y;
    }
    for (size_t i = 0; i < s->n_images; i++) {
        struct camera *cam = &s->images[i].cam;
        for (size_t r = 0; r < 3; r++) {
            double a = cam->rot[3 * r], b = cam->rot[3 * r + 1];
            cam->rot[3 * r] = c * a - n * b;
            cam->rot[3 * r + 1] = n * a + c * b;
            cam->trans[r] += (a - cam->rot[3 * r]) * o[0] + (b - cam->rot[3 * r + 1]) * o[1];
        }
    }
}

/* A turned scene in a turned grid has the cells of the scene in the grid, whose squares meet at the
 * origin. */
static void a_turned_grid_cuts_a_turned_scene_alike(void **state)
{
    enum { PLACES = 200 };
    struct err e = {0};
    struct scene s[2];
    struct partition p[2], again;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    const double yaw_rad = -0.3785, origin_m[2] = {10.0, -56.0};
    for (int k = 0; k < 2; k++) {
        flight_make(10, 10, 10.0, 15.0, &s[k]);
        if (k)
            flight_turn(&s[k], yaw_rad, origin_m);
        struct partition_config cfg = cells_of(30.0);
        cfg.grid = cell_grid_make(k ? yaw_rad : 0.0, origin_m);
        kit_ok(partition_make(&s[k], &cfg, &p[k], &e), e);
    }
    assert_int_equal(p[0].n_cells, 16);
    assert_int_equal(p[1].n_cells, 16);
    for (size_t i = 0; i < p[0].n_cells; i++) {
        const struct partition_cell *a = &p[0].cells[i], *b = &p[1].cells[i];
        assert_string_equal(a->id, b->id);
        for (size_t k = 0; k < 2; k++) {
            assert_true(fabs(remainder(a->min_m[k], 30.0)) < 1e-9); /* meets the origin */
            assert_true(fabs(a->min_m[k] - b->min_m[k]) < 1e-6);
        }
        assert_int_equal(a->n_location, b->n_location);
        assert_int_equal(a->n_images, b->n_images);
        assert_memory_equal(a->images, b->images, a->n_images * sizeof *a->images);
        assert_int_equal(a->n_points, b->n_points);
    }
    kit_tmpdir(dir);
    snprintf(path, sizeof path, "%s/plan.json", dir);
    kit_ok(cell_plan_write(path, &s[1], &p[1], &e), e);
    kit_ok(cell_plan_read(path, &s[1], &again, &e), e);
    for (size_t i = 0; i < PLACES; i++) {
        double x = 140.0 * rng_unit(3, 1, i) - 25.0, y = 140.0 * rng_unit(3, 2, i) - 25.0;
        double u = x - origin_m[0], v = y - origin_m[1];
        double tx = origin_m[0] + cos(yaw_rad) * u - sin(yaw_rad) * v,
               ty = origin_m[1] + sin(yaw_rad) * u + cos(yaw_rad) * v;
        size_t owner = partition_owner(&p[0], x, y);
        assert_int_equal(partition_owner(&p[1], tx, ty), owner);
        assert_int_equal(partition_owner(&again, tx, ty), owner);
        struct cell cell[2];
        for (int k = 0; k < 2; k++)
            cell_planned(&s[k], &p[k], 5, p[k].cells[5].images, p[k].cells[5].n_location, &cell[k]);
        assert_true(fabs(cell_distance(&cell[0], x, y) - cell_distance(&cell[1], tx, ty)) < 1e-6);
        const double lo[2] = {tx - 0.5, ty - 0.5}, hi[2] = {tx + 0.5, ty + 0.5};
        bool deep = cell_distance(&cell[0], x, y) == 0.0 && owner == 5 &&
                    x > p[0].cells[5].min_m[0] + origin_m[0] + 1.0 &&
                    x < p[0].cells[5].max_m[0] + origin_m[0] - 1.0 &&
                    y > p[0].cells[5].min_m[1] + origin_m[1] + 1.0 &&
                    y < p[0].cells[5].max_m[1] + origin_m[1] - 1.0;
        assert_true(!deep || partition_covers(&p[1], 5, lo, hi));
        assert_true(owner == 5 || !partition_covers(&p[1], 5, lo, hi));
    }
    /* A box around the whole turned cell is not within it. */
    const double middle[2] = {0.5 * (p[1].cells[5].min_m[0] + p[1].cells[5].max_m[0]),
                              0.5 * (p[1].cells[5].min_m[1] + p[1].cells[5].max_m[1])};
    double x = origin_m[0] + cos(yaw_rad) * middle[0] - sin(yaw_rad) * middle[1],
           y = origin_m[1] + sin(yaw_rad) * middle[0] + cos(yaw_rad) * middle[1];
    assert_true(partition_covers(&p[1], 5, (double[2]){x, y}, (double[2]){x, y}));
    assert_false(partition_covers(&p[1], 5, (double[2]){x - 14.9, y - 14.9},
                                  (double[2]){x + 14.9, y + 14.9}));
    partition_free(&again);
    for (int k = 0; k < 2; k++) {
        partition_free(&p[k]);
        scene_free(&s[k]);
    }
    kit_rmdir(dir);
}

static void what_lies_outside_of_all_cells_is_owned_by_the_nearest(void **state)
{
    enum { PLACES = 500 };
    struct err e = {0};
    struct scene s;
    struct partition p;
    flight_make(10, 10, 10.0, 25.0, &s); /* points reach 25 m beyond the cameras */
    struct partition_config cfg = cells_of(30.0);
    kit_ok(partition_make(&s, &cfg, &p, &e), e);
    assert_int_equal(p.n_cells, 9);
    size_t outside = 0;
    for (size_t i = 0; i < PLACES; i++) {
        double x = 140.0 * rng_unit(7, 1, i) - 25.0, y = 140.0 * rng_unit(7, 2, i) - 25.0;
        size_t owner = partition_owner(&p, x, y);
        outside += partition_distance(&p.cells[owner], x, y) > 0.0;
        for (size_t k = 0; k < p.n_cells; k++)
            assert_true(partition_distance(&p.cells[k], x, y) >=
                        partition_distance(&p.cells[owner], x, y));
    }
    assert_true(outside > PLACES / 4);
    partition_free(&p);
    scene_free(&s);
}

/* A wide flight, so that photographs show several cells. */
static void parts_make(struct scene *s, struct partition *p, double share_min)
{
    struct err e = {0};
    flight_make(6, 6, 10.0, 30.0, s);
    struct partition_config cfg = cells_of(20.0);
    kit_ok(partition_make(s, &cfg, p, &e), e);
    kit_ok(share_photographs(s, share_min, p, &e), e);
    assert_int_equal(p->n_cells, 9);
}

static void every_photograph_is_shared_out_among_the_cells_that_it_shows(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p;
    parts_make(&s, &p, 1e-6);
    double sum[36] = {0}, most = 0.0, taken = 0.0;
    struct window looked;
    kit_ok(window_open(&s, &p, &looked, &e), e);
    for (size_t i = 0; i < p.n_cells; i++) {
        const struct partition_cell *c = &p.cells[i];
        struct cell cell;
        cell_planned(&s, &p, i, c->images, c->n_location, &cell);
        assert_true(cell.cut && cell.plan == &p && cell.index == i);
        /* what is too large is measured by all cameras, not by those in the cell */
        assert_true(fabs(cell.scene_extent_m - 1.1 * hypot(25.0, 25.0)) < 1e-9);
        assert_true(cell.extent_m < cell.scene_extent_m);
        most = fmax(most, cell.steps_share);
        taken += cell.steps_share;
        for (size_t k = 0; k < c->n_images; k++) {
            const struct camera *cam = &s.images[c->images[k]].cam;
            struct camera_window w;
            kit_ok(window_look(&looked, c->images[k], &e), e);
            assert_true(window_part(&looked, i, &w));
            sum[c->images[k]] += window_share(&looked, i);
            /* what it frames of the cell is in the part */
            struct camera part = camera_crop(cam, &w);
            size_t framed = 0, in_part = 0;
            for (size_t j = 0; j < s.n_points; j++) {
                const double *at = s.points[j].enu_m;
                bool mine = partition_owner(&p, at[0], at[1]) == i;
                framed += mine && camera_frames(cam, at, 0.0, NULL);
                in_part += mine && camera_frames(&part, at, 0.0, NULL);
            }
            assert_true(framed > 0 && in_part == framed);
            assert_true(part.width_px <= cam->width_px && part.height_px <= cam->height_px);
        }
    }
    window_free(&looked);
    for (size_t i = 0; i < s.n_images; i++)
        assert_true(fabs(sum[i] - 1.0) < 1e-9);
    assert_true(fabs(most - 1.0) < 1e-12 && taken < 9.0);
    partition_free(&p);
    scene_free(&s);
}

static void a_part_is_much_smaller_than_the_photograph_and_its_camera_is_shifted(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p;
    parts_make(&s, &p, 0.02);
    struct window looked;
    struct camera_window w;
    kit_ok(window_open(&s, &p, &looked, &e), e);
    kit_ok(window_look(&looked, 14, &e), e);
    const struct camera *cam = &s.images[14].cam; /* east 20, north 20: above the cell's middle */
    assert_true(window_part(&looked, 4, &w));
    /* 20 m of 60 m, a sample and 4 % on each side */
    assert_true(w.x1 - w.x0 > 20.0 / 60.0 && w.x1 - w.x0 < 0.48);
    struct camera part = camera_crop(cam, &w);
    const double place[3] = {22.0, 27.0, 0.0};
    uint32_t at[4];
    double whole[2], cut[2];
    camera_window_px(cam, &w, at);
    assert_true(camera_project(cam, place, 0.1, whole, NULL));
    assert_true(camera_project(&part, place, 0.1, cut, NULL));
    assert_true(fabs(whole[0] - at[0] - cut[0]) < 1e-9 && fabs(whole[1] - at[1] - cut[1]) < 1e-9);
    s.images[14].cam = camera_heading((double[3]){20.0, 20.0, 50.0}, 0.0, 90.0, 1.0, 200, 200);
    kit_ok(window_look(&looked, 14, &e), e);
    assert_int_equal(looked.n_owned, 0); /* looks up */
    assert_false(window_part(&looked, 4, &w));
    assert_true(w.x0 <= 0.0 && w.y0 <= 0.0 && w.x1 >= 1.0 && w.y1 >= 1.0);
    window_free(&looked);
    partition_free(&p);
    scene_free(&s);
}

static void the_plan_says_whether_photographs_are_cut(void **state)
{
    struct err e = {0};
    struct scene s;
    struct partition p, again;
    struct cell cell;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX + 64];
    kit_tmpdir(dir);
    snprintf(path, sizeof path, "%s/plan.json", dir);
    for (int cut = 0; cut < 2; cut++) {
        parts_make(&s, &p, cut ? 0.02 : 0.0);
        kit_ok(cell_plan_write(path, &s, &p, &e), e);
        kit_ok(cell_plan_read(path, &s, &again, &e), e);
        cell_planned(&s, &again, 0, again.cells[0].images, again.cells[0].n_location, &cell);
        assert_int_equal(cell.cut, cut);
        assert_int_equal(cell.steps_share < 1.0, cut);
        assert_int_equal(again.cells[0].n_images, p.cells[0].n_images);
        partition_free(&again);
        partition_free(&p);
        scene_free(&s);
    }
    kit_rmdir(dir);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_grid_covers_every_camera_and_cells_tile_the_plane),
        cmocka_unit_test(visibility_adds_photographs_that_look_in),
        cmocka_unit_test(every_point_of_a_cell_is_seen_by_three_of_its_photographs),
        cmocka_unit_test(poor_cells_merge_into_rectangles_and_rich_ones_divide),
        cmocka_unit_test(empty_and_tiny_cells_become_background),
        cmocka_unit_test(the_plan_file_reads_back_and_refuses_another_scene),
        cmocka_unit_test(a_turned_grid_cuts_a_turned_scene_alike),
        cmocka_unit_test(every_photograph_is_shared_out_among_the_cells_that_it_shows),
        cmocka_unit_test(a_part_is_much_smaller_than_the_photograph_and_its_camera_is_shifted),
        cmocka_unit_test(the_plan_says_whether_photographs_are_cut),
        cmocka_unit_test(what_lies_outside_of_all_cells_is_owned_by_the_nearest),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
