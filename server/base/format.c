/* See format.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/base/format.h"

static const struct {
    const char *ext, *type;
} format_rows[] = {
#define FORMAT_ROW(id, ext, type) {ext, type},
    FORMAT_LIST(FORMAT_ROW)
#undef FORMAT_ROW
};

const char *format_ext(enum format f)
{
    return format_rows[f].ext;
}

const char *format_type(enum format f)
{
    return format_rows[f].type;
}
