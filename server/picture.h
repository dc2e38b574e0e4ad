/* Pictures, map tiles and questions about the surface, as the process that draws makes them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PICTURE_H
#define SERVER_PICTURE_H

#include "server/config.h"
#include "server/dataset.h"
#include "server/draw.h"
#include "server/job.h"

struct picture;
/* STARTING: the device is not known yet. READY: it is, whether or not the process that draws is
 * just being started again (picture_status). */
enum picture_state { PICTURE_STARTING, PICTURE_READY, PICTURE_OFF };

/* picture_close it. ERR_MEM. */
enum err_code picture_open(const struct server_config *cfg, struct picture **out,
                           struct err *e) ERR_USE;
/* Start the process; until then everything waits. ERR_MEM. */
enum err_code picture_start(struct picture *p, struct err *e) ERR_USE;
void picture_stop(struct picture *p); /* what is being made is given up; any thread */
void picture_close(struct picture **p);
enum picture_state picture_state(const struct picture *p); /* any thread */
/* Device name when ready, else why there is none; any thread. */
void picture_about(struct picture *p, char *out, size_t n);
/* How the process is; any thread. */
void picture_status(const struct picture *p, struct worker_status *out);
/* On the drawing thread: append what q asks of d. The caller sets q's kind, appearance and what
 * belongs to the kind; the rest is filled in. limit: most bytes. A reference of d is kept until
 * another picture is asked for when nobody else has one. ERR_DEVICE, ERR_BUSY: no process;
 * ERR_NOENT (the revision's file is gone), ERR_CANCEL, ERR_MEM, and what view_render,
 * map_tile_make, query_answer and paint_encode return. */
enum err_code picture_make(struct picture *p, const struct job *j, struct dataset *d,
                           struct draw_request *q, size_t limit, struct buf *out,
                           struct err *e) ERR_USE;

#endif
