/* Ground truth of a procedural city at poses that are usual in maps (lab/EVALUATION.md, "Map
 * views").
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LAB_SYNTH_VIEWS_H
#define LAB_SYNTH_VIEWS_H

#include "scene/synth/synth.h"

struct synth_views_options {
#define OPT OPTIONS_MEMBER
#include "lab/truth/synth_views.def"
};

/* Writes views of the city that the same version of the program made in the folder `city` into
 * o->output, or if that is NULL into the city's map-views/; *out_dir is that folder:
 *
 *     views.json              manifest: the kind of each view, and COLMAP -> ENU
 *     NAME.json               camera, as for `citysplat render --camera`; ENU
 *     NAME.png, NAME.npy      picture without lens errors; depth along the axis, m, 0 = sky
 *     NAME_mask.png           255: surface that three training photographs see, each pair of
 *                             them at least 5 degrees apart; 128: one sees it; 64: hidden in
 *                             each that looks there; 0: none looks there, or sky
 *     NAME_square.png         255: inside the built-up square
 *
 * View i depends on the options of the city, o->seed and i alone. Errors of truth_config; ERR_ARG,
 * ERR_IO, ERR_MEM, ERR_CANCEL. */
enum err_code synth_views_run(const char *city, const struct synth_views_options *o,
                              char out_dir[FILE_PATH_MAX], struct err *e) ERR_USE;

#endif
