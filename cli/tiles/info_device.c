/* citysplat info --device: the OpenCL device, and how its compiler does with our kernels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/tiles/info_device.h"

#include <jansson.h>

#include "core/device/dev.h"
#include "render/render.h"
#include "scene/stereo/sweep.h"
#include "train/loss/photometric.h"
#include "train/loss/solid.h"

/* Programs of every step: photographs, pictures, training. What is opened first is closed last. */
enum { INFO_PLANES = 64 /* room for them; the program is the same for any number */ };

static enum err_code info_device_build(struct dev *d, struct err *e)
{
    struct render *render = NULL;
    struct render_importance *importance = NULL;
    struct render_surface *surface = NULL;
    struct photometric *photometric = NULL;
    struct solid *solid = NULL;
    struct sweep *sweep = NULL;
    enum err_code rc = render_open(d, &render, e);
    if (!rc)
        rc = render_importance_open(render, &importance, e);
    if (!rc)
        rc = render_surface_open(render, &surface, e);
    if (!rc)
        rc = photometric_open(d, &photometric, e);
    if (!rc)
        rc = solid_open(d, &solid, e);
    if (!rc)
        rc = sweep_open(d, INFO_PLANES, &sweep, e);
    sweep_close(&sweep);
    solid_close(&solid);
    photometric_close(&photometric);
    render_surface_close(&surface);
    render_importance_close(&importance);
    render_close(&render);
    return rc;
}

static json_t *info_device_programs(const struct dev *d)
{
    json_t *list = json_array();
    for (size_t i = 0; i < d->n_built; i++)
        json_array_append_new(list,
                              json_pack("{s:f,s:s,s:s}", "seconds", d->built[i].seconds, "from",
                                        d->built[i].from, "program", d->built[i].name));
    return list;
}

enum err_code info_device(const char *want, struct json_t *out, struct err *e)
{
    struct dev d;
    enum err_code rc = dev_open(want, &d, e);
    if (rc)
        return rc;
    rc = info_device_build(&d, e);
    json_t *about =
        json_pack("{s:s,s:s,s:s,s:b,s:I,s:s,s:s,s:f,s:o}", "device", d.name, "driver", d.driver,
                  "type", d.is_cpu ? "CPU" : "GPU", "pocl", d.is_pocl, "memory_mib",
                  (json_int_t)(d.global_bytes >> 20), "work_groups", dev_method(&d), "kept_in",
                  *d.programs ? d.programs
                  : d.is_pocl ? "nowhere"
                              : "the driver's own cache",
                  "compiling_s", d.compile_s, "programs", info_device_programs(&d));
    if (!rc && (!about || json_object_update(out, about)))
        rc = err_set(e, ERR_MEM, "info: out of memory");
    json_decref(about);
    dev_close(&d);
    return rc;
}
