/* Shared by all stages of a frame: buffers that grow, work sizes, launches, stage times.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "render/frame.h"

#include "core/base.h"

enum err_code frame_reserve(struct render *r, struct frame_buffer *b, size_t n_bytes, struct err *e)
{
    size_t want = n_bytes;
    if (b->mem && b->cap_bytes >= n_bytes)
        return ERR_OK;
    if (want < b->cap_bytes + b->cap_bytes / 2)
        want = b->cap_bytes + b->cap_bytes / 2;
    if (want > r->dev->max_alloc_bytes && n_bytes <= r->dev->max_alloc_bytes)
        want = n_bytes;
    dev_release(&b->mem);
    b->cap_bytes = 0;
    enum err_code rc = dev_buffer(r->dev, want, NULL, &b->mem, e);
    if (!rc)
        b->cap_bytes = want;
    return rc;
}

size_t frame_items(const struct render *r, uint32_t groups, size_t *local)
{
    if (r->dev->vector_width == LAYOUT_LANES) {
        *local = 1;
        return (groups + LAYOUT_PROJECT_GROUPS - 1) / LAYOUT_PROJECT_GROUPS;
    }
    *local = 64;
    return (size_t)groups * LAYOUT_LANES;
}

enum err_code frame_run(struct render *r, cl_kernel k, const char *name,
                        const struct frame_arg *args, size_t n_args, size_t global, size_t local,
                        struct err *e)
{
    for (size_t i = 0; i < n_args; i++) {
        cl_int code = clSetKernelArg(k, (cl_uint)i, args[i].size, args[i].value);
        if (code != CL_SUCCESS)
            return err_set(e, ERR_INTERNAL, "%s: argument %zu: %s", name, i, dev_error_name(code));
    }
    return dev_run(r->dev, k, name, global, local, e);
}

double frame_now(const struct render *r)
{
    return r->timing_cpu ? clock_cpu_s() : clock_s();
}

enum err_code frame_clock(struct render *r, double *since_s, double *ms, struct err *e)
{
    if (!r->timing)
        return ERR_OK;
    enum err_code rc = dev_finish(r->dev, e);
    double now = frame_now(r);
    *ms = (now - *since_s) * 1e3;
    *since_s = now;
    return rc;
}

enum err_code frame_ask_counts(struct render *r, struct err *e)
{
    return dev_read_soon(r->dev, r->counts, 0, sizeof r->counted, &r->counted, &r->counting, e);
}
