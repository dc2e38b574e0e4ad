/* COLMAP's binary files, read and written: cameras.bin, images.bin, points3D.bin. All is
 * little-endian.
 *
 *     cameras.bin   u64 n; each: i32 id, i32 model, u64 width, u64 height, f64 params[k]
 *     images.bin    u64 n; each: i32 id, f64 q[4] (w x y z), f64 t[3], i32 camera, name NUL, u64 m,
 *                   m times: f64 x, f64 y, i64 point (-1 = none)
 *     points3D.bin  u64 n; each: u64 id, f64 xyz[3], u8 rgb[3], f64 error, u64 len,
 *                   len times: i32 image, i32 obs
 *
 * A count is compared with the bytes that are left before it is used. A hostile count can therefore
 * not make us allocate more than a small multiple of the file.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <string.h>

#include "codec/scene/colmap.h"
#include "codec/scene/colmap_parse.h"

enum {
    CAMERA_MIN = 24 + 2 * 8,
    IMAGE_MIN = 4 + 7 * 8 + 4 + 1 + 8,
    POINT_MIN = 8 + 24 + 3 + 8 + 8,
    OBS_SIZE = 24,
    TRACK_SIZE = 8
};

/* A count of records of at least `min` bytes each. */
static bool bin_count_read(struct cursor *c, size_t min, size_t *out)
{
    uint64_t n = cursor_u64(c);
    *out = 0;
    if (c->bad || n > cursor_left(c) / min)
        return false;
    *out = (size_t)n;
    return true;
}

static enum err_code bin_count_error(const char *file, const struct cursor *c, struct err *e)
{
    return err_set(e, ERR_FORMAT,
                   "%s: its count of records does not fit its size (%zu bytes after it): truncated",
                   file, cursor_left(c));
}

static enum err_code bin_out_of_memory(const char *file, size_t n, struct err *e)
{
    return err_set(e, ERR_MEM, "%s: out of memory for %zu records", file, n);
}

static enum err_code bin_trailing_check(const char *file, const struct cursor *c, struct err *e)
{
    if (cursor_left(c))
        return err_set(e, ERR_FORMAT, "%s: %zu bytes follow the last record", file, cursor_left(c));
    return ERR_OK;
}

enum err_code colmap_bin_cameras(const struct buf *file, struct colmap_model *m, struct err *e)
{
    static const char name[] = "cameras.bin";
    struct cursor c = cursor_over(file->data, file->size);
    size_t n;
    if (!bin_count_read(&c, CAMERA_MIN, &n))
        return bin_count_error(name, &c, e);
    m->cameras = arena_get(&m->arena, n, sizeof *m->cameras);
    if (!m->cameras)
        return bin_out_of_memory(name, n, e);
    m->n_cameras = n;
    for (size_t i = 0; i < n; i++) {
        struct colmap_camera *cam = &m->cameras[i];
        cam->id = cursor_u32(&c);
        uint32_t model = cursor_u32(&c);
        uint64_t w = cursor_u64(&c), h = cursor_u64(&c);
        struct colmap_lens lens = {0};
        double params[COLMAP_PARAMS_MAX] = {0};
        if (!c.bad && !colmap_lens_find(NULL, model, &lens))
            return err_set(e, ERR_FORMAT, "%s: camera %zu of %zu: unknown model %u", name, i + 1, n,
                           model);
        for (size_t k = 0; k < lens.n_params; k++)
            params[k] = cursor_f64(&c);
        if (c.bad)
            return err_set(e, ERR_FORMAT, "%s: camera %zu of %zu: truncated", name, i + 1, n);
        if (!(w >= 1 && h >= 1 && w <= 1 << 20 && h <= 1 << 20))
            return err_set(e, ERR_FORMAT, "%s: camera %zu of %zu: impossible size %llu x %llu px",
                           name, i + 1, n, (unsigned long long)w, (unsigned long long)h);
        cam->lens.width_px = (uint32_t)w;
        cam->lens.height_px = (uint32_t)h;
        const char *why = colmap_set_lens(&lens, params, cam);
        if (why)
            return err_set(e, ERR_FORMAT, "%s: camera %zu of %zu: %s", name, i + 1, n, why);
    }
    return bin_trailing_check(name, &c, e);
}

static char *bin_name_read(struct cursor *c, struct arena *a)
{
    const uint8_t *end = c->bad ? NULL : memchr(c->p, 0, cursor_left(c));
    if (!end) {
        c->bad = true;
        return NULL;
    }
    size_t n = (size_t)(end - c->p) + 1;
    const uint8_t *p = cursor_take(c, n);
    char *out = arena_get(a, n, 1);
    if (out)
        memcpy(out, p, n);
    return out;
}

static enum err_code bin_image_read_record(struct cursor *c, struct colmap_model *m,
                                           struct colmap_image *im, struct err *e)
{
    im->id = cursor_u32(c);
    for (int k = 0; k < 4; k++)
        im->quat_wxyz[k] = cursor_f64(c);
    for (int k = 0; k < 3; k++)
        im->trans[k] = cursor_f64(c);
    im->camera = cursor_u32(c);
    im->name = bin_name_read(c, &m->arena);
    if (!c->bad && !im->name)
        return err_set(e, ERR_MEM, "out of memory");
    if (c->bad || !bin_count_read(c, OBS_SIZE, &im->n_obs))
        return err_set(e, ERR_FORMAT, "truncated");
    im->obs = arena_get(&m->arena, im->n_obs, sizeof *im->obs);
    if (!im->obs)
        return err_set(e, ERR_MEM, "out of memory for %zu observations", im->n_obs);
    for (size_t j = 0; j < im->n_obs; j++) {
        im->obs[j].x_px = cursor_f64(c);
        im->obs[j].y_px = cursor_f64(c);
        im->obs[j].point = (int64_t)cursor_u64(c);
    }
    const char *why = colmap_check_image(im);
    return why ? err_set(e, ERR_FORMAT, "%s", why) : ERR_OK;
}

enum err_code colmap_bin_images(const struct buf *file, struct colmap_model *m, struct err *e)
{
    static const char name[] = "images.bin";
    struct cursor c = cursor_over(file->data, file->size);
    size_t n;
    if (!bin_count_read(&c, IMAGE_MIN, &n))
        return bin_count_error(name, &c, e);
    m->images = arena_get(&m->arena, n, sizeof *m->images);
    if (!m->images)
        return bin_out_of_memory(name, n, e);
    m->n_images = n;
    for (size_t i = 0; i < n; i++) {
        struct err inner = {0};
        enum err_code rc = bin_image_read_record(&c, m, &m->images[i], &inner);
        if (rc)
            return err_set(e, rc, "%s: image %zu of %zu: %s", name, i + 1, n, inner.msg);
    }
    return bin_trailing_check(name, &c, e);
}

/* Sum of all track lengths: tracks are one array, so its size must be known first. */
static bool bin_tracks_count(struct cursor c, size_t n, size_t *total)
{
    *total = 0;
    for (size_t i = 0; i < n; i++) {
        size_t len;
        cursor_take(&c, POINT_MIN - 8);
        if (!bin_count_read(&c, TRACK_SIZE, &len))
            return false;
        cursor_take(&c, len * TRACK_SIZE);
        *total += len;
    }
    return true;
}

enum err_code colmap_bin_points(const struct buf *file, struct colmap_model *m, struct err *e)
{
    static const char name[] = "points3D.bin";
    struct cursor c = cursor_over(file->data, file->size);
    size_t n, total = 0;
    if (!bin_count_read(&c, POINT_MIN, &n))
        return bin_count_error(name, &c, e);
    bool whole =
        bin_tracks_count(c, n, &total); /* a truncated file is read up to the record to be named */
    m->points = arena_get(&m->arena, n, sizeof *m->points);
    m->tracks = arena_get(&m->arena, total, sizeof *m->tracks);
    if (!m->points || !m->tracks)
        return bin_out_of_memory(name, n + total, e);
    m->n_points = n;
    m->n_tracks = total;
    size_t at = 0;
    for (size_t i = 0; i < n; i++) {
        struct colmap_point *p = &m->points[i];
        p->id = cursor_u64(&c);
        for (int k = 0; k < 3; k++)
            p->xyz[k] = cursor_f64(&c);
        for (int k = 0; k < 3; k++)
            p->rgb[k] = cursor_u8(&c);
        p->error_px = cursor_f64(&c);
        if (!bin_count_read(&c, TRACK_SIZE, &p->n_track))
            return err_set(e, ERR_FORMAT, "%s: point %zu of %zu: truncated", name, i + 1, n);
        p->track = at;
        for (size_t k = 0; k < p->n_track; k++, at++) {
            m->tracks[at].image = cursor_u32(&c);
            m->tracks[at].obs = cursor_u32(&c);
        }
    }
    if (!whole)
        return err_set(e, ERR_FORMAT, "%s: truncated", name);
    return bin_trailing_check(name, &c, e);
}

/* ---- writing ---- */

static void bin_cameras_write(const struct colmap_model *m, struct buf *b)
{
    buf_u64(b, m->n_cameras);
    for (size_t i = 0; i < m->n_cameras; i++) {
        const struct colmap_camera *c = &m->cameras[i];
        buf_u32(b, c->id);
        buf_u32(b, (uint32_t)c->lens.model);
        buf_u64(b, c->lens.width_px);
        buf_u64(b, c->lens.height_px);
        for (size_t k = 0; k < lens_param_count(c->lens.model); k++)
            buf_f64(b, c->lens.params[k]);
    }
}

static void bin_images_write(const struct colmap_model *m, struct buf *b)
{
    buf_u64(b, m->n_images);
    for (size_t i = 0; i < m->n_images; i++) {
        const struct colmap_image *im = &m->images[i];
        buf_u32(b, im->id);
        for (int k = 0; k < 4; k++)
            buf_f64(b, im->quat_wxyz[k]);
        for (int k = 0; k < 3; k++)
            buf_f64(b, im->trans[k]);
        buf_u32(b, m->cameras[im->camera].id);
        buf_add(b, im->name, strlen(im->name) + 1);
        buf_u64(b, im->n_obs);
        for (size_t j = 0; j < im->n_obs; j++) {
            int64_t p = im->obs[j].point;
            buf_f64(b, im->obs[j].x_px);
            buf_f64(b, im->obs[j].y_px);
            buf_u64(b, p < 0 ? UINT64_MAX : m->points[p].id);
        }
    }
}

static void bin_points_write(const struct colmap_model *m, struct buf *b)
{
    buf_u64(b, m->n_points);
    for (size_t i = 0; i < m->n_points; i++) {
        const struct colmap_point *p = &m->points[i];
        buf_u64(b, p->id);
        for (int k = 0; k < 3; k++)
            buf_f64(b, p->xyz[k]);
        buf_add(b, p->rgb, 3);
        buf_f64(b, p->error_px);
        buf_u64(b, p->n_track);
        for (size_t k = 0; k < p->n_track; k++) {
            buf_u32(b, m->images[m->tracks[p->track + k].image].id);
            buf_u32(b, m->tracks[p->track + k].obs);
        }
    }
}

enum err_code colmap_write_bin(const char *dir, const struct colmap_model *m, struct err *e)
{
    static const char *const names[] = {"cameras.bin", "images.bin", "points3D.bin"};
    static void (*const writers[])(const struct colmap_model *, struct buf *) = {
        bin_cameras_write, bin_images_write, bin_points_write};
    enum err_code rc = file_mkdir(dir, e);
    for (int i = 0; i < 3 && !rc; i++) {
        char path[FILE_PATH_MAX];
        struct buf b = {0};
        writers[i](m, &b);
        rc = buf_check(&b, e);
        if (!rc)
            rc = file_join(path, dir, names[i], e);
        if (!rc)
            rc = file_write(path, b.data, b.size, e);
        buf_free(&b);
    }
    return rc;
}
