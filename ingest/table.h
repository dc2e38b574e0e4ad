/* Lines of fields, as lists of ground control points and of positions are: by commas, semicolons or
 * blanks, numbers with a decimal point. And names of photographs, as such lists write them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef INGEST_TABLE_H
#define INGEST_TABLE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct buf;

enum { TABLE_FIELDS = 32, TABLE_LINE_MAX = 1024 };
struct table { /* {0}, then table_open; table_close it */
    const char *path;
    struct buf *bytes;
    char *next;  /* NULL: no more */
    size_t line; /* of the last that was read, from 1 */
};
/* ERR_NOENT, ERR_IO, ERR_LIMIT, ERR_MEM. */
enum err_code table_open(const char *path, struct table *out, struct err *e) ERR_USE;
void table_close(struct table *t);
/* The next line that is not empty, without blanks before it. *more: there was one. ERR_FORMAT: it
 * is too long. */
enum err_code table_next(struct table *t, char line[TABLE_LINE_MAX], bool *more,
                         struct err *e) ERR_USE;
/* Split at `comma`, or at 0 at blanks, commas and semicolons, in place; blanks around fields go.
 * Returns how many there are. */
size_t table_split(char *text, char comma, char *field[TABLE_FIELDS]);
/* A finite number of at most 1e12, and nothing else. */
bool table_number(const char *text, double *out);
/* "634676,12": digits around a comma, where commas do not divide the fields; its length, 0: none.
 */
size_t table_decimal_comma(const char *line, const char **at);
/* How well the path of a photograph and the one of a list end alike, 0 for not: folders that both
 * have must be the same, capitals do not matter (cameras write .JPG), the whole path is better than
 * a part. */
size_t table_alike(const char *photo, const char *listed);

#endif
