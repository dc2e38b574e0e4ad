/* Turns Gaussians between the axes of the working frame (ENU, z up) and of glTF (y up), and by any
 * rotation.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_AXES_H
#define CODEC_AXES_H

#include "core/splat/gauss.h"

/* ENU (z up) -> glTF (y up): p' = (E, U, -N); and back. Rotations and SH are turned too. Both work
 * in place, cannot fail, and may be called from any thread. */
void axes_enu_to_gltf(struct gauss *g);
void axes_gltf_to_enu(struct gauss *g);
/* One point, likewise. */
void axes_point_to_gltf(double p[3]);
void axes_point_to_enu(double p[3]);
/* Turns by any rotation, p' = rot p, likewise. */
void axes_turn(struct gauss *g, const double rot[9]);
#endif
