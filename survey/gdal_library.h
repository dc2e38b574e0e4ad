/* GDAL's functions for survey/. gdal_shim.c is a library of its own, which is loaded when a map, a
 * vector file or a projection is first opened. GDAL needs 110 libraries. Every process linked with
 * it takes 0.1 s of processor time more to start, and most commands open no map.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SURVEY_GDAL_LIBRARY_H
#define SURVEY_GDAL_LIBRARY_H

#include <stdint.h>

#include <gdal/cpl_conv.h>
#include <gdal/cpl_error.h>
#include <gdal/cpl_string.h>
#include <gdal/gdal.h>
#include <gdal/gdal_alg.h>
#include <gdal/gdal_frmts.h>
#include <gdal/ogr_api.h>
#include <gdal/ogr_srs_api.h>

#include "core/err.h"

#define GDAL_LIBRARY_FILE "citysplat-gdal.so"
#define GDAL_LIBRARY_SYMBOL "gdal_library_table"
#define GDAL_LIBRARY_VERSION 2u /* changes with every change of this table */

/* Declared in ogrsf_frmts.h too, but that is C++. */
void RegisterOGRGeoJSON(void);
void RegisterOGRGeoPackage(void);
void RegisterOGRMEM(void);

/* Called by their own names: gdal->GDALClose(d). */
struct gdal_library {
    uint32_t version;
#define GDAL_FUNCTION(name) __typeof__(name) *name; /* NOLINT(bugprone-macro-parentheses) */
#include "survey/gdal_functions.def"
#undef GDAL_FUNCTION
};
extern const struct gdal_library *gdal; /* NULL before gdal_load */
/* Loads the library, once in a process. Any thread. Call it before anything of `gdal`. ERR_NOENT,
 * ERR_INTERNAL: as library_load. */
enum err_code gdal_load(struct err *e) ERR_USE;
/* From here GDAL prints no errors, it only keeps the last one. gdal_errors_show ends that. Without
 * the library nothing happens. */
void gdal_errors_keep(void);
void gdal_errors_show(void);

#endif
