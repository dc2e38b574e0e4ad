/* The partition as plan.json, for jobs on other machines, and as an SVG for people.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <jansson.h>

#include "codec/scene/scene.h"
#include "scene/cells/cell_plan.h"
#include "scene/cells/partition.h"

enum { PLAN_VERSION = 1, PLAN_SVG_PX = 900, PLAN_SVG_POINTS = 6000 };

static json_t *plan_cell_json(const struct scene *s, const struct partition *p, size_t i)
{
    const struct partition_cell *c = &p->cells[i];
    json_t *names = json_array(), *azimuth = json_array();
    for (size_t k = 0; k < c->n_images; k++)
        json_array_append_new(names, json_string(s->images[c->images[k]].name));
    for (size_t k = 0; k < 8; k++)
        json_array_append_new(azimuth, json_integer(c->azimuth[k]));
    return json_pack("{s:s, s:[f,f], s:[f,f], s:s?, s:I, s:I, s:o, s:o}", "id", c->id, "min_m",
                     c->min_m[0], c->min_m[1], "max_m", c->max_m[0], c->max_m[1], "parent",
                     c->parent >= 0 ? p->cells[c->parent].id : NULL, "by_location",
                     (json_int_t)c->n_location, "points", (json_int_t)c->n_points,
                     "azimuth_octants", azimuth, "photographs", names);
}

enum err_code cell_plan_write(const char *path, const struct scene *s, const struct partition *p,
                              struct err *e)
{
    json_t *cells = json_array();
    json_t *root =
        json_pack("{s:i, s:f, s:f, s:I, s:I, s:o}", "plan_version", PLAN_VERSION, "edge_m",
                  p->edge_m, "share_min", p->share_min, "merged", (json_int_t)p->n_merged,
                  "divided", (json_int_t)p->n_divided, "cells", cells);
    bool bad = !root;
    const struct cell_grid *g = &p->grid;
    if (!bad && g->turned)
        bad = json_object_set_new(root, "grid",
                                  json_pack("{s:f, s:[f,f]}", "yaw_rad", g->yaw_rad, "origin_m",
                                            g->origin_m[0], g->origin_m[1])) != 0;
    for (size_t i = 0; !bad && i < p->n_cells; i++)
        bad = json_array_append_new(cells, plan_cell_json(s, p, i)) != 0;
    enum err_code rc =
        bad ? err_set(e, ERR_MEM, "out of memory for %s", path) : jsonc_write(path, root, e);
    json_decref(root);
    return rc;
}

/* ---- reading ---- */

struct plan_name { /* for finding a photograph by name */
    const char *name;
    uint32_t image;
};

static int plan_name_compare(const void *a, const void *b)
{
    const struct plan_name *x = a, *y = b;
    return strcmp(x->name, y->name);
}

static enum err_code plan_read_images(const json_t *o, const struct plan_name *names,
                                      size_t n_names, struct partition_cell *c, struct arena *a,
                                      struct err *e)
{
    const json_t *list = json_object_get(o, "photographs");
    double by_location = 0.0;
    enum err_code rc = jsonc_num(o, "by_location", &by_location, e);
    if (rc)
        return rc;
    c->n_images = json_array_size(list);
    c->images = arena_get(a, c->n_images + 1, sizeof *c->images);
    if (!c->images)
        return err_set(e, ERR_MEM, "out of memory");
    for (size_t k = 0; k < c->n_images; k++) {
        const char *name = json_string_value(json_array_get(list, k));
        struct plan_name key = {.name = name ? name : ""};
        const struct plan_name *hit =
            bsearch(&key, names, n_names, sizeof *names, plan_name_compare);
        if (!hit)
            return err_set(e, ERR_FORMAT,
                           "photograph '%s' is not in the scene; make the plan again", key.name);
        c->images[k] = hit->image;
    }
    if (!(by_location >= 0.0 && by_location <= (double)c->n_images))
        return err_set(e, ERR_FORMAT, "\"by_location\" is larger than the number of photographs");
    c->n_location = (size_t)by_location;
    return ERR_OK;
}

static enum err_code plan_read_cell(const json_t *o, const struct plan_name *names, size_t n_names,
                                    struct partition_cell *c, struct arena *a, struct err *e)
{
    const char *id = NULL;
    double points = 0.0;
    enum err_code rc = jsonc_text(o, "id", &id, e);
    if (!rc && (!*id || strlen(id) >= sizeof c->id ||
                strspn(id, "abcdefghijklmnopqrstuvwxyz0123456789") != strlen(id)))
        rc = err_set(e, ERR_FORMAT, "\"id\": small letters and digits are expected");
    if (!rc) {
        memcpy(c->id, id, strlen(id) + 1);
        rc = jsonc_nums(o, "min_m", 2, c->min_m, e);
    }
    if (!rc)
        rc = jsonc_nums(o, "max_m", 2, c->max_m, e);
    if (!rc && !(c->min_m[0] < c->max_m[0] && c->min_m[1] < c->max_m[1]))
        rc = err_set(e, ERR_FORMAT, "the box is empty");
    if (!rc)
        rc = jsonc_num(o, "points", &points, e);
    if (!rc && !(points >= 0.0 && points <= 9007199254740992.0)) /* 2^53: whole numbers end */
        rc = err_set(e, ERR_FORMAT, "\"points\": %g is no number of points", points);
    c->n_points = rc ? 0 : (size_t)points;
    const json_t *az = json_object_get(o, "azimuth_octants");
    for (size_t k = 0; k < 8; k++)
        c->azimuth[k] = (uint32_t)json_integer_value(json_array_get(az, k));
    return rc ? rc : plan_read_images(o, names, n_names, c, a, e);
}

static enum err_code plan_read_parents(const json_t *cells, struct partition *p, struct err *e)
{
    for (size_t i = 0; i < p->n_cells; i++) {
        const char *parent = json_string_value(json_object_get(json_array_get(cells, i), "parent"));
        p->cells[i].parent = -1;
        for (size_t j = 0; parent && j < p->n_cells; j++)
            if (!strcmp(p->cells[j].id, parent))
                p->cells[i].parent = (ptrdiff_t)j;
        if (parent && p->cells[i].parent < 0)
            return err_set(e, ERR_FORMAT, "cell %s: its parent '%s' does not exist", p->cells[i].id,
                           parent);
    }
    for (size_t i = 0; i < p->n_cells; i++)
        if (p->cells[i].parent >= 0 && p->cells[p->cells[i].parent].parent >= 0)
            return err_set(e, ERR_FORMAT, "cell %s: its parent is a background cell itself",
                           p->cells[i].id);
    return ERR_OK;
}

static enum err_code plan_read_grid(const json_t *root, struct cell_grid *out, struct err *e)
{
    const json_t *o = json_object_get(root, "grid");
    double yaw_rad = 0.0, origin_m[2] = {0.0, 0.0};
    if (!o)
        return ERR_OK;
    enum err_code rc = jsonc_num(o, "yaw_rad", &yaw_rad, e);
    if (!rc)
        rc = jsonc_nums(o, "origin_m", 2, origin_m, e);
    if (!rc && !(isfinite(yaw_rad) && isfinite(origin_m[0]) && isfinite(origin_m[1])))
        rc = err_set(e, ERR_FORMAT, "\"grid\": numbers are expected");
    *out = cell_grid_make(yaw_rad, origin_m);
    return rc;
}

static enum err_code plan_read_cells(const json_t *root, const struct scene *s,
                                     struct partition *out, struct err *e)
{
    double version = 0.0;
    const json_t *cells = json_object_get(root, "cells");
    enum err_code rc = jsonc_num(root, "plan_version", &version, e);
    if (!rc && version != PLAN_VERSION)
        rc =
            err_set(e, ERR_FORMAT, "plan version %g, this program reads %d", version, PLAN_VERSION);
    if (!rc)
        rc = jsonc_num(root, "edge_m", &out->edge_m, e);
    if (!rc && json_object_get(root, "share_min")) /* plans of before had whole photographs */
        rc = jsonc_num(root, "share_min", &out->share_min, e);
    if (!rc && !(out->share_min >= 0.0 && out->share_min <= 1.0))
        rc = err_set(e, ERR_FORMAT, "\"share_min\": %g is no share", out->share_min);
    if (!rc)
        rc = plan_read_grid(root, &out->grid, e);
    if (!rc && (!json_array_size(cells) || !(out->edge_m > 0.0)))
        rc = err_set(e, ERR_FORMAT, "no cells");
    struct plan_name *names = rc ? NULL : arena_get(&out->arena, s->n_images + 1, sizeof *names);
    out->cells = rc ? NULL : arena_get(&out->arena, json_array_size(cells), sizeof *out->cells);
    if (!rc && (!names || !out->cells))
        rc = err_set(e, ERR_MEM, "out of memory");
    for (size_t i = 0; !rc && i < s->n_images; i++)
        names[i] = (struct plan_name){s->images[i].name, (uint32_t)i};
    if (!rc)
        qsort(names, s->n_images, sizeof *names, plan_name_compare);
    for (size_t i = 0; !rc && i < json_array_size(cells); i++) {
        rc = plan_read_cell(json_array_get(cells, i), names, s->n_images, &out->cells[out->n_cells],
                            &out->arena, e);
        if (rc)
            err_add(e, "cell %zu", i);
        else
            out->n_cells++;
        for (size_t k = 0; !rc && k + 1 < out->n_cells; k++)
            if (!strcmp(out->cells[k].id, out->cells[out->n_cells - 1].id))
                rc = err_set(e, ERR_FORMAT, "cell %zu: the id '%s' is taken by cell %zu", i,
                             out->cells[k].id, k);
    }
    return rc ? rc : plan_read_parents(cells, out, e);
}

enum err_code cell_plan_read(const char *path, const struct scene *s, struct partition *out,
                             struct err *e)
{
    *out = (struct partition){0};
    struct json_t *root = NULL;
    enum err_code rc = jsonc_read(path, &root, e);
    if (rc)
        return rc;
    rc = plan_read_cells(root, s, out, e);
    if (rc) {
        err_add(e, "%s", path);
        partition_free(out);
    }
    json_decref(root);
    return rc;
}

/* ---- the picture ---- */

struct plan_frame { /* metres -> SVG pixels, north up */
    double x0, y1, scale;
};

static double plan_x(const struct plan_frame *f, double x)
{
    return (x - f->x0) * f->scale;
}

static double plan_y(const struct plan_frame *f, double y)
{
    return (f->y1 - y) * f->scale;
}

static void plan_svg_cells(const struct partition *p, const struct plan_frame *f, struct buf *b)
{
    static const char *const fills[] = {"#4e79a7", "#f28e2b", "#59a14f",
                                        "#b07aa1", "#76b7b2", "#edc948"};
    for (size_t i = 0; i < p->n_cells; i++) {
        const struct partition_cell *c = &p->cells[i];
        double x = plan_x(f, c->min_m[0]), y = plan_y(f, c->max_m[1]);
        double w = (c->max_m[0] - c->min_m[0]) * f->scale,
               h = (c->max_m[1] - c->min_m[1]) * f->scale;
        buf_printf(b,
                   "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" fill=\"%s\" "
                   "fill-opacity=\"%s\" stroke=\"#222\"/>\n",
                   x, y, w, h, fills[i % 6], c->parent < 0 ? "0.25" : "0.06");
        buf_printf(b, "<text x=\"%.1f\" y=\"%.1f\" font-weight=\"bold\">%s%s</text>\n", x + 6,
                   y + 18, c->id, c->parent < 0 ? "" : " (background)");
        buf_printf(b, "<text x=\"%.1f\" y=\"%.1f\">%zu + %zu photographs</text>\n", x + 6, y + 34,
                   c->n_location, c->n_images - c->n_location);
        buf_printf(b, "<text x=\"%.1f\" y=\"%.1f\">%zu points</text>\n", x + 6, y + 50,
                   c->n_points);
    }
}

enum err_code cell_plan_svg(const char *path, const struct scene *s, const struct partition *p,
                            struct err *e)
{
    double lo[2] = {HUGE_VAL, HUGE_VAL}, hi[2] = {-HUGE_VAL, -HUGE_VAL};
    for (size_t i = 0; i < p->n_cells; i++)
        for (size_t k = 0; k < 2; k++) {
            lo[k] = fmin(lo[k], p->cells[i].min_m[k] - 0.15 * p->edge_m);
            hi[k] = fmax(hi[k], p->cells[i].max_m[k] + 0.15 * p->edge_m);
        }
    double scale = PLAN_SVG_PX / fmax(hi[0] - lo[0], hi[1] - lo[1]);
    struct plan_frame f = {.x0 = lo[0], .y1 = hi[1], .scale = scale};
    double w = (hi[0] - lo[0]) * scale, h = (hi[1] - lo[1]) * scale;
    struct buf b = {0};
    buf_printf(&b,
               "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%.0f\" height=\"%.0f\" "
               "viewBox=\"0 0 %.0f %.0f\" "
               "font-family=\"sans-serif\" font-size=\"12\">\n<rect width=\"100%%\" "
               "height=\"100%%\" fill=\"#fff\"/>\n",
               w, h + 30, w, h + 30);
    size_t every = s->n_points / PLAN_SVG_POINTS + 1;
    for (size_t i = 0; i < s->n_points; i += every) {
        double on[2];
        cell_grid_from_enu(&p->grid, s->points[i].enu_m[0], s->points[i].enu_m[1], on);
        double x = plan_x(&f, on[0]), y = plan_y(&f, on[1]);
        const uint8_t *c = s->points[i].rgb;
        if (x >= 0.0 && x <= w && y >= 0.0 && y <= h)
            buf_printf(&b, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"0.8\" fill=\"#%02x%02x%02x\"/>\n",
                       x, y, c[0], c[1], c[2]);
    }
    plan_svg_cells(p, &f, &b);
    for (size_t i = 0; i < s->n_images; i++) {
        const struct camera *cam = &s->images[i].cam;
        double at[3];
        camera_center(cam, at);
        cell_grid_from_enu(&p->grid, at[0], at[1], at);
        double x = plan_x(&f, at[0]), y = plan_y(&f, at[1]);
        double c = cos(p->grid.yaw_rad), n = sin(p->grid.yaw_rad); /* 1, 0 along ENU */
        double dx = c * cam->rot[6] + n * cam->rot[7], dy = c * cam->rot[7] - n * cam->rot[6];
        const char *color = s->images[i].split == SCENE_TEST ? "#d62728" : "#111";
        /* The horizontal part of the direction of view; a nadir view has none. */
        buf_printf(&b,
                   "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"%s\"/>"
                   "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"2.5\" fill=\"%s\"/>\n",
                   x, y, x + 14.0 * dx, y - 14.0 * dy, color, x, y, color);
    }
    buf_printf(
        &b,
        "<text x=\"8\" y=\"%.0f\">edge %.4g m; black: training photographs, red: test photographs; "
        "counts: by location + by visibility; up is north turned by %.4g degrees</text>\n</svg>\n",
        h + 20, p->edge_m, p->grid.yaw_rad * 57.29577951308232);
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}
