/* Marks ground control points in photographs, one change at a time: where points are expected in
 * photographs, how well marks agree, and the list as a file. Nothing here knows HTTP.
 *
 * A point is expected where its other marks place it; with one mark, at the depth of the sparse
 * points around it; without marks, where its coordinates lie in the frame. The frame is that of
 * three and more points that are placed by marks, else that of GPS, moved onto those that are.
 *
 * Pixels are those of the photographs' files. In the list they are `px_scale` for each of COLMAP's.
 * One thread at a time.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_MARKING_H
#define INGEST_MARKING_H

#include "ingest/gcp_write.h"
#include "ingest/ingest_look.h"

enum marking_source { /* what places a point */
                      MARKING_NOWHERE,
                      MARKING_FRAME,
                      MARKING_ONE,  /* mark, and the sparse points around it */
                      MARKING_MARKS /* two and more */
};
struct marking_spot { /* a point in a photograph */
    size_t photo;
    bool expected, marked, lost; /* lost: its mark does not count, the lens has no such ray */
    double expected_px[2], marked_px[2];
    double middle;      /* distance of the place from the picture's middle, in half diagonals */
    double residual_px; /* of the mark, from the place that all good marks give; NAN: unknown */
    double out_px;      /* from the place that the other marks give; NAN: they give none */
    bool suspect;       /* the mark contradicts the others */
};
struct marking_point { /* how a point stands */
    size_t marks, suspects;
    enum marking_source source;
    double worst_px; /* largest residual of its marks; NAN: unknown */
    double off_m[2]; /* plan and height: from where the others put it; NAN: they do not say */
};
struct marking; /* marking_close */

struct marking_config {
    const char *output; /* file that is written; its ending is its form */
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
/* Fills spots [survey.n] with the photographs in which the point is marked or expected, the nearest
 * to their middle first; where nothing is known of it, with all. Returns their number. */
size_t marking_spots(const struct marking *m, size_t point, struct marking_spot *spots);
/* Sets the mark of a point in a photograph; at NULL: takes it away. Then writes the file. On
 * failure nothing has changed. ERR_ARG: outside of the photograph. ERR_BUSY: another program has
 * changed the file. ERR_IO, ERR_MEM. */
enum err_code marking_set(struct marking *m, size_t point, size_t photo, const double *at_px,
                          struct err *e) ERR_USE;

#endif
