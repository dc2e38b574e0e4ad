/* See truth_config.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/truth/truth_config.h"

#include <jansson.h>

enum err_code truth_config(const char *city, struct synth_config *out, struct arena *a,
                           struct err *e)
{
    char path[FILE_PATH_MAX];
    json_t *root = NULL;
    enum err_code rc = file_join(path, city, "truth/truth.json", e);
    if (!rc)
        rc = jsonc_read(path, &root, e);
    if (!rc)
        rc = options_defaults(synth_options(), out, a, e);
    if (!rc && options_from_json(synth_options(), json_object_get(root, "config"), out, a, e))
        rc = err_add(e, "%s: config", path);
    json_decref(root);
    return rc;
}
