/* LPIPS: learned perceptual distance between a drawing and a photograph, with weights that the user
 * supplies (docs/evaluation.md).
 *
 * Features of VGG16 (after relu1_2, 2_2, 3_3, 4_3, 5_3) or AlexNet (after its five relus), each
 * normalised over channels, squared differences weighted per channel, mean over pixels, sum over
 * the five layers (Zhang, Isola, Efros, Shechtman and Wang, CVPR 2018, version 0.1). Lower is
 * better, 0 for equal pictures.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOSS_LPIPS_H
#define LOSS_LPIPS_H

#include "core/dev.h"

/* What the network is fed: colours scaled to -1..1, as LPIPS is defined, or 0..1 as they are, which
 * is what the tables of 3D Gaussian Splatting papers report. */
enum lpips_range { LPIPS_SIGNED, LPIPS_UNIT };

struct lpips; /* weights and buffers on one device; one caller */
/* Load a .safetensors file of the network's and LPIPS's weights; which network it is shows in it.
 * lpips_close it. ERR_NOENT, ERR_IO: the file; ERR_FORMAT: not those weights; ERR_DEVICE,
 * ERR_MEM. */
enum err_code lpips_open(struct dev *dev, const char *path, enum lpips_range range,
                         struct lpips **out, struct err *e) ERR_USE;
void lpips_close(struct lpips **l);
/* "lpips_vgg", "lpips_alex", "lpips_vgg_unit", "lpips_alex_unit": the key of a score. */
const char *lpips_key(const struct lpips *l);
/* rgb [h][w][3] is clamped to 0..1, target uint8 [h][w][3]; pixels where mask [h][w] (may be NULL)
 * is 0 are black in both. ERR_ARG when the picture is too small
 * for the network (16 pixels for VGG16, 31 for AlexNet). ERR_MEM, ERR_DEVICE. */
enum err_code lpips_run(struct lpips *l, const float *rgb, const uint8_t *target,
                        const uint8_t *mask, uint32_t width_px, uint32_t height_px, double *out,
                        struct err *e) ERR_USE;

#endif
