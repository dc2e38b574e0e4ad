/* What is known of a dataset's photographs: where and when they were taken, and in what light.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_APPEARANCE_ROWS_H
#define SERVER_APPEARANCE_ROWS_H

#include "core/base.h"

struct appearance_row {
    const char *name; /* borrowed from the dataset */
    uint32_t number;  /* as in appearances.json */
    bool posed, timed, coloured, thumbnail;
    double lon_deg, lat_deg;
    char time[20];
    uint8_t rgb[3];
};
struct appearance_rows { /* immutable, any thread; free with appearance_rows_close */
    struct appearance_row *row;
    size_t n;
    float *sample; /* [n_sample][len_gauss] embeddings over which colours are averaged */
    size_t n_sample;
};
void appearance_rows_close(struct appearance_rows **r);

#endif
