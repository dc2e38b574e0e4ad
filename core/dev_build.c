/* Programs of a device: compiling, what a compiler says, and binaries on the disk.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/dev.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/dev_internal.h"
#include "core/programs.h"

extern const char layout_h[]; /* core/layout.h, made by embed_cl */

enum { SOURCES_MAX = 16 };

static size_t dev_lines(const char *text)
{
    size_t n = 0;
    for (; *text; text++)
        n += *text == '\n';
    return n;
}

/* The file and its line that line `line` of all pieces is. */
static const char *dev_line_of(unsigned long *line, const char *const *text,
                               const char *const *names, size_t n_text)
{
    unsigned long before = 0;
    for (size_t i = 0; i < n_text; i++) {
        unsigned long lines = dev_lines(text[i]);
        if (i % 2 && *line > before && *line <= before + lines + 1) {
            *line -= before;
            return names[i / 2];
        }
        before += lines;
    }
    return NULL;
}

void dev_cite(const char *log, const char *const *text, const char *const *names, size_t n_text,
              struct buf *out)
{
    static const char mark[] = "<kernel>:";
    const char *at;
    while ((at = strstr(log, mark)) != NULL) {
        char *end;
        unsigned long line = strtoul(at + sizeof mark - 1, &end, 10);
        const char *name = dev_line_of(&line, text, names, n_text);
        buf_printf(out, "%.*s", (int)(at - log), log);
        if (name)
            buf_printf(out, "%s:%lu", name, line);
        else
            buf_printf(out, "%.*s", (int)(end - at), at);
        log = end;
    }
    buf_printf(out, "%s", log);
}

/* As much of the compiler's log as an err holds (its first error comes first); all of it at debug
 * level. */
static enum err_code dev_build_error(struct dev *d, cl_program program, const char *const *text,
                                     const char *const *names, size_t n_text, cl_int code,
                                     struct err *e)
{
    const char *name = names[n_text / 2 - 1];
    size_t size = 0;
    char *log = NULL;
    struct buf cited = {0};
    enum err_code rc = ERR_DEVICE;
    if (clGetProgramBuildInfo(program, d->device, CL_PROGRAM_BUILD_LOG, 0, NULL, &size) ==
        CL_SUCCESS)
        log = mem_array(size + 1, 1);
    if (log && clGetProgramBuildInfo(program, d->device, CL_PROGRAM_BUILD_LOG, size, log, NULL) ==
                   CL_SUCCESS) {
        dev_cite(log, text, names, n_text, &cited);
        const char *told = cited.failed ? log : (const char *)cited.data;
        log_debug("dev", "build log of %s:\n%s", name, told);
        rc = err_set(e, ERR_DEVICE, "dev_build: %s: %s:\n%s", name, dev_error_name(code), told);
    } else {
        rc = dev_fail(e, code, "dev_build", name);
    }
    buf_free(&cited);
    mem_free(log);
    return rc;
}

/* All that the binary of a program depends on. Not our own version: most kernels stay the same from
 * one to the next. */
static struct hash128 dev_program_key(const struct dev *d, const char *const *text, size_t n_text,
                                      const char *flags)
{
    const char *const more[] = {flags, d->name, d->driver};
    struct hash_state *h = hash_begin();
    for (size_t i = 0; i < n_text; i++)
        hash_add(h, text[i], strlen(text[i]) + 1);
    for (size_t i = 0; i < sizeof more / sizeof *more; i++)
        hash_add(h, more[i], strlen(more[i]) + 1);
    return hash_end(h);
}

/* The program that was kept, ready to use; NULL: none was, or the driver does not want it. */
static cl_program dev_program_load(struct dev *d, struct hash128 key, const char *flags)
{
    struct buf b = {0};
    cl_program program = NULL;
    cl_int code = CL_SUCCESS, status = CL_SUCCESS;
    if (!*d->programs || !programs_read(d->programs, key, &b))
        return NULL;
    const unsigned char *bytes = b.data;
    program = clCreateProgramWithBinary(d->context, 1, &d->device, &b.size, &bytes, &status, &code);
    if (program && (code != CL_SUCCESS || status != CL_SUCCESS ||
                    clBuildProgram(program, 1, &d->device, flags, NULL, NULL) != CL_SUCCESS)) {
        clReleaseProgram(program);
        program = NULL;
    }
    buf_free(&b);
    return program;
}

/* Asked for a binary, PoCL compiles all kernels of the program. A binary that cannot be kept costs
 * time at the next start, and nothing else. */
static void dev_program_keep(struct dev *d, struct hash128 key, cl_program program)
{
    struct err why = {0};
    size_t size = 0;
    if (!*d->programs ||
        clGetProgramInfo(program, CL_PROGRAM_BINARY_SIZES, sizeof size, &size, NULL) !=
            CL_SUCCESS ||
        size == 0)
        return;
    unsigned char *bytes = mem_uninit(size, 1);
    if (bytes &&
        clGetProgramInfo(program, CL_PROGRAM_BINARIES, sizeof bytes, &bytes, NULL) == CL_SUCCESS &&
        programs_write(d->programs, key, bytes, size, &why))
        log_debug("dev", "compiled program is not kept: %s", why.msg);
    mem_free(bytes);
}

/* Once: who waits some seconds sees why, and that the next start is faster. */
static void dev_say_compiling(struct dev *d)
{
    if (!d->said_compiling)
        log_info("dev", "compiling kernels for %s: takes some seconds%s", d->name,
                 *d->programs ? ", later starts find them on the disk" : "");
    d->said_compiling = true;
}

enum err_code dev_build(struct dev *d, const struct dev_source *sources, size_t n_sources,
                        const char *options, cl_program *out, struct err *e)
{
    enum { TEXTS_MAX = 2 * (SOURCES_MAX + 1) };
    const char *text[TEXTS_MAX], *names[SOURCES_MAX + 1];
    char lines[SOURCES_MAX + 1][160], flags[1024];
    const size_t n_text = 2 * (n_sources + 1);
    cl_int code = CL_SUCCESS;
    enum err_code rc = ERR_OK;

    assert(n_sources > 0 && n_sources <= SOURCES_MAX);
    *out = NULL;
    for (size_t i = 0; i <= n_sources; i++) {
        names[i] = i ? sources[i - 1].name : "core/layout.h";
        snprintf(lines[i], sizeof lines[i], "\n#line 1 \"%s\"\n", names[i]);
        text[2 * i] = lines[i];
        text[2 * i + 1] = i ? sources[i - 1].text : layout_h;
    }
    int n = snprintf(flags, sizeof flags, "-cl-std=CL1.2 -cl-denorms-are-zero -DVW=%u%s%s%s%s",
                     (unsigned)d->vector_width, d->is_pocl ? " -DHAS_PREFETCH=1" : "",
                     d->is_cpu ? " -DIS_CPU=1" : "", options && *options ? " " : "",
                     options ? options : "");
    if (n < 0 || (size_t)n >= sizeof flags)
        return err_set(e, ERR_LIMIT, "dev_build: %s: options too long",
                       sources[n_sources - 1].name);
    const double start_s = clock_s();
    const struct hash128 key = dev_program_key(d, text, n_text, flags);
    cl_program program = dev_program_load(d, key, flags);
    if (!program) {
        dev_say_compiling(d);
        program = clCreateProgramWithSource(d->context, (cl_uint)n_text, text, NULL, &code);
        if (code != CL_SUCCESS)
            return dev_fail(e, code, "dev_build", sources[n_sources - 1].name);
        code = clBuildProgram(program, 1, &d->device, flags, NULL, NULL);
        if (code == CL_SUCCESS)
            dev_program_keep(d, key, program);
    }
    d->compile_s += clock_s() - start_s;
    if (code != CL_SUCCESS) {
        rc = dev_build_error(d, program, text, names, n_text, code, e);
        clReleaseProgram(program);
        return rc;
    }
    *out = program;
    return ERR_OK;
}

enum err_code dev_kernel(cl_program program, const char *name, cl_kernel *out, struct err *e)
{
    cl_int code = CL_SUCCESS;
    *out = clCreateKernel(program, name, &code);
    if (code != CL_SUCCESS) {
        *out = NULL;
        return dev_fail(e, code, "dev_kernel", name);
    }
    return ERR_OK;
}
