/* Projects of OpenDroneMap and OpenSfM as COLMAP models: reconstruction.json, tracks.csv,
 * shots.geojson, cameras.json.
 *
 * OpenSfM's poses are world to camera, x right, y down, z forward, with the rotation as axis times
 * angle. Focal lengths and principal points are in units of the picture's larger side. Principal
 * points are relative to the picture's middle. Poses and points stay in the frame of the project.
 * Sources: OpenSfM, doc/geometry and opensfm/io.py; OpenDroneMap, opendm/shots.py.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_ODM_H
#define CODEC_ODM_H

#include "codec/scene/colmap.h"

struct odm_place { /* place of a photograph, as the project gives it */
    bool known;
    double lon_deg, lat_deg, h_m;
};
enum odm_links {                     /* how the photographs that see a point were found */
                 ODM_LINKS_TRACKS,   /* by tracks.csv */
                 ODM_LINKS_COMPUTED, /* where the point projects and nothing nearer hides it */
                 ODM_LINKS_NONE      /* there are no points */
};
struct odm_project { /* {0} is empty; odm_free */
    struct colmap_model model;
    struct odm_place *places; /* [model.n_images]; lives in the model's arena */
    size_t n_places;
    enum odm_links links;
    size_t n_others;             /* photographs of further, smaller reconstructions, left out */
    size_t n_alone;              /* points that less than two photographs see, left out */
    char from[FILE_PATH_MAX];    /* the file with the poses */
    char project[FILE_PATH_MAX]; /* the folder in which OpenDroneMap has images/ */
};

/* Reads a project. path: OpenDroneMap's folder, OpenSfM's folder inside it, or a file
 * reconstruction.json or shots.geojson. Of several reconstructions the largest is taken. Free *out
 * with odm_free. ERR_NOENT: there is none of these files. ERR_FORMAT, ERR_DATA: the message names
 * the file. ERR_DATA also: COLMAP has no model for a camera. ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code odm_read(const char *path, struct odm_project *out, struct err *e) ERR_USE;
void odm_free(struct odm_project *p);

#endif
