/* Positions from files: see positions.h. Which kind a file is of.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/positions.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"
#include "scene/control/positions_rows.h"
#include "scene/control/table.h"

static enum err_code positions_read_one(const char *path, struct positions *p, struct err *e)
{
    struct table t;
    char line[TABLE_LINE_MAX];
    bool more = false;
    enum position_by by = p->by;
    enum err_code rc = table_open(path, &t, e);
    if (!rc)
        rc = table_next(&t, line, &more, e);
    if (!rc && !more)
        rc = err_set(e, ERR_DATA, "%s: no positions", path);
    const char *dot = strrchr(path, '.');
    if (!rc && strstr(line, ",Ellh") && strchr(line, '['))
        rc = positions_mrk(&t, line, p, e);
    else if (!rc && (*line == '%' || (dot && !strcasecmp(dot, ".pos"))))
        rc = positions_pos(&t, line, p, e);
    else if (!rc)
        rc = positions_csv(&t, line, p, e);
    table_close(&t);
    if (!rc && p->files && (by != p->by || p->by != POSITION_BY_NUMBER))
        rc = err_set(e, ERR_DATA, "%s: several files of positions must all be .MRK", path);
    p->files++;
    return rc;
}

enum err_code positions_read(const char *paths, struct positions *out, struct err *e)
{
    enum err_code rc = ERR_OK;
    *out = (struct positions){.heights = "unknown"};
    for (const char *p = paths; !rc && *p;) {
        char path[FILE_PATH_MAX];
        size_t n = strcspn(p, ",");
        if (n >= sizeof path)
            rc = err_set(e, ERR_LIMIT, "--positions: the path is too long");
        if (!rc) {
            memcpy(path, p, n);
            path[n] = '\0';
            rc = positions_read_one(path, out, e);
        }
        p += n + (p[n] == ',');
    }
    if (!rc && !out->n)
        rc = err_set(e, ERR_DATA, "%s: no positions", paths);
    if (rc)
        positions_free(out);
    return rc;
}
