/* Requests pictures, map tiles and answers about the surface from the process that draws.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PICTURE_H
#define SERVER_PICTURE_H

#include "server/config.h"
#include "server/dataset.h"
#include "server/draw.h"
#include "server/job.h"
#include "server/memory.h"

struct picture;
/* STARTING: the device is not known yet. READY: it is known, even while the process is started
 * again (picture_status). */
enum picture_state { PICTURE_STARTING, PICTURE_READY, PICTURE_OFF };

/* plan: its part of the memory; {0}: the options alone. Both are borrowed. Close *out with
 * picture_close. ERR_MEM. */
enum err_code picture_open(const struct server_config *cfg, const struct memory_plan *plan,
                           struct picture **out, struct err *e) ERR_USE;
/* Starts the process; until then all requests wait. ERR_MEM. */
enum err_code picture_start(struct picture *p, struct err *e) ERR_USE;
void picture_stop(struct picture *p); /* gives up the picture in work; any thread */
void picture_close(struct picture **p);
enum picture_state picture_state(const struct picture *p); /* any thread */
/* Writes the device's name, or why there is none. Any thread. */
void picture_about(struct picture *p, char *out, size_t n);
/* State of the process. Any thread. */
void picture_status(const struct picture *p, struct worker_status *out);
/* Appends the answer to q about d; called in the thread that draws. The caller sets kind and
 * appearance of q and the members of that kind; the rest is filled in. limit: largest number of
 * bytes. It keeps a reference to d until the next picture of another dataset. ERR_DEVICE, ERR_BUSY:
 * there is no process. ERR_NOENT (the revision's file is gone), ERR_CANCEL, ERR_MEM, and the errors
 * of view_render, map_tile_make, query_answer and paint_encode. */
enum err_code picture_make(struct picture *p, const struct job *j, struct dataset *d,
                           struct draw_request *q, size_t limit, struct buf *out,
                           struct err *e) ERR_USE;

#endif
