/* PSNR and SSIM of a rendered picture against a photograph, in double.
 *
 * Two windows, because papers use both: METRIC_TRAINING is what the loss minimises (zero padded:
 * border windows see black beyond the edge), METRIC_VALID keeps only windows inside the picture, as
 * the usual metric libraries do. A window is inside exactly when its centre is 5 px from every
 * edge, and there the zero-padded map holds the same number.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>

#include "core/base.h"
#include "train/loss.h"
#include "train/loss_ref.h"

enum { BORDER_PX = 5 };

static double clamp01(double v)
{
    return v > 0 ? (v < 1 ? v : 1) : 0; /* NaN becomes 0 */
}

static enum err_code check_size(const char *who, uint32_t w, uint32_t h, uint32_t least,
                                struct err *e)
{
    if (w < least || h < least)
        return err_set(e, ERR_ARG,
                       "%s: a picture of %u x %u px is too small; at least %u x %u is needed", who,
                       w, h, least, least);
    return ERR_OK;
}

enum err_code metric_psnr(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, double *out_db, struct err *e)
{
    enum err_code rc = check_size("metric_psnr", width_px, height_px, 1, e);
    if (rc != ERR_OK)
        return rc;
    size_t n = (size_t)width_px * height_px;
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 3 && (!mask || mask[i]); c++) {
            double d = clamp01((double)rgb[3 * i + c]) - target[3 * i + c] / 255.0;
            sum += d * d;
        }
    *out_db = sum > 0 ? 10 * log10(3.0 * (double)n / sum) : HUGE_VAL;
    return ERR_OK;
}

enum err_code metric_ssim(const float *rgb, const uint8_t *target, const uint8_t *mask,
                          uint32_t width_px, uint32_t height_px, enum metric_window window,
                          double *out, struct err *e)
{
    size_t border = window == METRIC_VALID ? BORDER_PX : 0;
    enum err_code rc =
        check_size("metric_ssim", width_px, height_px, (uint32_t)(2 * border + 1), e);
    if (rc != ERR_OK)
        return rc;
    size_t w = width_px, h = height_px, n = w * h;
    double *block = mem_array(n, (loss_ref_scratch_planes() + 3) * sizeof *block);
    if (!block)
        return err_set(e, ERR_MEM, "metric_ssim: %u x %u px: out of memory", width_px, height_px);
    double *x = block, *y = x + n, *map = y + n, *scratch = map + n;
    double sum = 0;
    for (size_t c = 0; c < 3; c++) {
        for (size_t i = 0; i < n; i++) {
            bool used = !mask || mask[i];
            x[i] = used ? clamp01((double)rgb[3 * i + c]) : 0;
            y[i] = used ? target[3 * i + c] / 255.0 : 0;
        }
        loss_ref_ssim(x, y, w, h, scratch, map);
        for (size_t r = border; r < h - border; r++)
            for (size_t q = border; q < w - border; q++)
                sum += map[r * w + q];
    }
    *out = sum / (3.0 * (double)((w - 2 * border) * (h - 2 * border)));
    mem_free(block);
    return ERR_OK;
}
