/* Shared by the files of `citysplat mark`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CLI_MARK_WORK_H
#define CLI_MARK_WORK_H

#include <pthread.h>

#include "ingest/marking.h"
#include "server/route.h"
#include "server/server.h"

enum { MARK_TOKEN = 33 };
struct mark_work {        /* services.own */
    pthread_mutex_t lock; /* for marking */
    struct marking *marking;
    const char *images_dir, *output;
    char token[MARK_TOKEN]; /* whoever has it may see photographs and change marks */
};

/* The route table. */
extern const struct route MARK_ROUTES[];
extern const size_t MARK_ROUTES_COUNT;

/* ---- mark_photo.c ---- */

/* Reads a photograph for a browser: a JPEG as it is but without EXIF, by which browsers would turn
 * it, and COLMAP does not; others as JPEG. ERR_NOENT, ERR_IO, ERR_FORMAT, ERR_LIMIT, ERR_MEM. */
enum err_code mark_photo_read(const char *path, struct buf *out, struct err *e) ERR_USE;
/* Removes EXIF, XMP and maker's data (APP1 to APP15 without colour profiles) from a JPEG. False: it
 * is none, or ends within its head. */
bool mark_photo_strip(const uint8_t *jpeg, size_t n, struct buf *out);

#endif
