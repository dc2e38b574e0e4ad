/* Tables of other programs: they name photographs, and say by their headings what a column is. And
 * OpenDroneMap's geo.txt.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/positions_rows.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/base.h"
#include "scene/control/positions.h"
#include "scene/control/table.h"
#include "scene/control/wkt.h"

enum column {
    COLUMN_IMAGE,
    COLUMN_X,
    COLUMN_Y,
    COLUMN_Z,
    COLUMN_PLAN,
    COLUMN_EAST,
    COLUMN_NORTH,
    COLUMN_HEIGHT,
    COLUMN_BOTH,
    COLUMNS
};

static const struct {
    const char *word;
    enum column column;
} positions_words[] = {{"image", COLUMN_IMAGE},
                       {"photo", COLUMN_IMAGE},
                       {"photograph", COLUMN_IMAGE},
                       {"file", COLUMN_IMAGE},
                       {"filename", COLUMN_IMAGE},
                       {"sourcefile", COLUMN_IMAGE},
                       {"file_name", COLUMN_IMAGE},
                       {"image_name", COLUMN_IMAGE},
                       {"photo_name", COLUMN_IMAGE},
                       {"image_filename", COLUMN_IMAGE},
                       {"imagename", COLUMN_IMAGE},
                       {"name", COLUMN_IMAGE},
                       {"label", COLUMN_IMAGE},
                       {"x", COLUMN_X},
                       {"easting", COLUMN_X},
                       {"east", COLUMN_X},
                       {"lon", COLUMN_X},
                       {"longitude", COLUMN_X},
                       {"long", COLUMN_X},
                       {"lng", COLUMN_X},
                       {"gpslongitude", COLUMN_X},
                       {"y", COLUMN_Y},
                       {"northing", COLUMN_Y},
                       {"north", COLUMN_Y},
                       {"lat", COLUMN_Y},
                       {"latitude", COLUMN_Y},
                       {"gpslatitude", COLUMN_Y},
                       {"z", COLUMN_Z},
                       {"height", COLUMN_Z},
                       {"h", COLUMN_Z},
                       {"alt", COLUMN_Z},
                       {"altitude", COLUMN_Z},
                       {"elevation", COLUMN_Z},
                       {"ellipsoidal_height", COLUMN_Z},
                       {"ellipsoid_height", COLUMN_Z},
                       {"ell_height", COLUMN_Z},
                       {"height_above_ellipsoid", COLUMN_Z},
                       {"ellh", COLUMN_Z},
                       {"gpsaltitude", COLUMN_Z},
                       {"accuracy_xy", COLUMN_PLAN},
                       {"accuracy_horizontal", COLUMN_PLAN},
                       {"horizontal_accuracy", COLUMN_PLAN},
                       {"accuracy_h", COLUMN_PLAN},
                       {"accuracy_x/y", COLUMN_PLAN},
                       {"lateral_rms", COLUMN_PLAN},
                       {"sigma_xy", COLUMN_PLAN},
                       {"accuracy_x", COLUMN_EAST},
                       {"accuracy_y", COLUMN_NORTH},
                       {"sde", COLUMN_EAST},
                       {"sigma_e", COLUMN_EAST},
                       {"std_east", COLUMN_EAST},
                       {"sdn", COLUMN_NORTH},
                       {"sigma_n", COLUMN_NORTH},
                       {"std_north", COLUMN_NORTH},
                       {"accuracy_z", COLUMN_HEIGHT},
                       {"accuracy_vertical", COLUMN_HEIGHT},
                       {"vertical_accuracy", COLUMN_HEIGHT},
                       {"accuracy_v", COLUMN_HEIGHT},
                       {"elevation_rms", COLUMN_HEIGHT},
                       {"sdu", COLUMN_HEIGHT},
                       {"sigma_u", COLUMN_HEIGHT},
                       {"std_up", COLUMN_HEIGHT},
                       {"sigma_z", COLUMN_HEIGHT},
                       {"accuracy", COLUMN_BOTH},
                       {"accuracy_x/y/z", COLUMN_BOTH},
                       {"sigma", COLUMN_BOTH}};

static enum column positions_column(const char *word, int *epsg, char heights[HEIGHTS_MAX])
{
    char plain[TABLE_HEADING];
    table_heading(word, plain);
    for (size_t w = 0; w < sizeof positions_words / sizeof *positions_words; w++) {
        if (strcasecmp(plain, positions_words[w].word))
            continue;
        if (!strncasecmp(plain, "lon", 3) || !strcasecmp(plain, "lng") ||
            !strcasecmp(plain, "gpslongitude"))
            *epsg = POSITIONS_LONLAT;
        if (!strncasecmp(plain, "ell", 3) || !strcasecmp(plain, "height_above_ellipsoid"))
            snprintf(heights, HEIGHTS_MAX, "ellipsoid");
        return positions_words[w].column;
    }
    return COLUMNS;
}

static bool positions_known(const char *field)
{
    int epsg = 0;
    char heights[HEIGHTS_MAX];
    return positions_column(field, &epsg, heights) <= COLUMN_Z;
}

struct positions_head {
    char comma;
    size_t column[COLUMNS], wide;
    size_t enabled; /* Metashape's column of photographs that are switched on; SIZE_MAX: none */
    size_t n_off;   /* rows of photographs that are not */
    /* ExifTool's columns that say whether x, y and z count to the west, south and down */
    size_t ref[COLUMN_Z + 1];
};

/* x, y or z, if this is the heading of its direction: "GPSLongitudeRef"; COLUMNS: it is not. */
static enum column positions_ref_of(const char *word)
{
    char plain[TABLE_HEADING], heights[HEIGHTS_MAX];
    int epsg = 0;
    table_heading(word, plain);
    const size_t n = strlen(plain);
    if (n <= 3 || strcasecmp(plain + n - 3, "ref"))
        return COLUMNS;
    plain[n - 3 - (plain[n - 4] == '_')] = '\0';
    const enum column c = positions_column(plain, &epsg, heights);
    return c >= COLUMN_X && c <= COLUMN_Z ? c : COLUMNS;
}

static enum err_code positions_csv_head(const struct table *t, char *line, struct positions *p,
                                        struct positions_head *h, struct err *e)
{
    static const char *const wanted[] = {"image", "x (or lon)", "y (or lat)", "z (or height)"};
    char *field[TABLE_FIELDS];
    h->comma = table_separator(line, positions_known);
    h->wide = table_split(line, h->comma, field);
    h->enabled = SIZE_MAX;
    for (size_t c = 0; c < COLUMNS; c++)
        h->column[c] = SIZE_MAX;
    for (size_t c = 0; c <= COLUMN_Z; c++)
        h->ref[c] = SIZE_MAX;
    for (size_t i = 0; i < h->wide; i++) {
        const enum column of = positions_ref_of(field[i]);
        if (of != COLUMNS)
            h->ref[of] = i;
        int lonlat = 0;
        char heights[HEIGHTS_MAX] = "";
        const enum column c = positions_column(field[i], &lonlat, heights);
        if (!strncasecmp(field[i], "enable", 6) && h->enabled == SIZE_MAX)
            h->enabled = i;
        if (c == COLUMNS || h->column[c] != SIZE_MAX) /* of two the first counts */
            continue;
        const enum err_code rc = table_check_unit(t->path, t->line, field[i], e);
        if (rc)
            return rc;
        h->column[c] = i;
        p->epsg = p->epsg ? p->epsg : lonlat; /* a comment above may say it better */
        if (*heights)
            memcpy(p->heights, heights, sizeof p->heights);
    }
    for (size_t c = COLUMN_IMAGE; c <= COLUMN_Z; c++)
        if (h->column[c] == SIZE_MAX)
            return err_set(e, ERR_FORMAT,
                           "%s: line %zu: no column for %s; expected are a first line that names "
                           "the columns of a CSV file (image,lon,lat,height), OpenDroneMap's "
                           "geo.txt, RTKLIB's .pos or DJI's .MRK",
                           t->path, t->line, wanted[c]);
    return ERR_OK;
}

static bool positions_unknown(const char *field)
{
    static const char *const words[] = {"", "-", "nan", "n/a", "null", "none"};
    for (size_t k = 0; k < sizeof words / sizeof *words; k++)
        if (!strcasecmp(field, words[k]))
            return true;
    return false;
}

/* A photograph whose coordinates are all 0, empty or no number, or whose height is none: -9999 and
 * its like stand for unknown. */
static bool positions_nowhere(const struct positions_head *h, char *const field[TABLE_FIELDS],
                              size_t n)
{
    const double least_m = -1000, most_m = 20000;
    size_t none = 0;
    bool height = true;
    for (size_t c = COLUMN_X; c <= COLUMN_Z; c++) {
        const size_t i = h->column[c];
        double v;
        const bool unknown = i >= n || positions_unknown(field[i]);
        none += unknown || (table_number(field[i], &v) && v == 0);
        if (c == COLUMN_Z && i < n)
            height = !unknown && (!table_number(field[i], &v) || (v > least_m && v < most_m));
    }
    return none == 3 || !height;
}

/* A standard deviation. What stands for unknown, or is not above 0, is 0. */
static bool positions_sigma(const char *field, double *out)
{
    const double most_m = 1e4; /* more says no less */
    char *end;
    *out = 0;
    if (positions_unknown(field))
        return true;
    const double v = strtod(field, &end);
    *out = v > 0 ? fmin(v, most_m) : 0;
    return end != field && !*end;
}

/* Degrees as ExifTool and surveyors write them: 47 deg 33' 28.79" N, 47°33.48'S, 7:34:23.2 W. Two
 * numbers with blanks between are none: they may be two coordinates. */
static bool positions_angle(const char *text, const char letters[3], double *out)
{
    /* blanks, colons, quotation marks, and the bytes of typographic marks in UTF-8 */
    static const char between[] = " :'\"\xc2\xb0\xba\xe2\x80\xb2\xb3\x99\x9d";
    double part[3] = {0};
    size_t n = 0, marks = 0;
    const char *p = text;
    while (n < 3 && number_read(&p, &part[n])) {
        if (n && part[n - 1] != floor(part[n - 1]))
            return false;
        p += strspn(p, " ");
        if (!strncasecmp(p, "deg", 3))
            p += 3, marks++;
        marks += strspn(p, between);
        p += strspn(p, between);
        n++;
    }
    const char letter = *p ? (char)(*p | 0x20) : '\0';
    *out = fabs(part[0]) + part[1] / 60 + part[2] / 3600;
    if (signbit(part[0]) || letter == letters[1])
        *out = -*out;
    return n > 0 && (n != 2 || marks) && part[1] >= 0 && part[1] < 60 && part[2] >= 0 &&
           part[2] < 60 && (!letter || (strchr(letters, letter) && !p[1]));
}

/* "426.8 m Above Sea Level" */
static bool positions_altitude(const char *text, double *out)
{
    const char *p = text;
    if (!number_read(&p, out))
        return false;
    p += strspn(p, " ");
    if (*p != 'm')
        return false;
    p += 1 + strspn(p + 1, " ");
    const bool below = !strcasecmp(p, "below sea level");
    *out = below ? -fabs(*out) : *out;
    return below || !*p || !strcasecmp(p, "above sea level");
}

/* Whether this field of a column of directions says west, south or below. Other words in columns of
 * such names mean something else: the height of the take-off, a coordinate system. */
static bool positions_turns(enum column c, const char *ref)
{
    static const char *const words[COLUMN_Z + 1][4] = {[COLUMN_X] = {"w", "west"},
                                                       [COLUMN_Y] = {"s", "south"},
                                                       [COLUMN_Z] = {"1", "3", "below sea level"}};
    for (size_t i = 0; words[c][i]; i++)
        if (!strcasecmp(ref, words[c][i]))
            return true;
    return false;
}

/* x, y or z of a row; its direction may stand in another column. */
static bool positions_coordinate(const struct positions_head *h, enum column c, bool lonlat,
                                 char *const field[TABLE_FIELDS], size_t wide, double *out)
{
    const char *text = field[h->column[c]];
    if (!table_number(text, out) &&
        !(c == COLUMN_Z ? positions_altitude(text, out)
                        : lonlat && positions_angle(text, c == COLUMN_X ? "ew" : "ns", out)))
        return false;
    if (h->ref[c] < wide && positions_turns(c, field[h->ref[c]]))
        *out = -fabs(*out);
    return true;
}

/* Numbers of a row. `wide` is how many fields it has. */
static enum err_code positions_numbers(const struct table *t, const struct positions_head *h,
                                       bool lonlat, char *const field[TABLE_FIELDS], size_t wide,
                                       double v[COLUMNS], struct err *e)
{
    static const char *const what[] = {"", "x (or lon)", "y (or lat)", "z (or height)"};
    for (size_t c = COLUMN_X; c < COLUMNS; c++) {
        const size_t i = h->column[c];
        const bool there = i < wide && *field[i];
        if (!there && c <= COLUMN_Z)
            return err_set(e, ERR_FORMAT,
                           "%s: line %zu: %s is missing: give it, or remove the line", t->path,
                           t->line, what[c]);
        if (there &&
            !(c <= COLUMN_Z ? positions_coordinate(h, (enum column)c, lonlat, field, wide, &v[c])
                            : positions_sigma(field[i], &v[c])))
            return err_set(
                e, ERR_FORMAT, "%s: line %zu: field %zu, '%.40s', is no number: write %s", t->path,
                t->line, i + 1, field[i],
                table_is_grouped(field[i])
                    ? "it without thousands separators and with a decimal point, as 5123456.78"
                : strchr(field[i], ',') ? "it with a decimal point"
                                        : "metres, or decimal degrees that are negative "
                                          "in the south and west, without units");
    }
    return ERR_OK;
}

/* A line divided by blanks, of a list that names no columns: "634 676.5 5 123 456.78" would be an x
 * of 634. Both coordinates look so; "512 340.5 120" may be two of a site's own grid, and a height.
 */
static enum err_code positions_check_grouped(const struct table *t, char *const field[TABLE_FIELDS],
                                             size_t n, struct err *e)
{
    char x[80], y[80];
    if (n <= COLUMN_Z + 2)
        return ERR_OK;
    snprintf(x, sizeof x, "%.30s %.30s", field[COLUMN_X], field[COLUMN_Y]);
    snprintf(y, sizeof y, "%.30s %.30s", field[COLUMN_Z], field[COLUMN_Z + 1]);
    return table_is_grouped(x) && table_is_grouped(y)
               ? err_set(e, ERR_FORMAT,
                         "%s: line %zu: '%s' has a thousands separator: write it without, as "
                         "5123456.78",
                         t->path, t->line, x)
               : ERR_OK;
}

static bool positions_is_off(const struct positions_head *h, char *const field[TABLE_FIELDS],
                             size_t n)
{
    return h->enabled < n &&
           (!strcmp(field[h->enabled], "0") || !strcasecmp(field[h->enabled], "false"));
}

static enum err_code positions_csv_row(struct table *t, struct positions_head *h, char *line,
                                       struct positions *p, struct err *e)
{
    char *field[TABLE_FIELDS];
    double v[COLUMNS] = {0};
    struct position one = {.time_s = (double)NAN, .line = t->line};
    if (h->comma != ',')
        table_decimal_points(t, line);
    size_t tabs = 0;
    for (const char *q = line; *q; q++)
        tabs += *q == '\t';
    /* names may have blanks where tabs divide */
    const char comma = h->comma || tabs < COLUMN_Z ? h->comma : '\t';
    size_t n = table_split(line, comma, field), most = n;
    while (most > h->wide && !*field[most - 1])
        most--;
    if (most > h->wide)
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: %zu fields, but the first line names %zu; " TABLE_DIVIDED,
                       t->path, t->line, most, h->wide);
    if (positions_nowhere(h, field, n)) {
        p->n_left_out++;
        return ERR_OK;
    }
    if (positions_is_off(h, field, n)) {
        h->n_off++;
        return ERR_OK;
    }
    enum err_code rc = ERR_OK;
    if (!comma && h->wide == TABLE_FIELDS && p->epsg > 0 && p->epsg != POSITIONS_LONLAT)
        rc = positions_check_grouped(t, field, n, e);
    if (!rc)
        rc = positions_numbers(t, h, p->epsg == POSITIONS_LONLAT, field, n, v, e);
    if (rc)
        return rc;
    const char *image = h->column[COLUMN_IMAGE] < n ? field[h->column[COLUMN_IMAGE]] : "";
    if (!*image || strlen(image) >= sizeof one.image)
        return err_set(e, ERR_FORMAT, "%s: line %zu: no photograph is named, or by over %d bytes",
                       t->path, t->line, POSITION_IMAGE_MAX - 1);
    snprintf(one.image, sizeof one.image, "%s", image);
    memcpy(one.at, v + COLUMN_X, sizeof one.at);
    double axes = sqrt(0.5 * (v[COLUMN_EAST] * v[COLUMN_EAST] + v[COLUMN_NORTH] * v[COLUMN_NORTH]));
    one.sigma_m[0] = v[COLUMN_PLAN] > 0 ? v[COLUMN_PLAN] : axes > 0 ? axes : v[COLUMN_BOTH];
    one.sigma_m[1] = v[COLUMN_HEIGHT] > 0 ? v[COLUMN_HEIGHT] : v[COLUMN_BOTH];
    return positions_add(p, &one, e);
}

/* Is it a heading, as Metashape's "#Label,X/Longitude,..."? Other lines that begin so are comments.
 */
static bool positions_is_heading(const char *line)
{
    char copy[TABLE_LINE_MAX], *field[TABLE_FIELDS];
    size_t known = 0;
    snprintf(copy, sizeof copy, "%s", line);
    const size_t n = table_split(copy, table_separator(line, positions_known), field);
    for (size_t i = 0; i < n; i++)
        known += positions_known(field[i]);
    return known >= 3;
}

/* Does a line name the coordinate system? EPSG:4979 is WGS 84 with heights. */
static bool positions_take_system(const char *line, struct positions *p)
{
    const int with_heights = 4979;
    int epsg, heights;
    if (!wkt_system(line, &epsg, &heights))
        return false;
    p->epsg = epsg == with_heights ? POSITIONS_LONLAT : epsg;
    if (heights)
        snprintf(p->heights, sizeof p->heights, "EPSG:%d", heights);
    else if (epsg == with_heights)
        snprintf(p->heights, sizeof p->heights, "ellipsoid");
    return true;
}

/* Comments above the heading; one may name the coordinate system. */
static enum err_code positions_comments(struct table *t, char *line, struct positions *p,
                                        struct err *e)
{
    bool more = true;
    enum err_code rc = ERR_OK;
    while (!rc && more && (*line == '#' || !strncmp(line, "//", 2)) &&
           !positions_is_heading(line)) {
        (void)positions_take_system(line, p);
        rc = table_next(t, line, &more, e);
    }
    return !rc && !more ? err_set(e, ERR_DATA, "%s: no positions", t->path) : rc;
}

/* OpenDroneMap's geo.txt: below the coordinate system a line has a photograph, x, y, z, and if they
 * are known three angles and the accuracies in plan and height. */
static bool positions_geo_head(const char *line, struct positions *p, struct positions_head *h)
{
    if (!positions_take_system(line, p) &&
        *line != '+') /* a system by PROJ may have no code here */
        return false;
    h->enabled = h->ref[COLUMN_X] = h->ref[COLUMN_Y] = h->ref[COLUMN_Z] = SIZE_MAX;
    for (size_t c = 0; c < COLUMNS; c++)
        h->column[c] = c <= COLUMN_Z ? c : SIZE_MAX;
    h->column[COLUMN_PLAN] = 7;
    h->column[COLUMN_HEIGHT] = 8;
    h->wide = TABLE_FIELDS;
    return true;
}

enum err_code positions_csv(struct table *t, char *line, struct positions *p, struct err *e)
{
    struct positions_head h = {0};
    bool more = true;
    enum err_code rc = positions_comments(t, line, p, e);
    if (!rc && !positions_geo_head(line, p, &h))
        rc = positions_csv_head(t, line, p, &h, e);
    while (!rc && !(rc = table_next(t, line, &more, e)) && more)
        if (*line != '#')
            rc = positions_csv_row(t, &h, line, p, e);
    if (!rc && p->n_left_out)
        log_warn("positions", "%s: %zu rows have no coordinates and are left out", t->path,
                 p->n_left_out);
    if (!rc && h.n_off)
        log_warn("positions", "%s: %zu rows are switched off and are left out", t->path, h.n_off);
    return rc;
}
