/* Depth of the last frame: launches surface.cl over the buffers of render_forward. It owns the
 * compiled kernel and its maps, and changes nothing of the frame.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/base.h"
#include "render/frame.h"

extern const char surface_cl[];

struct render_surface {
    struct render *render; /* borrowed */
    cl_program program;
    cl_kernel tilts, rows;
    struct frame_buffer limit, maps, tilt;
};

enum err_code render_surface_open(struct render *r, struct render_surface **out, struct err *e)
{
    const struct dev_source sources[] = {FRAME_SOURCES, {"render/surface.cl", surface_cl}};
    *out = NULL;
    struct render_surface *s = mem_array(1, sizeof *s);
    if (!s)
        return err_set(e, ERR_MEM, "render_surface_open: out of memory");
    s->render = r;
    enum err_code rc =
        dev_build(r->dev, sources, sizeof sources / sizeof *sources, NULL, &s->program, e);
    if (!rc)
        rc = dev_kernel(s->program, "surface_tilts", &s->tilts, e);
    if (!rc)
        rc = dev_kernel(s->program, "surface_rows", &s->rows, e);
    if (rc)
        render_surface_close(&s);
    *out = s;
    return rc;
}

void render_surface_close(struct render_surface **p)
{
    struct render_surface *s = *p;
    if (!s)
        return;
    if (s->tilts)
        clReleaseKernel(s->tilts);
    if (s->rows)
        clReleaseKernel(s->rows);
    if (s->program)
        clReleaseProgram(s->program);
    dev_release(&s->limit.mem);
    dev_release(&s->maps.mem);
    dev_release(&s->tilt.mem);
    mem_free(s);
    *p = NULL;
}

/* How each Gaussian of the frame lies to its rays. */
static enum err_code surface_tilts(struct render_surface *s, struct err *e)
{
    struct render *r = s->render;
    size_t local, items = frame_items(r, r->view.groups, &local);
    size_t bytes = (size_t)r->view.groups * LAYOUT_LANES * LAYOUT_SURFACE_TILT * sizeof(float);
    enum err_code rc = frame_reserve(r, &s->tilt, bytes ? bytes : sizeof(float), e);
    if (rc || !items)
        return rc;
    return frame_run(r, s->tilts, "surface_tilts",
                     FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(r->drawn_params),
                                FRAME_ARG(r->drawn_list), FRAME_ARG(r->depth_key.mem),
                                FRAME_ARG(s->tilt.mem)),
                     items, local, e);
}

enum err_code render_surface_run(struct render_surface *s, const float *limit_m,
                                 const struct render_surface_maps *out, struct err *e)
{
    struct render *r = s->render;
    if (!r->drawn)
        return err_set(e, ERR_ARG, "render_surface: no frame was drawn");
    size_t bytes = (size_t)r->view.width * r->view.height * sizeof(float);
    bool wide = r->dev->vector_width == LAYOUT_LANES;
    size_t items = (size_t)r->tiles * (wide ? LAYOUT_TILE : LAYOUT_TILE_PIXELS);
    cl_uint limited = limit_m != NULL,
            median_alone = !out->mean_m && !out->front && !out->near_m && !out->far_m && !out->met;
    float *const maps[LAYOUT_SURFACE_MAPS] = {
        [LAYOUT_SURFACE_MEDIAN] = out->median_m, [LAYOUT_SURFACE_MEAN] = out->mean_m,
        [LAYOUT_SURFACE_FRONT] = out->front,     [LAYOUT_SURFACE_NEAR] = out->near_m,
        [LAYOUT_SURFACE_FAR] = out->far_m,       [LAYOUT_SURFACE_MET] = out->met};
    enum err_code rc = frame_reserve(r, &s->maps, LAYOUT_SURFACE_MAPS * bytes, e);
    if (!rc)
        rc = frame_reserve(r, &s->limit, limited ? bytes : sizeof(float), e);
    if (!rc && limited)
        rc = dev_write(r->dev, s->limit.mem, 0, bytes, limit_m, e);
    if (!rc)
        rc = surface_tilts(s, e);
    if (!rc)
        rc = frame_run(
            r, s->rows, "surface_rows",
            FRAME_ARGS(FRAME_ARG(r->view_mem), FRAME_ARG(r->splats.mem),
                       FRAME_ARG(r->tile_start.mem), FRAME_ARG(r->intersection_splat.mem),
                       FRAME_ARG(r->depth_key.mem), FRAME_ARG(s->tilt.mem), FRAME_ARG(s->limit.mem),
                       FRAME_ARG(limited), FRAME_ARG(median_alone), FRAME_ARG(s->maps.mem)),
            items, wide ? 1 : LAYOUT_TILE_PIXELS, e);
    for (size_t m = 0; !rc && m < LAYOUT_SURFACE_MAPS; m++)
        if (maps[m])
            rc = dev_read(r->dev, s->maps.mem, m * bytes, bytes, maps[m], e);
    if (!rc && out->transmittance)
        rc = dev_read(r->dev, r->transmit.mem, 0, bytes, out->transmittance, e);
    return rc;
}
