/* The background of a picture, or depth instead of its colours; and its encoding.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_COMPOSITE_H
#define SERVER_COMPOSITE_H

#include "core/splat/camera.h"
#include "server/drawing/backdrop.h"
#include "server/route/target.h"

/* Parses text [n] as a unit of depth: "mm", "cm", "dm" or "m". Returns false for any other. */
bool composite_read_depth(const char *text, size_t n, struct composite *out);

/* The renderer's output for a picture [h][w]; NULL: not wanted. */
struct composite_planes {
    const float *rgb;           /* [3]; for SKY and TRANSPARENT on black */
    const float *transmittance; /* behind the last Gaussian */
    const float *depth_m;       /* of the visible surface, along the optical axis; 0: none */
    const struct backdrop *sky; /* for SKY */
};
/* Return whether a picture needs transmittance, or depth. */
bool composite_needs_transmittance(const struct composite *p);
bool composite_needs_depth(const struct composite *p, enum format f);
/* Chooses the supersampling of a picture with px pixels, if the request does not. `supersample` is
 * the requested factor; 0: as suits the view. A larger factor is lowered so that at most most_px
 * pixels are drawn. For depth the factor is 1, because depth is that of a pixel's middle. */
void composite_settle(struct composite *p, enum format f, uint32_t supersample, double px,
                      double most_px);
/* Checks whether a format can hold the picture. ERR_DATA: it cannot; the message says what to
 * request instead. */
enum err_code composite_check(const struct composite *p, enum format f, struct err *e) ERR_USE;
/* Appends the encoded picture. Depth as PNG is 16-bit grey in the unit of p. 0: nothing is visible;
 * 65535: farther; a text chunk has the unit. Depth as .npy is float32 metres, NaN: nothing is
 * visible. ERR_MEM, and the errors of image_encode and png_encode: ERR_ARG, ERR_INTERNAL. */
enum err_code composite_encode(const struct composite *p, const struct camera *cam, enum format f,
                               int quality, const struct composite_planes *in, struct buf *out,
                               struct err *e) ERR_USE;
/* Appends the picture, which is not transparent, in planes for a video. ERR_MEM. */
enum err_code composite_frame(const struct composite *p, const struct camera *cam,
                              const struct composite_planes *in, struct buf *out,
                              struct err *e) ERR_USE;
/* Rotates a camera clockwise about its optical axis, in degrees. The picture rotates the other way.
 */
void composite_roll(struct camera *cam, double roll_deg);

#endif
