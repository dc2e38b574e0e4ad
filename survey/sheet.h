/* Reads a map, written by survey/geotiff.h or similar, piece by piece.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_SHEET_H
#define SURVEY_SHEET_H

#include "survey/map.h"

struct sheet; /* only one thread at a time may use it */
/* Opens a GeoTIFF, north up, with square pixels, in an EPSG projection in metres: 4 bands of 8 bits
 * for colours; 1 band for heights, or 2 of which the first is read. Close *out with sheet_close.
 * ERR_NOENT, ERR_FORMAT: it is no such file; the message says what is wrong. ERR_ARG, ERR_IO: of
 * its projection. ERR_LIMIT: larger than map.h allows. ERR_MEM. */
enum err_code sheet_open(const char *path, enum geotiff_kind kind, struct sheet **out,
                         struct err *e) ERR_USE;
void sheet_close(struct sheet **s);
const struct map_grid *sheet_grid(const struct sheet *s);
const struct crs *sheet_crs(const struct sheet *s);
/* Returns the info with which a file of the same pixels begins; borrowed from the sheet. */
struct geotiff_info sheet_info(const struct sheet *s);
/* Reads w x h pixels from (x, y) on, inside the map, as geotiff_write takes them. ERR_FORMAT: the
 * file is damaged. */
enum err_code sheet_read(const struct sheet *s, uint32_t x, uint32_t y, uint32_t w, uint32_t h,
                         void *pixels, struct err *e) ERR_USE;
/* Whether heights have standard deviations. */
bool sheet_has_sigma(const struct sheet *s);
/* Reads them as sheet_read reads heights. ERR_FORMAT: the file is damaged, or has none. */
enum err_code sheet_read_sigma(const struct sheet *s, uint32_t x, uint32_t y, uint32_t w,
                               uint32_t h, float *sigma_m, struct err *e) ERR_USE;

#endif
