/* Marks ground control points in photographs, one change at a time: where points are expected in
 * photographs, how well marks agree, and the list as a file. Nothing here knows HTTP.
 *
 * A point is expected where its other marks place it; with one mark, at the depth of the sparse
 * points around it; without marks, where its coordinates lie in the frame. The frame is fitted to
 * the points that are placed by marks, if there are three or more. Else it is the frame of GPS,
 * moved onto the points that are placed.
 *
 * Pixels are those of the photographs' files. A pixel of COLMAP's photographs is `px_scale` pixels
 * of the list. Only one thread at a time may use a struct marking.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_INGEST_MARKING_H
#define SCENE_INGEST_MARKING_H

#include "scene/control/gcp_write.h"
#include "scene/ingest/ingest_look.h"

enum marking_source { /* what places a point */
                      MARKING_NOWHERE,
                      MARKING_FRAME,
                      MARKING_ONE,  /* one mark, and the sparse points around it */
                      MARKING_MARKS /* two and more */
};
struct marking_spot { /* a point in a photograph */
    size_t photo;
    /* lost: its mark does not count, because the lens has no such ray */
    bool expected, marked, lost;
    double expected_px[2], marked_px[2];
    double middle; /* distance of the place from the picture's middle, in half diagonals */
    /* distance of the mark from the place that all good marks give; NAN: unknown */
    double residual_px;
    /* distance of the mark from the place that the other marks give; NAN: they give none */
    double out_px;
    bool suspect; /* the mark contradicts the others */
};
struct marking_point { /* the state of a point */
    size_t marks, suspects;
    enum marking_source source;
    double worst_px; /* largest residual of its marks; NAN: unknown */
    double off_m[2]; /* plan and height: distance from where the others put it; NAN: unknown */
};
struct marking; /* marking_close */

struct marking_config {
    const char *output; /* file that is written; its ending decides its form */
    double px_scale, mark_px, sigma_m;
};
/* Takes over *survey and *list, whose points are in longitude, latitude and height, also on
 * failure. ERR_DATA: a mark lies outside of its photograph or its name fits several, or names
 * cannot be written. ERR_MEM. */
enum err_code marking_open(const struct marking_config *cfg, struct ingest_survey *survey,
                           struct gcp_list *list, struct marking **out, struct err *e) ERR_USE;
void marking_close(struct marking **m);
const struct ingest_survey *marking_survey(const struct marking *m);
const struct gcp_list *marking_list(const struct marking *m);
/* Grows with every change. */
uint64_t marking_revision(const struct marking *m);
/* Number of marks in photographs that the model does not have; they stay in the file. */
size_t marking_strays(const struct marking *m);
struct marking_point marking_point(const struct marking *m, size_t point);
/* Fills spots [survey.n] with the photographs in which the point is marked or expected; if its
 * place is not known, with all photographs. Photographs with the point nearest to their middle come
 * first. Returns their number. */
size_t marking_spots(const struct marking *m, size_t point, struct marking_spot *spots);
/* Sets the mark of a point in a photograph; at NULL: takes it away. Then writes the file. On
 * failure nothing has changed. ERR_ARG: the mark is outside of the photograph. ERR_BUSY: another
 * program has changed the file. ERR_IO, ERR_MEM. */
enum err_code marking_set(struct marking *m, size_t point, size_t photo, const double *at_px,
                          struct err *e) ERR_USE;

#endif
