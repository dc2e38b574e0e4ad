/* A procedural city of Gaussians, the same on every machine: what the benchmarks draw and train.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_CITY_H
#define BENCH_CITY_H

#include "core/camera.h"
#include "core/gauss.h"

/* n Gaussians with SH of degree 3, in random order; and in Morton order, as trained tiles come.
 * gauss_free. */
enum err_code city_make(size_t n, struct gauss *out, struct err *e) ERR_USE;
enum err_code city_sorted(size_t n, struct gauss *out, struct err *e) ERR_USE;
/* The oblique view of it that every figure is about. */
struct camera city_camera(uint32_t width_px, uint32_t height_px);

#endif
