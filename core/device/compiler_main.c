/* citysplat-compiler: compiles one OpenCL program for the process that started it. See compiler.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>
#include <unistd.h>

#include "core/device/compiler.h"
#include "core/device/dev.h"

static bool compiler_main_build(const struct compiler_job *job, struct buf *out)
{
    struct dev d;
    struct err e = {0};
    if (!dev_open(job->device, &d, &e))
        return dev_compile(&d, job, out);
    fprintf(stderr, "%s\n", e.msg);
    return false;
}

int main(void)
{
    const int code = compiler_serve(compiler_main_build);
    fflush(NULL);
    _exit(code); /* the driver's own end takes longer than a compilation of ours */
}
