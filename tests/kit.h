/* What the tests share: cmocka in the right order, error printing, temporary folders, near-equality
 * that says where and by how much it failed.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_KIT_H
#define TESTS_KIT_H

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "core/base.h"
#include "core/gauss.h"

/* Expect ERR_OK, or print the message and fail. `e` is the struct err of the call. */
#define kit_ok(call, e)                                                                            \
    do {                                                                                           \
        enum err_code kit_rc = (call);                                                             \
        if (kit_rc != ERR_OK)                                                                      \
            fail_msg("%s: %s: %s", #call, err_name(kit_rc), (e).msg);                              \
    } while (0)
/* Expect this code, and `part` (may be NULL) in the message. */
#define kit_fails(call, want, e, part)                                                             \
    do {                                                                                           \
        enum err_code kit_rc = (call);                                                             \
        if (kit_rc != (want))                                                                      \
            fail_msg("%s: got %s (%s), want %s", #call, err_name(kit_rc), (e).msg,                 \
                     err_name(want));                                                              \
        kit_expect_text((e).msg, part, __FILE__, __LINE__);                                        \
    } while (0)
void kit_expect_text(const char *msg, const char *part, const char *file, int line);

/* |got - want| <= abs_tol + rel_tol * |want| for all n, else fail naming the worst index. */
void kit_near(const char *what, const float *got, const double *want, size_t n, double abs_tol,
              double rel_tol);
void kit_near_d(const char *what, const double *got, const double *want, size_t n, double abs_tol,
                double rel_tol);

/* A fresh folder under the system's temporary one; kit_rmdir removes it with everything inside. */
void kit_tmpdir(char path[FILE_PATH_MAX]);
void kit_rmdir(const char *path);
/* Setup and teardown of tests that need one such folder. */
extern char kit_tmp[FILE_PATH_MAX];
int kit_tmp_make(void **state);
int kit_tmp_remove(void **state);
/* Run a command line through the shell; returns its exit status, output (stdout and stderr) goes
 * into `out` (may be NULL). */
int kit_run(struct buf *out, const char *fmt, ...) ERR_PRINTF(2, 3);
/* The program under test (CITYSPLAT_BIN, set by ctest); skips the test when it is not set. */
const char *kit_program(void);

/* digest() gives the same text twice in this process, and as the program's own `digest` argument
 * prints it, with one, two and three PoCL worker threads. self: argv[0]. */
void kit_same_bits(const char *self, void (*digest)(char out[33]));

/* One figure measured against a failure of docs/stability.md, on one line of standard output:
 * "stability F22 worst_drop_db=0.31 limit=1.50". Fields are name=value; tests/stability/collect.sh
 * gathers them. */
void kit_figure(const char *row, const char *fmt, ...) ERR_PRINTF(2, 3);

/* 400 x 300 pixels, focal length 300 px, at `at_m` and looking straight down, north up. */
struct camera;
void kit_camera_down(const double at_m[3], struct camera *out);

/* n seeded Gaussians in a box of half-edge `half_m` about the origin: sizes 1-10 % of the box,
 * random rotations, opacities 0.05-0.95, SH of the given degree. gauss_free it. */
void kit_gauss(uint64_t seed, size_t n, double half_m, uint32_t sh_degree, uint32_t embed_len,
               struct gauss *out);

#endif
