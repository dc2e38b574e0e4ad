/* An index of a dataset's photographs: where and when they were taken, and in what light.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_SEARCH_INDEX_H
#define SERVER_SEARCH_INDEX_H

#include "core/base.h"

struct search_photo {
    const char *name; /* borrowed from the dataset */
    uint32_t number;  /* as in appearances.json */
    bool posed, timed, coloured, thumbnail;
    double lon_deg, lat_deg, at_m[3]; /* at_m: on the ellipsoid, in the dataset's frame */
    int64_t time_s;
    char time[20];
    uint8_t rgb[3];
    double lab[3];
};
struct search_index { /* immutable, any thread; free with search_index_close */
    struct search_photo *photo;
    size_t n;
    float *sample; /* [n_sample][len_gauss] embeddings over which colours are averaged */
    size_t n_sample;
};
void search_index_close(struct search_index **s);
/* Converts sRGB to CIE Lab, white D65 (IEC 61966-2-1, CIE 15). Equal distances look about equally
 * different. */
void search_index_lab(const uint8_t rgb[3], double lab[3]);

#endif
