/* Photographs and poses as ingest reads them, without a scene: what ingest_look gives.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_INGEST_LOOK_H
#define SCENE_INGEST_INGEST_LOOK_H

#include "codec/scene/colmap.h"
#include "core/geo/geo.h"
#include "scene/control/gcp_locate.h"
#include "scene/control/sim3.h"

struct ingest_survey_photo {
    char *file; /* path below the folder of photographs */
    uint32_t width_px, height_px;
    struct gcp_view view; /* points into the model; without GPS */
};
struct ingest_survey { /* {0} is empty; ingest_survey_free */
    struct colmap_model model;
    struct ingest_survey_photo *photos; /* [n] by name; those whose poses ingest would not use are
                                         * left out */
    size_t n;
    bool placed;     /* there is a frame */
    struct sim3 sim; /* COLMAP -> ENU about origin */
    struct geo_origin origin;
};

#endif
