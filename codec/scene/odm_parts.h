/* Shared by the files that read projects of OpenDroneMap: odm_read.c, odm_shots.c, odm_tracks.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_ODM_PARTS_H
#define CODEC_ODM_PARTS_H

#include "codec/scene/odm.h"

struct json_t;

static const double odm_far = 1e9; /* larger coordinates of translations and points are refused */

struct odm_key { /* a name, and the index of the thing with that name; lists are sorted by name */
    const char *name;
    uint32_t index;
};
struct odm_keys {
    struct odm_key *list; /* lives in the arena that it was made with */
    size_t n;
};
/* Sorts a list by name. */
void odm_keys_sort(struct odm_keys *k);
/* The index of a name; UINT32_MAX: there is none. */
uint32_t odm_keys_find(const struct odm_keys *k, const char *name);
/* The members of a JSON object, sorted by name; index = rank. ERR_MEM. */
enum err_code odm_keys_of(const struct json_t *object, struct arena *a, struct odm_keys *out,
                          struct err *e) ERR_USE;
/* Converts a camera of OpenSfM to COLMAP's. ERR_DATA: COLMAP has no such model. ERR_FORMAT. */
enum err_code odm_lens(const char *id, const struct json_t *camera, struct lens *out,
                       struct err *e) ERR_USE;
/* Sets name and pose of a photograph. ERR_FORMAT: its name or numbers are not valid. ERR_MEM. */
enum err_code odm_image_set(struct colmap_model *m, size_t i, const char *name,
                            const struct json_t *pose, struct err *e) ERR_USE;

/* odm_shots.c: reads poses from shots.geojson and fills model and places; `project` is the folder
 * with cameras.json. ERR_NOENT, ERR_FORMAT, ERR_DATA, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code odm_shots_read(const char *path, const char *project, struct odm_project *out,
                             struct err *e) ERR_USE;
/* Reads only the places from shots.geojson, for the photographs in `names`. ERR_NOENT, ERR_FORMAT,
 * ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code odm_shots_places(const char *path, const struct odm_keys *names,
                               struct odm_project *out, struct err *e) ERR_USE;

/* odm_tracks.c: adds observations and tracks to the model's points, from the file `path`. If path
 * is NULL, it computes them. Points that less than two photographs see are removed. ERR_FORMAT
 * (names the line), ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code odm_tracks_link(const char *path, const struct odm_keys *names,
                              const struct odm_keys *points, struct odm_project *out,
                              struct err *e) ERR_USE;

#endif
