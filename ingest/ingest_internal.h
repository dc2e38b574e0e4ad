/* Between the files of ingest: the state of one run, and its steps.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_INGEST_INTERNAL_H
#define INGEST_INGEST_INTERNAL_H

#include <stdatomic.h>

#include "codec/colmap.h"
#include "codec/scene.h"
#include "core/outdir.h"
#include "ingest/ingest.h"

struct ingest {
    const struct ingest_config *cfg;
    const char *images_dir;
    struct outdir dir;
    struct colmap_model model;
    struct ingest_photo *photos; /* by name; all arrays and names from the scene's arena */
    size_t n;
    struct ingest_view *views;
    size_t n_views;
    /* [model.n_images] index in the scene, UINT32_MAX = dropped; by index in the model */
    uint32_t *kept;
    struct georef_result georef;
    bool fitted;
    struct scene scene;
    struct progress progress;
    atomic_flag progress_busy; /* whoever holds it may touch `progress` */
    atomic_size_t done, masks;
    size_t points[INGEST_POINT_VERDICTS];
};

/* ingest_frame.c: origin and similarity into the scene, verdicts of those that contradict their
 * GPS. */
enum err_code ingest_frame_find(struct ingest *g, struct err *e) ERR_USE;
/* --origin: "LON,LAT,H" in degrees and metres. ERR_ARG. */
enum err_code ingest_frame_parse(const char *text, struct geo_origin *o, struct err *e) ERR_USE;
/* ingest_scene.c: images, points and tracks of the scene from what was kept; fills kept and views.
 */
enum err_code ingest_scene_fill(struct ingest *g, struct err *e) ERR_USE;

/* ingest_points.c: take the sparse points out of the scene that are no surface, with their
 * observations; count[] says how many and why. ERR_MEM. */
enum err_code ingest_points_filter(const struct ingest_config *cfg, struct scene *s,
                                   size_t count[INGEST_POINT_VERDICTS], struct err *e) ERR_USE;

/* ingest_exposure.c: exposure and white balance of the scene's photographs, which are written by now.
 * What is read: ERR_IO, ERR_NOENT, ERR_FORMAT; ERR_CANCEL, ERR_MEM. */
enum err_code ingest_exposure_find(struct ingest *g, struct err *e) ERR_USE;

/* ---- ingest_mask.c ---- */

/* The mask of a photograph for the pinhole picture that ingest makes of it, as PNG. */
enum err_code ingest_mask_convert(const struct ingest_view *v, const char *from, const char *to,
                                  struct err *e) ERR_USE;

#endif
