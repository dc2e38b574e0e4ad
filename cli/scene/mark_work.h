/* Shared by the files of `citysplat mark`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_MARK_WORK_H
#define CLI_MARK_WORK_H

#include <pthread.h>

#include "codec/image/image.h"
#include "core/options/options.h"
#include "scene/ingest/marking.h"
#include "server/route/route.h"
#include "server/server.h"

enum { MARK_TOKEN = 33 };
/* A tablet has no room for photographs of 20 megapixels, 80 MB each. */
enum { MARK_WHOLE_PX = 2048, MARK_PART_PX = 1024, MARK_ALBUM_PAGES = 2 };
struct mark_album {       /* {.lock = PTHREAD_MUTEX_INITIALIZER}; mark_album_free */
    pthread_mutex_t lock; /* for all */
    struct mark_album_page {
        size_t photo;
        uint64_t used; /* when, by `now` */
        struct image image;
    } pages[MARK_ALBUM_PAGES];
    uint64_t now;
};
struct mark_work {        /* services.own */
    pthread_mutex_t lock; /* for marking */
    struct marking *marking;
    struct mark_album album;
    const char *images_dir, *output;
    char token[MARK_TOKEN]; /* whoever has it may see photographs and change marks */
};

struct mark_source {         /* what is marked; lives in an arena */
    const char *scene;       /* NULL: two folders were given */
    const char *photographs; /* folder */
    const char *model;       /* folder */
    const char *gcp;         /* the list that the scene was made with; NULL: none */
    int gcp_epsg;            /* 0: as the list says */
    double gcp_scale;
    double max_reprojection_px; /* only for a scene */
};
/* Fills *out from the arguments SCENE, or PHOTOGRAPHS MODEL (mark_scene.c). ERR_NOENT: there is no
 * scene, or its photographs are elsewhere. ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code mark_scene_find(const struct options_args *args, struct mark_source *out,
                              struct arena *a, struct err *e) ERR_USE;

/* The route table. */
extern const struct route MARK_ROUTES[];
extern const size_t MARK_ROUTES_COUNT;

/* ---- mark_photo.c ---- */

/* Makes a photograph for a browser. A JPEG stays as it is, but without EXIF; other formats become
 * JPEG. If its longest edge is over MARK_WHOLE_PX, the photograph becomes a smaller picture.
 * ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_LIMIT, ERR_MEM. Any thread. */
enum err_code mark_photo_whole(struct mark_album *a, const char *path, size_t photo,
                               uint32_t longest_px, struct buf *out, struct err *e) ERR_USE;
/* Cuts a square of MARK_PART_PX pixels from a photograph at full size; at its right and lower edge
 * the part is smaller. ERR_NOENT also: there is no such part. Any thread. */
enum err_code mark_photo_part(struct mark_album *a, const char *path, size_t photo, uint32_t column,
                              uint32_t row, struct buf *out, struct err *e) ERR_USE;
void mark_album_free(struct mark_album *a);

#endif
