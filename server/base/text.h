/* Parses a request's target from left to right. A function returns false if the text is not of its
 * form. The text t is then undefined, so the caller gives up or works on a copy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_TEXT_H
#define SERVER_TEXT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/err.h"

struct text { /* the rest to read, borrowed */
    const char *p, *end;
};

bool text_take(struct text *t, const char *word); /* false: t is unchanged */
int text_hex(char c);                             /* value of a hexadecimal digit; -1: it is none */
bool text_at_end(const struct text *t);
/* Reads a natural number of at most 9 digits, without leading zeros. */
bool text_take_uint(struct text *t, uint32_t *out);
/* Reads [-+]digits[.digits] times 10^scale, rounded half away from zero. It has at most 9 digits
 * before the point and any number after it: programs print a double with up to 17. "-0" is 0. */
bool text_take_fixed(struct text *t, int scale, int64_t *out);
/* Reads n numbers joined by commas, longitude and latitude in turn, in 1e-7 degrees. ERR_NOENT: it
 * is no such text; e is not set. ERR_DATA: "WHAT no longitude and latitude". */
enum err_code text_take_degrees(struct text *t, int n, const char *what, int32_t *out_e7,
                                struct err *e) ERR_USE;
/* Percent-decodes the rest of t; '+' becomes `plus`. False: it is too long for out, or has a broken
 * escape or a control character. */
bool text_take_unescaped(struct text *t, char plus, char *out, size_t room);
/* The same as UTF-8, with a space for '+', as in forms. False as well: it is empty, or no UTF-8. */
bool text_take_decoded(struct text *t, char *out, size_t room);

/* Percent-encodes a text as a value of a query. RFC 3986's unreserved characters stay, and so do
 * ',' ':' '=', which it allows there. out has 3 bytes for each byte of text, and one more. */
void text_escape(const char *text, char *out);

bool text_is_utf8(const char *text);
/* Returns whether a text has no control characters except tabs (RFC 9110, section 5.5). */
bool text_is_clean(const char *p, size_t n);

/* Writes at p and returns the end. There must be room, and no NUL is written. Every answer of a
 * tile uses it, because printf would be a tenth of the work. */
char *text_put(char *p, const char *word);
char *text_put_uint(char *p, uint32_t v); /* in decimal, at most TEXT_UINT bytes */
enum { TEXT_UINT = 10 };

#endif
