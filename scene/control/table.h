/* Reads lines of fields, as in lists of ground control points and of positions. Fields are
 * separated by commas, semicolons or blanks, and numbers have a decimal point, or a
 * decimal comma where fields are separated by semicolons or tabs. Also compares names
 * of photographs in such lists.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SCENE_CONTROL_TABLE_H
#define SCENE_CONTROL_TABLE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct buf;

enum { TABLE_FIELDS = 32, TABLE_LINE_MAX = 4096, TABLE_HEADING = 64 };
struct table { /* {0}, then table_open; table_close it */
    const char *path;
    struct buf *bytes;
    char *next;     /* NULL: no more */
    size_t line;    /* number of the last line that was read, from 1 */
    bool commas;    /* decimal commas were found and reported */
    bool thousands; /* one of them may separate thousands; reported */
};
/* Opens a file of UTF-8 or UTF-16. Close *out with table_close. ERR_NOENT, ERR_FORMAT (no text),
 * ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code table_open(const char *path, struct table *out, struct err *e) ERR_USE;
void table_close(struct table *t);
/* Reads the next line that is not empty, without leading blanks. *more: there was one. ERR_FORMAT:
 * it is too long. */
enum err_code table_next(struct table *t, char line[TABLE_LINE_MAX], bool *more,
                         struct err *e) ERR_USE;
/* Splits text in place at `comma`, or if that is 0 at blanks, commas and semicolons. Blanks around
 * fields are removed, and with a comma quotes. Returns the number of fields. */
size_t table_split(char *text, char comma, char *field[TABLE_FIELDS]);
/* Returns the character that divides a line of headings: of comma, semicolon and tab the one that
 * gives the most fields which `known` knows; 0: none gives two, blanks divide it. */
char table_separator(const char *line, bool (*known)(const char *field));
/* Writes the name of a column in a standard form: "Accuracy Horizontal (m)" as accuracy_horizontal,
 * "#Label" as Label, "X/Easting" as Easting. */
void table_heading(const char *field, char out[TABLE_HEADING]);
/* Checks that a heading has no unit in brackets, or metres or degrees: another one would give
 * silent nonsense. ERR_FORMAT. */
enum err_code table_check_unit(const char *path, size_t line, const char *field,
                               struct err *e) ERR_USE;
/* Parses a finite number of at most 1e12 and nothing else. Returns false if the text is no such
 * number. */
bool table_number(const char *text, double *out);
/* Is a field that is no number one with thousands separators: "5 123 456.78", "5,123", "5'123"? */
bool table_is_grouped(const char *field);
/* The end of a message about a line in which numbers do not stand where they should. */
#define TABLE_DIVIDED                                                                              \
    "are there decimal commas or thousands separators? Write numbers as 5123456.78"
/* Finds a decimal comma, as in "634676,12", in a line whose fields are not separated by commas.
 * Returns its length; 0: there is none. */
size_t table_decimal_comma(const char *line, const char **at);
/* Replaces decimal commas of such a line by points. The first of a table is reported. */
void table_decimal_points(struct table *t, char *line);
/* Rates how well the path of a photograph matches one in a list, from its end. 0: no match. Folders
 * that both have must be equal. Case is ignored, because cameras write .JPG. A match of the whole
 * path rates higher than one of a part, and a name with its ending higher than a name without, such
 * as Metashape's labels. A letter with an accent is the same as one character and as two (NFC and
 * NFD of Unicode: systems differ in what they make of file names). Such a match rates lowest. It is
 * tried where only one of the names has accents as characters of their own; which letters carry
 * accents is not compared then. */
size_t table_alike(const char *photo, const char *listed);
/* Is it the same path but for case, the direction of slashes, and the form of letters with accents?
 */
bool table_same_path(const char *a, const char *b);
/* Names of a list that are not written as those of the photographs which they match. */
struct table_renamed {
    size_t n;
    const char *photo, *listed; /* the first; borrowed */
};
/* Notes a match whose names differ in case, slashes or accents. */
void table_rename(struct table_renamed *r, const char *photo, const char *listed);
/* Reports them, if there are any. what: the list. */
void table_tell_renamed(const struct table_renamed *r, const char *what);

#endif
