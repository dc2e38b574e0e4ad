/* What a picture is made of behind the Gaussians, or in place of their colours; and its bytes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PAINT_H
#define SERVER_PAINT_H

#include "core/camera.h"
#include "server/target.h"

/* RRGGBB, sky or transparent; mm, cm, dm or m: what a text[n] says. False: neither. */
bool paint_read_background(const char *text, size_t n, struct paint *out);
bool paint_read_depth(const char *text, size_t n, struct paint *out);

/* What the renderer gives for a picture [h][w]; NULL: not asked for. */
struct paint_planes {
    const float *rgb;           /* [3]; for SKY and TRANSPARENT on black */
    const float *transmittance; /* what is left behind the last Gaussian */
    const float *depth_m;       /* along the optical axis, of the surface that is seen; 0: none */
};
/* Does it need the transmittance, or the depth? */
bool paint_needs_transmittance(const struct paint *p);
bool paint_needs_depth(const struct paint *p, enum format f);
/* How fine a picture of so many pixels is drawn where the request does not say: supersample (0: as
 * it suits the view), or less, so that at most most_px are drawn. 1 for depth, which is of a
 * pixel's middle. */
void paint_settle(struct paint *p, enum format f, uint32_t supersample, double px, double most_px);
/* ERR_DATA where a format cannot hold it: what to ask for instead. */
enum err_code paint_check(const struct paint *p, enum format f, struct err *e) ERR_USE;
/* Append the encoded picture. Depth as PNG is 16-bit grey in the unit of p, 0 where nothing is seen
 * and 65535 for what is farther, with the unit in a text chunk; as .npy it is float32 metres, NaN
 * where nothing is seen. ERR_MEM, and what image_encode and png_encode return: ERR_ARG,
 * ERR_INTERNAL. */
enum err_code paint_encode(const struct paint *p, const struct camera *cam, enum format f,
                           int quality, const struct paint_planes *in, struct buf *out,
                           struct err *e) ERR_USE;
/* Turn a camera clockwise about its optical axis, degrees: the picture turns the other way. */
void paint_roll(struct camera *cam, double roll_deg);

#endif
