/* Reads XML by one pass over its tags: no tree, no namespaces, no entities except XML's five and
 * characters by number. A document type is refused. The caller reads the text between tags.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_XML_H
#define CODEC_XML_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

enum { XML_NAME = 24 };
struct xml_tag {
    char name[XML_NAME];     /* cut if it is longer */
    const char *attrs, *end; /* its attributes */
    bool opens, closes;      /* both: it is empty */
};
struct xml {
    const char *path; /* for messages */
    const char *p;    /* what comes next; the text ends with 0 */
    size_t line;      /* from 1 */
};
/* Finds the next tag; *more: there is one, and x->p then points behind it. Comments and
 * declarations are skipped. ERR_FORMAT names the line. */
enum err_code xml_next(struct xml *x, struct xml_tag *t, bool *more, struct err *e) ERR_USE;
/* Sets ERR_FORMAT with path and line, and returns it. */
enum err_code xml_bad(const struct xml *x, const char *why, struct err *e) ERR_USE;
/* Reads one character or entity of [p, end) as at most 4 bytes; returns the place behind it. */
const char *xml_character(const char *p, const char *end, char out[8], size_t *n);
/* Reads an attribute and replaces its entities. Returns false if it is absent or too long. */
bool xml_attr(const struct xml_tag *t, const char *name, char *out, size_t size);
/* Read an attribute that must be a finite number, or an integer. Return false if it is not. */
bool xml_number(const struct xml_tag *t, const char *name, double *out);
bool xml_id(const struct xml_tag *t, const char *name, long long *out);
/* Returns whether an attribute is "false" or "0". */
bool xml_off(const struct xml_tag *t, const char *name);

#endif
