/* Ground control points as Metashape has them: markers exported as XML.
 *
 * The XML has a chunk with cameras (id, label), markers (id, label, reference x y z), and a frame
 * with the markers' places in photographs (marker_id, camera_id, x, y). Its pixels are COLMAP's:
 * the middle of the first is 0.5, 0.5. Labels are names of photographs, mostly without the ending.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GCP_METASHAPE_H
#define SCENE_CONTROL_GCP_METASHAPE_H

#include "scene/control/gcp.h"

/* Is this file XML? */
bool gcp_metashape_is(const char *path);
/* Adds the markers of a file and their marks to a list. Markers without coordinates are left out,
 * and a warning counts them. Markers that are switched off are check points. ERR_FORMAT names the
 * line. ERR_NOENT, ERR_DATA, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code gcp_metashape_read(const char *path, struct gcp_list *l, struct err *e) ERR_USE;
#endif
