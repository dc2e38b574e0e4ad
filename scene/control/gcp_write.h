/* Writes lists of ground control points, in the forms that gcp.h reads.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_GCP_WRITE_H
#define SCENE_CONTROL_GCP_WRITE_H

#include "core/base.h"
#include "scene/control/gcp.h"

enum gcp_form {
    GCP_FORM_ODM, /* gcp_list.txt of OpenDroneMap */
    GCP_FORM_CSV,
    GCP_FORM_XML /* markers of Metashape: gcp_metashape.h */
};
/* By the ending: .csv is CSV, .xml is Metashape's, all else gcp_list.txt. */
enum gcp_form gcp_form_of(const char *path);
/* Returns whether a name of a point or photograph can stand in a list of this form: no separator,
 * no quotation mark, no control character. XML forbids only control characters. */
bool gcp_name_fits(enum gcp_form form, const char *name);
/* Appends the list, with coordinates as in its file. Points keep their order, and so do the marks
 * of each. Points without marks become comments, except in XML. Check points are named in a
 * comment, GCP_CHECKS. Numbers have as many digits as they need. ERR_DATA: a name does not fit, or
 * the coordinate system is not known. ERR_MEM. */
enum err_code gcp_write(const struct gcp_list *l, enum gcp_form form, struct buf *out,
                        struct err *e) ERR_USE;

#endif
