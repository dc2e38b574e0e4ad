/* The photometric loss and the metrics (train/loss/photometric.c, photometric_ref.c, metric.c):
 * closed forms, finite differences in double, values of other programs, kernels against the
 * reference at awkward sizes, and equal bits in every run and for any number of worker threads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"
#include "train/loss/metric.h"
#include "train/loss/photometric.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Central differences in double with h = 1e-5: truncation h^2 * f''' / 6 relative to gradients of
 * 1e-3. */
#define FD_STEP 1e-5
#define FD_REL 1e-6
#define FD_ABS 1e-10
/* float kernels: sums of 121 products and a quotient whose denominator may be as small as C2 = 9e-4
 * with a cancellation error of 2e-7, so 3e-4 relative at worst in single pixels; 1e-5 over the
 * picture (L2). */
#define KERNEL_REL 2e-3
#define KERNEL_L2 1e-4
#define VALUE_REL 2e-6

struct picture { /* one allocation each; picture_free */
    uint32_t w, h;
    size_t n; /* w * h * 3 */
    double *rgb, *target;
    uint8_t *target_u8, *mask;
};

static struct picture picture_make(uint32_t w, uint32_t h, bool masked, uint64_t seed)
{
    struct picture p = {.w = w, .h = h, .n = (size_t)w * h * 3};
    p.rgb = mem_array(p.n, sizeof *p.rgb);
    p.target = mem_array(p.n, sizeof *p.target);
    p.target_u8 = mem_array(p.n, 1);
    p.mask = masked ? mem_array(p.n / 3, 1) : NULL;
    assert_true(p.rgb && p.target && p.target_u8 && (p.mask || !masked));
    for (size_t i = 0; i < p.n; i++) {
        double wave = 0.5 + 0.4 * sin(0.37 * (double)(i / 3 % w) + 0.2 * (double)(i / 3 / w) +
                                      (double)(i % 3));
        p.target_u8[i] = (uint8_t)(255 * wave);
        p.target[i] = p.target_u8[i] / 255.0;
        p.rgb[i] = (double)(float)(p.target[i] + 0.1 * rng_normal(seed, 1, i));
    }
    for (size_t i = 0; masked && i < p.n / 3; i++)
        p.mask[i] = rng_unit(seed, 2, i) < 0.8;
    return p;
}

static void picture_free(struct picture *p)
{
    mem_free(p->rgb);
    mem_free(p->target);
    mem_free(p->target_u8);
    mem_free(p->mask);
}

static double ref_total(const struct picture *p, double l1, double ssim)
{
    struct photometric_value v;
    struct err e = {0};
    kit_ok(photometric_ref_run(p->rgb, p->target, p->mask, p->w, p->h, l1, ssim, NULL, &v, &e), e);
    return v.total;
}

static void test_ref_closed_forms(void **state)
{
    struct picture p = picture_make(30, 20, false, 1);
    struct photometric_value v;
    struct err e = {0};
    kit_ok(photometric_ref_run(p.target, p.target, NULL, p.w, p.h, 0.8, 0.2, NULL, &v, &e), e);
    assert_true(fabs(v.total) < 1e-12 && v.l1 == 0 && v.mse == 0 && fabs(v.ssim - 1) < 1e-12);
    /* Constant pictures a and y: away from the border S = (2ay + C1) / (a^2 + y^2 + C1) exactly. */
    const double a = 0.25, c1 = 1e-4;
    float rgb[31 * 25 * 3];
    uint8_t target[31 * 25 * 3];
    for (size_t i = 0; i < sizeof target; i++) {
        rgb[i] = (float)a;
        target[i] = 191;
    }
    double y = 191 / 255.0, got;
    kit_ok(metric_ssim(rgb, target, NULL, 31, 25, METRIC_VALID, &got, &e), e);
    assert_true(fabs(got - (2 * a * y + c1) / (a * a + y * y + c1)) < 1e-9);
    kit_ok(metric_psnr(rgb, target, NULL, 31, 25, &got, &e), e);
    assert_true(fabs(got + 20 * log10(y - a)) < 1e-9);
    kit_fails(photometric_ref_run(p.rgb, p.target, NULL, 0, 5, 1, 1, NULL, &v, &e), ERR_ARG, e,
              "empty");
    picture_free(&p);
}

static void test_ref_finite_differences(void **state)
{
    for (int masked = 0; masked < 2; masked++) {
        struct picture p = picture_make(17, 13, masked, 2);
        struct err e = {0};
        struct photometric_value v;
        double *grad = mem_array(p.n, sizeof *grad), *fd = mem_array(p.n, sizeof *fd);
        assert_true(grad && fd);
        kit_ok(photometric_ref_run(p.rgb, p.target, p.mask, p.w, p.h, 0.8, 0.2, grad, &v, &e), e);
        for (size_t i = 0; i < p.n; i++) {
            double keep = p.rgb[i];
            if (fabs(keep - p.target[i]) < 2 * FD_STEP) { /* the kink of L1 */
                fd[i] = grad[i];
                continue;
            }
            p.rgb[i] = keep + FD_STEP;
            double up = ref_total(&p, 0.8, 0.2);
            p.rgb[i] = keep - FD_STEP;
            fd[i] = (up - ref_total(&p, 0.8, 0.2)) / (2 * FD_STEP);
            p.rgb[i] = keep;
        }
        kit_near_d("loss gradient", grad, fd, p.n, FD_ABS, FD_REL);
        mem_free(grad);
        mem_free(fd);
        picture_free(&p);
    }
}

/* Numbers from a program of its own: windows of 11 x 11 weights exp(-r^2 / 4.5), normalised, summed
 * one by one in double as Wang et al. 2004 write it, over a picture anybody can make. */
static void test_metrics_by_another_program(void **state)
{
    enum { W = 19, H = 14 };
    float rgb[W * H * 3];
    uint8_t target[W * H * 3];
    double got[3];
    struct err e = {0};
    for (unsigned j = 0; j < H; j++)
        for (unsigned i = 0; i < W; i++)
            for (unsigned c = 0; c < 3; c++) {
                unsigned v = 37 * i + 11 * j * j + 53 * c, at = (j * W + i) * 3 + c;
                rgb[at] = (float)(v % 256) / 255.0f;
                target[at] = (uint8_t)((v + (5 * i * j + 7 * c) % 60) % 256);
            }
    kit_ok(metric_ssim(rgb, target, NULL, W, H, METRIC_TRAINING, &got[0], &e), e);
    kit_ok(metric_ssim(rgb, target, NULL, W, H, METRIC_VALID, &got[1], &e), e);
    kit_ok(metric_psnr(rgb, target, NULL, W, H, &got[2], &e), e);
    const double want[3] = {0.554774695000, 0.397763442917, 10.2278558253};
    kit_near_d("SSIM padded, SSIM inside, PSNR", got, want, 3, 0, 1e-6); /* rgb is float */
}

/* GMSD against a program of its own that follows the authors' published one line by line, over
 * pictures anybody can make; odd sizes are the ones where implementations differ. */
static void test_gmsd_by_another_program(void **state)
{
    enum { MOST = 31 * 23 };
    static const uint32_t sizes[3][2] = {{24, 16}, {31, 23}, {9, 40}};
    static const double want[3] = {0.169543333740, 0.155236467582, 0.154097179833};
    float rgb[MOST * 3], same[MOST * 3];
    uint8_t target[MOST * 3];
    double got[3], zero;
    struct err e = {0};
    for (unsigned k = 0; k < 3; k++) {
        unsigned w = sizes[k][0], h = sizes[k][1];
        for (unsigned j = 0; j < h; j++)
            for (unsigned i = 0; i < w; i++)
                for (unsigned c = 0; c < 3; c++) {
                    unsigned at = (j * w + i) * 3 + c;
                    rgb[at] = (float)((29 * i + 57 * j + 11 * c + i * i) % 256) / 255.0f;
                    target[at] = (uint8_t)((37 * i + 91 * j + 53 * c + i * j * (c + 1)) % 256);
                    same[at] = (float)target[at] / 255.0f;
                }
        kit_ok(metric_gmsd(rgb, target, NULL, w, h, &got[k], &e), e);
        kit_ok(metric_gmsd(same, target, NULL, w, h, &zero, &e), e);
        assert_true(zero < 1e-6); /* rgb is float */
    }
    kit_near_d("GMSD", got, want, 3, 0, 1e-6); /* rgb is float */
    uint8_t mask[MOST] = {0};
    kit_ok(metric_gmsd(rgb, target, mask, 9, 40, &zero, &e), e);
    assert_true(zero < 1e-12); /* masked pixels are black in both */
    kit_fails(metric_gmsd(rgb, target, NULL, 3, 9, &zero, &e), ERR_ARG, e, "too small");
}

static void test_metrics(void **state)
{
    struct picture p = picture_make(40, 71, true, 3);
    struct err e = {0};
    struct photometric_value v;
    double got;
    float *rgb = mem_array(p.n, sizeof *rgb);
    assert_non_null(rgb);
    for (size_t i = 0; i < p.n; i++) {
        p.rgb[i] = fmin(fmax(p.rgb[i], 0), 1);
        rgb[i] = (float)p.rgb[i];
    }
    kit_ok(photometric_ref_run(p.rgb, p.target, p.mask, p.w, p.h, 0.8, 0.2, NULL, &v, &e), e);
    kit_ok(metric_ssim(rgb, p.target_u8, p.mask, p.w, p.h, METRIC_TRAINING, &got, &e), e);
    assert_true(fabs(got - v.ssim) < 1e-12);
    kit_ok(metric_psnr(rgb, p.target_u8, p.mask, p.w, p.h, &got, &e), e);
    size_t used = 0; /* the loss is a mean over all pixels, PSNR over those that count */
    for (size_t i = 0; i < p.n / 3; i++)
        used += p.mask[i] != 0;
    assert_true(used > 0 && used < p.n / 3);
    assert_true(fabs(got + 10 * log10(v.mse * (double)(p.n / 3) / (double)used)) < 1e-9);
    uint8_t *nothing = mem_array(p.n / 3, 1);
    assert_non_null(nothing);
    kit_fails(metric_psnr(rgb, p.target_u8, nothing, p.w, p.h, &got, &e), ERR_DATA, e, "no pixel");
    mem_free(nothing);
    /* The valid window does not see beyond the edge: what differs is only the border. */
    double valid;
    kit_ok(metric_ssim(rgb, p.target_u8, p.mask, p.w, p.h, METRIC_VALID, &valid, &e), e);
    assert_true(valid < 1 && valid > 0 && valid != v.ssim);
    kit_fails(metric_ssim(rgb, p.target_u8, p.mask, 10, 21, METRIC_VALID, &got, &e), ERR_ARG, e,
              "too small");
    mem_fail_at(1);
    kit_fails(metric_ssim(rgb, p.target_u8, p.mask, p.w, p.h, METRIC_TRAINING, &got, &e), ERR_MEM,
              e, NULL);
    mem_fail_at(0);
    mem_free(rgb);
    picture_free(&p);
}

/* ---- kernels ---- */

static struct dev *dev_get(void)
{
    static struct dev dev;
    struct err e = {0};
    if (!dev.context)
        kit_ok(dev_open(NULL, &dev, &e), e);
    return &dev;
}

/* Run the kernels on p; grad [h][w][3] is caller's. */
static void kernel_run(struct photometric *l, const struct picture *p, float l1, float ssim,
                       float *grad, struct photometric_value *v)
{
    struct dev *d = dev_get();
    struct err e = {0};
    size_t px = p->n / 3;
    float *planar = mem_array(p->n, sizeof *planar);
    assert_non_null(planar);
    for (size_t i = 0; i < p->n; i++)
        planar[i % 3 * px + i / 3] = (float)p->rgb[i];
    cl_mem color, target, mask = NULL, out;
    kit_ok(dev_buffer(d, p->n * sizeof(float), planar, &color, &e), e);
    kit_ok(dev_buffer(d, p->n, p->target_u8, &target, &e), e);
    kit_ok(dev_buffer(d, p->n * sizeof(float), NULL, &out, &e), e);
    if (p->mask)
        kit_ok(dev_buffer(d, px, p->mask, &mask, &e), e);
    struct photometric_input in = {color, target, mask, p->w, p->h, l1, ssim, false};
    struct photometric_value alone;
    kit_ok(photometric_run(l, &in, out, &e), e);
    kit_ok(photometric_read(l, v, &e), e);
    in.value_only = true;
    kit_ok(photometric_run(l, &in, NULL, &e), e);
    kit_ok(photometric_read(l, &alone, &e), e);
    assert_memory_equal(v, &alone, sizeof alone);
    kit_ok(dev_read(d, out, 0, p->n * sizeof(float), planar, &e), e);
    for (size_t i = 0; i < p->n; i++)
        grad[i] = planar[i % 3 * px + i / 3];
    dev_release(&color);
    dev_release(&target);
    dev_release(&mask);
    dev_release(&out);
    mem_free(planar);
}

static void check_kernel(struct photometric *l, uint32_t w, uint32_t h, bool masked, double l1,
                         double ssim)
{
    struct picture p = picture_make(w, h, masked, 10 + w);
    struct photometric_value want, got;
    struct err e = {0};
    double *grad = mem_array(p.n, sizeof *grad), err2 = 0, ref2 = 0, largest = 0;
    float *kernel = mem_array(p.n, sizeof *kernel);
    assert_true(grad && kernel);
    for (size_t i = 0; i < p.n; i++) { /* exactly what the kernel sees: its u8 / 255 is a float */
        p.target[i] = (double)((float)p.target_u8[i] * (1.0f / 255.0f));
        if (i % 97 == 0)
            p.rgb[i] = p.target[i]; /* a difference of exactly 0 has an L1 gradient of 0 */
    }
    kit_ok(photometric_ref_run(p.rgb, p.target, p.mask, w, h, l1, ssim, grad, &want, &e), e);
    kernel_run(l, &p, (float)l1, (float)ssim, kernel, &got);
    for (size_t i = 0; i < p.n; i++) {
        double d = (double)kernel[i] - grad[i];
        err2 += d * d;
        ref2 += grad[i] * grad[i];
        largest = fmax(largest, fabs(grad[i]));
    }
    kit_near("kernel loss gradient", kernel, grad, p.n, KERNEL_REL * largest, KERNEL_REL);
    if (sqrt(err2) > KERNEL_L2 * sqrt(ref2))
        fail_msg("%ux%u: relative L2 error %g > %g", w, h, sqrt(err2 / ref2), KERNEL_L2);
    const double g[4] = {got.total, got.l1, got.ssim, got.mse},
                 r[4] = {want.total, want.l1, want.ssim, want.mse};
    kit_near_d("loss values", g, r, 4, VALUE_REL, VALUE_REL);
    for (size_t i = 0; p.mask && i < p.n; i++)
        assert_true(p.mask[i / 3] || kernel[i] == 0.0f);
    mem_free(grad);
    mem_free(kernel);
    picture_free(&p);
}

static void test_kernel_matches_reference(void **state)
{
    struct photometric *l;
    struct err e = {0};
    struct photometric_value v;
    kit_ok(photometric_open(dev_get(), &l, &e), e);
    kit_fails(photometric_read(l, &v, &e), ERR_ARG, e, "nothing was run");
    static const uint32_t sizes[][2] = {{1, 1},   {3, 2},   {11, 11}, {16, 32},  {17, 33}, {64, 31},
                                        {65, 64}, {63, 70}, {128, 5}, {130, 97}, {7, 100}};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++)
        for (int masked = 0; masked < 2; masked++)
            check_kernel(l, sizes[i][0], sizes[i][1], masked, 0.8, 0.2);
    check_kernel(l, 70, 40, true, 1, 0); /* the L1 shortcut */
    check_kernel(l, 70, 40, false, 0, 1);
    check_kernel(l, 33, 12, false, 0.8,
                 0.2); /* a smaller picture in larger buffers: stale margins */
    struct photometric_input bad = {NULL, NULL, NULL, 0, 10, 1, 1, false};
    kit_fails(photometric_run(l, &bad, NULL, &e), ERR_ARG, e, "sizes");
    /* What render_color_grad_buffer gives when the device is full: no crash in a kernel. */
    cl_mem full;
    kit_ok(dev_buffer(dev_get(), 8 * 8 * 3 * sizeof(float), NULL, &full, &e), e);
    struct photometric_input small = {full, full, NULL, 8, 8, 0.8f, 0.2f, false};
    kit_fails(photometric_run(l, &small, NULL, &e), ERR_MEM, e, "8 x 8");
    dev_release(&full);
    photometric_close(&l);
    photometric_close(&l);
}

/* The kernels as a GPU gets them: a work-item a pixel. */
static void test_narrow_kernel_matches_reference(void **state)
{
    struct dev *d = dev_get();
    uint32_t own = d->vector_width;
    struct photometric *l;
    struct err e = {0};
    d->vector_width = 1;
    enum err_code rc = photometric_open(d, &l, &e);
    d->vector_width = own;
    kit_ok(rc, e);
    static const uint32_t sizes[][2] = {{1, 1}, {16, 16}, {17, 33}, {70, 31}};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++)
        for (int masked = 0; masked < 2; masked++)
            check_kernel(l, sizes[i][0], sizes[i][1], masked, 0.8, 0.2);
    check_kernel(l, 40, 20, true, 1, 0);
    photometric_close(&l);
}

/* The bits of one run as text; `test_loss digest` prints it, so that it can be compared between
 * processes with different numbers of worker threads. */
static void digest(char out[33])
{
    struct photometric *l;
    struct err e = {0};
    struct photometric_value v;
    struct picture p = picture_make(150, 130, true, 5);
    float *grad = mem_array(p.n + 8, sizeof *grad);
    assert_non_null(grad);
    kit_ok(photometric_open(dev_get(), &l, &e), e);
    kernel_run(l, &p, 0.8f, 0.2f, grad, &v);
    memcpy(grad + p.n, &v, sizeof v);
    hash_text(hash_bytes(grad, (p.n + 8) * sizeof *grad), out);
    photometric_close(&l);
    mem_free(grad);
    picture_free(&p);
}

/* Every allocation of the host fails once: an error, no leak, no crash. */
static void test_out_of_memory(void **state)
{
    enum err_code rc = ERR_MEM;
    for (size_t k = 1; rc; k++) {
        struct photometric *l = NULL;
        struct err e = {0};
        cl_mem color, target, grad;
        kit_ok(dev_buffer(dev_get(), 3 * 20 * 20 * sizeof(float), NULL, &color, &e), e);
        kit_ok(dev_buffer(dev_get(), 3 * 20 * 20 * sizeof(float), NULL, &grad, &e), e);
        kit_ok(dev_buffer(dev_get(), 3 * 20 * 20, NULL, &target, &e), e);
        struct photometric_input in = {color, target, NULL, 20, 20, 0.8f, 0.2f, false};
        mem_fail_at(k);
        rc = photometric_open(dev_get(), &l, &e);
        if (!rc)
            rc = photometric_run(l, &in, grad, &e);
        mem_fail_at(0);
        assert_true(!rc || rc == ERR_MEM);
        assert_true(k < 100);
        kit_ok(dev_finish(dev_get(), &e), e);
        photometric_close(&l);
        dev_release(&color);
        dev_release(&target);
        dev_release(&grad);
    }
}

static void test_same_bits(void **state)
{
    kit_same_bits(digest);
}

int main(int argc, char **argv)
{
    if (kit_digest(argc, argv, digest)) {
        dev_close(dev_get());
        return 0;
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ref_closed_forms),
        cmocka_unit_test(test_ref_finite_differences),
        cmocka_unit_test(test_metrics_by_another_program),
        cmocka_unit_test(test_gmsd_by_another_program),
        cmocka_unit_test(test_metrics),
        cmocka_unit_test(test_kernel_matches_reference),
        cmocka_unit_test(test_out_of_memory),
        cmocka_unit_test(test_narrow_kernel_matches_reference),
        cmocka_unit_test(test_same_bits),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
