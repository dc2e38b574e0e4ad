/* The reference of heights in a scene or store, as a short text:
 *
 *     ellipsoid   the WGS 84 ellipsoid; "" means the same, for imports
 *     sea-exif    above sea level, as cameras write it into EXIF; the geoid is not known
 *     sea         above sea level; the geoid is not known
 *     takeoff     above the place where the drone took off; its height is not known
 *     EPSG:7837   heights of this vertical coordinate system
 *     unknown     the reference was not given
 *     unscaled    as unknown, and metres are not known either: units are those of a model that
 *                 photographs without GPS and control gave
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_HEIGHTS_H
#define CORE_HEIGHTS_H

#include <stdbool.h>

enum { HEIGHTS_MAX = 24, HEIGHTS_WORDS_MAX = 80 };
/* Returns whether it is one of the texts above. */
bool heights_valid(const char *text);
bool heights_ellipsoidal(const char *text);
/* Whether both texts name one reference. Two references that are unknown may still differ. */
bool heights_same(const char *a, const char *b);
/* The text itself, and "ellipsoid" for "". */
const char *heights_name(const char *text);
/* sea, sea-exif: a geoid leads to the ellipsoid. */
bool heights_of_sea(const char *text);
/* The code of "EPSG:7837"; 0: none. */
int heights_epsg(const char *text);
/* Writes words that follow "height above": "the WGS 84 ellipsoid". */
void heights_words(const char *text, char out[HEIGHTS_WORDS_MAX]);
/* Writes the reference alone: "WGS 84 ellipsoid". */
void heights_datum(const char *text, char out[HEIGHTS_WORDS_MAX]);

#endif
