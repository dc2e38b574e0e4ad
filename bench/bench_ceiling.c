/* Peak arithmetic and memory bandwidth of the device, measured in the same run as all other
 * results.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "bench/bench.h"

extern const char ceiling_cl[];

enum {
    CEILING_ROUNDS = 20000,
    CEILING_CHAINS = 12, /* a round: so many vectors, multiply and add */
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

static enum err_code ceiling_open(struct ceiling *t, struct dev *dev, cl_program *program,
                                  struct err *e)
{
    const struct dev_source src = {.name = "bench/ceiling.cl", .text = ceiling_cl};
    t->dev = dev;
    t->shape = &ceiling_shapes[dev->vector_width == 1];
    const size_t bytes = ceiling_bytes(t->shape);
    enum err_code rc = dev_build(dev, &src, 1, "", program, e);
    if (!rc)
        rc = dev_kernel(*program, "ceiling_fma", &t->fma, e);
    if (!rc)
        rc = dev_kernel(*program, "ceiling_triad", &t->triad, e);
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

enum err_code bench_ceiling(struct bench *b, struct err *e)
{
    struct ceiling t = {0};
    cl_program program = NULL;
    double fma_ms = 0.0, triad_ms = 0.0;
    t.rounds = b->quick ? CEILING_ROUNDS / 20 : CEILING_ROUNDS;
    enum err_code rc = ceiling_open(&t, b->dev, &program, e);
    if (!rc)
        rc = bench_time(b, ceiling_run_fma, &t, &fma_ms, NULL, e);
    if (!rc)
        rc = bench_time(b, ceiling_run_triad, &t, &triad_ms, NULL, e);
    if (!rc) {
        double flop = 2.0 * CEILING_CHAINS * (double)(t.shape->items * t.shape->lanes);
        b->fma_gflops = flop * t.rounds / (fma_ms * 1e6);
        b->triad_gbps = 3.0 * (double)ceiling_bytes(t.shape) / (triad_ms * 1e6);
        bench_report(b, "fma", b->fma_gflops, "GFLOP/s", 0.0, NULL);
        bench_report(b, "triad", b->triad_gbps, "GB/s", 0.0, NULL);
    }
    cl_mem *buffers[] = {&t.out, &t.a, &t.b, &t.c};
    for (size_t i = 0; i < sizeof buffers / sizeof buffers[0]; i++)
        dev_release(buffers[i]);
    if (t.fma)
        clReleaseKernel(t.fma);
    if (t.triad)
        clReleaseKernel(t.triad);
    if (program)
        clReleaseProgram(program);
    return rc;
}
