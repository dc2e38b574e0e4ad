/* The options of a procedural city, as they stand in its folder.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_TRUTH_CONFIG_H
#define LAB_TRUTH_CONFIG_H

#include "scene/synth/synth.h"

/* Reads the options of the city that the same version of the program made in a folder. Texts live
 * in the arena. ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_DATA, ERR_ARG: of its truth.json. ERR_MEM. */
enum err_code truth_config(const char *city, struct synth_config *out, struct arena *a,
                           struct err *e) ERR_USE;

#endif
