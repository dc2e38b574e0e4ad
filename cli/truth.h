/* An orthophoto against the procedural city that it is of.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_TRUTH_H
#define CLI_TRUTH_H

#include "synth/synth.h"

struct truth_score {
    uint64_t pixels, inside; /* that the orthophoto shows; of these within the built-up square */
    double psnr_db, inside_psnr_db; /* NAN: none */
};
/* Draw the city of folder cfg->city on the pixels of the orthophoto cfg->map, into the GeoTIFF
 * cfg->output (NULL: none is written). Errors of synth_views_config, sheet.h and geotiff.h;
 * ERR_DATA: the orthophoto shows nothing; ERR_CANCEL. */
enum err_code truth_map(const struct synth_config *cfg, struct truth_score *out,
                        struct err *e) ERR_USE;

#endif
