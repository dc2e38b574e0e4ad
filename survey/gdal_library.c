/* GDAL, loaded when it is needed: see gdal_library.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/gdal_library.h"

#include <pthread.h>

#include "core/library.h"

const struct gdal_library *gdal;

static struct err gdal_why; /* why it could not be loaded */

static void gdal_load_once(void)
{
    static const struct library l = {"maps and projections", GDAL_LIBRARY_FILE, GDAL_LIBRARY_SYMBOL,
                                     GDAL_LIBRARY_VERSION};
    const void *table;
    if (!library_load(&l, &table, &gdal_why))
        gdal = table;
}

enum err_code gdal_load(struct err *e)
{
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, gdal_load_once);
    return gdal ? ERR_OK : err_set(e, gdal_why.code, "%s", gdal_why.msg);
}

void gdal_errors_keep(void)
{
    if (gdal)
        gdal->CPLPushErrorHandler(gdal->CPLQuietErrorHandler);
}

void gdal_errors_show(void)
{
    if (gdal)
        gdal->CPLPopErrorHandler();
}
