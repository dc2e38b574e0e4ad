/* LPIPS: learned perceptual distance between a drawing and a photograph. The user supplies the
 * weights (lab/EVALUATION.md).
 *
 * It compares features of VGG16 (after relu1_2, 2_2, 3_3, 4_3, 5_3) or AlexNet (after its five
 * relus). Features are normalised over channels. Squared differences are weighted by channel,
 * averaged over pixels, and summed over the five layers (Zhang, Isola, Efros, Shechtman and Wang,
 * CVPR 2018, version 0.1). Lower is better; equal pictures have 0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_LPIPS_H
#define LAB_LPIPS_H

#include "core/device/dev.h"

/* Range of the network's input: colours scaled to -1..1, as LPIPS is defined, or 0..1, as in the
 * tables of 3D Gaussian Splatting papers. */
enum lpips_range { LPIPS_SIGNED, LPIPS_UNIT };

struct lpips; /* weights and buffers on one device; only one thread may use it */
/* Loads a .safetensors file with the weights of the network and of LPIPS; the file tells which
 * network it is. Free *out with lpips_close. ERR_NOENT, ERR_IO: the file cannot be read.
 * ERR_FORMAT: it has other weights. ERR_DEVICE, ERR_MEM. */
enum err_code lpips_open(struct dev *dev, const char *path, enum lpips_range range,
                         struct lpips **out, struct err *e) ERR_USE;
void lpips_close(struct lpips **l);
/* The key of a score: "lpips_vgg", "lpips_alex", "lpips_vgg_unit" or "lpips_alex_unit". */
const char *lpips_key(const struct lpips *l);
/* Compares rgb [h][w][3], clamped to 0..1, with target uint8 [h][w][3]. Pixels where mask [h][w]
 * (may be NULL) is 0 are black in both. ERR_ARG: the picture is too small for the network (16
 * pixels for VGG16, 31 for AlexNet). ERR_MEM, ERR_DEVICE. */
enum err_code lpips_run(struct lpips *l, const float *rgb, const uint8_t *target,
                        const uint8_t *mask, uint32_t width_px, uint32_t height_px, double *out,
                        struct err *e) ERR_USE;

#endif
