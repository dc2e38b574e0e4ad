/* Coordinate systems in well-known text: see wkt.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/ingest/wkt.h"

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

/* The number of "+zone=32" and its like; 0: none. */
static int wkt_proj_number(const char *text, const char *key)
{
    const char *at = strstr(text, key);
    int v = 0;
    return at && sscanf(at + strlen(key), "%d", &v) == 1 ? v : 0;
}

/* Zones of UTM by datum: WGS 84, ETRS89, NAD83; 0: none of them. */
static int wkt_utm(const char *datum, int zone, bool south)
{
    if (zone < 1 || zone > 60)
        return 0;
    if (strstr(datum, "etrs") || strstr(datum, "grs80"))
        return !south && zone >= 28 && zone <= 38 ? 25800 + zone : 0;
    if (strstr(datum, "nad83"))
        return !south && zone <= 23 ? 26900 + zone : 0;
    if (!strstr(datum, "wgs"))
        return 0;
    return (south ? 32700 : 32600) + zone;
}

/* "+proj=utm +zone=32 +datum=WGS84", "+proj=longlat"; in small letters. */
static int wkt_proj(const char *text)
{
    if (strstr(text, "+proj=longlat") || strstr(text, "+proj=latlong"))
        return strstr(text, "wgs84") || strstr(text, "grs80") ? 4326 : 0;
    return strstr(text, "+proj=utm") && !strstr(text, "+units=us-ft") && !strstr(text, "+units=ft")
               ? wkt_utm(text, wkt_proj_number(text, "+zone="), strstr(text, "+south") != NULL)
               : 0;
}

bool wkt_system(const char *text, int *epsg, int *heights)
{
    static const char metashape[] = "CoordinateSystem:";
    char low[160];
    size_t n = 0;
    *epsg = *heights = 0;
    text += strspn(text, " \t#");
    if (!strncasecmp(text, metashape, sizeof metashape - 1))
        text += sizeof metashape - 1;
    text += strspn(text, " \t");
    if (wkt_epsg(text, epsg, heights))
        return *epsg > 0;
    for (; text[n] && n + 1 < sizeof low; n++)
        low[n] = (char)(text[n] >= 'A' && text[n] <= 'Z' ? text[n] + 32 : text[n]);
    low[n] = '\0';
    const char *code = strstr(low, "epsg"), *utm = strstr(low, "utm");
    if (code && (code == low || !strncmp(low, "urn:", 4))) {
        code += 4 + strspn(code + 4, ": \t");
        return sscanf(code, "%d+%d", epsg, heights) >= 1 && *epsg > 0;
    }
    if (*low == '+')
        *epsg = wkt_proj(low);
    else if (utm) { /* "WGS84 UTM 32N", "WGS 84 / UTM zone 32N" */
        int zone = 0;
        char side = 0;
        utm += 3 + strspn(utm + 3, " ");
        utm += !strncmp(utm, "zone", 4) ? 4 : 0;
        if (sscanf(utm, "%d %c", &zone, &side) == 2 && (side == 'n' || side == 's'))
            *epsg = wkt_utm(low, zone, side == 's');
    } else if (!strcmp(low, "wgs84") || !strcmp(low, "wgs 84"))
        *epsg = 4326;
    return *epsg > 0;
}
