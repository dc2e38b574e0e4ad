/* Peak arithmetic and memory bandwidth of the device, measured in the same run as all other
 * results.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/bench/bench.h"

#include <math.h>

extern const char ceiling_cl[];

enum {
    CEILING_ROUNDS = 20000,
    CEILING_CHAINS = 12, /* a round: so many vectors, multiply and add */
    CEILING_BEST_OF = 5, /* bench_ceilings: runs of a quarter of the rounds */
};

/* Of a CPU and of a GPU: a GPU has thousands of lanes at work, and more memory than its cache. */
static const struct ceiling_shape {
    size_t lanes; /* of a vector */
    size_t local, items;
    size_t chunk, chunks;                                  /* vectors of a work-item, work-items */
} ceiling_shapes[2] = {{16, 1, 4096, 1024, 1024},          /* 64 MiB an array */
                       {4, 256, 1024 * 1024, 8, 8 << 20}}; /* 1 GiB an array */

struct ceiling {
    struct dev *dev;
    const struct ceiling_shape *shape;
    cl_program program;
    cl_kernel fma, triad;
    cl_mem out, a, b, c;
    cl_int rounds;
};

static size_t ceiling_bytes(const struct ceiling_shape *s)
{
    return s->chunks * s->chunk * s->lanes * sizeof(float);
}

static enum err_code ceiling_run_fma(void *user, struct err *e)
{
    struct ceiling *t = user;
    float x = 1.0f;
    dev_arg(t->fma, 0, t->out);
    dev_arg(t->fma, 1, x);
    dev_arg(t->fma, 2, t->rounds);
    enum err_code rc = dev_run(t->dev, t->fma, "ceiling_fma", t->shape->items, t->shape->local, e);
    return rc ? rc : dev_finish(t->dev, e);
}

static enum err_code ceiling_run_triad(void *user, struct err *e)
{
    struct ceiling *t = user;
    float s = 0.5f;
    cl_int chunk = (cl_int)t->shape->chunk;
    dev_arg(t->triad, 0, t->a);
    dev_arg(t->triad, 1, t->b);
    dev_arg(t->triad, 2, t->c);
    dev_arg(t->triad, 3, s);
    dev_arg(t->triad, 4, chunk);
    enum err_code rc =
        dev_run(t->dev, t->triad, "ceiling_triad", t->shape->chunks, t->shape->local, e);
    return rc ? rc : dev_finish(t->dev, e);
}

static enum err_code ceiling_open(struct ceiling *t, struct dev *dev, struct err *e)
{
    const struct dev_source src = {.name = "lab/bench/ceiling.cl", .text = ceiling_cl};
    t->dev = dev;
    t->shape = &ceiling_shapes[dev->vector_width == 1];
    const size_t bytes = ceiling_bytes(t->shape);
    enum err_code rc = dev_build(dev, &src, 1, "", &t->program, e);
    if (!rc)
        rc = dev_kernel(t->program, "ceiling_fma", &t->fma, e);
    if (!rc)
        rc = dev_kernel(t->program, "ceiling_triad", &t->triad, e);
    if (!rc)
        rc = dev_buffer(dev, t->shape->items * t->shape->lanes * sizeof(float), NULL, &t->out, e);
    cl_mem *arrays[] = {&t->a, &t->b, &t->c};
    for (size_t i = 0; !rc && i < 3; i++) {
        rc = dev_buffer(dev, bytes, NULL, arrays[i], e);
        if (!rc)
            rc = dev_zero(dev, *arrays[i], 0, bytes, e);
    }
    return rc;
}

static void ceiling_close(struct ceiling *t)
{
    cl_mem *buffers[] = {&t->out, &t->a, &t->b, &t->c};
    for (size_t i = 0; i < sizeof buffers / sizeof buffers[0]; i++)
        dev_release(buffers[i]);
    if (t->fma)
        clReleaseKernel(t->fma);
    if (t->triad)
        clReleaseKernel(t->triad);
    if (t->program)
        clReleaseProgram(t->program);
}

static double ceiling_flop(const struct ceiling *t)
{
    return 2.0 * CEILING_CHAINS * (double)(t->shape->items * t->shape->lanes) * t->rounds;
}

enum err_code bench_ceiling(struct bench *b, struct err *e)
{
    struct ceiling t = {0};
    double fma_ms = 0.0, triad_ms = 0.0;
    t.rounds = b->quick ? CEILING_ROUNDS / 20 : CEILING_ROUNDS;
    enum err_code rc = ceiling_open(&t, b->dev, e);
    if (!rc)
        rc = bench_time(b, ceiling_run_fma, &t, &fma_ms, NULL, e);
    if (!rc)
        rc = bench_time(b, ceiling_run_triad, &t, &triad_ms, NULL, e);
    if (!rc) {
        b->fma_gflops = ceiling_flop(&t) / (fma_ms * 1e6);
        b->triad_gbps = 3.0 * (double)ceiling_bytes(t.shape) / (triad_ms * 1e6);
        bench_report(b, "fma", b->fma_gflops, "GFLOP/s", 0.0, NULL);
        bench_report(b, "triad", b->triad_gbps, "GB/s", 0.0, NULL);
    }
    ceiling_close(&t);
    return rc;
}

/* ---- again and again, between other measurements ---- */

unsigned bench_cores(const struct bench *b)
{
    cl_uint cores = 1;
    if (b->dev->is_cpu && clGetDeviceInfo(b->dev->device, CL_DEVICE_MAX_COMPUTE_UNITS, sizeof cores,
                                          &cores, NULL) != CL_SUCCESS)
        cores = 1;
    return cores;
}

enum err_code bench_ceilings_open(struct bench *b, struct ceiling **out, struct err *e)
{
    struct ceiling *t = *out = mem_array(1, sizeof *t);
    if (!t)
        return err_set(e, ERR_MEM, "ceilings: out of memory");
    enum err_code rc = ceiling_open(t, b->dev, e);
    t->rounds = b->quick ? CEILING_ROUNDS / 20 : CEILING_ROUNDS / 4;
    if (!rc) /* the first launch compiles */
        rc = ceiling_run_fma(t, e);
    if (!rc)
        rc = ceiling_run_triad(t, e);
    if (rc)
        bench_ceilings_close(out);
    return rc;
}

void bench_ceilings_close(struct ceiling **t)
{
    if (*t)
        ceiling_close(*t);
    mem_free(*t);
    *t = NULL;
}

enum err_code bench_ceilings(struct bench *b, struct ceiling *t, struct bench_ceilings *out,
                             struct err *e)
{
    double least[2] = {(double)INFINITY, (double)INFINITY}; /* ms */
    enum err_code rc = ERR_OK;
    for (int i = 0; !rc && i < CEILING_BEST_OF; i++) {
        struct dev_time times[2];
        size_t n = 0;
        rc = dev_time_begin(b->dev, e);
        if (rc)
            break;
        dev_time_cores(b->dev);
        rc = ceiling_run_fma(t, e);
        if (!rc)
            rc = ceiling_run_triad(t, e);
        enum err_code ended = dev_time_end(b->dev, times, 2, &n, e);
        rc = rc ? rc : ended;
        for (size_t k = 0; !rc && k < n; k++)
            least[k] =
                fmin(least[k], b->dev->is_cpu ? times[k].core_ms / bench_cores(b) : times[k].ms);
    }
    out->fma_gflops = ceiling_flop(t) / (least[0] * 1e6);
    out->triad_gbps = 3.0 * (double)ceiling_bytes(t->shape) / (least[1] * 1e6);
    return rc;
}
