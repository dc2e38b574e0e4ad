/* A store as a streamed SOG, for `citysplat export`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_EXPORT_SOG_H
#define CLI_EXPORT_SOG_H

#include "core/base.h"

struct store;

/* Writes a folder with lod-meta.json and a folder for each chunk. It appears only when complete.
 * image: as in bake_read. ERR_ARG (the folder exists), ERR_CANCEL, ERR_DATA (no Gaussians), and the
 * errors of bake_read and sog_write. */
enum err_code export_sog_folder(struct store *s, const float *image, const char *output,
                                bool overwrite, struct err *e) ERR_USE;

#endif
