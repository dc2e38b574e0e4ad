/* The cameras of the flight: nadir strips back and forth over the city, then four oblique passes
 * that look north, east, south and west at 48 degrees below the horizon, moved back so that they
 * see the city. And the disturbances of each photograph: light, exposure, GPS noise and outliers,
 * wrong poses.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "scene/synth/synth.h"

static const double oblique_pitch_deg = -48,
                    oblique_height = 0.8; /* of the nadir height above ground */

static double flight_unit(const struct synth_config *cfg, enum synth_stream stream, size_t photo,
                          uint64_t k)
{
    return rng_unit((uint64_t)cfg->seed, stream, (uint64_t)photo * 64 + k);
}

static double flight_normal(const struct synth_config *cfg, enum synth_stream stream, size_t photo,
                            uint64_t k)
{
    return rng_normal((uint64_t)cfg->seed, stream, (uint64_t)photo * 64 + k);
}

struct lens synth_flight_lens(const struct synth_config *cfg)
{
    double w = (double)cfg->width_px, h = (double)cfg->height_px,
           f = 0.5 * w / tan(cfg->fov_deg * M_PI / 360);
    struct lens l = {.model = LENS_PINHOLE,
                     .width_px = (uint32_t)cfg->width_px,
                     .height_px = (uint32_t)cfg->height_px,
                     .params = {f, f, 0.5 * w, 0.5 * h}};
    if (cfg->distorted) { /* a compact camera: barrel, slightly decentred */
        const double p[8] = {
            f, f * 1.001, 0.5 * w + 0.011 * w, 0.5 * h - 0.008 * h, -0.10, 0.035, 0.0008, -0.0011};
        l.model = LENS_OPENCV;
        memcpy(l.params, p, sizeof p);
    }
    return l;
}

/* n positions in a grid over a rectangle of w x h metres, walked back and forth; columns follow the
 * aspect. */
struct strips {
    size_t n, rows, cols;
};

static struct strips flight_strips_make(size_t n)
{
    size_t rows = (size_t)fmax(1, floor(sqrt((double)n) + 0.5));
    return (struct strips){n, rows, (n + rows - 1) / rows};
}

/* Position k as fractions -0.5 .. 0.5 across and along. */
static void flight_strips_at(const struct strips *s, size_t k, double *u, double *v)
{
    size_t row = k / s->cols, col = k % s->cols;
    size_t in_row = row + 1 < s->rows ? s->cols : s->n - (s->rows - 1) * s->cols;
    if (row % 2)
        col = in_row - 1 - col % in_row;
    *u = in_row > 1 ? (double)col / (double)(in_row - 1) - 0.5 : 0;
    *v = s->rows > 1 ? (double)row / (double)(s->rows - 1) - 0.5 : 0;
}

static size_t flight_oblique_count(const struct synth_config *cfg)
{
    return (size_t)((double)cfg->photos * cfg->oblique_share + 0.5);
}

double synth_flight_height(const struct synth_config *cfg)
{
    size_t n_nadir = (size_t)cfg->photos - flight_oblique_count(cfg);
    double fov_y =
        2 * atan(tan(cfg->fov_deg * M_PI / 360) * (double)cfg->height_px / (double)cfg->width_px);
    if (cfg->altitude_m > 0)
        return cfg->altitude_m;
    /* neighbours of the nadir grid overlap by about 70 % */
    return fmax(45, cfg->extent_m / fmax(1, sqrt((double)n_nadir) - 1) / (0.6 * tan(0.5 * fov_y)));
}

static struct camera flight_photo_camera(const struct synth_config *cfg, size_t i, double yaw_rad)
{
    size_t n_oblique = flight_oblique_count(cfg), n_nadir = (size_t)cfg->photos - n_oblique;
    double fov_y =
        2 * atan(tan(cfg->fov_deg * M_PI / 360) * (double)cfg->height_px / (double)cfg->width_px);
    double height = synth_flight_height(cfg);
    double u, v, heading = 0, pitch = -90, back = 0, x, y;
    double side = 0.78 * cfg->extent_m; /* photographs reach half a picture farther */
    if (i < n_nadir) {
        struct strips s = flight_strips_make(n_nadir);
        flight_strips_at(&s, i, &u, &v);
        x = u * side;
        y = v * side;
        heading = (i / s.cols) % 2 ? 180 : 0;
    } else {
        size_t k = i - n_nadir, quarter = (n_oblique + 3) / 4, pass = k / quarter;
        struct strips s = flight_strips_make(pass < 3 ? quarter : n_oblique - 3 * quarter);
        flight_strips_at(&s, k % quarter, &u, &v);
        height *= oblique_height;
        heading = 90 * (double)pass;
        pitch = oblique_pitch_deg;
        back = height / tan(-oblique_pitch_deg * M_PI / 180);
        x = u * side * 0.9;
        y = v * side * 0.9;
    }
    x += 0.01 * height * flight_normal(cfg, SYNTH_STREAM_FLIGHT, i, 0);
    y += 0.01 * height * flight_normal(cfg, SYNTH_STREAM_FLIGHT, i, 1);
    double z = height * (1 + 0.008 * flight_normal(cfg, SYNTH_STREAM_FLIGHT, i, 2));
    x -= back *
         sin(heading * M_PI / 180); /* in the city's frame, so passes look along its streets */
    y -= back * cos(heading * M_PI / 180);
    double eye[3] = {x * cos(yaw_rad) - y * sin(yaw_rad), x * sin(yaw_rad) + y * cos(yaw_rad), z};
    heading += -yaw_rad * 180 / M_PI + 1.5 * flight_normal(cfg, SYNTH_STREAM_FLIGHT, i, 3);
    pitch += 0.7 * flight_normal(cfg, SYNTH_STREAM_FLIGHT, i, 4);
    struct camera cam = camera_heading(eye, heading, pitch, fov_y, (uint32_t)cfg->width_px,
                                       (uint32_t)cfg->height_px);
    struct lens l = synth_flight_lens(cfg);
    lens_focal(&l, &cam.fx_px, &cam.fy_px, &cam.cx_px, &cam.cy_px);
    return cam;
}

static void flight_photo_light(const struct synth_config *cfg, size_t i, struct synth_photo *p)
{
    p->light = synth_shade_light();
    p->exposure_ev = cfg->exposure_ev * flight_normal(cfg, SYNTH_STREAM_LIGHT, i, 0);
    double warm = cfg->white_balance * flight_normal(cfg, SYNTH_STREAM_LIGHT, i, 1);
    double sun = cfg->sun_variation * flight_normal(cfg, SYNTH_STREAM_LIGHT, i, 2);
    double tint = 0.4 * cfg->sun_variation * flight_normal(cfg, SYNTH_STREAM_LIGHT, i, 3);
    const double balance[3] = {0.5 * warm, 0, -0.5 * warm}, hue[3] = {0.5 * tint, 0, -0.5 * tint};
    for (int k = 0; k < 3; k++) {
        p->light.gain[k] = (float)exp2(p->exposure_ev + balance[k]);
        p->light.sun[k] *= (float)exp2(-fabs(sun) + hue[k]); /* clouds take sun away ... */
        p->light.sky[k] *= (float)exp2(0.35 * fabs(sun));    /* ... and give some of it back */
    }
}

/* A random direction times a length. */
static void flight_shift_by(const struct synth_config *cfg, enum synth_stream stream, size_t i,
                            double length, double out[3])
{
    double d[3], n = 0;
    for (uint64_t k = 0; k < 3; k++) {
        d[k] = flight_normal(cfg, stream, i, 8 + k);
        n += d[k] * d[k];
    }
    for (int k = 0; k < 3; k++)
        out[k] = d[k] * length / sqrt(n);
}

static void flight_photo_errors(const struct synth_config *cfg, size_t i, struct synth_photo *p)
{
    camera_center(&p->cam, p->gps_enu_m);
    for (uint64_t k = 0; k < 3; k++)
        p->gps_enu_m[k] += cfg->gps_sigma_m * flight_normal(cfg, SYNTH_STREAM_GPS, i, k);
    p->flight = 2 * i >= (size_t)cfg->photos;
    if (p->flight)
        p->gps_enu_m[2] += cfg->flight_offset_m;
    p->gps_outlier = flight_unit(cfg, SYNTH_STREAM_OUTLIER, i, 0) < cfg->gps_outlier_share;
    if (p->gps_outlier) {
        double off[3], length = 40 * pow(10, flight_unit(cfg, SYNTH_STREAM_OUTLIER, i, 1));
        flight_shift_by(cfg, SYNTH_STREAM_OUTLIER, i, length, off);
        for (int k = 0; k < 3; k++)
            p->gps_enu_m[k] += off[k];
    }
    p->pose_error = flight_unit(cfg, SYNTH_STREAM_POSE, i, 0) < cfg->pose_error_share;
    if (p->pose_error)
        flight_shift_by(cfg, SYNTH_STREAM_POSE, i, cfg->pose_error_m, p->pose_shift_m);
}

void synth_flight_make(const struct synth_config *cfg, struct synth_photo *out)
{
    double yaw = (rng_unit((uint32_t)cfg->seed, SYNTH_STREAM_YAW, 0) - 0.5) *
                 0.9; /* as in synth_city_make */
    for (size_t i = 0; i < (size_t)cfg->photos; i++) {
        struct synth_photo *p = &out[i];
        *p = (struct synth_photo){.cam = flight_photo_camera(cfg, i, yaw)};
        snprintf(p->name, sizeof p->name, "IMG_%04u.jpg", (unsigned)(i + 1) & 0xffffffu);
        p->vehicles = flight_unit(cfg, SYNTH_STREAM_MOVING, i, 32) < cfg->vehicle_share;
        flight_photo_light(cfg, i, p);
        flight_photo_errors(cfg, i, p);
    }
}
