/* Shared by all tests: cmocka in the right order, printing of errors, temporary folders,
 * comparisons that report where and by how much they failed.
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
#include "core/splat/gauss.h"

const char *kit_err(enum err_code code); /* its name, "ERR_IO" */
/* Expects ERR_OK, else prints the message and fails. `e` is the struct err of the call. */
#define kit_ok(call, e)                                                                            \
    do {                                                                                           \
        enum err_code kit_rc = (call);                                                             \
        if (kit_rc != ERR_OK)                                                                      \
            fail_msg("%s: %s: %s", #call, kit_err(kit_rc), (e).msg);                               \
    } while (0)
/* Expects this code, and `part` (may be NULL) in the message. */
#define kit_fails(call, want, e, part)                                                             \
    do {                                                                                           \
        enum err_code kit_rc = (call);                                                             \
        if (kit_rc != (want))                                                                      \
            fail_msg("%s: got %s (%s), want %s", #call, kit_err(kit_rc), (e).msg, kit_err(want));  \
        kit_expect_text((e).msg, part, __FILE__, __LINE__);                                        \
    } while (0)
/* Expects ERR_MEM while the first allocation of the call fails, then the second, and so on, and
 * ERR_OK when it has made all its allocations, at least `least`. The call frees what an earlier one
 * left, if need be: (buf_free(&b), spz_encode(...)). */
#define kit_out_of_memory(call, least, e)                                                          \
    do {                                                                                           \
        enum err_code kit_rc = ERR_MEM;                                                            \
        size_t kit_k = 0;                                                                          \
        while (kit_rc == ERR_MEM && ++kit_k < 10000) {                                             \
            mem_fail_at(kit_k);                                                                    \
            kit_rc = (call);                                                                       \
            mem_fail_at(0);                                                                        \
        }                                                                                          \
        if (kit_rc != ERR_OK || kit_k <= (least))                                                  \
            fail_msg("%s: allocation %zu fails: %s: %s", #call, kit_k, kit_err(kit_rc), (e).msg);  \
    } while (0)
/* Waits until the condition holds, which is looked at every millisecond. Fails when it does not
 * within PATIENCE_S, far longer than a busy machine needs. */
#define PATIENCE_S 20.0
#define kit_await(condition)                                                                       \
    do {                                                                                           \
        for (double kit_end_s = clock_s() + PATIENCE_S; !(condition); nap_ms(1))                   \
            if (clock_s() > kit_end_s)                                                             \
                fail_msg("not in %.0f s: %s", PATIENCE_S, #condition);                             \
    } while (0)
void nap_ms(long ms);
void kit_expect_text(const char *msg, const char *part, const char *file, int line);

/* Expects |got - want| <= abs_tol + rel_tol * |want| for all n values, else names the worst index.
 */
void kit_near(const char *what, const float *got, const double *want, size_t n, double abs_tol,
              double rel_tol);
void kit_near_d(const char *what, const double *got, const double *want, size_t n, double abs_tol,
                double rel_tol);

/* Makes a new folder in the system's temporary folder. kit_rmdir removes it with its content. */
void kit_tmpdir(char path[FILE_PATH_MAX]);
void kit_rmdir(const char *path);
/* Setup and teardown for tests that need one such folder. */
extern char kit_tmp[FILE_PATH_MAX];
int kit_tmp_make(void **state);
int kit_tmp_remove(void **state);
/* Runs a command line in the shell and returns its exit status. stdout and stderr go to `out` (may
 * be NULL). */
int kit_run(struct buf *out, const char *fmt, ...) ERR_PRINTF(2, 3);
/* The program under test (CITYSPLAT_BIN, which ctest sets). If it is not set, the test is skipped.
 */
const char *kit_program(void);

/* Checks that digest() gives the same text twice in this process, and in new processes with one,
 * two and three PoCL worker threads. The new processes run this program with the argument `digest`:
 * main begins with kit_digest, which prints the text and returns true if that is the argument. */
bool kit_digest(int argc, char **argv, void (*digest)(char out[33]));
void kit_same_bits(void (*digest)(char out[33]));

/* Prints a measured number for a failure of lab/STABILITY.md as one line on stdout: "stability F22
 * worst_drop_db=0.31 limit=1.50". Fields are name=value. tests/stability/collect.sh collects them.
 */
void kit_figure(const char *row, const char *fmt, ...) ERR_PRINTF(2, 3);

/* Writes a geoid as a .gtx grid of 3 x 4 degrees: 45 m at its west, 1 m more each degree to the
 * east. */
void kit_gtx(const char *path, double south_deg, double west_deg);

/* A camera of 400 x 300 pixels with a focal length of 300 px at `at_m`, straight down, north up. */
struct camera;
void kit_camera_down(const double at_m[3], struct camera *out);

/* n seeded Gaussians in a box of half-edge `half_m` about the origin: sizes of 1-10 % of the box,
 * random rotations, opacities of 0.05-0.95, SH of the given degree. Free *out with gauss_free. */
void kit_gauss(uint64_t seed, size_t n, double half_m, uint32_t sh_degree, uint32_t embed_len,
               struct gauss *out);

#endif
