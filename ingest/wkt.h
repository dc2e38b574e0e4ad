/* Finds the coordinate system that a text describes.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_WKT_H
#define INGEST_WKT_H

#include <stdbool.h>

/* The EPSG codes of a system in OGC's well-known text, of versions 1 and 2: its own, and that of
 * its heights if it is compound. 0: the text gives none. Returns false if this is no such text. */
bool wkt_epsg(const char *wkt, int *epsg, int *heights);

#endif
