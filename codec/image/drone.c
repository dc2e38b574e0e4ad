/* XMP of drones: see drone.h.
 *
 * DJI, Autel, Skydio and Parrot give the camera's own angles: pitch above the horizon (-90 is
 * straight down), roll about the optical axis. Cameras that follow Pix4D's tags ("Camera:") count
 * pitch from straight down and turn about the axes of a body that looks down: roll about the top of
 * the picture.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/drone.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { DRONE_TEXT_MAX = 64 };
static const double drone_rad = 0.017453292519943295;

struct drone_source {
    bool (*get)(const void *user, const char *name, char *text, size_t room);
    const void *user;
};

/* "+427.00", and as some write it: a decimal comma, a fraction, metres behind it. */
static bool drone_value(const char *text, double *out)
{
    char plain[DRONE_TEXT_MAX], *end, *comma;
    if (snprintf(plain, sizeof plain, "%s", text) >= (int)sizeof plain)
        return false;
    comma = strchr(plain, ',');
    if (comma && !strchr(plain, '.'))
        *comma = '.';
    double den = 1;
    *out = strtod(plain, &end);
    if (end == plain)
        return false;
    if (*end == '/')
        den = strtod(end + 1, &end);
    *out /= den;
    end += strspn(end, " \t\r\n");
    end += *end == 'm';
    return !end[strspn(end, " \t\r\n")] && isfinite(*out);
}

/* The first of the names that holds a number between lo and hi, and nothing else. */
static bool drone_number(const struct drone_source *s, const char *const *names, double lo,
                         double hi, double *out)
{
    for (; *names; names++) {
        char text[DRONE_TEXT_MAX];
        double v;
        if (s->get(s->user, *names, text, sizeof text) && drone_value(text, &v) && v >= lo &&
            v <= hi) {
            *out = v;
            return true;
        }
    }
    return false;
}

/* Up in the axes of the camera, from the horizon's pitch and the roll about the optical axis. */
static bool drone_gimbal(const struct drone_source *s, double up[3])
{
    static const char *const pitches[] = {"drone-dji:GimbalPitchDegree",
                                          "drone-autel:GimbalPitchDegree",
                                          "drone-parrot:CameraPitchDegree",
                                          "drone-skydio:CameraOrientationNED/Pitch", NULL},
                             *const rolls[] = {"drone-dji:GimbalRollDegree",
                                               "drone-autel:GimbalRollDegree",
                                               "drone-parrot:CameraRollDegree",
                                               "drone-skydio:CameraOrientationNED/Roll", NULL};
    double pitch, roll;
    if (!drone_number(s, pitches, -180, 180, &pitch) || !drone_number(s, rolls, -360, 360, &roll))
        return false;
    up[0] = -sin(drone_rad * roll) * cos(drone_rad * pitch);
    up[1] = -cos(drone_rad * roll) * cos(drone_rad * pitch);
    up[2] = sin(drone_rad * pitch);
    return true;
}

/* The same by Pix4D's tags: v = Rz(yaw) Ry(pitch) Rx(roll) in north-east-down, of a body whose x is
 * the top of the picture and whose z is the optical axis. */
static bool drone_body(const struct drone_source *s, double up[3])
{
    static const char *const pitches[] = {"Camera:Pitch", NULL}, *const rolls[] = {"Camera:Roll",
                                                                                   NULL};
    double pitch, roll;
    if (!drone_number(s, pitches, -180, 180, &pitch) || !drone_number(s, rolls, -360, 360, &roll))
        return false;
    up[0] = -cos(drone_rad * pitch) * sin(drone_rad * roll);
    up[1] = -sin(drone_rad * pitch);
    up[2] = -cos(drone_rad * pitch) * cos(drone_rad * roll);
    return true;
}

/* Degrees of XMP: "47.5", or as EXIF's namespace has it "47,33.48N" and "47,33,28.8N". */
static bool drone_angle_of(const char *text, double *out)
{
    double part[3] = {0};
    size_t n = 0;
    const char *p = text;
    for (char *end; n < 3; p = end + (*end == ',')) {
        part[n] = strtod(p, &end);
        if (end == p || !isfinite(part[n++]))
            return false;
        if (*end != ',') {
            p = end;
            break;
        }
    }
    *out = fabs(part[0]) + part[1] / 60 + part[2] / 3600;
    const char letter = *p ? (char)(*p | 0x20) : '\0';
    if (signbit(part[0]) || letter == 's' || letter == 'w')
        *out = -*out;
    return part[1] >= 0 && part[2] >= 0 && (!*p || (strchr("nsew", letter) && !p[1]));
}

static bool drone_angle(const struct drone_source *s, const char *const *names, double most,
                        double *out)
{
    for (; *names; names++) {
        char text[DRONE_TEXT_MAX];
        if (s->get(s->user, *names, text, sizeof text) && drone_angle_of(text, out) &&
            fabs(*out) <= most)
            return true;
    }
    return false;
}

static void drone_position(const struct drone_source *s, struct drone_meta *out)
{
    /* The first is DJI's own spelling. */
    static const char *const lon[] = {"drone-dji:GpsLongtitude",
                                      "drone-dji:GpsLongitude",
                                      "drone-dji:Longitude",
                                      "drone-autel:GpsLongitude",
                                      "drone-skydio:Longitude",
                                      "exif:GPSLongitude",
                                      NULL},
                             *const lat[] = {"drone-dji:GpsLatitude",   "drone-dji:Latitude",
                                             "drone-autel:GpsLatitude", "drone-skydio:Latitude",
                                             "exif:GPSLatitude",        NULL};
    out->has_position = drone_angle(s, lat, 90, &out->lat_deg) &&
                        drone_angle(s, lon, 180, &out->lon_deg) &&
                        (out->lat_deg != 0 || out->lon_deg != 0);
}

/* EXIF's altitude as XMP has it, a fraction: "42700/100". */
static bool drone_exif_altitude(const struct drone_source *s, double *out)
{
    char text[DRONE_TEXT_MAX];
    double v;
    if (!s->get(s->user, "exif:GPSAltitude", text, sizeof text) || !drone_value(text, &v) ||
        fabs(v) > 20000 || v == 0)
        return false;
    *out = s->get(s->user, "exif:GPSAltitudeRef", text, sizeof text) && !strcmp(text, "1")
               ? -fabs(v)
               : v;
    return true;
}

static bool drone_says(const struct drone_source *s, const char *name, const char *word)
{
    char text[DRONE_TEXT_MAX];
    return s->get(s->user, name, text, sizeof text) && !strcasecmp(text, word);
}

/* Standard deviations: of DJI's RTK by axis, of Pix4D's tags in plan and height. */
static void drone_sigma(const struct drone_source *s, double out[2])
{
    static const char *const east[] = {"drone-dji:RtkStdLon", NULL},
                             *const north[] = {"drone-dji:RtkStdLat", NULL},
                             *const plan[] = {"Camera:GPSXYAccuracy", NULL},
                             *const up[] = {"drone-dji:RtkStdHgt", "Camera:GPSZAccuracy", NULL};
    double e, n, v;
    if (drone_number(s, east, 1e-4, 1000, &e) && drone_number(s, north, 1e-4, 1000, &n))
        out[0] = sqrt(0.5 * (e * e + n * n));
    else if (drone_number(s, plan, 1e-4, 1000, &v))
        out[0] = v;
    if (drone_number(s, up, 1e-4, 1000, &v))
        out[1] = v;
}

void drone_read(bool (*get)(const void *user, const char *name, char *text, size_t room),
                const void *user, struct drone_meta *out)
{
    static const char *const relative[] = {"drone-dji:RelativeAltitude",
                                           "drone-autel:RelativeAltitude",
                                           "drone-skydio:RelativeAltitude",
                                           "Camera:AboveGroundAltitude", NULL},
                             *const absolute[] = {"drone-dji:AbsoluteAltitude",
                                                  "drone-autel:AbsoluteAltitude",
                                                  "drone-skydio:AbsoluteAltitude", NULL},
                             *const flag[] = {"drone-dji:RtkFlag", NULL};
    const struct drone_source s = {get, user};
    double rtk = 0;
    *out = (struct drone_meta){0};
    drone_sigma(&s, out->sigma_m);
    drone_position(&s, out);
    out->has_relative = drone_number(&s, relative, -2000, 20000, &out->relative_m);
    out->has_absolute = (drone_number(&s, absolute, -1000, 20000, &out->absolute_m) &&
                         out->absolute_m != 0) || /* 0 is what it has without a fix */
                        drone_exif_altitude(&s, &out->absolute_m);
    out->has_up = drone_gimbal(&s, out->up_cam) || drone_body(&s, out->up_cam);
    /* 50: carrier phases are resolved; 34: not yet; 16: without them. A base or a network gives
     * places on the ellipsoid. The type alone stands in photographs of drones without RTK. */
    (void)drone_number(&s, flag, 0, 1000, &rtk);
    out->ellipsoidal =
        rtk == 50 ||
        ((rtk == 16 || rtk == 34) && drone_says(&s, "drone-dji:AltitudeType", "RtkAlt")) ||
        drone_says(&s, "Camera:VerticalCS", "ellipsoidal");
}
