/* Adapts coarser levels to the appearance network of the finest one: see refit.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "train/refit.h"

#include <math.h>

#include "codec/container/ckpt.h"
#include "train/base/stage.h"
#include "train/model/appearance_train.h"

#define REFIT_SHARE 0.2 /* of the level's steps */

bool refit_wanted(const struct appearance_train *a, const struct stage *at)
{
    return appearance_train_is_on(a) && !a->shared && at->n_levels > 1 &&
           appearance_train_learns(a, &at->levels[1]);
}

enum err_code refit_look(const struct appearance_train *a, const struct ckpt_rows *c, bool *needed,
                         struct err *e)
{
    struct buf blob = {0};
    struct appearance saved = {0};
    enum err_code rc = ckpt_rows_blob(c, APPEARANCE_TRAIN_BLOB, &blob, e);
    if (!rc)
        rc = appearance_read(blob.data, blob.size, &saved, e);
    *needed = !rc && !appearance_train_same(&saved, &a->model);
    appearance_free(&saved);
    buf_free(&blob);
    return rc;
}

struct schedule refit_schedule(const struct schedule *level)
{
    struct schedule s = *level;
    double steps = floor((double)s.steps * REFIT_SHARE + 0.5);
    s.steps = steps >= 1.0 ? (uint32_t)steps : 1;
    s.densify_until = 0;
    s.sh_interval = 0;
    s.lr_mean_first = s.lr_mean_last = 0.0;
    s.fade_from = s.steps;
    s.still = true;
    return s;
}

struct schedule refit_schedule_last(const struct schedule *level)
{
    struct schedule s = refit_schedule(level);
    s.lr_mean_first = s.lr_mean_last = level->lr_mean_last;
    s.last = true;
    s.still = false;
    return s;
}
