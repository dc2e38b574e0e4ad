/* Values that drones write into the XMP of their photographs: height above take-off, the reference
 * of altitudes, the tilt of the camera.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_DRONE_H
#define CODEC_DRONE_H

#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct drone_meta { /* {0}: nothing is known */
    bool has_relative, has_absolute, has_up, has_position;
    double relative_m; /* height above take-off, by the barometer */
    double absolute_m;
    double lat_deg, lon_deg; /* position by XMP, which repeats EXIF's or stands for it */
    /* absolute_m and EXIF's altitude are heights above the ellipsoid: RTK says so with a fix */
    bool ellipsoidal;
    /* accuracy of the position, on each horizontal axis and of height; 0: not given */
    double sigma_m[2];
    /* unit vector up in camera axes (x right, y down, z forward), from the gimbal */
    double up_cam[3];
};
/* Reads the values with `get`. `get` writes the text of an attribute such as
 * "drone-dji:RelativeAltitude", cut to `room` bytes with its NUL, and returns false if there is
 * none. Values that are damaged or implausible are left out. */
void drone_read(bool (*get)(const void *user, const char *name, char *text, size_t room),
                const void *user, struct drone_meta *out);

#ifdef __cplusplus
}
#endif
#endif
