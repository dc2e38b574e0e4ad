/* Positions of photographs from files, as receivers with RTK or PPK write them: CSV with a first
 * line that names the columns, RTKLIB's and Emlid's .pos of camera events, DJI's .MRK.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_POSITIONS_H
#define INGEST_POSITIONS_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"
#include "core/heights.h"

enum { POSITION_IMAGE_MAX = 256, POSITIONS_LONLAT = 4326 };
enum position_by { POSITION_BY_NAME, POSITION_BY_TIME, POSITION_BY_NUMBER };

struct position {
    char image[POSITION_IMAGE_MAX]; /* by name; of .MRK what names of its photographs begin with */
    double time_s;                  /* since year 0, by GPS's or universal time; NAN: not said */
    size_t number;                  /* of .MRK */
    double at[3];      /* longitude, latitude, height, or as the file has them until projected */
    double sigma_m[2]; /* an axis in plan, height; 0: not said */
    size_t line, file;
};
struct positions { /* {0} is empty; positions_free */
    struct position *list;
    size_t n, cap;
    enum position_by by;
    size_t files;
    int epsg; /* of the file; 0: it does not say */
    char heights[HEIGHTS_MAX];
};
/* One file, or several .MRK by commas. ERR_NOENT, ERR_FORMAT (which line, what is expected),
 * ERR_DATA (no positions, or more than one kind), ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code positions_read(const char *paths, struct positions *out, struct err *e) ERR_USE;
void positions_free(struct positions *p);

struct position_photo {
    const char *name;
    double time_s; /* by the camera's clock; NAN: not said */
    bool has_gps;
    double lon_deg, lat_deg;
    size_t position; /* out: index in the list, SIZE_MAX: none */
};
/* Find the position of each photograph. By time: the clocks may differ by a constant. ERR_DATA:
 * names fit several, numbers or times do not fit the photographs: says why; ERR_MEM. */
enum err_code positions_match(const struct positions *p, struct position_photo *photos, size_t n,
                              struct err *e) ERR_USE;
/* "2024:06:01 10:00:00" or with slashes, seconds with a fraction; NAN: it is none. */
double positions_time(const char *text);

#endif
