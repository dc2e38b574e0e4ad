/* Makes a scene in metres from photographs and COLMAP poses. Reading order: ingest.c (all steps),
 * ingest_frame.c (where the scene lies), georef.c (which positions are reliable), sim3.c (the
 * mathematics), ingest_scene.c (cameras, points), ingest_points.c (which points are reliable),
 * ingest_photo.c (pixels), ingest_report.c (the report).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_INGEST_H
#define SCENE_INGEST_INGEST_H

#include "core/options/options.h"

struct gcp_list;
struct positions;
struct ingest_survey; /* ingest_look.h */

struct ingest_config {
#define OPT OPTIONS_MEMBER
#include "scene/ingest/ingest.def"
};
/* The table of struct ingest_config: flags, defaults, ranges, help. */
const struct options_spec *ingest_options(void);

/* Makes the scene folder. It prints a report on stdout and writes it to report.json. ERR_ARG,
 * ERR_DATA, ERR_FORMAT, ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_MEM, ERR_CANCEL. */
enum err_code ingest_run(const char *images_dir, const char *sparse_dir,
                         const struct ingest_config *cfg, struct err *e) ERR_USE;
/* As ingest_run, with the frame fitted to ground control points in longitude, latitude and height.
 * gcps NULL: as ingest_run. Also the errors of gcp_fit_make. */
enum err_code ingest_run_gcp(const char *images_dir, const char *sparse_dir,
                             const struct ingest_config *cfg, const struct gcp_list *gcps,
                             struct err *e) ERR_USE;

/* As ingest_run_gcp, with positions of photographs from a file instead of EXIF, in longitude,
 * latitude and height. positions NULL: as ingest_run_gcp. Also the errors of positions_match. */
enum err_code ingest_run_with(const char *images_dir, const char *sparse_dir,
                              const struct ingest_config *cfg, const struct gcp_list *gcps,
                              const struct positions *positions, struct err *e) ERR_USE;

/* Reads photographs and poses without making a scene. The frame is that of GPS, if there is enough
 * of it. Free *out with ingest_survey_free. ERR_DATA, ERR_FORMAT, ERR_NOENT, ERR_IO, ERR_LIMIT,
 * ERR_MEM, ERR_CANCEL. */
enum err_code ingest_look(const char *images_dir, const char *sparse_dir,
                          const struct ingest_config *cfg, struct ingest_survey *out,
                          struct err *e) ERR_USE;
void ingest_survey_free(struct ingest_survey *s);

#endif
