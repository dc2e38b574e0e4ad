/* Stands in for an OpenCL driver whose compiler ends the process, as PoCL 6 with LLVM 18 does: this
 * library is loaded before the driver's (LD_PRELOAD). DYING says of which methods it dies: "usual",
 * or "all". Programs that are made of binaries are not compiled, so they live.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#define _GNU_SOURCE
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

cl_int clBuildProgram(cl_program program, cl_uint n, const cl_device_id *devices,
                      const char *options, void(CL_CALLBACK *told)(cl_program, void *), void *user)
{
    typedef cl_int build(cl_program, cl_uint, const cl_device_id *, const char *,
                         void(CL_CALLBACK *)(cl_program, void *), void *);
    const char *dying = getenv("DYING"), *method = getenv("POCL_WORK_GROUP_METHOD");
    build *real = NULL;
    size_t source = 0;
    void *found = dlsym(RTLD_NEXT, "clBuildProgram");
    memcpy(&real, &found, sizeof real);
    (void)clGetProgramInfo(program, CL_PROGRAM_SOURCE, 0, NULL, &source);
    if (dying && source > 1 && (!strcmp(dying, "all") || !method || strcmp(method, "cbs") != 0)) {
        fprintf(stderr, "LLVM ERROR: a stand-in did not reach a fixpoint\n");
        abort();
    }
    return real(program, n, devices, options, told, user);
}
