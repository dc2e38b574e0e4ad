/* Known depths of the photographs: folder and points. See depth_prior.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/photographs/depth_prior.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/container/npy.h"
#include "codec/scene/scene.h"
#include "core/base.h"
#include "train/base/config.h"

enum { DEPTH_PRIOR_COLUMNS = 6 };

enum err_code depth_prior_dir(const struct train_config *cfg, const struct scene *s, char *out,
                              struct err *e)
{
    const char *want = cfg->depth_prior ? cfg->depth_prior : "none";
    bool is_auto = !strcmp(want, "auto"), own = is_auto || !strcmp(want, "stereo");
    char marker[FILE_PATH_MAX];
    out[0] = '\0';
    if (!strcmp(want, "none"))
        return ERR_OK;
    enum err_code rc = ERR_OK;
    if (own)
        rc = file_join(out, s->dir, "depth", e);
    else if (snprintf(out, FILE_PATH_MAX, "%s", want) >= FILE_PATH_MAX)
        rc = err_set(e, ERR_LIMIT, "--depth-prior: the name of the folder is too long");
    if (!rc)
        rc = file_join(marker, out, "depths.json", e);
    if (rc || file_exists(own ? marker : out))
        return rc;
    if (!is_auto)
        return err_set(e, ERR_NOENT,
                       "--depth-prior %s: there is no %s; make it with: citysplat "
                       "stereo %s",
                       want, own ? marker : out, s->dir);
    out[0] = '\0';
    return ERR_OK;
}

enum err_code depth_prior_points(const char *dir, float **out, size_t *n, struct err *e)
{
    size_t shape[2] = {0, 0};
    char path[FILE_PATH_MAX];
    *out = NULL;
    *n = 0;
    enum err_code rc = file_join(path, dir, "points.npy", e);
    if (rc || !file_exists(path))
        return rc;
    rc = npy_read(path, 2, shape, out, e);
    if (!rc && shape[1] != DEPTH_PRIOR_COLUMNS)
        rc = err_set(e, ERR_FORMAT, "%s: %zu columns: 6 are expected", path, shape[1]);
    for (size_t i = 0; !rc && i < shape[0] * shape[1]; i++)
        if (!isfinite((*out)[i]))
            rc = err_set(e, ERR_FORMAT, "%s: value %zu is not finite", path, i);
    if (rc) {
        mem_free(*out);
        *out = NULL;
        return rc;
    }
    *n = shape[0];
    return ERR_OK;
}
