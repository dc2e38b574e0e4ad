/* Compares an orthophoto with the procedural city that it shows.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_TRUTH_H
#define CLI_TRUTH_H

#include "synth/synth.h"

struct truth_score {
    /* pixels of the orthophoto with a value; those of them in the built-up square */
    uint64_t pixels, inside;
    double psnr_db, inside_psnr_db; /* NAN: no pixels */
};
/* Draws the city of folder cfg->city on the pixels of the orthophoto cfg->map, and writes it to the
 * GeoTIFF cfg->output (NULL: none). Errors of synth_views_config, sheet.h and geotiff.h. ERR_DATA:
 * the orthophoto is empty. ERR_CANCEL. */
enum err_code truth_map(const struct synth_config *cfg, struct truth_score *out,
                        struct err *e) ERR_USE;

#endif
