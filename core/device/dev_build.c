/* Programs of a device: compiling, what a compiler says, and binaries on the disk.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/device/dev.h"

#include <assert.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/device/compiler.h"
#include "core/device/dev_internal.h"
#include "core/device/programs.h"

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

/* A binary as a program that is ready to use; NULL: the driver does not want it. */
static cl_program dev_program_of(struct dev *d, const struct buf *b, const char *flags)
{
    cl_int code = CL_SUCCESS, status = CL_SUCCESS;
    const unsigned char *bytes = b->data;
    cl_program program =
        clCreateProgramWithBinary(d->context, 1, &d->device, &b->size, &bytes, &status, &code);
    if (program && (code != CL_SUCCESS || status != CL_SUCCESS ||
                    clBuildProgram(program, 1, &d->device, flags, NULL, NULL) != CL_SUCCESS)) {
        clReleaseProgram(program);
        program = NULL;
    }
    return program;
}

/* The program that was kept; NULL: none was, or it is of no use. */
static cl_program dev_program_load(struct dev *d, struct hash128 key, const char *flags)
{
    struct buf b = {0};
    cl_program program = NULL;
    if (*d->programs && programs_read(d->programs, key, &b))
        program = dev_program_of(d, &b, flags);
    buf_free(&b);
    return program;
}

/* A binary that cannot be kept costs time at the next start, and nothing else. */
static void dev_program_keep(struct dev *d, struct hash128 key, const struct buf *b)
{
    struct err why = {0};
    if (*d->programs && programs_write(d->programs, key, b->data, b->size, &why))
        log_debug("dev", "compiled program is not kept: %s", why.msg);
}

/* Asked for a binary, PoCL compiles all kernels of the program. */
static void dev_program_bytes(cl_program program, struct buf *out)
{
    size_t size = 0;
    if (clGetProgramInfo(program, CL_PROGRAM_BINARY_SIZES, sizeof size, &size, NULL) !=
            CL_SUCCESS ||
        size == 0)
        return;
    unsigned char *bytes = mem_uninit(size, 1);
    if (bytes &&
        clGetProgramInfo(program, CL_PROGRAM_BINARIES, sizeof bytes, &bytes, NULL) == CL_SUCCESS)
        buf_add(out, bytes, size);
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

/* ---- compiling ---- */

/* What this process says if the driver's compiler ends it, about the compilation under way. */
static char dev_last_words[640];

static void dev_on_death(int sig)
{
    (void)!write(STDERR_FILENO, dev_last_words, strlen(dev_last_words));
    (void)raise(sig); /* as it would have ended: the handler is gone (SA_RESETHAND) */
}

static const int dev_deaths[] = {SIGABRT, SIGSEGV, SIGBUS, SIGILL, SIGFPE};
enum { DEV_DEATHS = sizeof dev_deaths / sizeof *dev_deaths };

/* From here to dev_mourn_end the last words are about this program. */
static void dev_mourn_begin(const struct dev *d, const char *what, struct sigaction *was)
{
    struct sigaction act = {.sa_handler = dev_on_death, .sa_flags = (int)SA_RESETHAND};
    snprintf(dev_last_words, sizeof dev_last_words,
             "citysplat: the compiler of the OpenCL driver of %s, version %s, ends the program "
             "while it compiles %s: update the driver, or take another device: --device cpu needs "
             "the package pocl-opencl-icd\n",
             d->name, d->driver, what);
    for (int i = 0; i < DEV_DEATHS; i++)
        (void)sigaction(dev_deaths[i], &act, &was[i]);
}

static void dev_mourn_end(const struct sigaction *was)
{
    for (int i = 0; i < DEV_DEATHS; i++)
        (void)sigaction(dev_deaths[i], &was[i], NULL);
}

/* Compiles in this process, and adds the binary to `out` (NULL: it is not wanted). */
static cl_program dev_compile_here(struct dev *d, const struct compiler_job *job, struct buf *out,
                                   cl_int *code)
{
    cl_program program = clCreateProgramWithSource(d->context, (cl_uint)job->n_text,
                                                   (const char **)(uintptr_t)job->text, NULL, code);
    if (*code == CL_SUCCESS)
        *code = clBuildProgram(program, 1, &d->device, job->flags, NULL, NULL);
    if (*code == CL_SUCCESS && out)
        dev_program_bytes(program, out);
    return program;
}

bool dev_compile(struct dev *d, const struct compiler_job *job, struct buf *out)
{
    const size_t before = out->size;
    cl_int code = CL_SUCCESS;
    cl_program program = dev_compile_here(d, job, out, &code);
    if (program)
        clReleaseProgram(program);
    return out->size > before;
}

static const char *const dev_methods[] = {NULL /* as it is */, "cbs", "loopvec"};
enum { DEV_METHODS = sizeof dev_methods / sizeof *dev_methods };

const char *dev_method(const struct dev *d)
{
    return dev_methods[d->method] ? dev_methods[d->method] : "as the driver does";
}

/* Compiles in another process: see compiler.h. Where the driver dies of its usual method the next
 * one is tried, for this program and those that come after it. Our kernels are as fast with each:
 * they are made of vectors, and a work-item of a CPU is a whole piece of work. Without an error
 * `binary` may stay empty: the source has errors, or there is no such process; then it is compiled
 * here. ERR_DEVICE: no method is left. */
static enum err_code dev_compile_apart(struct dev *d, const struct compiler_job *job,
                                       const char *what, struct buf *binary, struct err *e)
{
    char words[2][320] = {"", ""};
    enum compiler_end end = COMPILER_DIED;
    const size_t first = d->method;
    for (size_t i = first; i < DEV_METHODS && end == COMPILER_DIED; i++) {
        end = compiler_run(job, dev_methods[i], binary, words[i > first], sizeof words[0]);
        d->method = end == COMPILER_DONE ? i : d->method;
        if (end == COMPILER_DIED && strstr(words[i > first], "signal 9,"))
            return err_set(
                e, ERR_MEM,
                "dev_build: %s: the compiler was killed (%s): there is too little memory", what,
                words[i > first]);
    }
    if (end == COMPILER_MISSING)
        log_debug("dev", "%s", words[0][0] ? words[0] : words[1]);
    if (end == COMPILER_DONE && d->method > first)
        log_info(
            "dev",
            "the compiler of the OpenCL driver (%s, version %s) ended while it compiled %s (%s); "
            "with " COMPILER_METHOD "=%s it does not, and kernels are as fast: nothing has to be "
            "done",
            d->name, d->driver, what, words[0], dev_methods[d->method]);
    if (end != COMPILER_DIED)
        return ERR_OK;
    return err_set(
        e, ERR_DEVICE,
        "dev_build: %s: the compiler of the OpenCL driver (%s, version %s) ended by itself "
        "in every way that it has (%s): update the package of the driver (pocl-opencl-icd "
        "for CPUs), or take another device with --device; `citysplat info --device auto` "
        "tries again",
        what, d->name, d->driver, words[0]);
}

/* For `citysplat info --device`. */
static void dev_note(struct dev *d, const char *name, const char *from, double seconds)
{
    if (d->n_built < DEV_BUILT_MAX)
        d->built[d->n_built++] = (struct dev_built){name, from, seconds};
}

/* Not kept yet: compiles it, keeps it. The program may be NULL after an error. */
static enum err_code dev_program_make(struct dev *d, const struct compiler_job *job,
                                      struct hash128 key, const char *what, cl_program *out,
                                      cl_int *code, struct err *e)
{
    struct buf binary = {0};
    enum err_code rc = ERR_OK;
    *out = NULL;
    dev_say_compiling(d);
    if (d->is_pocl)
        rc = dev_compile_apart(d, job, what, &binary, e);
    if (!rc && binary.size)
        *out = dev_program_of(d, &binary, job->flags);
    if (!rc && !*out) {
        struct sigaction was[DEV_DEATHS];
        buf_free(&binary);
        dev_mourn_begin(d, what, was);
        *out = dev_compile_here(d, job, d->is_pocl ? &binary : NULL, code);
        dev_mourn_end(was);
    }
    if (!rc && *code == CL_SUCCESS && binary.size)
        dev_program_keep(d, key, &binary);
    buf_free(&binary);
    return rc;
}

enum err_code dev_build(struct dev *d, const struct dev_source *sources, size_t n_sources,
                        const char *options, cl_program *out, struct err *e)
{
    enum { TEXTS_MAX = 2 * (SOURCES_MAX + 1) };
    const char *text[TEXTS_MAX], *names[SOURCES_MAX + 1];
    char lines[SOURCES_MAX + 1][160], flags[1024];
    const char *const what = sources[n_sources - 1].name;
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
        return err_set(e, ERR_LIMIT, "dev_build: %s: options too long", what);
    const double start_s = clock_s();
    const struct hash128 key = dev_program_key(d, text, n_text, flags);
    const struct compiler_job job = {
        .device = d->name, .flags = flags, .text = text, .n_text = n_text};
    cl_program program = dev_program_load(d, key, flags);
    const bool kept = program != NULL;
    if (!kept)
        rc = dev_program_make(d, &job, key, what, &program, &code, e);
    d->compile_s += clock_s() - start_s;
    if (!rc && code != CL_SUCCESS)
        rc = program ? dev_build_error(d, program, text, names, n_text, code, e)
                     : dev_fail(e, code, "dev_build", what);
    if (rc) {
        if (program)
            clReleaseProgram(program);
        return rc;
    }
    dev_note(d, what, kept ? "kept" : "compiled", clock_s() - start_s);
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
