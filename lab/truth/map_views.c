/* Reading and scoring of map views.
 *
 * Measures within the mask ask only for what training could know: surface that three photographs
 * see from different sides. Where no photograph looked, nothing should be drawn, and that is what
 * halo counts; what was hidden from those that looked, below trees and behind walls, should be
 * covered by something. The depth of a drawing is that of the Gaussian at which half of the light
 * is gone: the surface that an eye sees. The mean depth would move with every faint floater in
 * front and every gap behind, at silhouettes above all; the faint ones are counted by veil instead.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/map_views.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/limits.h"
#include "codec/scene/scene.h"
#include "core/math/sort.h"
#include "train/loss/metric.h"

enum { MASK_SUPPORTED = 255, MASK_SEEN = MAP_VIEWS_SEEN };
static const double share_min = 0.01; /* of a picture: smaller masks have no PSNR worth a mean */

/* ---- reading ---- */

/* Both are COLMAP -> own frame; theirs is undone first. */
enum err_code map_views_move(const struct map_move *from, const struct scene *s,
                             struct map_move *out, struct err *e)
{
    if (!(from->scale > 0.0 && isfinite(s->scale / from->scale)))
        return err_set(e, ERR_FORMAT, "colmap_to_enu: scale %g", from->scale);
    out->scale = s->scale / from->scale;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            out->rot[3 * i + j] = 0.0;
            for (int k = 0; k < 3; k++)
                out->rot[3 * i + j] += s->rot[3 * i + k] * from->rot[3 * j + k];
        }
    for (int i = 0; i < 3; i++) {
        out->trans[i] = s->trans[i];
        for (int j = 0; j < 3; j++)
            out->trans[i] -= out->scale * out->rot[3 * i + j] * from->trans[j];
    }
    return ERR_OK;
}

/* x = rot^T (y - trans) / scale. */
struct map_move map_views_move_back(const struct map_move *m)
{
    struct map_move back = {.scale = 1.0 / m->scale};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            back.rot[3 * i + j] = m->rot[3 * j + i];
            back.trans[i] -= back.scale * m->rot[3 * j + i] * m->trans[j];
        }
    return back;
}

static enum err_code map_move_read(const json_t *o, const struct scene *s, struct map_move *out,
                                   struct err *e)
{
    struct map_move from;
    enum err_code rc = jsonc_num(o, "scale", &from.scale, e);
    if (!rc)
        rc = jsonc_nums(o, "rot", 9, from.rot, e);
    if (!rc)
        rc = jsonc_nums(o, "trans", 3, from.trans, e);
    return rc ? err_add(e, "colmap_to_enu") : map_views_move(&from, s, out, e);
}

/* x_cam = W x + t becomes scale x_cam = W rot^T y + t', so depths grow by scale. */
void map_views_move_camera(const struct map_move *m, struct camera *c)
{
    double rot[9];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            rot[3 * i + j] = 0.0;
            for (int k = 0; k < 3; k++)
                rot[3 * i + j] += c->rot[3 * i + k] * m->rot[3 * j + k];
        }
    for (int i = 0; i < 3; i++) {
        c->trans[i] *= m->scale;
        for (int j = 0; j < 3; j++)
            c->trans[i] -= rot[3 * i + j] * m->trans[j];
    }
    memcpy(c->rot, rot, sizeof rot);
}

/* Names become files, so they are plain. */
static enum err_code map_view_word(const json_t *o, const char *key, char out[MAP_VIEWS_NAME],
                                   struct err *e)
{
    const char *text = NULL;
    enum err_code rc = jsonc_text(o, key, &text, e);
    if (rc)
        return rc;
    size_t n = strspn(text, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-");
    if (!n || text[n] || n >= MAP_VIEWS_NAME)
        return err_set(e, ERR_FORMAT,
                       "\"%s\": '%.64s': 1 to %d letters, digits, - and _ are expected", key, text,
                       MAP_VIEWS_NAME - 1);
    memcpy(out, text, n + 1);
    return ERR_OK;
}

static enum err_code map_view_file(const struct map_views *v, const char *name, const char *tail,
                                   char *out, struct err *e)
{
    char file[MAP_VIEWS_NAME + 16];
    snprintf(file, sizeof file, "%s%s", name, tail);
    return file_join(out, v->dir, file, e);
}

/* The photograph in whose light a view is. */
static enum err_code map_view_light(const json_t *o, const struct scene *s, struct map_view *out,
                                    struct err *e)
{
    const char *name = NULL;
    out->photograph = MAP_VIEWS_ONE_LIGHT;
    if (!json_object_get(o, "photograph"))
        return ERR_OK;
    enum err_code rc = jsonc_text(o, "photograph", &name, e);
    for (size_t i = 0; !rc && i < s->n_images; i++)
        if (!strcmp(s->images[i].name, name)) {
            out->photograph = (uint32_t)i;
            return ERR_OK;
        }
    return rc ? rc
              : err_set(e, ERR_DATA,
                        "view %s is in the light of %.64s, which the scene does not have: were "
                        "both made from the same photographs?",
                        out->name, name);
}

static enum err_code map_view_read(struct map_views *v, const json_t *o, const struct scene *s,
                                   const struct map_move *m, struct map_view *out, struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *cam = NULL;
    enum err_code rc = map_view_word(o, "name", out->name, e);
    if (!rc)
        rc = map_view_word(o, "kind", out->kind, e);
    if (!rc)
        rc = map_view_light(o, s, out, e);
    if (!rc)
        rc = map_view_file(v, out->name, ".json", path, e);
    if (!rc)
        rc = jsonc_read(path, &cam, e);
    if (!rc && camera_from_json(cam, &out->cam, e))
        rc = err_add(e, "%s", path);
    json_decref(cam);
    if (!rc)
        map_views_move_camera(m, &out->cam);
    return rc;
}

enum err_code map_views_read(const char *dir, const struct scene *s, struct map_views *out,
                             struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *root = NULL;
    struct map_move m = {0};
    const char *format = NULL;
    *out = (struct map_views){0};
    snprintf(out->dir, sizeof out->dir, "%s", dir);
    enum err_code rc = file_join(path, dir, "views.json", e);
    if (!rc)
        rc = jsonc_read(path, &root, e);
    if (rc)
        return err_add(e, "map views (`citysplat-lab map-views` makes them)");
    const json_t *list = json_object_get(root, "views");
    rc = jsonc_text(root, "format", &format, e);
    if (!rc && strcmp(format, "citysplat-views"))
        rc = err_set(e, ERR_FORMAT, "format '%.40s' instead of citysplat-views", format);
    if (!rc)
        rc = map_move_read(json_object_get(root, "colmap_to_enu"), s, &m, e);
    if (!rc && !json_array_size(list))
        rc = err_set(e, ERR_FORMAT, "\"views\": an array of views is expected");
    if (!rc && !(out->views = mem_array(json_array_size(list), sizeof *out->views)))
        rc = err_set(e, ERR_MEM, "out of memory for %zu views", json_array_size(list));
    for (; !rc && out->n < json_array_size(list); out->n++)
        rc = map_view_read(out, json_array_get(list, out->n), s, &m, &out->views[out->n], e);
    out->scale = m.scale;
    json_decref(root);
    if (rc) {
        map_views_free(out);
        return err_add(e, "%s", path);
    }
    return ERR_OK;
}

void map_views_free(struct map_views *v)
{
    mem_free(v->views);
    *v = (struct map_views){0};
}

/* A grey picture of the camera's size as bytes. */
static enum err_code map_mask_read(const char *path, const struct map_truth *t, uint8_t **out,
                                   struct err *e)
{
    struct image img = {0};
    enum err_code rc = image_read(path, NULL, &img, e);
    size_t n = (size_t)t->width_px * t->height_px;
    if (!rc && (img.width_px != t->width_px || img.height_px != t->height_px))
        rc = err_set(e, ERR_FORMAT, "%s: %u x %u px, its camera has %u x %u", path, img.width_px,
                     img.height_px, t->width_px, t->height_px);
    if (!rc && !(*out = mem_array(n, 1)))
        rc = err_set(e, ERR_MEM, "%s: out of memory", path);
    for (size_t i = 0; !rc && i < n; i++)
        (*out)[i] = img.px[i * img.channels];
    image_free(&img);
    return rc;
}

static enum err_code map_depth_read(const char *path, const struct map_truth *t, double scale,
                                    float **out, struct err *e)
{
    size_t shape[2];
    enum err_code rc = npy_read(path, 2, shape, out, e);
    if (!rc && (shape[0] != t->height_px || shape[1] != t->width_px))
        rc = err_set(e, ERR_FORMAT, "%s: %zu x %zu values, its camera has %u x %u", path, shape[1],
                     shape[0], t->width_px, t->height_px);
    for (size_t i = 0; !rc && i < shape[0] * shape[1]; i++) {
        float d = (*out)[i];
        if (!(d >= 0.0f && isfinite(d)))
            rc = err_set(e, ERR_FORMAT, "%s: value %zu: a depth of 0 or more is expected", path, i);
        (*out)[i] = (float)((double)d * scale);
    }
    return rc;
}

enum err_code map_views_load(const struct map_views *v, size_t i, struct map_truth *out,
                             struct err *e)
{
    char path[FILE_PATH_MAX];
    const struct map_view *view = &v->views[i];
    *out = (struct map_truth){.width_px = view->cam.width_px, .height_px = view->cam.height_px};
    enum err_code rc = map_view_file(v, view->name, ".png", path, e);
    if (!rc)
        rc = image_read(path, NULL, &out->picture, e);
    if (!rc && (out->picture.width_px != out->width_px || out->picture.height_px != out->height_px))
        rc = err_set(e, ERR_FORMAT, "%s: %u x %u px, its camera has %u x %u", path,
                     out->picture.width_px, out->picture.height_px, out->width_px, out->height_px);
    if (!rc)
        rc = map_view_file(v, view->name, "_mask.png", path, e);
    if (!rc)
        rc = map_mask_read(path, out, &out->mask, e);
    if (!rc)
        rc = map_view_file(v, view->name, "_square.png", path, e);
    if (!rc)
        rc = map_mask_read(path, out, &out->square, e);
    if (!rc)
        rc = map_view_file(v, view->name, ".npy", path, e);
    if (!rc)
        rc = map_depth_read(path, out, v->scale, &out->depth_m, e);
    if (rc)
        map_truth_free(out);
    return rc;
}

void map_truth_free(struct map_truth *t)
{
    image_free(&t->picture);
    mem_free(t->mask);
    mem_free(t->square);
    mem_free(t->depth_m);
    *t = (struct map_truth){0};
}

/* ---- scoring ---- */

void map_views_limit(const struct map_truth *t, float *limit_m)
{
    for (size_t i = 0; i < (size_t)t->width_px * t->height_px; i++)
        limit_m[i] =
            t->depth_m[i] > 0.0f ? (float)(1.0 - MAP_VIEWS_HAZE) * t->depth_m[i] : INFINITY;
}

static enum err_code map_sums_reserve(struct map_sums *s, size_t more, struct err *e)
{
    size_t want = s->n_errors + more;
    if (want <= s->cap_errors)
        return ERR_OK;
    want += want / 2;
    float *grown = mem_resize(s->errors, s->cap_errors, want, sizeof *grown);
    if (!grown)
        return err_set(e, ERR_MEM, "map views: out of memory for %zu depths", want);
    s->errors = grown;
    s->cap_errors = want;
    return ERR_OK;
}

/* One line of a mask spread by MAP_VIEWS_EDGE_PX to both sides: how far is the last pixel of it? */
static void map_spread_line(const uint8_t *in, size_t n, size_t step, uint8_t *out)
{
    for (size_t i = 0; i < n; i++)
        out[i * step] = 0;
    for (int back = 0; back < 2; back++) {
        size_t since = MAP_VIEWS_EDGE_PX + 1;
        for (size_t k = 0; k < n; k++) {
            size_t i = (back ? n - 1 - k : k) * step;
            since = in[i] ? 0 : since + 1;
            out[i] |= since <= MAP_VIEWS_EDGE_PX;
        }
    }
}

/* 1 within MAP_VIEWS_EDGE_PX rows and columns of a pixel of the mask; row: scratch, as large. */
static void map_spread(const struct map_truth *t, uint8_t *row, uint8_t *out)
{
    size_t w = t->width_px, h = t->height_px;
    for (size_t y = 0; y < h; y++)
        map_spread_line(t->mask + y * w, w, 1, row + y * w);
    for (size_t x = 0; x < w; x++)
        map_spread_line(row + x, h, w, out + x);
}

/* Depth, haze, veil and halo of the pixels. */
static void map_sums_pixels(struct map_sums *s, const struct map_truth *t,
                            const struct map_drawing *d, const float *limit_m, const uint8_t *edge)
{
    size_t n = (size_t)t->width_px * t->height_px;
    s->n_pixels += (double)n;
    for (size_t i = 0; i < n; i++) {
        double alpha = 1.0 - (double)d->transmittance[i];
        if (!t->mask[i]) {
            s->n_unobserved += 1.0;
            s->sum.halo += alpha;
            s->n_fog += !edge[i];
            s->sum.fog += edge[i] ? 0.0 : alpha;
            continue;
        }
        if (t->mask[i] < MASK_SEEN) {
            s->n_hidden += 1.0;
            s->sum.gaps += alpha;
            continue;
        }
        s->n_seen += 1.0;
        s->sum.haze += d->median_m[i] > 0.0f && d->median_m[i] < limit_m[i];
        s->sum.veil += (double)d->front[i];
        if (t->mask[i] != MASK_SUPPORTED || !(t->depth_m[i] > 0.0f))
            continue;
        double off = fabs((double)d->median_m[i] / (double)t->depth_m[i] - 1.0);
        off = d->median_m[i] > 0.0f && off < 1.0 ? off : 1.0;
        s->errors[s->n_errors++] = (float)off;
        s->sum.depth_above += off > MAP_VIEWS_DEPTH;
    }
}

/* Is enough of the picture in the mask? `only`: pixels of that value become 255, others 0. */
static bool map_mask_pick(const uint8_t *mask, size_t n, uint8_t *out)
{
    size_t used = 0;
    for (size_t i = 0; i < n; i++) {
        out[i] = mask[i] == MASK_SUPPORTED ? 255 : 0;
        used += out[i] != 0;
    }
    return (double)used >= share_min * (double)n;
}

/* Another ground behind the drawing: to is rgb with what `transmittance` lets through of it. */
static void map_before_bright(const struct map_drawing *d, size_t n, float *to)
{
    static const float bright[3] = MAP_VIEWS_BRIGHT;
    for (size_t i = 0; i < 3 * n; i++)
        to[i] = d->rgb[i] + d->transmittance[i / 3] * bright[i % 3];
}

/* `used` and `bright` are scratch, [n] and [n][3]. */
static enum err_code map_sums_colour(struct map_sums *s, const struct map_truth *t,
                                     const struct map_drawing *d, uint8_t *used, float *bright,
                                     struct err *e)
{
    size_t n = (size_t)t->width_px * t->height_px;
    const uint8_t *truth = t->picture.px;
    uint32_t w = t->width_px, h = t->height_px;
    struct metric_scores m, b;
    enum err_code rc = ERR_OK;
    map_before_bright(d, n, bright);
    if (map_mask_pick(t->mask, n, used)) {
        rc = metric_within(d->rgb, truth, used, w, h, &m, e);
        if (!rc)
            rc = metric_within(bright, truth, used, w, h, &b, e);
        if (rc)
            return rc;
        s->sum.n_supported++;
        s->sum.psnr_db += m.psnr_db;
        s->sum.bright_psnr_db += b.psnr_db;
        s->sum.ssim += m.ssim;
        s->sum.gmsd += m.gmsd;
    }
    if (map_mask_pick(t->square, n, used)) {
        rc = metric_within(d->rgb, truth, used, w, h, &m, e);
        if (!rc)
            rc = metric_within(bright, truth, used, w, h, &b, e);
        if (rc)
            return rc;
        s->sum.n_square++;
        s->sum.square_psnr_db += m.psnr_db;
        s->sum.bright_square_psnr_db += b.psnr_db;
    }
    return rc;
}

enum err_code map_sums_add(struct map_sums *s, const struct map_truth *t,
                           const struct map_drawing *d, struct err *e)
{
    size_t n = (size_t)t->width_px * t->height_px;
    float *limit_m = mem_array(n, sizeof *limit_m), *bright = mem_array(n, 3 * sizeof *bright);
    uint8_t *used = mem_array(n, 1), *edge = mem_array(n, 1);
    enum err_code rc = limit_m && bright && used && edge
                           ? map_sums_reserve(s, n, e)
                           : err_set(e, ERR_MEM, "map views: out of memory");
    if (!rc) {
        map_views_limit(t, limit_m);
        map_spread(t, used, edge);
        map_sums_pixels(s, t, d, limit_m, edge);
        s->sum.n_views++;
        rc = map_sums_colour(s, t, d, used, bright, e);
    }
    mem_free(limit_m);
    mem_free(bright);
    mem_free(used);
    mem_free(edge);
    return rc;
}

struct map_score map_sums_score(struct map_sums *s)
{
    struct map_score m = s->sum;
    double supported = (double)m.n_supported, n = (double)s->n_errors;
    m.psnr_db /= supported; /* 0 / 0 is NaN */
    m.bright_psnr_db /= supported;
    m.ssim /= supported;
    m.gmsd /= supported;
    m.square_psnr_db /= (double)m.n_square;
    m.bright_square_psnr_db /= (double)m.n_square;
    m.depth_above /= n;
    m.depth_median = m.depth_95 = (double)NAN;
    if (s->n_errors) {
        m.depth_median = (double)sort_select(s->errors, s->n_errors, s->n_errors / 2);
        m.depth_95 =
            (double)sort_select(s->errors, s->n_errors, (size_t)(0.95 * (double)(s->n_errors - 1)));
    }
    m.halo /= s->n_unobserved;
    m.fog /= s->n_fog;
    m.gaps /= s->n_hidden;
    m.haze /= s->n_seen;
    m.veil /= s->n_seen;
    m.supported = n / s->n_pixels;
    m.unobserved = s->n_unobserved / s->n_pixels;
    return m;
}

void map_sums_free(struct map_sums *s)
{
    mem_free(s->errors);
    *s = (struct map_sums){0};
}
