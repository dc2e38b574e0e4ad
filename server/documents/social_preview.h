/* The preview of a link to a scene, and the page without scripts: title, text and a picture of the
 * whole scene.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SOCIAL_PREVIEW_H
#define SERVER_SOCIAL_PREVIEW_H

#include "server/data/dataset.h"

/* Appends the address of a picture of the whole scene, as map viewers see it first, behind `up`
 * ("", "..", "https://host/below"). Nothing is appended where the scene has no place. */
/* Writes the place from which the whole dataset is in sight, in the direction of the viewer's first
 * view: longitude, latitude in degrees, height in metres, heading and pitch in degrees. False: it
 * has no Gaussians. */
bool social_preview_camera(const struct dataset *d, double aspect, double out[5]);
void social_preview_picture(const struct dataset *d, const char *up, unsigned width_px,
                            unsigned height_px, struct buf *out);
/* Makes the viewer's page for one dataset from the page for all: title, description, Open Graph and
 * Twitter tags, and the text for readers without scripts. Texts of the dataset are escaped. origin:
 * where the service is, without '/' at the end; "" (not known) or `pictures` false: no picture.
 * ERR_MEM. */
enum err_code social_preview_page(const struct body *page, const struct dataset *d,
                                  const char *origin, bool pictures, struct body **out,
                                  struct err *e) ERR_USE;

#endif
