/* What drones write into the XMP of their photographs beside EXIF: height above take-off, what
 * heights count from, how the camera was tilted.
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

struct drone_meta { /* {0}: nothing is said */
    bool has_relative, has_absolute, has_up;
    double relative_m; /* above where it took off, by the barometer */
    double absolute_m;
    bool ellipsoidal; /* absolute_m, or EXIF's altitude, counts from the ellipsoid */
    double up_cam[3]; /* unit; up in the camera's axes (x right, y down, z forward) by its gimbal */
};
/* get: the text of an attribute, "drone-dji:RelativeAltitude", cut to room bytes with the NUL;
 * false: not there. What is damaged or no number that a drone can mean is not said. */
void drone_read(bool (*get)(const void *user, const char *name, char *text, size_t room),
                const void *user, struct drone_meta *out);

#ifdef __cplusplus
}
#endif
#endif
