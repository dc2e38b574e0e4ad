/* Requests pictures, map tiles and answers about the surface from the processes that draw.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PICTURE_H
#define SERVER_PICTURE_H

#include "server/base/config.h"
#include "server/base/memory.h"
#include "server/data/dataset.h"
#include "server/drawing/draw.h"
#include "server/jobs/job.h"

struct picture;
/* STARTING: the device is not known yet. READY: it is known, even while the process is started
 * again (picture_status). OFF: it did not start yet, and is tried again. */
enum picture_state { PICTURE_STARTING, PICTURE_READY, PICTURE_OFF };

/* plan: its part of the memory; {0}: the options alone. Both are borrowed. Close *out with
 * picture_close. ERR_MEM. */
enum err_code picture_open(const struct server_config *cfg, const struct memory_plan *plan,
                           struct picture **out, struct err *e) ERR_USE;
/* Starts the processes; until then all requests wait. ERR_MEM. */
enum err_code picture_start(struct picture *p, struct err *e) ERR_USE;
void picture_stop(struct picture *p); /* gives up the pictures in work; any thread */
void picture_close(struct picture **p);
enum picture_state picture_state(const struct picture *p); /* any thread */
/* Writes the device's name, or that it did not start, without the driver's words. Any thread. */
void picture_about(struct picture *p, char *out, size_t n);
/* State of the process that is nearest to drawing, and counts of all. Returns how many are ready.
 * Any thread. */
size_t picture_status(const struct picture *p, struct worker_status *out);
/* Memory that the processes hold. Any thread. */
size_t picture_held_bytes(const struct picture *p);
/* Returns whether this process is not ready and another one is. Any thread. */
bool picture_rests(const struct picture *p, size_t drawer);
/* Appends the answer to q about d, by one of the processes; called in the thread that draws by it,
 * which is the only one to do so. The caller sets kind and
 * appearance of q and the members of that kind; the rest is filled in. limit: largest number of
 * bytes. It keeps a reference to d until the next picture of another dataset. ERR_DEVICE, ERR_BUSY:
 * there is no process. ERR_NOENT (the revision's file is gone), ERR_CANCEL, ERR_MEM, and the errors
 * of view_render, map_tile_make, query_answer and composite_encode. */
enum err_code picture_make(struct picture *p, size_t drawer, const struct job *j, struct dataset *d,
                           struct draw_request *q, size_t limit, struct buf *out,
                           struct err *e) ERR_USE;

#endif
