/* A procedural city of Gaussians, the same on every machine: what the benchmarks draw and train.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef BENCH_CITY_H
#define BENCH_CITY_H

#include "core/appearance.h"
#include "core/camera.h"
#include "core/gauss.h"

/* n Gaussians with SH of degree 3, in random order; and in Morton order, as trained tiles come.
 * gauss_free. */
enum err_code city_make(size_t n, struct gauss *out, struct err *e) ERR_USE;
enum err_code city_sorted(size_t n, struct gauss *out, struct err *e) ERR_USE;
/* The same with fewer harmonics: ten million fit into memory without them. */
enum err_code city_make_degree(size_t n, uint32_t sh_degree, struct gauss *out,
                               struct err *e) ERR_USE;
enum err_code city_sorted_degree(size_t n, uint32_t sh_degree, struct gauss *out,
                                 struct err *e) ERR_USE;
/* The same Gaussians with embeddings, of the default length, and a network for them as training
 * begins: one photograph, and *frame its constants. gauss_free, appearance_free, mem_free. */
enum err_code city_appearance(const struct gauss *g, struct gauss *out, struct appearance *a,
                              float **frame, struct err *e) ERR_USE;
/* The oblique view of it that every figure is about. */
struct camera city_camera(uint32_t width_px, uint32_t height_px);

#endif
