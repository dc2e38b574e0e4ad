/* Binary glTF with KHR_gaussian_splatting.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_GLB_H
#define CODEC_GLB_H

#include "core/base.h"
#include "core/gauss.h"

struct codec_limits;
struct quant;

/* .glb with KHR_gaussian_splatting, appended to out: payload SPZ v3 (CesiumJS, ArcGIS,
 * 3d-tiles-renderer with Spark). copyright may be NULL. ERR_ARG (it is not UTF-8), ERR_LIMIT,
 * ERR_MEM. Any thread, as all here. */
enum err_code glb_encode_spz(const struct quant *q, const char *copyright, struct buf *out,
                             struct err *e) ERR_USE;
/* The same with plain float accessors (three, PlayCanvas, Babylon). g in glTF axes. ERR_ARG,
 * ERR_DATA (not finite), ERR_LIMIT, ERR_MEM. */
enum err_code glb_encode_plain(const struct gauss *g, const char *copyright, struct buf *out,
                               struct err *e) ERR_USE;
/* Either form: one splat primitive, no node transform, glTF axes. gauss_free it; empty on errors.
 * ERR_FORMAT, ERR_DATA, ERR_LIMIT, ERR_MEM. */
enum err_code glb_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e) ERR_USE;
/* The payload back out of a glb: the .spz bytes inside (borrowed from bytes). ERR_NOENT: a plain
 * one; ERR_FORMAT. */
enum err_code glb_find_spz(const void *bytes, size_t n, const void **spz, size_t *n_spz,
                           struct err *e) ERR_USE;
#endif
