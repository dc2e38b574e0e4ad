/* The OpenCL device: choice, context, queue, programs, buffers. The only file that knows device
 * quirks.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_DEV_H
#define CORE_DEV_H

#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

enum { DEV_LAUNCHES_MAX = 256 };
struct dev { /* made by dev_open; one caller at a time */
    cl_platform_id platform;
    cl_device_id device;
    cl_context context;
    cl_command_queue queue; /* in order */
    bool is_cpu;
    bool is_pocl;
    uint32_t vector_width; /* VW of the per-Gaussian kernels: 16 on CPUs, 1 on GPUs */
    uint64_t max_alloc_bytes, global_bytes;
    char name[128], driver[64];
    double compile_s;   /* spent on compiling kernels so far: programs, and first launches */
    struct dev_launch { /* those that were launched before */
        cl_kernel kernel;
        size_t local;
        bool large; /* more work-items than PoCL compiles its smaller version for */
    } launched[DEV_LAUNCHES_MAX];
    size_t n_launched;
};

/* `want` selects: NULL or "auto" (first GPU, else first CPU), "cpu", "gpu", "gpu:K" (the K-th from
 * 0), or a substring of the device name. ERR_DEVICE lists what was found, or says how to install
 * PoCL when there is none. Must be called before any fork; kernels are cached in POCL_CACHE_DIR /
 * XDG_CACHE_HOME. dev_close it. */
enum err_code dev_open(const char *want, struct dev *out, struct err *e) ERR_USE;
void dev_close(struct dev *d);

/* One source file of a program: `text` is embedded by core/embed.cmake; `name` is what the log
 * cites. */
struct dev_source {
    const char *name, *text;
};
/* Build from sources in order, core/layout.h first, each preceded by a #line. `options` is added to
 * the fixed set (-cl-std=CL1.2 -cl-denorms-are-zero -DVW=...). The whole build log goes into e.
 * clReleaseProgram it; a kernel, clReleaseKernel. ERR_DEVICE, ERR_MEM. */
enum err_code dev_build(struct dev *d, const struct dev_source *sources, size_t n_sources,
                        const char *options, cl_program *out, struct err *e) ERR_USE;
enum err_code dev_kernel(cl_program program, const char *name, cl_kernel *out,
                         struct err *e) ERR_USE;
/* size_bytes is rounded up to 64; 0 becomes 64. `host` (may be NULL) is copied. ERR_MEM / ERR_LIMIT
 * say how much was asked and what the device allows. */
enum err_code dev_buffer(struct dev *d, size_t size_bytes, const void *host, cl_mem *out,
                         struct err *e) ERR_USE;
void dev_release(cl_mem *m); /* NULL is accepted; leaves NULL */
/* Bytes [offset, offset + n) of a buffer. Reading and writing block. ERR_DEVICE. */
enum err_code dev_read(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes, void *out,
                       struct err *e) ERR_USE; /* blocking */
enum err_code dev_write(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                        const void *in, struct err *e) ERR_USE;
enum err_code dev_zero(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                       struct err *e) ERR_USE;
/* The first n_bytes of a buffer as the host sees them, to read (CL_MAP_READ), to write or both: no
 * copy where host and device share memory. Blocking. Meanwhile kernels may read what is mapped for
 * reading only, and must leave everything else alone. dev_unmap gives *out back; NULL is accepted
 * and it leaves NULL. ERR_DEVICE. */
enum err_code dev_map(struct dev *d, cl_mem m, cl_map_flags flags, size_t n_bytes, void **out,
                      struct err *e) ERR_USE;
enum err_code dev_unmap(struct dev *d, cl_mem m, void **mapped, struct err *e) ERR_USE;
/* Set argument `index`, collecting failures: call per argument, check once at dev_run. */
#define dev_arg(k, index, value) clSetKernelArg((k), (index), sizeof(value), &(value))
/* Enqueue a one-dimensional launch of items `global`, rounded up to a multiple of `local`;
 * dev_finish waits for all that was enqueued. ERR_DEVICE. */
enum err_code dev_run(struct dev *d, cl_kernel k, const char *name, size_t global, size_t local,
                      struct err *e) ERR_USE;
enum err_code dev_finish(struct dev *d, struct err *e) ERR_USE;
const char *dev_error_name(cl_int code);

#endif
