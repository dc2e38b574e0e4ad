/* .splat: 32 bytes a Gaussian and no header, the format of the first web viewer. Import only.
 *
 *     3 f32 position   3 f32 sigma (linear)   4 u8 colour and opacity
 *     4 u8 rotation w x y z = q * 128 + 128
 *
 * It has no SH beyond the colour and no frame. Only its size, a multiple of 32, tells it from other
 * bytes. Source: github.com/antimatter15/splat.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/splat.h"
#include "codec/limits.h"
#include "core/base.h"

#include <math.h>

enum { ROW_BYTES = 32 };

static void splat_row_read(struct cursor *c, size_t i, struct gauss *g)
{
    for (size_t k = 0; k < 3; k++)
        g->mean_m[3 * i + k] = cursor_f32(c);
    for (size_t k = 0; k < 3; k++) {
        float sigma = cursor_f32(c);
        g->scale_log[3 * i + k] =
            logf(sigma < 1e-9f ? 1e-9f : sigma); /* NaN stays, and is left out */
    }
    for (size_t k = 0; k < 3; k++)
        g->sh[3 * i + k] = ((float)cursor_u8(c) / 255 - 0.5f) / (float)GAUSS_SH_C0;
    float a = (float)cursor_u8(c);
    a = a < 0.25f ? 0.25f : a > 254.75f ? 254.75f : a; /* finite logits */
    g->opacity_logit[i] = logf(a / (255 - a));
    for (size_t k = 0; k < 4; k++)
        g->quat_wxyz[4 * i + k] = ((float)cursor_u8(c) - 128) / 128;
}

enum err_code splat_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                           struct gauss *out, struct err *e)
{
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    struct cursor c = cursor_over(bytes, n);
    *out = (struct gauss){0};
    if (!n || n % ROW_BYTES)
        return err_set(e, ERR_FORMAT, "splat: %zu bytes: not a multiple of %d", n, ROW_BYTES);
    if (n / ROW_BYTES > most)
        return err_set(e, ERR_LIMIT, "splat: %zu Gaussians: the limit is %zu", n / ROW_BYTES, most);
    enum err_code rc = gauss_alloc(out, n / ROW_BYTES, 0, 0, e);
    if (rc)
        return rc;
    out->n = n / ROW_BYTES;
    for (size_t i = 0; i < out->n; i++)
        splat_row_read(&c, i, out);
    rc = gauss_keep_good(out, "splat", e);
    if (rc)
        gauss_free(out);
    return rc;
}
