/* Internal to positions: readers of the rows of one file. Rows of all kinds end in one list, and
 * pass the same checks when photographs take them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_POSITIONS_ROWS_H
#define SCENE_CONTROL_POSITIONS_ROWS_H

#include "core/err.h"

struct position;
struct positions;
struct table;

/* A copy of `one` behind the list, of the file that is read. ERR_MEM. */
enum err_code positions_add(struct positions *p, const struct position *one, struct err *e) ERR_USE;
/* Seconds since year 0 of a moment in a week of GPS, which counts from 1980-01-06. */
double positions_week(double week, double seconds);

/* Each reads an open file to its end, from `line` on, TABLE_LINE_MAX bytes that are overwritten;
 * sets p->by, p->epsg and p->heights as far as the file tells. ERR_FORMAT (names the line and what
 * is expected), ERR_DATA, ERR_IO, ERR_LIMIT, ERR_MEM.
 *
 * A table whose first line names the columns, or OpenDroneMap's geo.txt. */
enum err_code positions_csv(struct table *t, char *line, struct positions *p,
                            struct err *e) ERR_USE;
/* RTKLIB's .pos. */
enum err_code positions_pos(struct table *t, char *line, struct positions *p,
                            struct err *e) ERR_USE;
/* DJI's .MRK; its name begins as those of its photographs do. */
enum err_code positions_mrk(struct table *t, char *line, struct positions *p,
                            struct err *e) ERR_USE;

#endif
