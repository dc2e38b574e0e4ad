/* Coordinate systems in well-known text: see wkt.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "ingest/wkt.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

/* The first child of this name in NAME["...",CHILD[...],...]; NULL: there is none. `names` ends
 * with NULL. Text in quotation marks is no child. */
static const char *wkt_child(const char *node, const char *const *names)
{
    int depth = 0;
    bool quoted = false, begins = false;
    for (const char *p = node; *p; p++) {
        if (*p == '"') {
            quoted = !quoted;
        } else if (quoted) {
            continue;
        } else if (*p == '[' || *p == '(') {
            depth++;
            begins = true;
            continue;
        } else if (*p == ']' || *p == ')') {
            if (--depth <= 0)
                return NULL;
        } else if (depth == 1 && begins) {
            for (size_t k = 0; names[k]; k++) {
                const size_t n = strlen(names[k]);
                if (!strncasecmp(p, names[k], n) && (p[n] == '[' || p[n] == '('))
                    return p;
            }
        }
        begins = *p == ',' || (begins && strchr(" \t\r\n", *p));
    }
    return NULL;
}

/* AUTHORITY["EPSG","25832"], ID["EPSG",25832]; 0: neither. */
static int wkt_code(const char *node)
{
    static const char *const names[] = {"AUTHORITY", "ID", NULL};
    const char *a = wkt_child(node, names);
    int code = 0;
    a = a ? strpbrk(a, "[(") : NULL;
    if (!a || strncasecmp(a + 1, "\"EPSG\"", 6))
        return 0;
    a = strchr(a, ',');
    if (!a || sscanf(a, ",%*[ \"]%d", &code) == 1)
        return code > 0 ? code : 0;
    return sscanf(a, ",%d", &code) == 1 && code > 0 ? code : 0;
}

bool wkt_epsg(const char *wkt, int *epsg, int *heights)
{
    static const char *const plane[] = {"PROJCS", "GEOGCS", "PROJCRS", "GEOGCRS", "GEODCRS", NULL};
    static const char *const others[] = {"LOCAL_CS", "ENGCRS", "GEOCCS", NULL};
    static const char *const compound[] = {"COMPD_CS", "COMPOUNDCRS", NULL};
    static const char *const vertical[] = {"VERT_CS", "VERTCRS", NULL};
    const char *const *kinds[] = {plane, others, compound};
    size_t kind = 0, found = 3;
    for (; kind < 3 && found == 3; kind++)
        for (size_t k = 0; kinds[kind][k]; k++)
            if (!strncasecmp(wkt, kinds[kind][k], strlen(kinds[kind][k])) &&
                strchr("[(", wkt[strlen(kinds[kind][k])]) && wkt[strlen(kinds[kind][k])])
                found = kind;
    *epsg = *heights = 0;
    if (found == 3)
        return false;
    if (found == 0)
        *epsg = wkt_code(wkt);
    if (found == 2) {
        const char *p = wkt_child(wkt, plane), *v = wkt_child(wkt, vertical);
        *epsg = p ? wkt_code(p) : 0;
        *heights = v ? wkt_code(v) : 0;
    }
    return true;
}
