/* A path is positions joined by ';', each written as in the address of a picture:
 * lon,lat,height@heading,pitch. Between them the camera flies straight at its speed, and turns. If
 * turning takes longer than flying, the leg takes that long. The path is sampled about twice a
 * second.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/course.h"

#include <math.h>
#include <string.h>

#include "server/text.h"

static const double COURSE_STEP_S = 0.5, COURSE_TURN_DEG_S = 45, COURSE_SPEED_M_S = 20,
                    COURSE_AHEAD_S = 10;

/* lon,lat,height@heading,pitch */
static enum err_code course_take(struct text *t, struct view_pose *out, struct err *e)
{
    int64_t v[5];
    static const char *const before[5] = {"", ",", ",", "@", ","};
    static const int scale[5] = {7, 7, 3, 3, 3};
    for (int i = 0; i < 5; i++)
        if (!text_take(t, before[i]) || !text_take_fixed(t, scale[i], &v[i]))
            return err_set(e, ERR_FORMAT,
                           "path is lon,lat,height@heading,pitch, or several of them joined by ;");
    *out = (struct view_pose){.lon_deg = (double)v[0] / 1e7,
                              .lat_deg = (double)v[1] / 1e7,
                              .h_m = (double)v[2] / 1e3,
                              .heading_deg = (double)v[3] / 1e3,
                              .pitch_deg = (double)v[4] / 1e3};
    if (fabs(out->lon_deg) > 180 || fabs(out->lat_deg) > 90 || out->h_m < -20e3 || out->h_m > 2e6 ||
        fabs(out->heading_deg) > 360 || fabs(out->pitch_deg) > 90)
        return err_set(
            e, ERR_DATA,
            "of path, longitude is -180..180, latitude and pitch are -90..90 and heading "
            "-360..360 degrees, height is -20000..2000000 m");
    return ERR_OK;
}

static enum err_code course_read_path(const struct target_course *t, struct course *out,
                                      struct err *e)
{
    struct text raw = t->path;
    if (!text_take_decoded(&raw, out->path, sizeof out->path))
        return err_set(e, ERR_FORMAT, "path cannot be read, or is longer than %d bytes",
                       COURSE_TEXT_MAX - 1);
    struct text plain = {out->path, out->path + strlen(out->path)};
    do {
        if (out->n == COURSE_POSES_MAX)
            return err_set(e, ERR_DATA, "path has at most %d positions", COURSE_POSES_MAX);
        enum err_code rc = course_take(&plain, &out->pose[out->n], e);
        if (rc)
            return rc;
        out->n++;
    } while (text_take(&plain, ";"));
    return text_at_end(&plain)
               ? ERR_OK
               : err_set(e, ERR_FORMAT, "path: position %zu does not end where the next begins",
                         out->n);
}

enum err_code course_read(const struct target_course *t, struct course *out, struct err *e)
{
    memset(out, 0, sizeof *out);
    if (!t->path.p)
        return ERR_OK;
    enum err_code rc = course_read_path(t, out, e);
    if (rc)
        return rc;
    double fov_deg = t->fov_e3 ? t->fov_e3 / 1e3 : 60;
    for (size_t i = 0; i < out->n; i++)
        out->pose[i].fov_y_deg = fov_deg;
    out->width_px = t->width_px ? t->width_px : 1280;
    out->height_px = t->height_px ? t->height_px : 720;
    out->error_px = t->error_e3 ? t->error_e3 / 1e3 : 16;
    out->speed_m_s = t->speed_e3 ? t->speed_e3 / 1e3 : out->n > 1 ? COURSE_SPEED_M_S : 0;
    out->horizon_s = t->horizon_e3                       ? t->horizon_e3 / 1e3
                     : out->n == 1 && out->speed_m_s > 0 ? COURSE_AHEAD_S
                                                         : 0;
    return ERR_OK;
}

/* The shorter way around, -180 to 180. */
static double course_turn_deg(double from, double to)
{
    return remainder(to - from, 360);
}

/* Metres from a to b, in the frame of a. */
static enum err_code course_way(const struct view_pose *a, const struct view_pose *b, double out[3],
                                struct err *e)
{
    const struct geo_origin at = {a->lon_deg, a->lat_deg, a->h_m};
    return geo_to_enu(&at, b->lon_deg, b->lat_deg, b->h_m, out, e);
}

/* Where one that looks in the direction of `from` is after so many metres, at its height. */
static enum err_code course_ahead(const struct view_pose *from, double metres,
                                  struct view_pose *out, struct err *e)
{
    const struct geo_origin at = {from->lon_deg, from->lat_deg, from->h_m};
    double heading = from->heading_deg * 3.14159265358979323846 / 180, h_m;
    const double way[3] = {metres * sin(heading), metres * cos(heading), 0};
    *out = *from;
    return geo_from_enu(&at, way, &out->lon_deg, &out->lat_deg, &h_m, e);
}

static struct view_pose course_between(const struct view_pose *a, const struct view_pose *b,
                                       double part)
{
    struct view_pose p = *a;
    p.lon_deg = remainder(a->lon_deg + part * course_turn_deg(a->lon_deg, b->lon_deg), 360);
    p.lat_deg += part * (b->lat_deg - a->lat_deg);
    p.h_m += part * (b->h_m - a->h_m);
    p.heading_deg += part * course_turn_deg(a->heading_deg, b->heading_deg);
    p.pitch_deg += part * (b->pitch_deg - a->pitch_deg);
    return p;
}

/* The positions of the way and the times at which they are reached; one more than given where the
 * camera flies on straight ahead. */
static enum err_code course_times(const struct course *c, struct view_pose *pose, double *at_s,
                                  size_t *n, struct err *e)
{
    memcpy(pose, c->pose, c->n * sizeof *pose);
    *n = c->n;
    at_s[0] = 0;
    if (c->n == 1 && c->speed_m_s > 0) {
        enum err_code rc = course_ahead(&pose[0], c->speed_m_s * c->horizon_s, &pose[1], e);
        at_s[1] = c->horizon_s;
        *n = 2;
        return rc;
    }
    for (size_t i = 1; i < *n; i++) {
        double way[3];
        enum err_code rc = course_way(&pose[i - 1], &pose[i], way, e);
        if (rc)
            return rc;
        double fly_s = sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]) / c->speed_m_s;
        double turn_deg = fmax(fabs(course_turn_deg(pose[i - 1].heading_deg, pose[i].heading_deg)),
                               fabs(pose[i].pitch_deg - pose[i - 1].pitch_deg));
        at_s[i] = at_s[i - 1] + fmax(fly_s, turn_deg / COURSE_TURN_DEG_S);
    }
    return ERR_OK;
}

enum err_code course_cameras(const struct course *c, const struct geo_origin *origin,
                             struct camera *cam, double *at_s, size_t *n, struct err *e)
{
    struct view_pose pose[COURSE_POSES_MAX + 1];
    double reached_s[COURSE_POSES_MAX + 1];
    size_t n_poses, leg = 1;
    enum err_code rc = course_times(c, pose, reached_s, &n_poses, e);
    if (rc)
        return rc;
    double end_s = reached_s[n_poses - 1];
    end_s = c->horizon_s > 0 ? fmin(end_s, c->horizon_s) : end_s;
    *n = (size_t)fmin(ceil(end_s / COURSE_STEP_S) + 1, COURSE_CAMERAS_MAX);
    for (size_t i = 0; !rc && i < *n; i++) {
        double t = i ? end_s * (double)i / (double)(*n - 1) : 0;
        while (leg + 1 < n_poses && reached_s[leg] < t)
            leg++;
        struct view_pose p = pose[0];
        if (i) {
            double took_s = reached_s[leg] - reached_s[leg - 1];
            double part = took_s > 0 ? (t - reached_s[leg - 1]) / took_s : 1;
            p = course_between(&pose[leg - 1], &pose[leg], fmin(part, 1));
        }
        at_s[i] = t;
        rc = view_camera(origin, &p, c->width_px, c->height_px, &cam[i], e);
    }
    return rc;
}
