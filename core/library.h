/* Parts of the program that are shared libraries of their own, loaded when they are first needed.
 * The start of the program then loads no large foreign libraries: OpenImageIO brings 250, GDAL 110.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_LIBRARY_H
#define CORE_LIBRARY_H

#include <stdbool.h>
#include <stdint.h>

#include "core/base.h"

struct library {
    const char *what;   /* for messages, "images" */
    const char *file;   /* "citysplat-image.so", beside the program or in its library folder */
    const char *symbol; /* name of a table whose first member is its version, a uint32_t */
    uint32_t version;   /* the version that the caller knows */
};
/* Loads a library, which stays loaded. *table is borrowed. ERR_NOENT: the file is missing.
 * ERR_INTERNAL: it cannot be loaded, or is of another version. */
enum err_code library_load(const struct library *l, const void **table, struct err *e) ERR_USE;

/* The path of a file beside the program or in its library folder. False: there is none. */
bool library_find(const char *file, char out[FILE_PATH_MAX]);

#endif
