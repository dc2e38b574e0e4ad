/* Sky, horizon and ground behind a city, in the light in which the city is shown, and what is left
 * of the city at its edge: the rule of the viewer (web/src/backdrop.ts and groundmap.ts, by day),
 * but for its terrain: this ground is level. The colours come from the city as seen from straight
 * above. tests/web/light.test.mjs holds both to each other.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_BACKDROP_H
#define SERVER_BACKDROP_H

#include "core/splat/camera.h"
#include "render/render.h"

enum { BACKDROP_PX = LAYOUT_EDGE }; /* a side of the picture from above */

struct backdrop {
    double top[3], low[3], ground[3]; /* colours 0..1: the zenith, the horizon, the far ground */
    double level_m;                   /* height of the ground in the world frame */
    double reach_m;          /* of the city, from its middle: there the ground meets the horizon */
    struct render_edge edge; /* of the city; the ground's colours have its square */
    float near[BACKDROP_PX][BACKDROP_PX][3]; /* of the ground there, rows from south to north */
};

/* The camera from straight above whose picture backdrop_read takes; world frame ENU metres. min,
 * max: a box around nearly all of the city. */
struct camera backdrop_camera(const double min_enu_m[3], const double max_enu_m[3]);
/* The backdrop of a city in that box, by its picture from above: rgb [128][128][3] on black,
 * transmittance [128][128]. Where nothing is in the picture, that of a usual day. ERR_MEM. */
enum err_code backdrop_read(const double min_enu_m[3], const double max_enu_m[3], const float *rgb,
                            const float *transmittance, struct backdrop *out,
                            struct err *e) ERR_USE;
/* The colour that is seen from a place in a direction, which need not be of length 1. */
void backdrop_color(const struct backdrop *b, const double eye_enu_m[3], const double ray[3],
                    double out[3]);

#endif
