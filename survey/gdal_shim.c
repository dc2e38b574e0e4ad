/* The library citysplat-gdal.so: a table of GDAL's functions. See gdal_library.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/gdal_library.h"

extern const struct gdal_library gdal_library_table;
const struct gdal_library gdal_library_table = {
#define GDAL_FUNCTION(name) .name = (name),
#include "survey/gdal_functions.def"
#undef GDAL_FUNCTION
    .version = GDAL_LIBRARY_VERSION,
};
