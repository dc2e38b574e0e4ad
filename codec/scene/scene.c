/* A scene folder: scene.json (origin, transform, cameras, split) and points.bin (points and
 * tracks).
 *
 * scene.json is for people and scripts too; the bulk is binary. points.bin, little-endian:
 *
 *   "CSPT" u32 version = 1, u64 n_points, u64 n_tracks
 *   points: f64 enu_m[3], u8 rgb[3], u8 0, f32 error_px, u32 track_length        (36 bytes)
 *   tracks: u32 point, u32 image, f32 x_px, f32 y_px, sorted by image            (16 bytes)
 *   u64 lo, hi of XXH3-128 over all that precedes
 *
 * points.bin is written before scene.json, which holds its hash, so a half-written pair does not
 * load.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/scene/scene.h"

enum { SCENE_VERSION = 1, POINTS_HEAD = 24, POINT_SIZE = 36, TRACK_SIZE = 16, POINTS_TAIL = 16 };
static const char points_magic[4] = {'C', 'S', 'P', 'T'};

size_t scene_first_track(const struct scene *s, uint32_t image)
{
    size_t lo = 0, hi = s->n_tracks;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (s->tracks[mid].image < image)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

void scene_free(struct scene *s)
{
    arena_free(&s->arena);
    *s = (struct scene){0};
}

/* ---- points.bin ---- */

static enum err_code scene_points_write(const char *path, const struct scene *s,
                                        struct hash128 *hash, struct err *e)
{
    struct buf b = {0};
    buf_add(&b, points_magic, sizeof points_magic);
    buf_u32(&b, SCENE_VERSION);
    buf_u64(&b, s->n_points);
    buf_u64(&b, s->n_tracks);
    for (size_t i = 0; i < s->n_points; i++) {
        const struct scene_point *p = &s->points[i];
        for (int k = 0; k < 3; k++)
            buf_f64(&b, p->enu_m[k]);
        buf_add(&b, p->rgb, 3);
        buf_u8(&b, 0);
        buf_f32(&b, p->error_px);
        buf_u32(&b, p->track_length);
    }
    for (size_t i = 0; i < s->n_tracks; i++) {
        const struct scene_track *t = &s->tracks[i];
        buf_u32(&b, t->point);
        buf_u32(&b, t->image);
        buf_f32(&b, t->x_px);
        buf_f32(&b, t->y_px);
    }
    enum err_code rc = buf_check(&b, e);
    if (!rc) {
        *hash = hash_bytes(b.data, b.size);
        buf_u64(&b, hash->lo);
        buf_u64(&b, hash->hi);
        rc = buf_check(&b, e);
    }
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&b);
    return rc;
}

static enum err_code scene_points_head(const char *path, const struct buf *b, struct cursor *c,
                                       struct scene *s, struct hash128 *hash, struct err *e)
{
    *c = cursor_over(b->data, b->size);
    const uint8_t *magic = cursor_take(c, sizeof points_magic);
    uint32_t version = cursor_u32(c);
    if (!magic || memcmp(magic, points_magic, sizeof points_magic) || version != SCENE_VERSION)
        return err_set(e, ERR_FORMAT, "%s: not the points of a scene, version %d", path,
                       SCENE_VERSION);
    uint64_t np = cursor_u64(c), nt = cursor_u64(c);
    size_t left = cursor_left(c);
    if (c->bad || left < POINTS_TAIL || np > left / POINT_SIZE || nt > left / TRACK_SIZE ||
        np * POINT_SIZE + nt * TRACK_SIZE + POINTS_TAIL != left)
        return err_set(e, ERR_FORMAT, "%s: its size does not fit its counts: truncated", path);
    struct hash128 h = hash_bytes(b->data, b->size - POINTS_TAIL);
    struct cursor tail = cursor_over(b->data + b->size - POINTS_TAIL, POINTS_TAIL);
    if (cursor_u64(&tail) != h.lo || cursor_u64(&tail) != h.hi)
        return err_set(e, ERR_FORMAT, "%s: its hash does not match: corrupt", path);
    *hash = h;
    s->n_points = (size_t)np;
    s->n_tracks = (size_t)nt;
    s->points = arena_get(&s->arena, s->n_points, sizeof *s->points);
    s->tracks = arena_get(&s->arena, s->n_tracks, sizeof *s->tracks);
    if (!s->points || !s->tracks)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu points", path, s->n_points);
    return ERR_OK;
}

/* Needs s->n_images. */
static enum err_code scene_points_read(const char *path, struct scene *s, struct hash128 *hash,
                                       struct err *e)
{
    struct buf b = {0};
    struct cursor c;
    enum err_code rc = file_read(path, (size_t)64 << 30, &b, e);
    if (!rc)
        rc = scene_points_head(path, &b, &c, s, hash, e);
    for (size_t i = 0; !rc && i < s->n_points; i++) {
        struct scene_point *p = &s->points[i];
        for (int k = 0; k < 3; k++) {
            p->enu_m[k] = cursor_f64(&c);
            if (!isfinite(p->enu_m[k]))
                rc = err_set(e, ERR_FORMAT, "%s: point %zu is not finite", path, i);
        }
        for (int k = 0; k < 3; k++)
            p->rgb[k] = cursor_u8(&c);
        cursor_u8(&c);
        p->error_px = cursor_f32(&c);
        p->track_length = cursor_u32(&c);
    }
    for (size_t i = 0; !rc && i < s->n_tracks; i++) {
        struct scene_track *t = &s->tracks[i];
        t->point = cursor_u32(&c);
        t->image = cursor_u32(&c);
        t->x_px = cursor_f32(&c);
        t->y_px = cursor_f32(&c);
        if (t->point >= s->n_points || t->image >= s->n_images ||
            (i && t->image < s->tracks[i - 1].image))
            rc = err_set(e, ERR_FORMAT, "%s: track %zu (point %u, image %u) does not fit the scene",
                         path, i, t->point, t->image);
    }
    buf_free(&b);
    return rc;
}

/* ---- scene.json ---- */

static json_t *scene_to_json(const struct scene *s, struct hash128 points_hash)
{
    char hash[33];
    hash_text(points_hash, hash);
    json_t *images = json_array();
    for (size_t i = 0; images && i < s->n_images; i++)
        if (json_array_append_new(images, scene_image_to_json(&s->images[i]))) {
            json_decref(images);
            images = NULL;
        }
    return json_pack(
        "{s:s, s:i, s:{s:f, s:f, s:f}, s:s, s:{s:f, s:o, s:o}, s:f, s:s?, s:{s:s, s:I, s:I, s:s}, "
        "s:o}",
        "format", "citysplat-scene", "version", SCENE_VERSION, "origin", "lon_deg",
        s->origin.lon_deg, "lat_deg", s->origin.lat_deg, "h_m", s->origin.h_m, "heights",
        s->heights, "colmap_to_enu", "scale", s->scale, "rot", scene_image_numbers(s->rot, 9),
        "trans", scene_image_numbers(s->trans, 3), "vertical_offset_m", s->vertical_offset_m,
        "attribution", s->attribution, "points", "file", "points.bin", "count",
        (json_int_t)s->n_points, "tracks", (json_int_t)s->n_tracks, "hash", hash, "images", images);
}

enum err_code scene_write(const char *dir, const struct scene *s, struct err *e)
{
    char path[FILE_PATH_MAX];
    struct hash128 hash;
    enum err_code rc = file_join(path, dir, "points.bin", e);
    if (!rc)
        rc = scene_points_write(path, s, &hash, e);
    if (!rc)
        rc = file_join(path, dir, "scene.json", e);
    if (rc)
        return rc;
    json_t *json = scene_to_json(s, hash);
    if (!json)
        return err_set(e, ERR_DATA,
                       "%s: cannot be written: a number is not finite, or a name is not UTF-8",
                       path);
    rc = jsonc_write(path, json, e);
    json_decref(json);
    return rc;
}

static enum err_code scene_images_from_json(const json_t *root, struct scene *s, struct err *e)
{
    const json_t *list = json_object_get(root, "images");
    if (!json_is_array(list))
        return err_set(e, ERR_FORMAT, "images: expected a list");
    s->n_images = json_array_size(list);
    s->images = arena_get(&s->arena, s->n_images, sizeof *s->images);
    if (!s->images)
        return err_set(e, ERR_MEM, "out of memory for %zu images", s->n_images);
    for (size_t i = 0; i < s->n_images; i++) {
        enum err_code rc =
            scene_image_from_json(json_array_get(list, i), &s->images[i], &s->arena, e);
        if (rc) {
            err_add(e, "images[%zu]", i);
            return rc;
        }
    }
    return ERR_OK;
}

static enum err_code scene_frame_from_json(const json_t *root, struct scene *s, struct err *e)
{
    const json_t *origin = json_object_get(root, "origin"),
                 *sim = json_object_get(root, "colmap_to_enu");
    const char *text;
    double version;
    enum err_code rc = jsonc_text(root, "format", &text, e);
    if (!rc && strcmp(text, "citysplat-scene"))
        rc = err_set(e, ERR_FORMAT, "format: '%.40s' is not citysplat-scene", text);
    if (!rc)
        rc = jsonc_num(root, "version", &version, e);
    if (!rc && version != SCENE_VERSION)
        rc = err_set(e, ERR_FORMAT, "version: this program reads %d; run ingest again",
                     SCENE_VERSION);
    if (!rc)
        rc = jsonc_num(origin, "lon_deg", &s->origin.lon_deg, e);
    if (!rc)
        rc = jsonc_num(origin, "lat_deg", &s->origin.lat_deg, e);
    if (!rc)
        rc = jsonc_num(origin, "h_m", &s->origin.h_m, e);
    if (!rc && !(fabs(s->origin.lat_deg) <= 90 && fabs(s->origin.lon_deg) <= 360))
        rc = err_set(e, ERR_FORMAT, "origin: not a place on earth");
    if (!rc)
        rc = jsonc_num(sim, "scale", &s->scale, e);
    if (!rc)
        rc = jsonc_nums(sim, "rot", 9, s->rot, e);
    if (!rc)
        rc = jsonc_nums(sim, "trans", 3, s->trans, e);
    if (!rc)
        rc = jsonc_num(root, "vertical_offset_m", &s->vertical_offset_m, e);
    const char *heights = json_string_value(json_object_get(root, "heights"));
    if (!rc && heights && !heights_valid(heights))
        rc = err_set(e, ERR_FORMAT,
                     "heights: '%.40s' is none of ellipsoid, sea-exif, sea, takeoff, unknown, "
                     "unscaled and EPSG:CODE",
                     heights);
    if (!rc && heights)
        snprintf(s->heights, sizeof s->heights, "%s", heights);
    const json_t *who = json_object_get(root, "attribution");
    if (!rc && json_is_string(who) &&
        !(s->attribution = arena_text(&s->arena, json_string_value(who))))
        rc = err_set(e, ERR_MEM, "out of memory");
    return rc;
}

/* The points must be those this scene.json was written with. */
static enum err_code scene_points_match(const json_t *root, const char *path, struct hash128 hash,
                                        struct err *e)
{
    const char *want;
    char got[33];
    enum err_code rc = jsonc_text(json_object_get(root, "points"), "hash", &want, e);
    hash_text(hash, got);
    if (!rc && strcmp(want, got))
        rc = err_set(e, ERR_FORMAT,
                     "%s: does not belong to this scene.json (hash %s, expected %.40s)", path, got,
                     want);
    return rc;
}

enum err_code scene_read(const char *dir, struct scene *out, struct err *e)
{
    char path[FILE_PATH_MAX], points[FILE_PATH_MAX];
    struct scene s = {0};
    json_t *root = NULL;
    enum err_code rc = file_join(path, dir, "scene.json", e);
    if (!rc)
        rc = file_join(points, dir, "points.bin", e);
    if (!rc && !file_exists(path))
        rc = err_set(e, ERR_NOENT,
                     "%s: not found; make a scene with `citysplat ingest PHOTOS SPARSE -o %.200s`",
                     path, dir);
    if (!rc)
        rc = jsonc_read(path, &root, e);
    if (rc)
        goto out;
    rc = scene_frame_from_json(root, &s, e);
    if (!rc)
        rc = scene_images_from_json(root, &s, e);
    if (rc) {
        err_add(e, "%s", path);
        goto out;
    }
    struct hash128 hash = {0};
    rc = scene_points_read(points, &s, &hash, e);
    if (!rc)
        rc = scene_points_match(root, points, hash, e);
    if (!rc) {
        snprintf(s.dir, sizeof s.dir, "%s", dir);
        *out = s;
        s = (struct scene){0};
    }
out:
    json_decref(root);
    scene_free(&s);
    if (rc)
        *out = (struct scene){0};
    return rc;
}
