/* The procedural city of Gaussians that benchmarks draw and train. It is the same on every machine.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_CITY_H
#define LAB_CITY_H

#include "core/splat/appearance.h"
#include "core/splat/camera.h"
#include "core/splat/gauss.h"

struct bench;

/* A city of n Gaussians with SH of degree 3: city_make in random order, city_sorted in Morton
 * order, as in trained tiles. Free *out with gauss_free. ERR_MEM. */
enum err_code city_make(size_t n, struct gauss *out, struct err *e) ERR_USE;
enum err_code city_sorted(size_t n, struct gauss *out, struct err *e) ERR_USE;
/* As city_make and city_sorted, with another SH degree. Ten million Gaussians fit into memory with
 * degree 0. ERR_MEM. */
enum err_code city_make_degree(size_t n, uint32_t sh_degree, struct gauss *out,
                               struct err *e) ERR_USE;
enum err_code city_sorted_degree(size_t n, uint32_t sh_degree, struct gauss *out,
                                 struct err *e) ERR_USE;
#define CITY_M 420.0 /* edge of the square that the city fills */
/* n Gaussians in side x side copies of the city, in a square about the origin. */
struct city_size {
    size_t n, side; /* n 0 ends a list */
};
/* Each copy is in Morton order, and has n / side^2 Gaussians; embeddings are 0. ERR_MEM. */
enum err_code city_square(const struct city_size *size, uint32_t sh_degree, uint32_t embed_len,
                          struct gauss *out, struct err *e) ERR_USE;
/* Calls run() for each size of a list, until one fails. */
enum err_code city_each(struct bench *b, const struct city_size *sizes,
                        enum err_code (*run)(struct bench *b, const struct city_size *size,
                                             struct err *e),
                        struct err *e) ERR_USE;
/* Copies Gaussians, and adds embeddings of the default length and an untrained network with one
 * photograph. *frame has the constants of a frame. Free with gauss_free, appearance_free and
 * mem_free. ERR_MEM. */
enum err_code city_appearance(const struct gauss *g, struct gauss *out, struct appearance *a,
                              float **frame, struct err *e) ERR_USE;
/* The oblique view that benchmarks use. */
struct camera city_camera(uint32_t width_px, uint32_t height_px);

#endif
