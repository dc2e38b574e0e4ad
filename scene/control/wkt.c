/* Coordinate systems in well-known text: see wkt.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/wkt.h"

#include <stdint.h>
#include <string.h>
#include <strings.h>

#define WKT_SPACE " \t\r\n"
/* No code of EPSG has more than six digits. A text that names a system is shorter than a line. */
enum { WKT_CODE_MOST = 999999, WKT_TEXT_MOST = 1024 };

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

/* The whole number that a text begins with; 0: none from 1 to the largest code there is. */
static int wkt_number(const char *text, const char **end)
{
    int v = 0;
    for (; *text >= '0' && *text <= '9'; text++)
        v = v <= WKT_CODE_MOST ? 10 * v + (*text - '0') : v;
    if (end)
        *end = text;
    return v <= WKT_CODE_MOST ? v : 0;
}

/* AUTHORITY["EPSG","25832"], ID["EPSG",25832]; 0: neither. */
static int wkt_code(const char *node)
{
    static const char *const names[] = {"AUTHORITY", "ID", NULL};
    const char *a = wkt_child(node, names);
    a = a ? strpbrk(a, "[(") : NULL;
    if (!a || strncasecmp(a + 1, "\"EPSG\"", 6))
        return 0;
    a += 7 + strspn(a + 7, WKT_SPACE);
    return *a == ',' ? wkt_number(a + 1 + strspn(a + 1, WKT_SPACE "\""), NULL) : 0;
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

enum wkt_datum { WKT_OTHER, WKT_WGS84, WKT_ETRS89, WKT_NAD83 };

/* Zones of UTM; 0: the datum has none there. */
static int wkt_utm(enum wkt_datum datum, int zone, bool south)
{
    if (zone < 1 || zone > 60)
        return 0;
    if (datum == WKT_ETRS89)
        return !south && zone >= 28 && zone <= 38 ? 25800 + zone : 0;
    if (datum == WKT_NAD83)
        return !south && zone <= 23 ? 26900 + zone : 0;
    return datum == WKT_WGS84 ? (south ? 32700 : 32600) + zone : 0;
}

/* By a name such as "WGS 84 / UTM zone 32N", in small letters. WGS 72 is another datum. */
static enum wkt_datum wkt_named(const char *text)
{
    const char *wgs = strstr(text, "wgs");
    if (strstr(text, "etrs"))
        return WKT_ETRS89;
    if (strstr(text, "nad83"))
        return WKT_NAD83;
    if (!wgs)
        return WKT_OTHER;
    const int year = wkt_number(wgs + 3 + strspn(wgs + 3, " _-"), NULL);
    return year == 84 || year == 1984 ? WKT_WGS84 : WKT_OTHER;
}

/* ---- PROJ ---- */

/* The value of "+zone=" and its like; NULL: none. */
static const char *wkt_proj_get(const char *text, const char *key)
{
    const char *at = strstr(text, key);
    return at ? at + strlen(key) : NULL;
}

static bool wkt_proj_is(const char *value, const char *word)
{
    const size_t n = strlen(word);
    return value && !strncmp(value, word, n) && strchr(WKT_SPACE, value[n]);
}

/* That a parameter is absent, or has its default value. */
static bool wkt_proj_plain(const char *text, const char *key, const char *word)
{
    const char *value = wkt_proj_get(text, key);
    return !value || wkt_proj_is(value, word);
}

/* What moves or stretches a system makes it another one, whatever its datum is called. */
static bool wkt_proj_moved(const char *text)
{
    static const char *const own[] = {"+a=", "+b=", "+r=", "+rf=", "+f=", "+to_meter=", NULL};
    const char *shift = wkt_proj_get(text, "+towgs84=");
    for (size_t k = 0; own[k]; k++)
        if (wkt_proj_get(text, own[k]))
            return true;
    if (shift && !strchr(WKT_SPACE, shift[strspn(shift, "+-0.,")])) /* not all zeros */
        return true;
    return !wkt_proj_plain(text, "+vunits=", "m") || !wkt_proj_plain(text, "+axis=", "enu") ||
           !wkt_proj_plain(text, "+nadgrids=", "@null") ||
           !(wkt_proj_plain(text, "+pm=", "greenwich") || wkt_proj_plain(text, "+pm=", "0"));
}

/* The ellipsoid alone stands for the datum that is commonly meant. */
static enum wkt_datum wkt_proj_datum(const char *text)
{
    const char *datum = wkt_proj_get(text, "+datum="), *ellps = wkt_proj_get(text, "+ellps=");
    const bool grs80 = wkt_proj_is(ellps, "grs80"), wgs84 = wkt_proj_is(ellps, "wgs84");
    if (wkt_proj_moved(text) || (ellps && !grs80 && !wgs84))
        return WKT_OTHER;
    if (!datum)
        return grs80 ? WKT_ETRS89 : wgs84 ? WKT_WGS84 : WKT_OTHER;
    return wkt_proj_is(datum, "wgs84")    ? WKT_WGS84
           : wkt_proj_is(datum, "etrs89") ? WKT_ETRS89
           : wkt_proj_is(datum, "nad83")  ? WKT_NAD83
                                          : WKT_OTHER;
}

/* "+proj=utm +zone=32 +datum=WGS84", "+proj=longlat"; in small letters. */
static int wkt_proj(const char *text)
{
    const char *proj = wkt_proj_get(text, "+proj="), *zone = wkt_proj_get(text, "+zone=");
    const enum wkt_datum datum = wkt_proj_datum(text);
    if (wkt_proj_is(proj, "longlat") || wkt_proj_is(proj, "latlong"))
        return datum == WKT_WGS84 || datum == WKT_ETRS89 ? 4326 : 0;
    return wkt_proj_is(proj, "utm") && zone && wkt_proj_plain(text, "+units=", "m")
               ? wkt_utm(datum, wkt_number(zone, NULL), strstr(text, "+south") != NULL)
               : 0;
}

/* "25832+7837", "25832 + epsg:7837", and of a URN "25832,crs:epsg::7837", whose second code a
 * version may precede. */
static bool wkt_pair(const char *text, int *epsg, int *heights)
{
    *epsg = wkt_number(text, &text);
    text += strspn(text, " \t");
    const size_t join = *text == '+' ? 1 : !strncmp(text, ",crs:", 5) ? 5 : 0;
    text += join + (join ? strspn(text + join, " \t") : 0);
    const bool named = join && !strncmp(text, "epsg:", 5);
    if (named) {
        text += 5;
        const size_t version = strcspn(text, ":, \t");
        text += text[version] == ':' ? version + 1 : 0;
    }
    const bool both = named || (join && *text >= '0' && *text <= '9');
    *heights = both ? wkt_number(text, NULL) : 0;
    if (!*epsg || (both && !*heights))
        *epsg = *heights = 0;
    return *epsg > 0;
}

bool wkt_system(const char *text, int *epsg, int *heights)
{
    static const char metashape[] = "CoordinateSystem:";
    char low[WKT_TEXT_MOST];
    size_t n = 0, quoted = SIZE_MAX;
    *epsg = *heights = 0;
    text += strspn(text, " \t#");
    if (!strncasecmp(text, metashape, sizeof metashape - 1))
        text += sizeof metashape - 1;
    text += strspn(text, " \t");
    if (wkt_epsg(text, epsg, heights)) {
        if (*epsg || strncasecmp(text, "PROJ", 4) != 0)
            return *epsg > 0;
        text = strchr(text, '"'); /* no code: the name may say it */
        if (!text)
            return false;
        text++;
        quoted = strcspn(text, "\"");
    }
    for (; text[n] && n < quoted && n + 1 < sizeof low; n++)
        low[n] = (char)(text[n] >= 'A' && text[n] <= 'Z' ? text[n] + 32 : text[n]);
    low[n] = '\0';
    if (text[n] && n < quoted) /* what is cut off might say south */
        return false;
    const char *code = strstr(low, "epsg"), *utm = strstr(low, "utm"), *ogc = strstr(low, "crs84");
    if (ogc && !ogc[5]) { /* "OGC:CRS84", and as a URN or an address: longitude and latitude */
        *epsg = 4326;
        return true;
    }
    if (code && !strncmp(low, "http", 4)) { /* .../def/crs/EPSG/0/32632 */
        const char *last = strrchr(code, '/');
        return last && wkt_pair(last + 1, epsg, heights);
    }
    if (low[strspn(low, "0123456789")] == '\0' && n >= 4) /* a code alone */
        return wkt_pair(low, epsg, heights);
    if (code && !strncmp(low, "urn:", 4)) { /* there may be a version before the code */
        code += 4 + (code[4] == ':');
        const size_t version = strcspn(code, ":, \t");
        return wkt_pair(code + (code[version] == ':' ? version + 1 : 0), epsg, heights);
    }
    if (code && code == low)
        return wkt_pair(code + 4 + strspn(code + 4, ": \t"), epsg, heights);
    if (*low == '+')
        *epsg = wkt_proj(low);
    else if (utm) { /* "WGS84 UTM 32N", "WGS 84 / UTM zone 32N" */
        utm += 3 + strspn(utm + 3, " ");
        utm += !strncmp(utm, "zone", 4) ? 4 : 0;
        const int zone = wkt_number(utm + strspn(utm, " "), &utm);
        utm += strspn(utm, " ");
        if (*utm == 'n' || *utm == 's')
            *epsg = wkt_utm(wkt_named(low), zone, *utm == 's');
    } else if (!strcmp(low, "wgs84") || !strcmp(low, "wgs 84"))
        *epsg = 4326;
    return *epsg > 0;
}
