/* Binary glTF with KHR_gaussian_splatting. All functions may be called from any thread.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_GLB_H
#define CODEC_GLB_H

#include "core/base.h"
#include "core/splat/gauss.h"

struct codec_limits;
struct quant;

/* Appends a .glb whose payload is SPZ v3 to `out`. CesiumJS, ArcGIS and 3d-tiles-renderer with
 * Spark read it. copyright may be NULL. ERR_ARG (copyright is not UTF-8), ERR_LIMIT, ERR_MEM. */
enum err_code glb_encode_spz(const struct quant *q, const char *copyright, struct buf *out,
                             struct err *e) ERR_USE;
/* Appends a .glb with plain float accessors to `out`. three.js, PlayCanvas and Babylon read it. g
 * is in glTF axes. ERR_ARG, ERR_DATA (a value is not finite), ERR_LIMIT, ERR_MEM. */
enum err_code glb_encode_plain(const struct gauss *g, const char *copyright, struct buf *out,
                               struct err *e) ERR_USE;
/* Reads either form, and plain accessors of short integers and bytes: all primitives with Gaussians
 * of the scene, where their nodes place them (glb_nodes.h). *out is in glTF axes. Free it with
 * gauss_free; it is empty on errors. ERR_FORMAT, ERR_DATA, ERR_LIMIT, ERR_MEM. */
enum err_code glb_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e) ERR_USE;
/* Finds the .spz inside a .glb. *spz points into `bytes`. ERR_NOENT: it has plain accessors.
 * ERR_FORMAT. */
enum err_code glb_find_spz(const void *bytes, size_t n, const void **spz, size_t *n_spz,
                           struct err *e) ERR_USE;
#endif
