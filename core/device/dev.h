/* The OpenCL device: choice, context, queue, programs, buffers. Only core/device/dev.c and
 * dev_build.c know how devices of different vendors differ.
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

#include "core/base.h"

struct buf;
struct compiler_job;
enum { DEV_LAUNCHES_MAX = 256, DEV_BUILT_MAX = 32 };
struct dev_built {           /* a program of this device */
    const char *name, *from; /* its last source; "kept" on the disk, or "compiled" now */
    double seconds;
};
struct dev { /* made by dev_open; only one thread at a time may use it */
    cl_platform_id platform;
    cl_device_id device;
    cl_context context;
    cl_command_queue queue; /* in order */
    bool is_cpu;
    bool is_pocl;
    uint32_t vector_width; /* VW of the per-Gaussian kernels: 16 on CPUs, 1 on GPUs */
    uint64_t max_alloc_bytes, global_bytes;
    char name[128], driver[64];
    /* seconds spent so far on compiling kernels: of programs, and at first launches */
    double compile_s;
    cl_kernel launched[DEV_LAUNCHES_MAX]; /* at least once */
    size_t n_launched;
    char programs[FILE_PATH_MAX]; /* folder of compiled programs; "": none are kept */
    bool said_compiling;
    size_t method; /* which the compiler survived: dev_build.c */
    struct dev_built built[DEV_BUILT_MAX];
    size_t n_built;
    struct dev_timing *timing; /* dev_time_begin; NULL: no kernel is timed */
};

/* Opens a device. `want` is NULL or "auto" (first GPU, else first CPU), "cpu", "gpu", "gpu:K" (the
 * K-th from 0), or a part of the device's name. Compiled kernels are cached in POCL_CACHE_DIR or
 * XDG_CACHE_HOME. POCL_KERNEL_CACHE=0 turns that off. Call it before any fork. Close it with
 * dev_close. ERR_DEVICE lists the devices found; if there are none, it says how to install PoCL. */
enum err_code dev_open(const char *want, struct dev *out, struct err *e) ERR_USE;
void dev_close(struct dev *d);

/* One source file of a program. core/embed.cmake embeds `text`. The log cites `name`. */
struct dev_source {
    const char *name, *text;
};
/* dev_build compiles the sources in order, with core/layout.h before them and a #line before each.
 * `options` are added to the fixed ones (-cl-std=CL1.2 -cl-denorms-are-zero -DVW=...). On PoCL the
 * compiled program is kept on the disk for the next start, and another process compiles, which may
 * die without harm (core/device/compiler.h). On failure e has the whole build log. The caller
 * releases with clReleaseProgram and clReleaseKernel. ERR_DEVICE, ERR_MEM. */
enum err_code dev_build(struct dev *d, const struct dev_source *sources, size_t n_sources,
                        const char *options, cl_program *out, struct err *e) ERR_USE;
enum err_code dev_kernel(cl_program program, const char *name, cl_kernel *out,
                         struct err *e) ERR_USE;
/* For that process: compiles in this one and adds the binary to `out`. False: it has none. */
bool dev_compile(struct dev *d, const struct compiler_job *job, struct buf *out);
/* The way in which the driver compiles work-groups, for people: "as the driver does" or the name of
 * the one that its compiler survives. */
const char *dev_method(const struct dev *d);
/* Appends a build log with the right files and lines. Some drivers (NVIDIA's) ignore #line: their
 * logs cite "<kernel>" and count lines over all `n_text` pieces that the compiler was given.
 * names[i] is the file of piece 2 i + 1; piece 2 i is the #line before it. */
void dev_cite(const char *log, const char *const *text, const char *const *names, size_t n_text,
              struct buf *out);
/* Allocates a buffer. size_bytes is rounded up to a multiple of 64; 0 becomes 64. `host` (may be
 * NULL) is copied into it. ERR_MEM and ERR_LIMIT say how much was wanted and what the device
 * allows. */
enum err_code dev_buffer(struct dev *d, size_t size_bytes, const void *host, cl_mem *out,
                         struct err *e) ERR_USE;
void dev_release(cl_mem *m); /* NULL is accepted; leaves NULL */
/* Makes *m a buffer of at least n_bytes; *room is its size, 0 at first. A buffer that is too small
 * is replaced, and its values are lost. After ERR_MEM or ERR_LIMIT there is no buffer. */
enum err_code dev_reserve(struct dev *d, size_t n_bytes, cl_mem *m, size_t *room,
                          struct err *e) ERR_USE;
/* Read, write or zero the bytes [offset, offset + n) of a buffer. dev_read and dev_write block.
 * ERR_DEVICE. */
enum err_code dev_read(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes, void *out,
                       struct err *e) ERR_USE; /* blocks */
enum err_code dev_write(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                        const void *in, struct err *e) ERR_USE;
enum err_code dev_zero(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                       struct err *e) ERR_USE;
/* The same without waiting, in the order of the queue. What `in` points to must stay as it is until
 * the host has waited for something that was enqueued later. *out is filled when dev_wait of *p has
 * returned; it does not wait for what was enqueued later. Call it once for each dev_read_soon, also
 * after an error; {0} is accepted. ERR_DEVICE. */
struct dev_pending {
    cl_event event;
};
enum err_code dev_write_soon(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                             const void *in, struct err *e) ERR_USE;
enum err_code dev_read_soon(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes, void *out,
                            struct dev_pending *p, struct err *e) ERR_USE;
enum err_code dev_wait(struct dev *d, struct dev_pending *p, struct err *e) ERR_USE;
/* After a failure: waits until nothing borrowed is in use, and forgets the read (may be NULL). */
void dev_abandon(struct dev *d, struct dev_pending *p);
/* dev_map gives the host access to the first n_bytes of a buffer, for reading (CL_MAP_READ),
 * writing or both. Where host and device share memory nothing is copied. It blocks. While a buffer
 * is mapped for reading, kernels may read it. A buffer mapped for writing belongs to the host
 * alone. dev_unmap ends the access and sets *mapped to NULL; NULL is accepted. ERR_DEVICE. */
enum err_code dev_map(struct dev *d, cl_mem m, cl_map_flags flags, size_t n_bytes, void **out,
                      struct err *e) ERR_USE;
enum err_code dev_unmap(struct dev *d, cl_mem m, void **mapped, struct err *e) ERR_USE;
/* Sets argument `index` of a kernel. It returns an OpenCL code: OR the codes of all arguments and
 * check the result once. */
#define dev_arg(k, index, value) clSetKernelArg((k), (index), sizeof(value), &(value))
/* The local size for a kernel that works with any: 1 on CPUs, where a work-item is a whole piece of
 * work; 64 on GPUs, where a smaller group leaves lanes idle. The kernel must ignore work-items
 * beyond its last, because dev_run rounds up. */
size_t dev_local(const struct dev *d);
/* dev_run enqueues a one-dimensional launch of `global` work-items, rounded up to a multiple of
 * `local`. dev_finish waits until the queue is empty. ERR_DEVICE. */
enum err_code dev_run(struct dev *d, cl_kernel k, const char *name, size_t global, size_t local,
                      struct err *e) ERR_USE;
enum err_code dev_finish(struct dev *d, struct err *e) ERR_USE;
const char *dev_error_name(cl_int code);
/* Measure how long the kernels that are launched between dev_time_begin and dev_time_end take on
 * the device. Launches of the same name are added up. dev_time_end gives at most `max` names, in
 * the order of their first launch, and frees what dev_time_begin allocated. With out NULL it only
 * frees. Call it before dev_close. ERR_DEVICE, ERR_MEM. */
struct dev_time {
    const char *name; /* the name that dev_run was given */
    size_t launches;
    double ms;
    double core_ms; /* processor time of the threads that ran it; 0 without dev_time_cores */
};
enum err_code dev_time_begin(struct dev *d, struct err *e) ERR_USE;
enum err_code dev_time_end(struct dev *d, struct dev_time *out, size_t max, size_t *n,
                           struct err *e) ERR_USE;
/* After dev_time_begin, on a device whose threads are those of this process: each launch is waited
 * for, and its processor time is measured, which other programs on the machine disturb less. What
 * other threads of this process do meanwhile is counted, too. */
void dev_time_cores(struct dev *d);

#endif
