/* Compiles OpenCL programs in a process of its own, the program citysplat-compiler. The compiler in
 * a driver ends the process that it runs in when it finds a fault of its own: PoCL 6 with LLVM 18
 * aborts on one of our kernels (docs/decisions/003-build.md). In another process that is an error
 * that can be reported, and the driver can be asked to compile in another way.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_COMPILER_H
#define CORE_COMPILER_H

#include <stddef.h>

#include "core/base.h"

/* PoCL's choice between its ways to make loops of work-items. */
#define COMPILER_METHOD "POCL_WORK_GROUP_METHOD"

struct compiler_job {
    const char *device; /* its full name, which dev_open of the other process is given */
    const char *flags;
    const char *const *text; /* pieces of the source [n_text] */
    size_t n_text;
};
enum compiler_end {
    COMPILER_DONE,    /* `binary` has the program */
    COMPILER_REFUSED, /* the source has an error, or the device could not be opened */
    COMPILER_DIED,    /* `words` says how, and what the driver said last */
    COMPILER_MISSING  /* it cannot be started; `words` says why */
};
/* Waits for the end. `method`: COMPILER_METHOD of that process; NULL: as the environment has it.
 * Free `binary` with buf_free. */
enum compiler_end compiler_run(const struct compiler_job *job, const char *method,
                               struct buf *binary, char *words, size_t room);

/* The other process: reads one job from its descriptor 3, writes the answer there. `build` compiles
 * (core/device/dev.c) and adds the binary to `out`. Returns the exit code. */
int compiler_serve(bool (*build)(const struct compiler_job *job, struct buf *out));

#endif
