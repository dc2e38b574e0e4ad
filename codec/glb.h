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

/* .glb with KHR_gaussian_splatting: payload SPZ v3 (CesiumJS, ArcGIS, 3d-tiles-renderer + Spark)
 * ... */
enum err_code glb_encode_spz(const struct quant *q, const char *copyright, struct buf *out,
                             struct err *e) ERR_USE;
/* ... or plain float accessors (three, PlayCanvas, Babylon). g in glTF axes. */
enum err_code glb_encode_plain(const struct gauss *g, const char *copyright, struct buf *out,
                               struct err *e) ERR_USE;
/* Either form of glb: one splat primitive, no node transform, glTF axes. gauss_free it. */
enum err_code glb_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e) ERR_USE;
/* The payload back out of a glb: the .spz bytes inside (borrowed from bytes). ERR_NOENT: a plain
 * one. */
enum err_code glb_find_spz(const void *bytes, size_t n, const void **spz, size_t *n_spz,
                           struct err *e) ERR_USE;
#endif
