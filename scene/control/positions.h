/* Positions of photographs from files of receivers with RTK or PPK: CSV whose first line names the
 * columns, RTKLIB's and Emlid's .pos of camera events, and DJI's .MRK.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_POSITIONS_H
#define SCENE_CONTROL_POSITIONS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/geo/heights.h"

enum { POSITION_IMAGE_MAX = 256, POSITIONS_LONLAT = 4326 };
enum position_by { POSITION_BY_NAME, POSITION_BY_TIME, POSITION_BY_NUMBER };

struct position {
    /* name of the photograph; for .MRK the beginning of its photographs' names */
    char image[POSITION_IMAGE_MAX];
    double time_s;     /* since year 0, in GPS time or universal time; NAN: not given */
    size_t number;     /* for .MRK */
    double at[3];      /* longitude, latitude, height; as in the file until it is unprojected */
    double sigma_m[2]; /* of each horizontal axis, and of height; 0: not given */
    size_t line, file;
};
struct positions { /* {0} is empty; positions_free */
    struct position *list;
    size_t n, cap;
    size_t n_left_out; /* rows without coordinates */
    enum position_by by;
    size_t files;
    int epsg; /* of the file; 0: not given */
    char heights[HEIGHTS_MAX];
};
/* Reads one file, or several .MRK separated by commas. Free *out with positions_free. ERR_NOENT,
 * ERR_FORMAT (names the line and what is expected), ERR_DATA (no positions, or more than one kind),
 * ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code positions_read(const char *paths, struct positions *out, struct err *e) ERR_USE;
void positions_free(struct positions *p);

struct position_photo {
    const char *name;
    double time_s; /* by the camera's clock; NAN: not given */
    bool has_gps;
    double lon_deg, lat_deg;
    size_t position; /* output: index in the list; SIZE_MAX: none */
};
/* Finds the position of each photograph. If they are matched by time, the clocks may differ by a
 * constant. ERR_DATA: a name fits several photographs, or numbers or times do not fit; the message
 * says why. ERR_MEM. */
enum err_code positions_match(const struct positions *p, struct position_photo *photos, size_t n,
                              struct err *e) ERR_USE;
/* Parses "2024:06:01 10:00:00", also with slashes (then a comma or semicolon may precede the
 * hour) or a fraction of seconds. Returns NAN if the text is not a time. */
double positions_time(const char *text);

#endif
