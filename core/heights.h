/* What the heights of a scene or a store count from, as a short text:
 *
 *   ellipsoid   the WGS 84 ellipsoid; so does "", of imports
 *   sea-exif    above sea level as cameras write it into EXIF; no geoid is known
 *   sea         above sea level; by which geoid is not known
 *   EPSG:7837   heights of this vertical coordinate system
 *   unknown     nobody said
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_HEIGHTS_H
#define CORE_HEIGHTS_H

#include <stdbool.h>

enum { HEIGHTS_MAX = 24, HEIGHTS_WORDS_MAX = 80 };
/* Is it one of the texts above? */
bool heights_valid(const char *text);
bool heights_ellipsoidal(const char *text);
/* The code of "EPSG:7837"; 0: none. */
int heights_epsg(const char *text);
/* For people, after "height above": "the WGS 84 ellipsoid". */
void heights_words(const char *text, char out[HEIGHTS_WORDS_MAX]);
/* For people and programs, by itself: "WGS 84 ellipsoid". */
void heights_datum(const char *text, char out[HEIGHTS_WORDS_MAX]);

#endif
