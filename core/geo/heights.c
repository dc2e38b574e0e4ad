/* The reference of heights: see heights.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/geo/heights.h"

#include <stdio.h>
#include <string.h>

static const struct {
    const char *text, *words, *datum;
} kinds[] = {
    {"ellipsoid", "the WGS 84 ellipsoid", "WGS 84 ellipsoid"},
    {"", "the WGS 84 ellipsoid", "WGS 84 ellipsoid"},
    {"sea-exif", "sea level by EXIF (no geoid known)", "sea level by EXIF (no geoid known)"},
    {"sea", "sea level (no geoid known)", "sea level (no geoid known)"},
    {"takeoff", "the place of take-off, whose height is not known", "take-off (height not known)"},
    {"unknown", "a surface that is not known", "unknown"},
    {"unscaled", "the model's ground, in units that are not metres (scale not known)",
     "model's own (metres not known)"},
};
enum { HEIGHTS_KINDS = sizeof kinds / sizeof *kinds };

int heights_epsg(const char *text)
{
    int code = 0, n = 0;
    return sscanf(text, "EPSG:%7d%n", &code, &n) == 1 && !text[n] && code > 0 ? code : 0;
}

static size_t heights_kind(const char *text)
{
    size_t k = 0;
    while (k < HEIGHTS_KINDS && strcmp(kinds[k].text, text))
        k++;
    return k;
}

bool heights_valid(const char *text)
{
    return heights_kind(text) < HEIGHTS_KINDS || heights_epsg(text);
}

bool heights_ellipsoidal(const char *text)
{
    return heights_kind(text) < 2;
}

bool heights_same(const char *a, const char *b)
{
    return !strcmp(a, b) || (heights_ellipsoidal(a) && heights_ellipsoidal(b));
}

const char *heights_name(const char *text)
{
    return text[0] ? text : kinds[0].text;
}

bool heights_of_sea(const char *text)
{
    return !strcmp(text, "sea") || !strcmp(text, "sea-exif");
}

void heights_words(const char *text, char out[HEIGHTS_WORDS_MAX])
{
    size_t k = heights_kind(text);
    if (k < HEIGHTS_KINDS)
        snprintf(out, HEIGHTS_WORDS_MAX, "%s", kinds[k].words);
    else
        snprintf(out, HEIGHTS_WORDS_MAX, "the zero of EPSG:%d", heights_epsg(text));
}

void heights_datum(const char *text, char out[HEIGHTS_WORDS_MAX])
{
    size_t k = heights_kind(text);
    if (k < HEIGHTS_KINDS)
        snprintf(out, HEIGHTS_WORDS_MAX, "%s", kinds[k].datum);
    else
        snprintf(out, HEIGHTS_WORDS_MAX, "EPSG:%d", heights_epsg(text));
}
