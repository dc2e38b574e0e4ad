/* See kit.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _XOPEN_SOURCE 700
#include "tests/kit.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>

#include "core/splat/camera.h"

const char *kit_err(enum err_code code)
{
#define KIT_NAME(name, text) #name,
    static const char *const names[] = {ERR_LIST(KIT_NAME)};
    return names[code];
}

void nap_ms(long ms)
{
    const struct timespec ts = {.tv_sec = ms / 1000, .tv_nsec = ms % 1000 * 1000000};
    nanosleep(&ts, NULL);
}

void kit_expect_text(const char *msg, const char *part, const char *file, int line)
{
    if (part && !strstr(msg, part)) {
        print_error("message '%s' does not contain '%s'\n", msg, part);
        _fail(file, line);
    }
}

static void kit_worst(const char *what, size_t i, double got, double want, double tol)
{
    fail_msg("%s: worst at [%zu]: got %.9g, want %.9g, difference %.3g, tolerance %.3g", what, i,
             got, want, fabs(got - want), tol);
}

void kit_near(const char *what, const float *got, const double *want, size_t n, double abs_tol,
              double rel_tol)
{
    size_t worst = n;
    double excess = 0.0;
    for (size_t i = 0; i < n; i++) {
        double over = fabs((double)got[i] - want[i]) - (abs_tol + rel_tol * fabs(want[i]));
        if (!(over <= 0.0) && (worst == n || !(over <= excess))) { /* NaN is worst */
            worst = i;
            excess = over;
        }
    }
    if (worst < n)
        kit_worst(what, worst, (double)got[worst], want[worst],
                  abs_tol + rel_tol * fabs(want[worst]));
}

void kit_near_d(const char *what, const double *got, const double *want, size_t n, double abs_tol,
                double rel_tol)
{
    size_t worst = n;
    double excess = 0.0;
    for (size_t i = 0; i < n; i++) {
        double over = fabs(got[i] - want[i]) - (abs_tol + rel_tol * fabs(want[i]));
        if (!(over <= 0.0) && (worst == n || !(over <= excess))) {
            worst = i;
            excess = over;
        }
    }
    if (worst < n)
        kit_worst(what, worst, got[worst], want[worst], abs_tol + rel_tol * fabs(want[worst]));
}

void kit_tmpdir(char path[FILE_PATH_MAX])
{
    const char *base = getenv("TMPDIR");
    snprintf(path, FILE_PATH_MAX, "%s/citysplat-test-XXXXXX", base && *base ? base : "/tmp");
    if (!mkdtemp(path))
        fail_msg("cannot make a temporary folder %s", path);
}

void kit_rmdir(const char *path)
{
    if (path[0])
        file_remove_tree(path);
}

char kit_tmp[FILE_PATH_MAX];

int kit_tmp_make(void **state)
{
    kit_tmpdir(kit_tmp);
    return 0;
}

int kit_tmp_remove(void **state)
{
    kit_rmdir(kit_tmp);
    return 0;
}

int kit_run(struct buf *out, const char *fmt, ...)
{
    char cmd[8192];
    va_list ap;
    va_start(ap, fmt);
    int n = vsnprintf(cmd, sizeof cmd - 8, fmt, ap);
    va_end(ap);
    if (n < 0 || (size_t)n >= sizeof cmd - 8)
        fail_msg("command line too long");
    memcpy(cmd + n, " 2>&1", 6);
    FILE *f = popen(cmd, "r");
    if (!f)
        fail_msg("cannot run %s", cmd);
    char chunk[4096];
    for (size_t got; (got = fread(chunk, 1, sizeof chunk, f)) > 0;)
        if (out)
            buf_add(out, chunk, got);
    if (out) {
        buf_u8(out, 0);
        out->size--;
    }
    int status = pclose(f);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

const char *kit_program(void)
{
    const char *p = getenv("CITYSPLAT_BIN");
    if (!p || !*p) {
        print_message("CITYSPLAT_BIN is not set: run this test through ctest\n");
        skip();
    }
    return p;
}

void kit_figure(const char *row, const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    printf("stability %s ", row);
    vprintf(fmt, ap);
    printf("\n");
    fflush(stdout);
    va_end(ap);
}

void kit_camera_down(const double at_m[3], struct camera *out)
{
    static const double down[9] = {1, 0, 0, 0, -1, 0, 0, 0, -1};
    *out = (struct camera){
        .width_px = 400, .height_px = 300, .fx_px = 300, .fy_px = 300, .cx_px = 200, .cy_px = 150};
    memcpy(out->rot, down, sizeof down);
    for (size_t a = 0; a < 3; a++)
        out->trans[a] =
            -(down[3 * a] * at_m[0] + down[3 * a + 1] * at_m[1] + down[3 * a + 2] * at_m[2]);
}

void kit_gauss(uint64_t seed, size_t n, double half_m, uint32_t sh_degree, uint32_t embed_len,
               struct gauss *out)
{
    struct err e = {0};
    kit_ok(gauss_alloc(out, n, sh_degree, embed_len, &e), e);
    out->n = n;
    size_t k3 = 3 * gauss_sh_count(sh_degree);
    for (size_t i = 0; i < n; i++) {
        for (uint64_t k = 0; k < 3; k++) {
            out->mean_m[3 * i + k] = (float)(half_m * (2.0 * rng_unit(seed, k, i) - 1.0));
            out->scale_log[3 * i + k] =
                (float)log(half_m * 0.01 * pow(10.0, rng_unit(seed, 3 + k, i)));
        }
        for (uint64_t k = 0; k < 4; k++)
            out->quat_wxyz[4 * i + k] = (float)rng_normal(seed, 6 + k, i);
        double o = 0.05 + 0.9 * rng_unit(seed, 10, i);
        out->opacity_logit[i] = (float)log(o / (1.0 - o));
        for (uint64_t k = 0; k < k3; k++)
            out->sh[k3 * i + k] = (float)(rng_normal(seed, 11 + k, i) * (k < 3 ? 0.8 : 0.15));
        for (uint64_t k = 0; k < embed_len; k++)
            out->embed[embed_len * i + k] = (float)rng_normal(seed, 100 + k, i);
    }
}

void kit_gtx(const char *path, double south_deg, double west_deg)
{
    struct err e = {0};
    uint8_t bytes[40 + 4 * 3 * 4];
    const double head[4] = {south_deg, west_deg, 1, 1};
    const uint32_t size[2] = {3, 4};
    size_t at = 0;
    for (size_t k = 0; k < 4; k++)
        for (size_t i = 8; i-- > 0;)
            bytes[at++] = ((const uint8_t *)&head[k])[i];
    for (size_t k = 0; k < 2; k++)
        for (size_t i = 4; i-- > 0;)
            bytes[at++] = ((const uint8_t *)&size[k])[i];
    for (size_t k = 0; k < 12; k++) {
        float v = 45 + (float)(k % 4);
        for (size_t i = 4; i-- > 0;)
            bytes[at++] = ((const uint8_t *)&v)[i];
    }
    kit_ok(file_write(path, bytes, sizeof bytes, &e), e);
}

static const char *kit_self;

bool kit_digest(int argc, char **argv, void (*digest)(char out[33]))
{
    char text[33];
    kit_self = argv[0];
    if (argc < 2 || strcmp(argv[1], "digest"))
        return false;
    digest(text);
    puts(text);
    return true;
}

void kit_same_bits(void (*digest)(char out[33]))
{
    char first[33], again[33];
    digest(first);
    digest(again);
    assert_string_equal(first, again);
    for (int threads = 1; threads <= 3; threads++) {
        struct buf out = {0};
        if (kit_run(&out, "POCL_MAX_PTHREAD_COUNT=%d %s digest", threads, kit_self) != 0 ||
            !strstr((char *)out.data, first))
            fail_msg("%d threads: got %s, want %s", threads,
                     out.data ? (char *)out.data : "nothing", first);
        buf_free(&out);
    }
}
