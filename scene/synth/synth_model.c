/* The COLMAP model of the procedural city, as structure from motion would find it.
 *
 * Points are places that random pixels see. A photograph observes a point if a ray from its camera
 * reaches it. Pixels and places have a little noise. Poses are exact unless the options ask for
 * wrong ones. The model is in a frame with a random rotation, scale and shift, like a
 * reconstruction without GPS.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "codec/scene/colmap.h"
#include "scene/synth/synth.h"

static const double noise_px = 0.35,
                    place_noise_px = 0.4;             /* of a feature; of its triangulated place */
static const double reach_rel = 1e-5, reach_m = 0.02; /* a ray this near its goal has reached it */
enum { TRACK_MIN = 2 };

struct synth_similarity synth_model_frame(const struct synth_config *cfg)
{
    struct synth_similarity f;
    uint64_t seed = (uint64_t)cfg->seed;
    double q[4];
    for (uint64_t k = 0; k < 4; k++)
        q[k] = rng_normal(seed, SYNTH_STREAM_FRAME, k);
    camera_quat_to_rot(q, f.rot);
    f.scale = cfg->extent_m * 0.1 * exp2(2 * rng_unit(seed, SYNTH_STREAM_FRAME, 16) - 1);
    for (uint64_t k = 0; k < 3; k++)
        f.trans[k] = cfg->extent_m * (rng_unit(seed, SYNTH_STREAM_FRAME, 20 + k) - 0.5);
    return f;
}

struct sighting { /* of point `point` in photograph `image` */
    uint32_t point, image;
    double x_px, y_px;
};

struct maker {
    const struct synth_config *cfg;
    const struct synth_city *city;
    const struct synth_photo *photos;
    const struct synth_similarity *frame;
    struct lens lens;
    size_t n_photos;
    struct sighting *list;
    size_t n, cap;
    struct colmap_point *points; /* xyz in ENU until the end; track = first sighting */
    size_t n_points;
};

static void model_enu_to_city(const struct synth_city *c, const double v[3], double out[3])
{
    double cs = cos(c->yaw_rad), sn = sin(c->yaw_rad);
    out[0] = cs * v[0] + sn * v[1];
    out[1] = -sn * v[0] + cs * v[1];
    out[2] = v[2];
}

static void model_city_to_enu(const struct synth_city *c, const double v[3], double out[3])
{
    double cs = cos(c->yaw_rad), sn = sin(c->yaw_rad);
    out[0] = cs * v[0] - sn * v[1];
    out[1] = sn * v[0] + cs * v[1];
    out[2] = v[2];
}

/* Pixel of an ENU place; false when it is behind or outside. */
static bool model_project(const struct lens *lens, const struct camera *cam, const double p[3],
                          double *u, double *v)
{
    double t[3];
    for (int i = 0; i < 3; i++)
        t[i] = cam->rot[3 * i] * p[0] + cam->rot[3 * i + 1] * p[1] + cam->rot[3 * i + 2] * p[2] +
               cam->trans[i];
    if (!(t[2] > 0.1))
        return false;
    double x = t[0] / t[2], y = t[1] / t[2];
    if (fabs(x * cam->fx_px) > cam->width_px || fabs(y * cam->fy_px) > cam->height_px)
        return false; /* far outside, where a distortion may fold back */
    lens_distort(lens, x, y, u, v);
    return *u >= 0 && *v >= 0 && *u <= cam->width_px && *v <= cam->height_px;
}

static double model_sub_length(const double a[3], const double b[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a[i] - b[i];
    return sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
}

/* Does the straight line from the camera to the place end there? */
static bool model_sees(const struct synth_city *city, const struct camera *cam,
                       const double p_enu[3])
{
    double eye[3], d[3], eye_city[3], d_city[3];
    camera_center(cam, eye);
    double dist = model_sub_length(p_enu, eye, d);
    for (int i = 0; i < 3; i++)
        d[i] /= dist;
    model_enu_to_city(city, eye, eye_city);
    model_enu_to_city(city, d, d_city);
    struct synth_hit hit;
    synth_trace_ray(city, NULL, eye_city, d_city, &hit);
    return hit.t_m > dist - reach_m - reach_rel * dist;
}

bool synth_model_frames(const struct lens *lens, const struct camera *cam,
                        const double place_enu_m[3])
{
    double u, v;
    return model_project(lens, cam, place_enu_m, &u, &v);
}

bool synth_model_sees(const struct synth_city *c, const struct lens *lens, const struct camera *cam,
                      const double place_enu_m[3])
{
    return synth_model_frames(lens, cam, place_enu_m) && model_sees(c, cam, place_enu_m);
}

/* The place that a random pixel sees, in ENU; false for sky. */
static bool model_pick_place(const struct maker *m, uint64_t k, double place[3], uint8_t rgb[3],
                             double *gsd_m)
{
    uint64_t seed = (uint64_t)m->cfg->seed;
    const struct camera *cam = &m->photos[k % m->n_photos].cam;
    double u = rng_unit(seed, SYNTH_STREAM_POINTS, 16 * k) * cam->width_px;
    double v = rng_unit(seed, SYNTH_STREAM_POINTS, 16 * k + 1) * cam->height_px, x, y, d[3], eye[3];
    if (!lens_undistort(&m->lens, u, v, &x, &y))
        return false;
    double len = sqrt(x * x + y * y + 1), eye_city[3], d_city[3];
    for (int i = 0; i < 3; i++)
        d[i] = (cam->rot[i] * x + cam->rot[3 + i] * y + cam->rot[6 + i]) / len;
    camera_center(cam, eye);
    model_enu_to_city(m->city, eye, eye_city);
    model_enu_to_city(m->city, d, d_city);
    struct synth_hit hit;
    synth_trace_ray(m->city, NULL, eye_city, d_city, &hit);
    if (!isfinite(hit.t_m))
        return false;
    struct synth_light light = synth_shade_light();
    float color[3];
    *gsd_m = hit.t_m / cam->fx_px;
    synth_shade_hit(m->city, NULL, &light, d_city, &hit, *gsd_m, color);
    for (int i = 0; i < 3; i++)
        rgb[i] = synth_shade_encode(color[i]);
    model_city_to_enu(m->city, hit.pos, place);
    return true;
}

static enum err_code model_sighting_add(struct maker *m, const struct sighting *s, struct err *e)
{
    struct sighting *grown = mem_room(m->list, m->n, &m->cap, 4096, sizeof *grown);
    if (!grown)
        return err_set(e, ERR_MEM, "synth: out of memory for %zu observations", m->n + 1);
    m->list = grown;
    m->list[m->n++] = *s;
    return ERR_OK;
}

/* Try place k; it becomes a point when enough photographs see it. */
static enum err_code model_point_try(struct maker *m, uint64_t k, struct err *e)
{
    uint64_t seed = (uint64_t)m->cfg->seed;
    struct colmap_point p = {.id = k + 1, .track = m->n};
    double place[3], gsd;
    if (!model_pick_place(m, k, place, p.rgb, &gsd))
        return ERR_OK;
    for (int i = 0; i < 3; i++)
        p.xyz[i] = place[i] + place_noise_px * gsd *
                                  rng_normal(seed, SYNTH_STREAM_POINTS, 16 * k + 4 + (uint64_t)i);
    double error2 = 0;
    for (size_t i = 0; i < m->n_photos; i++) {
        struct sighting s = {(uint32_t)m->n_points, (uint32_t)i, 0, 0};
        const struct camera *cam = &m->photos[i].cam;
        double u, v, un, vn;
        if (!model_project(&m->lens, cam, place, &u, &v) || !model_sees(m->city, cam, place) ||
            !model_project(&m->lens, cam, p.xyz, &un, &vn))
            continue;
        uint64_t at = (k * m->n_photos + i) * 2;
        s.x_px = u + noise_px * rng_normal(seed, SYNTH_STREAM_PIXELS, at);
        s.y_px = v + noise_px * rng_normal(seed, SYNTH_STREAM_PIXELS, at + 1);
        error2 += (s.x_px - un) * (s.x_px - un) + (s.y_px - vn) * (s.y_px - vn);
        enum err_code rc = model_sighting_add(m, &s, e);
        if (rc)
            return rc;
    }
    p.n_track = m->n - p.track;
    if (p.n_track < TRACK_MIN) {
        m->n = p.track;
        return ERR_OK;
    }
    p.error_px = sqrt(error2 / (double)p.n_track);
    m->points[m->n_points++] = p;
    return ERR_OK;
}

/* ENU -> the model's frame. */
static void model_enu_to_model(const struct synth_similarity *f, const double enu[3], double out[3])
{
    double d[3] = {enu[0] - f->trans[0], enu[1] - f->trans[1], enu[2] - f->trans[2]};
    for (int i = 0; i < 3; i++)
        out[i] = (f->rot[i] * d[0] + f->rot[3 + i] * d[1] + f->rot[6 + i] * d[2]) / f->scale;
}

static void model_image_pose(const struct synth_similarity *f, const struct synth_photo *p,
                             struct colmap_image *im)
{
    double rot[9] = {0}, center[3], moved[3], c[3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                rot[3 * i + j] += p->cam.rot[3 * i + k] * f->rot[3 * k + j];
    camera_rot_to_quat(rot, im->quat_wxyz);
    camera_center(&p->cam, center);
    for (int i = 0; i < 3; i++)
        moved[i] = center[i] + p->pose_shift_m[i];
    model_enu_to_model(f, moved, c);
    for (int i = 0; i < 3; i++)
        im->trans[i] = -(rot[3 * i] * c[0] + rot[3 * i + 1] * c[1] + rot[3 * i + 2] * c[2]);
}

/* Sightings by point -> observations by image and tracks by point. */
static enum err_code model_assemble(const struct maker *m, struct colmap_model *out, struct err *e)
{
    struct arena *a = &out->arena;
    out->cameras = arena_get(a, 1, sizeof *out->cameras);
    out->images = arena_get(a, m->n_photos, sizeof *out->images);
    out->points = arena_get(a, m->n_points, sizeof *out->points);
    out->tracks = arena_get(a, m->n, sizeof *out->tracks);
    struct colmap_observation *obs = arena_get(a, m->n, sizeof *obs);
    if (!out->cameras || !out->images || !out->points || !out->tracks || !obs)
        return err_set(e, ERR_MEM, "synth: out of memory for a model of %zu points", m->n_points);
    out->n_cameras = 1;
    out->cameras[0] = (struct colmap_camera){.id = 1, .lens = m->lens};
    out->n_images = m->n_photos;
    out->n_points = m->n_points;
    out->n_tracks = m->n;
    for (size_t k = 0; k < m->n; k++)
        out->images[m->list[k].image].n_obs++;
    for (size_t i = 0; i < m->n_photos; i++) {
        struct colmap_image *im = &out->images[i];
        im->id = (uint32_t)(i + 1);
        im->name = arena_text(a, m->photos[i].name);
        if (!im->name)
            return err_set(e, ERR_MEM, "synth: out of memory");
        im->obs = obs;
        obs += im->n_obs;
        im->n_obs = 0;
        model_image_pose(m->frame, &m->photos[i], im);
    }
    for (size_t p = 0; p < m->n_points; p++) {
        out->points[p] = m->points[p];
        model_enu_to_model(m->frame, m->points[p].xyz, out->points[p].xyz);
        for (size_t k = m->points[p].track; k < m->points[p].track + m->points[p].n_track; k++) {
            const struct sighting *s = &m->list[k];
            struct colmap_image *im = &out->images[s->image];
            out->tracks[k] = (struct colmap_track_element){s->image, (uint32_t)im->n_obs};
            im->obs[im->n_obs++] = (struct colmap_observation){s->x_px, s->y_px, (int64_t)p};
        }
    }
    return ERR_OK;
}

enum err_code synth_model_make(const struct synth_config *cfg, const struct synth_city *city,
                               const struct synth_photo *photos,
                               const struct synth_similarity *frame, struct colmap_model *out,
                               struct err *e)
{
    struct maker m = {.cfg = cfg,
                      .city = city,
                      .photos = photos,
                      .frame = frame,
                      .lens = synth_flight_lens(cfg),
                      .n_photos = (size_t)cfg->photos};
    *out = (struct colmap_model){0};
    m.points = mem_array((size_t)cfg->points, sizeof *m.points);
    enum err_code rc =
        m.points ? ERR_OK : err_set(e, ERR_MEM, "synth: out of memory for the points");
    for (uint64_t k = 0; !rc && k < (uint64_t)cfg->points; k++)
        rc = signals_stopping() ? err_set(e, ERR_CANCEL, "stopped") : model_point_try(&m, k, e);
    if (!rc)
        rc = model_assemble(&m, out, e);
    if (rc)
        colmap_free(out);
    mem_free(m.points);
    mem_free(m.list);
    return rc;
}
