/* A store as a streamed SOG, for `citysplat export`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EXPORT_SOG_H
#define CLI_EXPORT_SOG_H

#include "core/base.h"

struct store;

/* lod-meta.json and a folder for each chunk, in a folder that appears as a whole; image: as of
 * bake_read. ERR_ARG (the folder is there), ERR_CANCEL, ERR_DATA (no Gaussians), and those of
 * bake_read and sog_write. */
enum err_code export_sog_folder(struct store *s, const float *image, const char *output,
                                bool overwrite, struct err *e) ERR_USE;

#endif
