/* Reads ground control points and their marks from files.
 *
 * There are three file formats. OpenDroneMap's gcp_list.txt has a line with the coordinate system,
 * then lines "x y z column row photograph [name]", separated by blanks or tabs. CSV, with commas or
 * semicolons, has a line with the names of columns: x, y, z (or easting, northing, height; or lon,
 * lat, height), px, py, image; optionally name, accuracy_xy and accuracy_z in metres, and
 * accuracy_px. A comment "# EPSG:25832" above names its coordinate system. Two files, of points and
 * of their marks, are named "POINTS.csv,MARKS.csv". Metashape's XML: gcp_metashape.h. Numbers have
 * decimal points, or decimal commas where semicolons or tabs separate the fields (table.h). Another
 * decimal comma is refused, and the message names the line.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GCP_READ_H
#define SCENE_CONTROL_GCP_READ_H

#include "scene/control/gcp.h"

/* Reads a file. Free *out with gcp_free. ERR_NOENT, ERR_FORMAT (names the line and what is
 * expected), ERR_DATA (none, or too many), ERR_IO, ERR_MEM. */
enum err_code gcp_read(const char *path, struct gcp_list *out, struct err *e) ERR_USE;
/* As gcp_read, and points may come without marks: "x y z [name]" in a gcp_list.txt, or CSV without
 * px, py and image, or with these left empty. There may be no point at all. */
enum err_code gcp_read_points(const char *path, struct gcp_list *out, struct err *e) ERR_USE;

#endif
