/* Views of stores, on one thread that owns the OpenCL device.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PICTURE_H
#define SERVER_PICTURE_H

#include "core/camera.h"
#include "lod/nadir.h"
#include "server/appearance_api.h"
#include "server/config.h"
#include "server/dataset.h"
#include "server/job.h"
#include "server/target.h"

struct picture;
enum picture_state { PICTURE_STARTING, PICTURE_READY, PICTURE_OFF };
struct picture_view { /* what to draw */
    struct camera cam;
    enum format format;
    int quality; /* of JPEG and WebP */
    struct paint paint;
};

/* picture_close it. ERR_MEM. */
enum err_code picture_open(const struct server_config *cfg, struct picture **out,
                           struct err *e) ERR_USE;
void picture_close(struct picture **p);
/* On the view thread: open the device and build the kernels; close all. */
void picture_enter(struct picture *p);
void picture_leave(struct picture *p);
enum picture_state picture_state(const struct picture *p); /* any thread */
/* Device name when ready, else why there is none. Copied under the lock; any thread. */
void picture_about(struct picture *p, char *out, size_t n);
/* On the view thread, as all below; views keep a reference of the dataset until another picture is
 * asked for when nobody else has one. What draws a dataset from straight above, in an appearance;
 * until the next picture. Errors as picture_make: ERR_DEVICE, ERR_NOENT, ERR_MEM, and what
 * view_open gives. */
enum err_code picture_nadir(struct picture *p, struct dataset *d, const struct appearance_choice *a,
                            struct nadir **out, struct err *e) ERR_USE;
/* On the view thread. Append the encoded picture. ERR_DEVICE, ERR_NOENT (the revision's file is
 * gone), ERR_CANCEL, ERR_MEM, and what view_render and image_encode return. */
enum err_code picture_make(struct picture *p, const struct job *j, struct dataset *d,
                           const struct appearance_choice *a, const struct picture_view *v,
                           struct buf *out, struct err *e) ERR_USE;

#endif
