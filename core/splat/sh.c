/* See sh.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/splat/sh.h"

#include <string.h>

void sh_basis(const double dir[3], uint32_t degree, double out[LAYOUT_SH_MAX])
{
    double x = dir[0], y = dir[1], z = dir[2], xx = x * x, yy = y * y, zz = z * z;
    memset(out, 0, LAYOUT_SH_MAX * sizeof *out);
    out[0] = GAUSS_SH_C0;
    if (degree >= 1) {
        out[1] = -0.4886025119029199 * y;
        out[2] = 0.4886025119029199 * z;
        out[3] = -0.4886025119029199 * x;
    }
    if (degree >= 2) {
        out[4] = 1.0925484305920792 * x * y;
        out[5] = -1.0925484305920792 * y * z;
        out[6] = 0.31539156525252005 * (2 * zz - xx - yy);
        out[7] = -1.0925484305920792 * x * z;
        out[8] = 0.5462742152960396 * (xx - yy);
    }
    if (degree >= 3) {
        out[9] = -0.5900435899266435 * y * (3 * xx - yy);
        out[10] = 2.890611442640554 * x * y * z;
        out[11] = -0.4570457994644658 * y * (4 * zz - xx - yy);
        out[12] = 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy);
        out[13] = -0.4570457994644658 * x * (4 * zz - xx - yy);
        out[14] = 1.445305721320277 * z * (xx - yy);
        out[15] = -0.5900435899266435 * x * (xx - 3 * yy);
    }
}
