/* The OpenCL device: choice, context, queue, buffers, launches. dev_build.c has its programs.
 *
 * All that depends on a vendor is decided here: the vector width of kernels (16 lanes on CPUs,
 * where PoCL keeps a float16 in one register; 1 on GPUs, where a work-item is a lane), whether
 * clang builtins may be used (PoCL), where compiled kernels are cached, and how much memory a
 * buffer may have. A device has one in-order queue, so no other code knows events.
 *
 * PoCL compiles kernels to its cache folder. If it cannot write there it fails late and without a
 * clear message, so the folder is checked before the first OpenCL call. Its cache still parses the
 * source at every start, so programs are kept as binaries too (docs/decisions/003-build.md).
 * PoCL's worker threads do not survive fork().
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/device/dev.h"

#include <assert.h>
#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base.h"
#include "core/device/dev_internal.h"
#include "core/device/programs.h"
#include "core/pool.h"
#include "core/trace.h"

enum { PLATFORMS_MAX = 16, DEVICES_MAX = 32, BUFFER_ROUND = 64 };

static enum err_code dev_trace_begin(struct dev *d, struct err *e) ERR_USE;
static void dev_trace_drain(struct dev *d);
static void dev_untime(struct dev *d);

struct found { /* one device of one platform */
    cl_platform_id platform;
    cl_device_id device;
    cl_device_type type;
    char name[128];
};

const char *dev_error_name(cl_int code)
{
    static const struct {
        cl_int code;
        const char *name;
    } names[] = {
        {CL_SUCCESS, "CL_SUCCESS"},
        {CL_DEVICE_NOT_FOUND, "CL_DEVICE_NOT_FOUND"},
        {CL_DEVICE_NOT_AVAILABLE, "CL_DEVICE_NOT_AVAILABLE"},
        {CL_COMPILER_NOT_AVAILABLE, "CL_COMPILER_NOT_AVAILABLE"},
        {CL_MEM_OBJECT_ALLOCATION_FAILURE, "CL_MEM_OBJECT_ALLOCATION_FAILURE"},
        {CL_OUT_OF_RESOURCES, "CL_OUT_OF_RESOURCES"},
        {CL_OUT_OF_HOST_MEMORY, "CL_OUT_OF_HOST_MEMORY"},
        {CL_MEM_COPY_OVERLAP, "CL_MEM_COPY_OVERLAP"},
        {CL_BUILD_PROGRAM_FAILURE, "CL_BUILD_PROGRAM_FAILURE"},
        {CL_MAP_FAILURE, "CL_MAP_FAILURE"},
        {CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST,
         "CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST"},
        {CL_INVALID_VALUE, "CL_INVALID_VALUE"},
        {CL_INVALID_DEVICE, "CL_INVALID_DEVICE"},
        {CL_INVALID_CONTEXT, "CL_INVALID_CONTEXT"},
        {CL_INVALID_COMMAND_QUEUE, "CL_INVALID_COMMAND_QUEUE"},
        {CL_INVALID_MEM_OBJECT, "CL_INVALID_MEM_OBJECT"},
        {CL_INVALID_BINARY, "CL_INVALID_BINARY"},
        {CL_INVALID_BUILD_OPTIONS, "CL_INVALID_BUILD_OPTIONS"},
        {CL_INVALID_PROGRAM, "CL_INVALID_PROGRAM"},
        {CL_INVALID_PROGRAM_EXECUTABLE, "CL_INVALID_PROGRAM_EXECUTABLE"},
        {CL_INVALID_KERNEL_NAME, "CL_INVALID_KERNEL_NAME"},
        {CL_INVALID_KERNEL, "CL_INVALID_KERNEL"},
        {CL_INVALID_ARG_INDEX, "CL_INVALID_ARG_INDEX"},
        {CL_INVALID_ARG_VALUE, "CL_INVALID_ARG_VALUE"},
        {CL_INVALID_ARG_SIZE, "CL_INVALID_ARG_SIZE"},
        {CL_INVALID_KERNEL_ARGS, "CL_INVALID_KERNEL_ARGS"},
        {CL_INVALID_WORK_DIMENSION, "CL_INVALID_WORK_DIMENSION"},
        {CL_INVALID_WORK_GROUP_SIZE, "CL_INVALID_WORK_GROUP_SIZE"},
        {CL_INVALID_WORK_ITEM_SIZE, "CL_INVALID_WORK_ITEM_SIZE"},
        {CL_INVALID_GLOBAL_OFFSET, "CL_INVALID_GLOBAL_OFFSET"},
        {CL_INVALID_BUFFER_SIZE, "CL_INVALID_BUFFER_SIZE"},
        {CL_INVALID_GLOBAL_WORK_SIZE, "CL_INVALID_GLOBAL_WORK_SIZE"},
        {-1001, "CL_PLATFORM_NOT_FOUND_KHR"},
    };
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (names[i].code == code)
            return names[i].name;
    return "unknown OpenCL error";
}

enum err_code dev_fail(struct err *e, int32_t code, const char *what, const char *which)
{
    bool memory = code == CL_MEM_OBJECT_ALLOCATION_FAILURE || code == CL_OUT_OF_HOST_MEMORY ||
                  code == CL_OUT_OF_RESOURCES;
    return err_set(e, memory ? ERR_MEM : ERR_DEVICE, "%s: %s: %s (%d)", what, which,
                   dev_error_name(code), (int)code);
}

/* ---- choice ---- */

/* mkdir -p; true when `path` is a folder we may write to afterwards. */
static bool dev_folder_writable(const char *path)
{
    char part[FILE_PATH_MAX];
    size_t n = strlen(path);
    if (n == 0 || n >= sizeof part)
        return false;
    memcpy(part, path, n + 1);
    for (size_t i = 1; i <= n; i++)
        if (part[i] == '/' || part[i] == '\0') {
            char keep = part[i];
            part[i] = '\0';
            (void)mkdir(part, 0700); /* an error shows in access() below */
            part[i] = keep;
        }
    struct stat st;
    return stat(path, &st) == 0 && S_ISDIR(st.st_mode) && access(path, R_OK | W_OK | X_OK) == 0;
}

/* PoCL writes compiled kernels to POCL_CACHE_DIR, else $XDG_CACHE_HOME/pocl, else ~/.cache/pocl. A
 * service account may have none of them; then a folder of our own under TMPDIR is used. `path`
 * [FILE_PATH_MAX] becomes that folder. */
static enum err_code dev_cache_prepare(char *path, struct err *e)
{
    const char *given = getenv("POCL_CACHE_DIR"), *xdg = getenv("XDG_CACHE_HOME"),
               *home = getenv("HOME"), *tmp = getenv("TMPDIR");
    if (given && *given) {
        snprintf(path, FILE_PATH_MAX, "%s", given);
        if (dev_folder_writable(given))
            return ERR_OK;
        return err_set(
            e, ERR_DEVICE,
            "dev_open: POCL_CACHE_DIR %s: cannot be created or written; compiled kernels are "
            "kept there, name another folder",
            given);
    }
    path[0] = '\0';
    if (xdg && *xdg)
        snprintf(path, FILE_PATH_MAX, "%s/pocl/kcache", xdg);
    else if (home && *home)
        snprintf(path, FILE_PATH_MAX, "%s/.cache/pocl/kcache", home);
    if (*path && dev_folder_writable(path))
        return ERR_OK;
    snprintf(path, FILE_PATH_MAX, "%s/citysplat-kernels-%lu", tmp && *tmp ? tmp : "/tmp",
             (unsigned long)getuid());
    struct stat st;
    /* The folder holds code that will be run: it must be ours, and nobody else may write to it. */
    if (!dev_folder_writable(path) || lstat(path, &st) != 0 || !S_ISDIR(st.st_mode) ||
        st.st_uid != getuid() || (st.st_mode & (S_IWGRP | S_IWOTH)))
        return err_set(
            e, ERR_DEVICE,
            "dev_open: kernel cache %s: not a private writable folder; set POCL_CACHE_DIR to one",
            path);
    if (setenv("POCL_CACHE_DIR", path, 1) != 0)
        return err_errno(e, ERR_DEVICE, "dev_open: POCL_CACHE_DIR");
    return ERR_OK;
}

/* By default PoCL compiles a kernel once more for each size of work-groups and of launches. Our
 * kernels gain nothing from that, and the binary of a program would hold none of these versions. */
static void dev_specialize_not(void)
{
    (void)setenv("POCL_WORK_GROUP_SPECIALIZATION", "0", 0);
}

/* Where compiled programs are kept: beside PoCL's kernels. Other drivers keep programs themselves.
 * Without a folder nothing is kept. */
static void dev_programs_prepare(struct dev *d, const char *cache)
{
    const char *off = getenv("POCL_KERNEL_CACHE");
    if (!d->is_pocl || (off && !strcmp(off, "0")) ||
        file_join(d->programs, cache, "citysplat", NULL) || !programs_folder(d->programs))
        d->programs[0] = '\0';
}

static size_t dev_list(struct found *list)
{
    cl_platform_id platforms[PLATFORMS_MAX];
    cl_uint n_platforms = 0;
    size_t n = 0;
    if (clGetPlatformIDs(PLATFORMS_MAX, platforms, &n_platforms) != CL_SUCCESS)
        return 0;
    if (n_platforms > PLATFORMS_MAX)
        n_platforms = PLATFORMS_MAX;
    for (cl_uint p = 0; p < n_platforms; p++) {
        cl_device_id devices[DEVICES_MAX];
        cl_uint n_devices = 0;
        if (clGetDeviceIDs(platforms[p], CL_DEVICE_TYPE_ALL, DEVICES_MAX, devices, &n_devices) !=
            CL_SUCCESS)
            continue;
        if (n_devices > DEVICES_MAX)
            n_devices = DEVICES_MAX;
        for (cl_uint d = 0; d < n_devices && n < DEVICES_MAX; d++) {
            struct found *f = &list[n];
            cl_bool usable = CL_FALSE;
            memset(f, 0, sizeof *f);
            f->platform = platforms[p];
            f->device = devices[d];
            if (clGetDeviceInfo(devices[d], CL_DEVICE_TYPE, sizeof f->type, &f->type, NULL) ||
                clGetDeviceInfo(devices[d], CL_DEVICE_COMPILER_AVAILABLE, sizeof usable, &usable,
                                NULL) ||
                clGetDeviceInfo(devices[d], CL_DEVICE_NAME, sizeof f->name, f->name, NULL))
                continue;
            f->name[sizeof f->name - 1] = '\0';
            n += usable ? 1 : 0;
        }
    }
    return n;
}

static bool dev_text_contains(const char *text, const char *part)
{
    size_t n = strlen(part);
    for (; *text; text++)
        if (strncasecmp(text, part, n) == 0)
            return true;
    return false;
}

static const struct found *dev_pick(const struct found *list, size_t n, const char *want)
{
    bool any = !want || !*want || strcmp(want, "auto") == 0;
    bool gpu = any || strcmp(want, "gpu") == 0;
    unsigned long nth = 0;
    if (!gpu && strncmp(want, "gpu:", 4) == 0 && isdigit((unsigned char)want[4])) {
        char *end;
        nth = strtoul(want + 4, &end, 10);
        gpu = *end == '\0';
    }
    for (size_t i = 0; gpu && i < n; i++)
        if ((list[i].type & CL_DEVICE_TYPE_GPU) && nth-- == 0)
            return &list[i];
    if (any || strcmp(want, "cpu") == 0)
        for (size_t i = 0; i < n; i++)
            if (list[i].type & CL_DEVICE_TYPE_CPU)
                return &list[i];
    if (!any)
        for (size_t i = 0; i < n; i++)
            if (dev_text_contains(list[i].name, want))
                return &list[i];
    return NULL;
}

/* The device we can run on is chosen; what is left is why none was. */
static enum err_code dev_none(const struct found *list, size_t n, const char *want, struct err *e)
{
    char names[512] = "";
    if (n == 0)
        return err_set(
            e, ERR_DEVICE,
            "dev_open: no OpenCL device found: install a driver; for the CPU the package is "
            "pocl-opencl-icd");
    for (size_t i = 0, at = 0; i < n && at < sizeof names - 1; i++) {
        int k = snprintf(names + at, sizeof names - at, "%s%s", i ? ", " : "", list[i].name);
        at += k > 0 ? (size_t)k : 0;
    }
    return err_set(e, ERR_DEVICE, "dev_open: device '%s': no such device; found: %s",
                   want ? want : "auto", names);
}

static enum err_code dev_query(struct dev *d, struct err *e)
{
    char platform[128] = "";
    cl_ulong max_alloc = 0, global = 0;
    cl_int rc = clGetDeviceInfo(d->device, CL_DEVICE_MAX_MEM_ALLOC_SIZE, sizeof max_alloc,
                                &max_alloc, NULL);
    if (rc == CL_SUCCESS)
        rc = clGetDeviceInfo(d->device, CL_DEVICE_GLOBAL_MEM_SIZE, sizeof global, &global, NULL);
    if (rc == CL_SUCCESS)
        rc = clGetDeviceInfo(d->device, CL_DRIVER_VERSION, sizeof d->driver, d->driver, NULL);
    if (rc == CL_SUCCESS)
        rc = clGetPlatformInfo(d->platform, CL_PLATFORM_NAME, sizeof platform, platform, NULL);
    if (rc != CL_SUCCESS)
        return dev_fail(e, rc, "dev_open", d->name);
    platform[sizeof platform - 1] = d->driver[sizeof d->driver - 1] = '\0';
    d->max_alloc_bytes = max_alloc;
    d->global_bytes = global;
    d->is_pocl = dev_text_contains(platform, "Portable Computing Language");
    return ERR_OK;
}

enum err_code dev_open(const char *want, struct dev *out, struct err *e)
{
    struct found list[DEVICES_MAX];
    struct dev d = {0};
    char cache[FILE_PATH_MAX];
    cl_int code = CL_SUCCESS;
    enum err_code rc = dev_cache_prepare(cache, e);
    memset(out, 0, sizeof *out);
    if (rc)
        return rc;
    dev_specialize_not();
    size_t n = dev_list(list);
    const struct found *f = dev_pick(list, n, want);
    if (!f)
        return dev_none(list, n, want, e);
    d.platform = f->platform;
    d.device = f->device;
    d.is_cpu = (f->type & CL_DEVICE_TYPE_CPU) != 0;
    d.vector_width = d.is_cpu ? 16 : 1;
    memcpy(d.name, f->name, sizeof d.name);
    rc = dev_query(&d, e);
    if (rc)
        goto out;
    dev_programs_prepare(&d, cache);
    cl_context_properties props[] = {CL_CONTEXT_PLATFORM, (cl_context_properties)d.platform, 0};
    d.context = clCreateContext(props, 1, &d.device, NULL, NULL, &code);
    if (code != CL_SUCCESS) {
        rc = dev_fail(e, code, "dev_open: context", d.name);
        goto out;
    }
    d.queue = clCreateCommandQueue(d.context, d.device, 0, &code);
    if (code != CL_SUCCESS) {
        rc = dev_fail(e, code, "dev_open: queue", d.name);
        goto out;
    }
    if (trace_on())
        rc = dev_trace_begin(&d, e);
out:
    if (rc)
        dev_close(&d);
    else
        *out = d;
    return rc;
}

void dev_close(struct dev *d)
{
    if (!d)
        return;
    if (d->timing && trace_on())
        dev_trace_drain(d);
    dev_untime(d);
    if (d->queue) {
        clFinish(d->queue);
        clReleaseCommandQueue(d->queue);
    }
    if (d->context)
        clReleaseContext(d->context);
    memset(d, 0, sizeof *d);
}

/* ---- buffers ---- */

/* A buffer of PoCL's CPU devices is plain memory, and a step of training walks through all of it.
 */
static void dev_prefer_huge(struct dev *d, cl_mem m, size_t n_bytes)
{
    cl_int code = CL_SUCCESS;
    if (!d->is_pocl || d->vector_width == 1)
        return;
    void *p =
        clEnqueueMapBuffer(d->queue, m, CL_TRUE, CL_MAP_WRITE, 0, n_bytes, 0, NULL, NULL, &code);
    if (code != CL_SUCCESS)
        return; /* nothing is lost but speed */
    mem_prefer_huge(p, n_bytes);
    (void)clEnqueueUnmapMemObject(d->queue, m, p, 0, NULL, NULL);
}

static enum err_code dev_too_large(const struct dev *d, size_t size_bytes, struct err *e)
{
    return err_set(
        e, ERR_LIMIT,
        "dev_buffer: %zu bytes: %s allows %llu in one buffer; use smaller cells or images",
        size_bytes, d->name, (unsigned long long)d->max_alloc_bytes);
}

enum err_code dev_buffer(struct dev *d, size_t size_bytes, const void *host, cl_mem *out,
                         struct err *e)
{
    cl_int code = CL_SUCCESS;
    *out = NULL;
    if (size_bytes > SIZE_MAX - BUFFER_ROUND ||
        (size_bytes + BUFFER_ROUND - 1) / BUFFER_ROUND * BUFFER_ROUND > d->max_alloc_bytes)
        return dev_too_large(d, size_bytes, e);
    size_t rounded = (size_bytes + BUFFER_ROUND - 1) / BUFFER_ROUND * BUFFER_ROUND;
    if (rounded == 0)
        rounded = BUFFER_ROUND;
    *out = clCreateBuffer(d->context, CL_MEM_READ_WRITE, rounded, NULL, &code);
    if (code != CL_SUCCESS) {
        char which[64];
        snprintf(which, sizeof which, "%zu bytes", rounded);
        *out = NULL;
        return dev_fail(e, code, "dev_buffer", which);
    }
    dev_prefer_huge(d, *out, rounded);
    if (host && size_bytes) {
        enum err_code rc = dev_write(d, *out, 0, size_bytes, host, e);
        if (rc) {
            dev_release(out);
            return rc;
        }
    }
    return ERR_OK;
}

void dev_release(cl_mem *m)
{
    if (m && *m) {
        clReleaseMemObject(*m);
        *m = NULL;
    }
}

enum err_code dev_reserve(struct dev *d, size_t n_bytes, cl_mem *m, size_t *room, struct err *e)
{
    if (*m && n_bytes <= *room)
        return ERR_OK;
    dev_release(m);
    enum err_code rc = dev_buffer(d, n_bytes, NULL, m, e);
    *room = rc ? 0 : n_bytes;
    return rc;
}

enum err_code dev_read(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes, void *out,
                       struct err *e)
{
    if (n_bytes == 0)
        return ERR_OK;
    cl_int code =
        clEnqueueReadBuffer(d->queue, m, CL_TRUE, offset_bytes, n_bytes, out, 0, NULL, NULL);
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_read", d->name);
}

static enum err_code dev_hand_over(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                                   const void *in, cl_bool wait, struct err *e)
{
    if (n_bytes == 0)
        return ERR_OK;
    cl_int code = clEnqueueWriteBuffer(d->queue, m, wait, offset_bytes, n_bytes, in, 0, NULL, NULL);
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_write", d->name);
}

enum err_code dev_write(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                        const void *in, struct err *e)
{
    return dev_hand_over(d, m, offset_bytes, n_bytes, in, CL_TRUE, e);
}

enum err_code dev_write_soon(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes,
                             const void *in, struct err *e)
{
    return dev_hand_over(d, m, offset_bytes, n_bytes, in, CL_FALSE, e);
}

enum err_code dev_zero(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes, struct err *e)
{
    const cl_uint zero = 0;
    /* The pattern's size must divide offset and length: words where possible, else bytes. */
    size_t pattern =
        offset_bytes % sizeof zero == 0 && n_bytes % sizeof zero == 0 ? sizeof zero : 1;
    if (n_bytes == 0)
        return ERR_OK;
    cl_int code =
        clEnqueueFillBuffer(d->queue, m, &zero, pattern, offset_bytes, n_bytes, 0, NULL, NULL);
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_zero", d->name);
}

enum err_code dev_read_soon(struct dev *d, cl_mem m, size_t offset_bytes, size_t n_bytes, void *out,
                            struct dev_pending *p, struct err *e)
{
    p->event = NULL;
    cl_int code =
        clEnqueueReadBuffer(d->queue, m, CL_FALSE, offset_bytes, n_bytes, out, 0, NULL, &p->event);
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_read_soon", d->name);
}

enum err_code dev_wait(struct dev *d, struct dev_pending *p, struct err *e)
{
    if (!p->event)
        return ERR_OK;
    cl_int code = clWaitForEvents(1, &p->event);
    clReleaseEvent(p->event);
    p->event = NULL;
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_wait", d->name);
}

void dev_abandon(struct dev *d, struct dev_pending *p)
{
    (void)clFinish(d->queue);
    if (p && p->event)
        clReleaseEvent(p->event);
    if (p)
        p->event = NULL;
}

enum err_code dev_map(struct dev *d, cl_mem m, cl_map_flags flags, size_t n_bytes, void **out,
                      struct err *e)
{
    cl_int code = CL_SUCCESS;
    *out = clEnqueueMapBuffer(d->queue, m, CL_TRUE, flags, 0, n_bytes ? n_bytes : 1, 0, NULL, NULL,
                              &code);
    if (code == CL_SUCCESS)
        return ERR_OK;
    *out = NULL;
    return dev_fail(e, code, "dev_map", d->name);
}

enum err_code dev_unmap(struct dev *d, cl_mem m, void **mapped, struct err *e)
{
    cl_int code = CL_SUCCESS;
    if (*mapped)
        code = clEnqueueUnmapMemObject(d->queue, m, *mapped, 0, NULL, NULL);
    *mapped = NULL;
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_unmap", d->name);
}

/* ---- launches ---- */

enum { DEV_TIMED_MAX = 8192 };
struct dev_timing {
    cl_command_queue plain; /* the device's own, put aside for one that keeps times */
    double offset_s;        /* of a trace: clock_s() less the device's clock */
    struct dev_timed {
        const char *name;
        cl_event event;
        double core_ms;
    } launch[DEV_TIMED_MAX];
    size_t n;
    bool cores; /* dev_time_cores */
};

enum err_code dev_time_begin(struct dev *d, struct err *e)
{
    cl_int code = clFinish(d->queue);
    struct dev_timing *t = mem_array(1, sizeof *t);
    if (!t)
        return err_set(e, ERR_MEM, "dev_time_begin: out of memory");
    t->plain = d->queue;
    cl_command_queue timed = NULL;
    if (code == CL_SUCCESS)
        timed = clCreateCommandQueue(d->context, d->device, CL_QUEUE_PROFILING_ENABLE, &code);
    if (code != CL_SUCCESS) {
        mem_free(t);
        return dev_fail(e, code, "dev_time_begin", d->name);
    }
    d->queue = timed;
    d->timing = t;
    return ERR_OK;
}

void dev_time_cores(struct dev *d)
{
    d->timing->cores = d->is_cpu;
}

/* Processor seconds of all threads but this one, which only enqueues and waits. */
static double dev_cores_s(void)
{
    struct timespec t;
    return clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t)
               ? 0.0
               : clock_cpu_s() - ((double)t.tv_sec + 1e-9 * (double)t.tv_nsec);
}

/* Back to the queue that keeps no times. */
static void dev_untime(struct dev *d)
{
    if (!d->timing)
        return;
    clReleaseCommandQueue(d->queue);
    d->queue = d->timing->plain;
    mem_free(d->timing);
    d->timing = NULL;
}

static cl_int dev_event_times(cl_event event, cl_ulong *from, cl_ulong *to)
{
    cl_int code =
        clGetEventProfilingInfo(event, CL_PROFILING_COMMAND_START, sizeof *from, from, NULL);
    return code == CL_SUCCESS
               ? clGetEventProfilingInfo(event, CL_PROFILING_COMMAND_END, sizeof *to, to, NULL)
               : code;
}

static cl_int dev_timed_add(const struct dev_timed *l, struct dev_time *out, size_t max, size_t *n)
{
    cl_ulong from = 0, to = 0;
    cl_int code = dev_event_times(l->event, &from, &to);
    size_t at = 0;
    while (at < *n && strcmp(out[at].name, l->name) != 0)
        at++;
    if (code != CL_SUCCESS || at == max)
        return code;
    if (at == *n)
        out[(*n)++] = (struct dev_time){.name = l->name};
    out[at].launches++;
    out[at].ms += (double)(to - from) * 1e-6;
    out[at].core_ms += l->core_ms;
    return CL_SUCCESS;
}

enum err_code dev_time_end(struct dev *d, struct dev_time *out, size_t max, size_t *n,
                           struct err *e)
{
    struct dev_timing *t = d->timing;
    cl_int code = clFinish(d->queue);
    if (out)
        *n = 0;
    for (size_t i = 0; t && i < t->n; i++) {
        if (out && code == CL_SUCCESS)
            code = dev_timed_add(&t->launch[i], out, max, n);
        clReleaseEvent(t->launch[i].event);
    }
    dev_untime(d);
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_time_end", d->name);
}

/* ---- a trace (core/trace.h): the time of every kernel, on the host's clock ---- */

/* OpenCL 1.2 has no common clock: a small command ends now, on both. */
static enum err_code dev_trace_begin(struct dev *d, struct err *e)
{
    cl_ulong from = 0, to = 0;
    cl_event event = NULL;
    cl_mem m = NULL;
    const cl_uint zero = 0;
    enum err_code rc = dev_time_begin(d, e);
    if (!rc)
        rc = dev_buffer(d, sizeof zero, NULL, &m, e);
    if (rc)
        return rc;
    cl_int code =
        clEnqueueWriteBuffer(d->queue, m, CL_TRUE, 0, sizeof zero, &zero, 0, NULL, &event);
    double now_s = clock_s();
    if (code == CL_SUCCESS)
        code = dev_event_times(event, &from, &to);
    if (event)
        clReleaseEvent(event);
    dev_release(&m);
    d->timing->offset_s = now_s - 1e-9 * (double)to;
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "trace", d->name);
}

/* Hands what was timed to the trace. Waits for it. */
static void dev_trace_drain(struct dev *d)
{
    struct dev_timing *t = d->timing;
    (void)clFinish(d->queue); /* a failure shows at the next launch */
    for (size_t i = 0; i < t->n; i++) {
        cl_ulong from = 0, to = 0;
        if (dev_event_times(t->launch[i].event, &from, &to) == CL_SUCCESS)
            trace_span("device", t->launch[i].name, t->offset_s + 1e-9 * (double)from,
                       t->offset_s + 1e-9 * (double)to);
        clReleaseEvent(t->launch[i].event);
    }
    t->n = 0;
}

/* Enqueues a launch; keeps its event if kernels are timed. */
static cl_int dev_enqueue(struct dev *d, cl_kernel k, const char *name, size_t global, size_t local)
{
    if (d->timing && d->timing->n == DEV_TIMED_MAX && trace_on())
        dev_trace_drain(d);
    struct dev_timing *t = d->timing && d->timing->n < DEV_TIMED_MAX ? d->timing : NULL;
    cl_event *event = t ? &t->launch[t->n].event : NULL;
    cl_int code = t && t->cores ? clFinish(d->queue) : CL_SUCCESS;
    double since_s = t && t->cores ? dev_cores_s() : 0.0;
    if (code == CL_SUCCESS)
        code = clEnqueueNDRangeKernel(d->queue, k, 1, NULL, &global, &local, 0, NULL, event);
    if (!t || code != CL_SUCCESS)
        return code;
    t->launch[t->n].name = name;
    t->launch[t->n].core_ms = 0.0;
    if (t->cores) {
        code = clFinish(d->queue);
        t->launch[t->n].core_ms = 1e3 * (dev_cores_s() - since_s);
    }
    t->n++;
    return code;
}

/* Was this kernel launched before? Remembers it. More than DEV_LAUNCHES_MAX count as launched. */
static bool dev_is_launched(struct dev *d, cl_kernel k)
{
    for (size_t i = d->n_launched; i-- > 0;)
        if (d->launched[i] == k)
            return true;
    if (d->n_launched == DEV_LAUNCHES_MAX)
        return true;
    d->launched[d->n_launched++] = k;
    return false;
}

/* A driver that keeps no programs compiles a kernel when it is launched first: the time of that
 * launch is taken for compiling. It waits for what was enqueued before, and for the launch. */
static cl_int dev_launch_first(struct dev *d, cl_kernel k, const char *name, size_t global,
                               size_t local)
{
    cl_int code = clFinish(d->queue);
    double start_s = clock_s();
    if (code == CL_SUCCESS)
        code = dev_enqueue(d, k, name, global, local);
    if (code == CL_SUCCESS)
        code = clFinish(d->queue);
    d->compile_s += clock_s() - start_s;
    return code;
}

size_t dev_local(const struct dev *d)
{
    return d->vector_width > 1 ? 1 : 64;
}

enum err_code dev_run(struct dev *d, cl_kernel k, const char *name, size_t global, size_t local,
                      struct err *e)
{
    assert(local > 0);
    if (global == 0)
        return ERR_OK; /* nothing to do is not an error here, though it is in OpenCL 1.2 */
    size_t rounded = (global + local - 1) / local * local;
    cl_int code = dev_is_launched(d, k) ? dev_enqueue(d, k, name, rounded, local)
                                        : dev_launch_first(d, k, name, rounded, local);
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_run", name);
}

enum err_code dev_finish(struct dev *d, struct err *e)
{
    cl_int code = clFinish(d->queue);
    return code == CL_SUCCESS ? ERR_OK : dev_fail(e, code, "dev_finish", d->name);
}
